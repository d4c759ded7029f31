"""Tune the gait on `Gait`: the best of phase offsets in quarters, then CMA-ES over all parameters.

    python examples/learning/train_gait.py -o runs/gait --ground highland

Needs `pip install -e '.[train]'`. One constant action is judged over whole episodes with commands
of all speeds and turns. Legs on the right follow those on the left by half a cycle, so that left
and right turns are alike. A run that was stopped goes on where it was. It writes `policy.onnx`,
its card and `log.jsonl`. Training never sees the seeds of the study.
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

from episodes import run_episode, run_main, train_extra
import numpy as np
from rich.progress import track

from lunar_rover_sim.autonomy.learning.gait_task import gait_of
from lunar_rover_sim.autonomy.learning.policy_file import constant_layers, Policy, save_policy
from lunar_rover_sim.autonomy.learning.task import RoverTask
from lunar_rover_sim.autonomy.learning.tasks import make_task
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.rover.gait.config import CUSTOM, GaitConfig

with train_extra():
    import cma

EVALUATED = range(20_000, 20_004)       # seeds that are neither trained on nor hidden
MOST_STARTS = 64
EPISODE_S, COMMAND_S = 6.0, 3.0


def main() -> None:
    """Tune, from the packaged gait or from the checkpoint of the folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('-o', '--output', type=Path, required=True)
    parser.add_argument('--ground', default='highland')
    parser.add_argument('--rover', default='quad')
    parser.add_argument('--generations', type=int, default=40)
    parser.add_argument('--minutes', type=float, default=120.0, help='stop after this time')
    parser.add_argument('--population', type=int, default=10)
    parser.add_argument('--episodes', type=int, default=2, help='of each candidate')
    parser.add_argument('--sigma', type=float, default=0.15)
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    task = make_task('gait', {'ground': args.ground, 'rover': args.rover, 'randomise': False,
                              'episode_s': EPISODE_S, 'command_s': COMMAND_S})
    end_s = time.monotonic() + 60.0 * args.minutes
    kept = args.output / 'checkpoint.pickle'
    if kept.exists():
        search = pickle.loads(kept.read_bytes())
    else:
        rows = max(task.rover.legs.rows())
        start = best_phases(task, rows, args)
        # Phases go round.
        ends = [1.0] * (len(start) - rows) + [None] * rows
        search = cma.CMAEvolutionStrategy(start, args.sigma, {
            'popsize': args.population, 'seed': args.seed, 'verbose': -9,
            'bounds': [[end and -end for end in ends], ends]})
    for _ in track(range(search.countiter, args.generations), description='generations'):
        first = int(np.random.default_rng((args.seed, search.countiter)).integers(10_000))
        candidates = search.ask()
        returns = [mean_return(task, one, range(first, first + args.episodes))
                   for one in candidates]
        search.tell(candidates, [-one for one in returns])
        kept.write_bytes(pickle.dumps(search))
        line = {'generation': search.countiter, 'best': max(returns),
                'median': float(np.median(returns)), 'sigma': search.sigma}
        if search.countiter % 5 == 0 or search.countiter == args.generations:
            line['evaluated'] = mean_return(task, search.mean, EVALUATED)
        log(args.output, {**line, 'mean': np.round(search.mean, 3).tolist()})
        save(args.output, task, search, args)
        if time.monotonic() > end_s:
            break
    task.close()


def best_phases(task: RoverTask, rows: int, args: argparse.Namespace) -> np.ndarray:
    """Return the numbers with the phases of the rows, in quarters of a cycle, that return most."""
    choices = list(itertools.product((0.0, 0.5, 1.0, 1.5), repeat=rows))[:MOST_STARTS]
    found = []
    for choice in track(choices, description='phase offsets'):
        numbers = np.array([*np.zeros(len(shape_names(task))), *choice])
        found.append((mean_return(task, numbers, EVALUATED), numbers))
        log(args.output, {'phases': choice, 'return': found[-1][0]})
    return max(found, key=lambda one: one[0])[1]


def shape_names(task: RoverTask) -> list[str]:
    """Return the names of the actions that are no phases."""
    return [one.name for one in task.actions if not one.name.startswith('phase/')]


def action_of(task: RoverTask, numbers: np.ndarray) -> np.ndarray:
    """Return the action of a search's numbers: those of the shape, and a phase of each row.

    A phase is in half cycles behind the first row; legs on the right follow by half a cycle.
    """
    legs, shape = task.rover.legs, len(shape_names(task))
    behind = [0.0, *(0.5 * numbers[shape:])]
    action = np.clip(numbers, -1.0, 1.0)[:shape].tolist()
    for channel, row, left in list(zip(task.actions[shape - 1:], legs.rows(), legs.on_left))[1:]:
        apart = behind[row] + (0.0 if left else 0.5) - channel.offset
        action.append(((apart + 0.5) % 1.0 - 0.5) / channel.scale)
    return np.array(action)


def mean_return(task: RoverTask, numbers: np.ndarray, seeds: range) -> float:
    """Return the mean return of episodes with the action of a search's numbers."""
    action = action_of(task, numbers)
    return float(np.mean([run_episode(task, lambda _: action, seed)[0] for seed in seeds]))


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
    decisions = round(EPISODE_S * 1e9 / task.driver.decision_ns)
    save_policy(folder / 'policy.onnx', constant_layers(task, action_of(task, search.mean)), task,
                {'algorithm': f'phase offsets in quarters, then CMA-ES, {search.countiter}'
                 f' generations of {args.population}', 'seeds': [args.seed],
                 'decisions': search.countiter * args.population * args.episodes * decisions})


def log(folder: Path, line: dict) -> None:
    """Add a line to the log."""
    with (folder / 'log.jsonl').open('a', encoding='utf-8') as file:
        file.write(json.dumps(line) + '\n')


if __name__ == '__main__':
    run_main(main)
