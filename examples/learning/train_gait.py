"""Tune the gait on `Gait`: the best of phase offsets in quarters, then CMA-ES over all parameters.

    python examples/learning/train_gait.py -o runs/gait --ground highland

Needs `pip install -e '.[train]'`. One constant action is judged over whole episodes. A run that
was stopped goes on where it was. It writes `policy.onnx`, its card, `log.jsonl`, and what
TensorBoard shows. Training never sees the seeds of the study.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
from pathlib import Path
import pickle
import time
from typing import Any

import cma
from episodes import run_episode
import numpy as np
from rich.progress import track
from torch.utils.tensorboard import SummaryWriter

from lunar_rover_sim.autonomy.learning.gait_task import gait_of
from lunar_rover_sim.autonomy.learning.policy_file import constant_layers, Policy, save_policy
from lunar_rover_sim.autonomy.learning.task import RoverTask
from lunar_rover_sim.autonomy.learning.tasks import make_task
from lunar_rover_sim.rover.gait.config import CUSTOM, GaitConfig
from lunar_rover_sim.rover.rover_file import load_rover

EVALUATED = range(20_000, 20_004)       # seeds that are neither trained on nor hidden
MOST_STARTS = 64
FAILED = 5.0    # cost of an episode that ends early, which has no energy to pay any more


def main() -> None:
    """Tune, from the packaged gait or from the checkpoint of the folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('-o', '--output', type=Path, required=True)
    parser.add_argument('--ground', default='highland')
    parser.add_argument('--rover', default='quad')
    parser.add_argument('--speed', type=float, default=0.12)
    parser.add_argument('--generations', type=int, default=40)
    parser.add_argument('--minutes', type=float, default=120.0, help='stop after this time')
    parser.add_argument('--population', type=int, default=10)
    parser.add_argument('--episodes', type=int, default=2, help='of each candidate')
    parser.add_argument('--episode', type=float, default=8.0, help='length of each [s]')
    parser.add_argument('--shaking', type=float, default=0.0, help='cost of pitch and roll rates')
    parser.add_argument('--sigma', type=float, default=0.15)
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    task = make_task('gait', {
        'ground': args.ground, 'rover': args.rover, 'randomise': False, 'start_s': 2.4,
        'forward_mps': (args.speed, args.speed), 'shaking_weight': args.shaking,
        'episode_s': args.episode})
    end_s = time.monotonic() + 60.0 * args.minutes
    kept = args.output / 'checkpoint.pickle'
    if kept.exists():
        search = pickle.loads(kept.read_bytes())
    else:
        start = best_phases(task, args)
        search = cma.CMAEvolutionStrategy(start, args.sigma, {
            'popsize': args.population, 'seed': args.seed, 'bounds': [-1.0, 1.0],
            'verbose': -9})
    with SummaryWriter(str(args.output / 'tensorboard')) as board:
        for _ in track(range(search.countiter, args.generations), description='generations'):
            first = int(np.random.default_rng((args.seed, search.countiter)).integers(10_000))
            candidates = search.ask()
            costs = [cost(task, one, range(first, first + args.episodes)) for one in candidates]
            search.tell(candidates, costs)
            kept.write_bytes(pickle.dumps(search))
            line = {'generation': search.countiter, 'best': min(costs),
                    'median': float(np.median(costs)), 'sigma': search.sigma}
            if search.countiter % 5 == 0 or search.countiter == args.generations:
                line['evaluated'] = cost(task, search.mean, EVALUATED)
            for name, value in line.items():
                board.add_scalar(f'cost/{name}', value, search.countiter)
            log(args.output, {**line, 'mean': np.round(search.mean, 3).tolist()})
            save(args.output, task, search, args)
            if time.monotonic() > end_s:
                break
    task.close()


def best_phases(task: RoverTask, args: argparse.Namespace) -> np.ndarray:
    """Return the action with the phase offsets, in quarters of a cycle, that cost least."""
    phases = [k for k, one in enumerate(task.actions) if one.name.startswith('phase/')]
    choices = list(itertools.product((-0.5, 0.0, 0.5, 1.0), repeat=len(phases)))
    if len(choices) > MOST_STARTS:
        chosen = np.random.default_rng(args.seed).choice(len(choices), MOST_STARTS, replace=False)
        choices = [choices[k] for k in chosen]
    found = []
    for choice in track(choices, description='phase offsets'):
        action = np.zeros(len(task.actions))
        action[phases] = choice
        found.append((cost(task, action, range(500, 501)), action))
        log(args.output, {'phases': choice, 'cost': found[-1][0]})
    return min(found, key=lambda one: one[0])[1]


def cost(task: RoverTask, action: np.ndarray, seeds: range) -> float:
    """Return the mean cost of episodes with one constant action."""
    episodes = [run_episode(task, lambda _: action, seed) for seed in seeds]
    return float(np.mean([FAILED * failed - total for total, failed in episodes]))


def tuned(policy: str, rover: str) -> dict[str, Any]:
    """Return the options of `Walk` by which a residual of zero walks as a policy of `Gait`."""
    if not policy:
        return {}
    card, packaged = Policy(policy).card, GaitConfig().for_rover(load_rover(rover))
    action = Policy(policy).act(np.zeros(len(card.observation), np.float32))
    gait, factor = gait_of(action, card.action, dataclasses.replace(packaged, gait=CUSTOM))
    return {'gait': gait.to_mapping(), 'speed_factor': factor}


def save(folder: Path, task: RoverTask, search: cma.CMAEvolutionStrategy,
         args: argparse.Namespace) -> None:
    """Write the mean of the search as a policy."""
    decisions = round(args.episode * 1e9 / task.driver.decision_ns)
    episodes = search.countiter * args.population * args.episodes + MOST_STARTS
    save_policy(folder / 'policy.onnx', constant_layers(task, np.clip(search.mean, -1.0, 1.0)),
                task, {'algorithm': f'phase offsets in quarters, then CMA-ES, {search.countiter}'
                       f' generations of {args.population}',
                       'decisions': episodes * decisions, 'seeds': [args.seed]})


def log(folder: Path, line: dict) -> None:
    """Add a line to the log."""
    with (folder / 'log.jsonl').open('a', encoding='utf-8') as file:
        file.write(json.dumps(line) + '\n')


if __name__ == '__main__':
    main()
