"""Returns side by side: standing, random gaits, the packaged gait, and policies.

    python examples/learning/returns.py feedback --grounds highland rigid

All walk the same episodes: commands, reliefs, soils and pushes of seeds that nothing was trained
on, with the randomisation of the training. A random gait has each of its parameters drawn evenly,
anew in each episode. The others are compared with the packaged gait in pairs; p is corrected for
the number of tests.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import dataclasses
import itertools
import sys
from typing import Any

from episodes import run_episode, run_main
import numpy as np

from lunar_rover_sim.autonomy.learning.follow import FollowConfig
from lunar_rover_sim.autonomy.learning.gait_task import gait_of
from lunar_rover_sim.autonomy.learning.policy_file import Policy
from lunar_rover_sim.autonomy.learning.tasks import make_task
from lunar_rover_sim.judge.evaluation.statistics import adjusted, Comparison, Mean
from lunar_rover_sim.rover.gait.config import CUSTOM, GaitConfig

FIRST = 90_000          # seed of the first episode
HIDDEN = (90_000, 99_999)       # seeds of reliefs
SHARED = {field.name for field in dataclasses.fields(FollowConfig)}
STANDING, RANDOM, PACKAGED = 'standing', 'random gait', 'packaged'


def main() -> None:
    """Print the mean of each walker, its 95 % interval, and the paired test."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('policies', nargs='*', help='packaged policies of Walk or Gait, or files')
    parser.add_argument('--grounds', nargs='+', default=['highland', 'rigid'])
    parser.add_argument('--episodes', type=int, default=20)
    args = parser.parse_args()
    for name in args.policies:
        Policy(name)    # what cannot be read is refused before anything walks
    found = {}
    for case in itertools.product(args.grounds, (PACKAGED, STANDING, RANDOM, *args.policies)):
        print(*case, file=sys.stderr)
        found[case] = returns_of(case[1], args.episodes, ground=case[0])
    tests = {(ground, walker): Comparison.of(returns, found[ground, PACKAGED])
             for (ground, walker), returns in found.items() if walker != PACKAGED}
    against = {case: dataclasses.replace(test, p=p).text() for (case, test), p
               in zip(tests.items(), adjusted([test.p for test in tests.values()]))}
    for cells in (['ground', 'walker', 'return', 'effect and p against the packaged gait'],
                  ['---'] * 4, *([*case, Mean.of(returns).text(2), against.get(case, '')]
                                 for case, returns in found.items())):
        print('|', ' | '.join(cells), '|')


def returns_of(walker: str, episodes: int, **options: Any) -> np.ndarray:
    """Return the returns of a walker in episodes of 6 s with two commands."""
    options = {'episode_s': 6.0, 'command_s': 3.0,
               'randomise': {'terrain_seed': HIDDEN}, **options}
    returns = []
    for seed in range(FIRST, FIRST + episodes):
        name, own, act = walker_of(walker, seed)
        task = make_task(name, {**options, **own})
        still = np.zeros(len(task.actions))
        returns.append(run_episode(task, act or (lambda _: still), seed)[0])
        task.close()
    return np.array(returns)


def walker_of(walker: str, seed: int
              ) -> tuple[str, dict[str, Any], Callable[..., np.ndarray] | None]:
    """Return the task of a walker, what it sets of it, and its actions, None for zeros."""
    if walker == PACKAGED:
        return 'walk', {}, None
    if walker == STANDING:
        return 'walk', {'action': 'speeds'}, None
    if walker == RANDOM:
        task = make_task('gait', {})
        drawn = np.random.default_rng((seed, 1)).uniform(-1.0, 1.0, len(task.actions))
        gait, factor = gait_of(drawn, task.actions, dataclasses.replace(
            GaitConfig().for_rover(task.rover), gait=CUSTOM, phase_offsets=(0.0,) * 4))
        return 'walk', {'gait': gait.to_mapping(), 'speed_factor': factor}, None
    policy = Policy(walker)
    own = {name: value for name, value in policy.card.options.items()
           if name not in SHARED}
    return policy.card.task, own, policy.act


if __name__ == '__main__':
    run_main(main)
