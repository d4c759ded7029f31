"""`lunar_rover_sim validate odometry`: wheel odometry against the truth, and its parameters."""

from __future__ import annotations

import dataclasses

import click
import numpy as np

from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_table, Progress, say
from lunar_rover_sim.judge.studies import odometry as study
from lunar_rover_sim.run.scenario import Scenario

_AXES = ('along the first heading [m]', 'across it [m]', 'yaw [rad]')


@options.command(scenarios=True)
@options.scenario('baseline')
@click.option('-n', '--drives', default=24, metavar='N',
              type=options.number('--drives', study.LEAST_DRIVES, kind=int),
              help='drives, one per seed')
@options.bounded('--duration', study.COMMAND_S, 600.0, unit='s', default=20.0, metavar='S',
                 help='length of each')
@options.seed(1, 'first seed')
@options.overrides()
@options.workers('processes that share the drives')
def odometry(scenario: str, drives: int, duration: float, seed: int, overrides: list[str],
             workers: int) -> int:
    """Compare the wheel odometry with the truth.

    Prints errors, consistency and the parameters that fit, over random drives. Exits with 1 if the
    covariance is not that stated.
    """
    loaded = Scenario.load(scenario, overrides, seed=seed)
    seeds = range(seed, seed + drives)
    with Progress('driving') as progress:
        result = study.study(loaded, seeds, duration, workers, progress)
    print_table(('error at the end of a drive', 'mean', 'root mean square'), 3, (
        (name, f'{errors.mean():+.3f}', f'{np.sqrt(np.mean(errors**2)):.3f}')
        for name, errors in zip(_AXES, result.errors.T)),
        title=f'{result.drives} drives of {duration:g} s on {loaded.name}, '
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
