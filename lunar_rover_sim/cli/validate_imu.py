"""`lunar_rover_sim validate imu`: read the noise of the IMU back from an hour at rest."""

from __future__ import annotations

import argparse
from pathlib import Path

from lunar_rover_sim.cli.terminal import console, table
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.outputs import check_file
from lunar_rover_sim.files.yaml_text import parse_yaml
from lunar_rover_sim.physics.config import ImuConfig
from lunar_rover_sim.studies import imu


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Simulates an IMU at rest, computes the overlapping Allan deviation and reads'
        ' white noise and bias random walk back from it.')
    parser.add_argument('--preset', default='adis16448', metavar='NAME',
                        help='part to simulate (adis16448, bmi160)')
    parser.add_argument('--set', action='append', default=[], metavar='NAME=VALUE',
                        help='parameter of the IMU, as physics_node has it under imu')
    parser.add_argument('--hours', type=float, default=1.0, help='length of the record')
    parser.add_argument('--rate', type=float, default=200.0, help='sampling rate [Hz]')
    parser.add_argument('--seed', type=int, default=1, help='seed of the noise')
    parser.add_argument('-o', '--output', type=Path, default=Path('imu_allan.png'), metavar='FILE',
                        help='plot to write')
    parser.set_defaults(run=run, check_output=check_file)


def run(args: argparse.Namespace) -> int:
    """Print the table, write the plot; return 1 if a density is out of tolerance."""
    if not 0.05 <= args.hours <= 24.0:
        raise ConfigError(f'--hours: {args.hours} is not valid; valid is 0.05 to 24')
    if not 1.0 <= args.rate <= 2000.0:
        raise ConfigError(f'--rate: {args.rate} is not valid; valid is 1 to 2000 [Hz]')
    values = {'preset': args.preset}
    for item in args.set:
        name, equals, value = item.partition('=')
        if not equals:
            raise ConfigError(f'--set: {item!r} is not valid; valid is NAME=VALUE')
        values[name] = parse_yaml(value, f'--set {name}')
    config = ImuConfig.from_mapping(values, 'imu')
    imu.plot_format(args.output)   # an error is reported now, not after the study
    sensors = imu.study(config, args.hours * 3600.0, args.rate, args.seed)
    comparisons = imu.compare(sensors)
    rows = table(('sensor', 'noise', 'configured', 'read back', 'error', 'bound', ''), 7,
                 title=f'{args.hours:g} h at {args.rate:g} Hz, preset {config.preset}')
    for c in comparisons:
        rows.add_row(c.sensor, c.noise, f'{c.configured:.4g}', f'{c.measured:.4g}',
                     f'{100 * c.error:+.1f} %', f'{100 * c.bound:.0f} %',
                     'ok' if c.passed else 'OUT')
    out = console()
    out.print(rows)
    imu.plot(sensors, args.output)
    out.print('white noise in m/s²/√Hz and rad/s/√Hz, bias random walk in m/s³/√Hz and'
              ' rad/s²/√Hz')
    out.print(f'plot: {args.output}', highlight=False, markup=False, soft_wrap=True)
    return 0 if all(c.passed for c in comparisons) else 1
