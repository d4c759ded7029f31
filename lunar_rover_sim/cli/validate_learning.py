"""`lunar_rover_sim validate learning`: policies against the packaged gait on hidden seeds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from lunar_rover_sim.autonomy.learning.policy_file import Policy, policy_names, policy_path
from lunar_rover_sim.autonomy.learning.randomisation import GROUNDS as ALL_GROUNDS
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_markdown, Progress, say
from lunar_rover_sim.judge.studies.learning import (Case, COMMANDS, GROUNDS, HIDDEN_SEEDS,
                                                    PACKAGED, SETTINGS, SLOPES_DEG, walk,
                                                    WalkStore, write_all)


def _velocity(text: str) -> tuple[float, float]:
    """Return the velocity that `MPS,RADPS` names; raise ConfigError for anything else."""
    try:
        speed, yaw_rate = (float(part) for part in text.split(','))
    except ValueError:
        speed = yaw_rate = -1.0
    if not (0.0 <= speed <= 1.0 and abs(yaw_rate) <= 1.0 and (speed or yaw_rate)):
        raise ConfigError(f'--commands: {text} is not valid; valid is MPS,RADPS, a speed of 0 to 1'
                          ' [m/s] and a yaw rate of -1 to 1 [rad/s], not both 0')
    return speed, yaw_rate


@options.command()
@options.argument('policies', 'packaged policies or files; by default all packaged ones', nargs=-1,
                  metavar='[POLICY]...')
@click.option('--against', metavar='WALKER', default=PACKAGED, help='what the others are compared '
              'with: packaged, or one of the policies')
@options.folder('folder for learning.md, learning.csv and the finished walks')
@options.resume('walks')
@options.several('--grounds', type=options.Choice(ALL_GROUNDS), default=GROUNDS,
                 metavar='GROUND...', help=f'of {", ".join(ALL_GROUNDS)}')
@options.several('--slopes', type=options.number('--slopes', 0.0, 30.0, 'deg'),
                 default=SLOPES_DEG, metavar='DEG...', help='uphill [deg]')
@options.several('--commands', type=_velocity, default=[f'{v:g},{w:g}' for v, w in COMMANDS],
                 metavar='MPS,RADPS...', help='speed and yaw rate')
@options.bounded('--seeds', 1, len(HIDDEN_SEEDS), kind=int, default=len(HIDDEN_SEEDS),
                 help='number of worlds')
@click.option('--rover', default='quad', metavar='NAME_OR_PATH',
              help='a packaged rover or a rover file')
@options.workers('processes that walk')
def learning(policies: Sequence[str], against: str, output: Path, resume: bool,
             grounds: Sequence[str], slopes: Sequence[float],
             commands: Sequence[tuple[float, float]], seeds: int, rover: str, workers: int) -> int:
    """Compare policies with the packaged gait on hidden seeds.

    All walk over the same worlds, which no training saw, by the same commands, and are compared
    in pairs.
    """
    names = policies or policy_names()
    for policy in names:
        Policy(policy)
    if against not in (PACKAGED, *names):
        raise ConfigError(f'--against: {against} is not valid; valid are '
                          f'{", ".join((PACKAGED, *names))}')
    walker_of = {PACKAGED: PACKAGED, **{
        name: name if name in policy_names() else str(policy_path(name).resolve())
        for name in names}}
    cases = [Case(walker, ground, slope, seed, rover, *command)
             for slope in slopes for ground in grounds for command in commands
             for seed in HIDDEN_SEEDS[:seeds] for walker in walker_of.values()]
    store = WalkStore(output, SETTINGS, resume)
    with Progress('walking', len(cases)) as progress:
        walks = list(store.study(walk, cases, workers,
                                 lambda _case, _walk, done: progress(done)).values())
    print_markdown(write_all(walks, walker_of[against], output))
    say(f'{output}: {len(walks)} walks')
    return 0
