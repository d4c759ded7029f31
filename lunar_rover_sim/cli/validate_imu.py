"""`lunar_rover_sim validate imu`: read the noise of the IMU back from an hour at rest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.paths import check_file
from lunar_rover_sim.base.files.yaml_text import parse_yaml
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_table, say
from lunar_rover_sim.judge.studies import imu as allan
from lunar_rover_sim.sensors.imu import ImuConfig


@options.command()
@click.option('--preset', default='adis16448', metavar='NAME',
              help='part to simulate (adis16448, bmi160)')
@options.overrides('NAME=VALUE', help='parameter of the IMU, as physics_node has it under imu')
@options.bounded('--hours', 0.05, 24.0, unit='h', default=1.0, help='length of the record')
@options.bounded('--rate', 1.0, 2000.0, unit='Hz', default=200.0, metavar='HZ',
                 help='sampling rate')
@options.seed(1, 'seed of the noise')
@options.output(check_file, 'FILE', 'plot to write', 'imu_allan.png')
def imu(preset: str, overrides: list[str], hours: float, rate: float, seed: int,
        output: Path) -> int:
    """Compare the Allan deviation of an IMU at rest with its configured noise.

    Reads white noise and bias random walk back. Exits with 1 if a density is out of tolerance.
    """
    values: dict[str, Any] = {'preset': preset}
    for item in overrides:
        name, equals, value = item.partition('=')
        if not equals:
            raise ConfigError(f'--set: {item!r} is not valid; valid is NAME=VALUE')
        values[name] = parse_yaml(value, f'--set {name}')
    config = ImuConfig.from_mapping(values, 'imu')
    allan.plot_format(output)   # an error is reported now, not after the study
    sensors = allan.study(config, hours * 3600.0, rate, seed)
    comparisons = allan.compare(sensors)
    print_table(('sensor', 'noise', 'configured', 'read back', 'error', 'bound', ''), 7, (
        (c.sensor, c.noise, f'{c.configured:.4g}', f'{c.measured:.4g}', f'{100 * c.error:+.1f} %',
         f'{100 * c.bound:.0f} %', 'ok' if c.passed else 'OUT') for c in comparisons),
        title=f'{hours:g} h at {rate:g} Hz, preset {config.preset}')
    allan.plot(sensors, output)
    say('white noise in m/s²/√Hz and rad/s/√Hz, bias random walk in m/s³/√Hz and rad/s²/√Hz')
    say(f'plot: {output}')
    return 0 if all(c.passed for c in comparisons) else 1
