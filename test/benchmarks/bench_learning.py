"""Decisions of the environments: `python test/benchmarks/bench_learning.py [--task Gait]`.

For 1, 16 and 64 environments on rigid and soft ground, interleaved so that other load hits all
alike: decisions a minute of wall time and of processor time, of all threads. With --policy, the
time of one decision of `PolicyController`.
"""

from __future__ import annotations

import argparse
import dataclasses
import time

import gymnasium
import numpy as np

from lunar_rover_sim.autonomy.learning.controller import PolicyController
from lunar_rover_sim.autonomy.learning.policy_file import Policy
from lunar_rover_sim.autonomy.learning.senses import Sample
from lunar_rover_sim.autonomy.learning.tasks import make_task
from lunar_rover_sim.rover.description import load_rover

COUNTS, GROUNDS, ROUNDS = (1, 16, 64), ('rigid', 'highland'), 2
DECISIONS = {'Walk': 640, 'Gait': 64, 'Reach': 64}      # of each round, of all environments


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--task', choices=tuple(DECISIONS), default='Walk')
    parser.add_argument('--policy', help='a policy of Walk: time its decisions instead')
    args = parser.parse_args()
    if args.policy:
        decide(args.policy)
        return
    cases = {(ground, count): gymnasium.make_vec(
        f'lunar_rover_sim.autonomy.learning:lunar_rover_sim/{args.task}-v0', num_envs=count,
        ground=ground)
        for ground in GROUNDS for count in COUNTS}
    for envs in cases.values():
        envs.reset(seed=1)
    found: dict[tuple[str, int], list[tuple[float, float]]] = {case: [] for case in cases}
    for _ in range(ROUNDS):
        for case, envs in cases.items():
            steps = max(2, DECISIONS[args.task] // envs.num_envs)
            actions = np.zeros(envs.action_space.shape)
            wall, cpu = time.perf_counter(), time.process_time()
            for _ in range(steps):
                envs.step(actions)
            made = 60.0 * steps * envs.num_envs
            found[case].append((made / (time.perf_counter() - wall),
                                made / (time.process_time() - cpu)))
    print('| ground | environments | decisions a minute | of processor time | range |')
    print('|---|---|---|---|---|')
    for (ground, count), pairs in found.items():
        wall, cpu = np.median(pairs, axis=0)
        print(f'| {ground} | {count} | {wall:,.0f} | {cpu:,.0f} '
              f'| {min(c for _, c in pairs):,.0f} to {max(c for _, c in pairs):,.0f} |')


def decide(path: str) -> None:
    """Print the processor time of a decision."""
    card = Policy(path).card
    task = make_task(card.task, {**card.options, 'randomise': False})
    task.reset(np.random.default_rng(1))
    controller = PolicyController(Policy(path), load_rover(card.rover))
    controller.set_velocity(0.12, 0.0)
    times = []
    for k in range(2000):
        sample = dataclasses.replace(Sample.of(task.state),
                                     stamp_ns=k * controller.driver.decision_ns)
        start = time.process_time()
        controller.update(sample)
        times.append(time.process_time() - start)
    print(f'{1e3 * np.median(times):.3f} ms a decision, p99 {1e3 * np.percentile(times, 99):.3f}'
          ' ms')


if __name__ == '__main__':
    main()
