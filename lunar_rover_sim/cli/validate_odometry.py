"""`lunar_rover_sim validate odometry`: wheel odometry against the truth, and its parameters."""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np

from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_table, Progress, say
from lunar_rover_sim.judge.studies import odometry
from lunar_rover_sim.run.scenario import Scenario

_AXES = ('along the first heading [m]', 'across it [m]', 'yaw [rad]')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Drives with random commands on the worlds of several seeds, without cameras, compares '
        'the wheel odometry with the truth and prints the parameters that fit.')
    options.add_scenario(parser, 'baseline')
    parser.add_argument('-n', '--drives', default=24, metavar='N',
                        type=options.number('--drives', odometry.LEAST_DRIVES, kind=int),
                        help='drives, one per seed (default: %(default)s)')
    options.add_number(parser, '--duration', odometry.COMMAND_S, 600.0, unit='s', default=20.0,
                       metavar='S', help='length of each')
    options.add_seed(parser, 1, 'first seed')
    options.add_overrides(parser)
    options.add_workers(parser, 'processes that share the drives')


def run(args: argparse.Namespace) -> int:
    """Print errors, consistency and parameters; return 1 if the covariance is not that stated."""
    scenario = Scenario.load(args.scenario, args.overrides, seed=args.seed)
    seeds = range(args.seed, args.seed + args.drives)
    with Progress('driving') as progress:
        result = odometry.study(scenario, seeds, args.duration, args.workers, progress)
    print_table(('error at the end of a drive', 'mean', 'root mean square'), 3, (
        (name, f'{errors.mean():+.3f}', f'{np.sqrt(np.mean(errors**2)):.3f}')
        for name, errors in zip(_AXES, result.errors.T)),
        title=f'{result.drives} drives of {args.duration:g} s on {scenario.name}, '
        f'legs rolled {result.rolled_m:.1f} m')
    if result.tipped_over:
        say('left out, since the rover tipped over: seed '
            f'{", ".join(str(seed) for seed in result.tipped_over)}')
    low, high = result.interval
    say(f'squared error over stated covariance: {result.consistency:.2f}; '
        f'{low:.2f} to {high:.2f} if it is right')
    say('what fits these drives:')
    for name, value in dataclasses.asdict(result.measured).items():
        say(f'  physics_node.wheel_odometry.{name}={value:.3f}')
    return 0 if result.consistent else 1
