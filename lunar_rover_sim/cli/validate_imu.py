"""`lunar_rover_sim validate imu`: read the noise of the IMU back from an hour at rest."""

from __future__ import annotations

import argparse

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.paths import check_file
from lunar_rover_sim.base.files.yaml_text import parse_yaml
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_table, say
from lunar_rover_sim.judge.studies import imu
from lunar_rover_sim.sensors.imu import ImuConfig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Simulates an IMU at rest, computes the overlapping Allan deviation and reads'
        ' white noise and bias random walk back from it.')
    parser.add_argument('--preset', default='adis16448', metavar='NAME',
                        help='part to simulate (adis16448, bmi160)')
    options.add_overrides(parser, 'NAME=VALUE', 'parameter of the IMU, as physics_node has it '
                          'under imu')
    options.add_number(parser, '--hours', 0.05, 24.0, unit='h', default=1.0,
                       help='length of the record')
    options.add_number(parser, '--rate', 1.0, 2000.0, unit='Hz', default=200.0, metavar='HZ',
                       help='sampling rate')
    options.add_seed(parser, 1, 'seed of the noise')
    options.add_output(parser, check_file, 'FILE', 'plot to write', 'imu_allan.png')


def run(args: argparse.Namespace) -> int:
    """Print the table, write the plot; return 1 if a density is out of tolerance."""
    values = {'preset': args.preset}
    for item in args.overrides:
        name, equals, value = item.partition('=')
        if not equals:
            raise ConfigError(f'--set: {item!r} is not valid; valid is NAME=VALUE')
        values[name] = parse_yaml(value, f'--set {name}')
    config = ImuConfig.from_mapping(values, 'imu')
    imu.plot_format(args.output)   # an error is reported now, not after the study
    sensors = imu.study(config, args.hours * 3600.0, args.rate, args.seed)
    comparisons = imu.compare(sensors)
    print_table(('sensor', 'noise', 'configured', 'read back', 'error', 'bound', ''), 7, (
        (c.sensor, c.noise, f'{c.configured:.4g}', f'{c.measured:.4g}', f'{100 * c.error:+.1f} %',
         f'{100 * c.bound:.0f} %', 'ok' if c.passed else 'OUT') for c in comparisons),
        title=f'{args.hours:g} h at {args.rate:g} Hz, preset {config.preset}')
    imu.plot(sensors, args.output)
    say('white noise in m/s²/√Hz and rad/s/√Hz, bias random walk in m/s³/√Hz and rad/s²/√Hz')
    say(f'plot: {args.output}')
    return 0 if all(c.passed for c in comparisons) else 1
