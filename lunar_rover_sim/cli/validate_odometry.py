"""`lunar_rover_sim validate odometry`: wheel odometry against the truth, and its parameters."""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np
from rich.progress import Progress

from lunar_rover_sim.cli.terminal import console, table
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.studies import odometry

_AXES = ('along the first heading [m]', 'across it [m]', 'yaw [rad]')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Drives with random commands on the worlds of several seeds, without cameras, compares '
        'the wheel odometry with the truth and prints the parameters that fit.')
    parser.add_argument('scenario', nargs='?', default='baseline',
                        help='packaged name or YAML file')
    parser.add_argument('-n', '--drives', type=int, default=24, help='drives, one per seed')
    parser.add_argument('--duration', type=float, default=20.0, help='length of each [s]')
    parser.add_argument('--seed', type=int, default=1, help='first seed')
    parser.add_argument('--set', action='append', default=[], metavar='NODE.PARAM=VALUE',
                        dest='overrides', help='change a parameter')
    parser.add_argument('--workers', type=int, default=1, help='processes')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print errors, consistency and parameters; return 1 if the covariance is not that stated."""
    for name, value, least in (('drives', args.drives, odometry.LEAST_DRIVES),
                               ('workers', args.workers, 1)):
        if value < least:
            raise ConfigError(f'--{name}: {value} is not valid; valid is at least {least}')
    if not odometry.COMMAND_S <= args.duration <= 600.0:
        raise ConfigError(f'--duration: {args.duration:g} is not valid; valid is '
                          f'{odometry.COMMAND_S:g} to 600 [s]')
    scenario = Scenario.load(args.scenario, args.overrides, seed=args.seed)
    seeds = range(args.seed, args.seed + args.drives)
    out = console()
    with Progress(console=out, transient=True) as progress:
        task = progress.add_task('driving', total=args.drives)
        result = odometry.study(scenario, seeds, args.duration, args.workers,
                                lambda done, _: progress.update(task, completed=done))
    rows = table(('error at the end of a drive', 'mean', 'root mean square'), 3,
                 title=f'{result.drives} drives of {args.duration:g} s on {scenario.name}, '
                 f'legs rolled {result.rolled_m:.1f} m')
    for name, errors in zip(_AXES, result.errors.T):
        rows.add_row(name, f'{errors.mean():+.3f}', f'{np.sqrt(np.mean(errors**2)):.3f}')
    out.print(rows)
    if result.tipped_over:
        out.print('left out, since the rover tipped over: seed '
                  f'{", ".join(str(seed) for seed in result.tipped_over)}')
    low, high = result.interval
    out.print(f'squared error over stated covariance: {result.consistency:.2f}; '
              f'{low:.2f} to {high:.2f} if it is right')
    out.print('what fits these drives:')
    for name, value in dataclasses.asdict(result.measured).items():
        out.print(f'  physics_node.wheel_odometry.{name}={value:.3f}', highlight=False,
                  markup=False, soft_wrap=True)
    return 0 if result.consistent else 1
