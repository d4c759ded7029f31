"""`lunar_rover_sim validate imu`: read the noise of the IMU back from an hour at rest."""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console
from rich.table import Table

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.yaml_text import parse_yaml
from lunar_rover_sim.physics.config import ImuConfig
from lunar_rover_sim.physics.imu import ImuNoise, noise_parameters
from lunar_rover_sim.studies.allan import fit_noise, NoiseFit, overlapping_allan

TOLERANCE = {'white noise': 0.05, 'bias random walk': 0.15}


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
    parser.add_argument('-o', '--output', default='imu_allan.png', help='plot to write')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the table, write the plot; return 1 if a figure is out of tolerance."""
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
    output = Path(args.output)
    if not output.parent.is_dir():
        raise ConfigError(f'--output: the folder {output.parent} does not exist')

    n = round(args.hours * 3600.0 * args.rate)
    at_rest = np.broadcast_to([0.0, 0.0, 1.62], (n, 3))
    noise = ImuNoise(config, args.rate, np.random.default_rng(args.seed))
    sample = noise.measure_many(at_rest, np.zeros((n, 3)))
    curves = [overlapping_allan(signal, args.rate)
              for signal in (sample.specific_force, sample.rate)]
    fits = [fit_noise(curve) for curve in curves]

    true = noise_parameters(config)
    rows = [
        ('accelerometer', 'white noise', true.accel_noise_density, fits[0].white),
        ('accelerometer', 'bias random walk', true.accel_bias_random_walk, fits[0].random_walk),
        ('gyroscope', 'white noise', true.gyro_noise_density, fits[1].white),
        ('gyroscope', 'bias random walk', true.gyro_bias_random_walk, fits[1].random_walk),
    ]
    table = Table('sensor', 'noise', 'configured', 'read back', 'error', 'bound', '',
                  title=f'{args.hours:g} h at {args.rate:g} Hz, preset {config.preset}')
    passed = True
    for sensor, parameter, configured, measured in rows:
        bound = TOLERANCE[parameter]
        error = measured / configured - 1.0 if configured > 0.0 else 0.0
        good = abs(error) <= bound
        passed &= good
        table.add_row(sensor, parameter, f'{configured:.4g}', f'{measured:.4g}',
                      f'{100 * error:+.1f} %', f'{100 * bound:.0f} %', 'ok' if good else 'OUT')
    console = Console()
    console.print(table)
    _plot(curves, fits, true, output)
    console.print('white noise in m/s²/√Hz and rad/s/√Hz, bias random walk in m/s³/√Hz and'
                  ' rad/s²/√Hz')
    console.print(f'plot: {output}')
    return 0 if passed else 1


def _plot(curves, fits, true, output) -> None:  # type: ignore[no-untyped-def]
    matplotlib.use('Agg')
    configured = (NoiseFit(true.accel_noise_density, true.accel_bias_random_walk),
                  NoiseFit(true.gyro_noise_density, true.gyro_bias_random_walk))
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.5), constrained_layout=True)
    labels = (('accelerometer', 'm/s²'), ('gyroscope', 'rad/s'))
    for ax, curve, fit, given, (name, unit) in zip(axes, curves, fits, configured, labels):
        for axis, letter in enumerate('xyz'):
            ax.loglog(curve.tau_s, curve.deviation[:, axis], '.', ms=4, label=letter)
        ax.loglog(curve.tau_s, given.deviation(curve.tau_s), 'k-', lw=2, alpha=0.4,
                  label='configured')
        ax.loglog(curve.tau_s, fit.deviation(curve.tau_s), 'r--', lw=1, label='read back')
        ax.set_title(name)
        ax.set_xlabel('averaging time [s]')
        ax.set_ylabel(f'Allan deviation [{unit}]')
        ax.grid(True, which='both', alpha=0.3)
        ax.legend()
    figure.savefig(output, dpi=110)
    plt.close(figure)
