"""Train feedback on `Walk` by CMA-ES: linear, from what a leg and the body feel to its speed.

    python examples/learning/train_feedback.py -o runs/feedback --ground highland --gait smooth

Needs `pip install -e '.[train]'`. All candidates of a generation walk in the same episodes, which
vary in command, soil, slope, friction, masses, motors, delay, relief and pushes. A run that was
stopped goes on where it was. It writes `policy.onnx`, its card and `log.jsonl`. Training never
sees the seeds of the study.
"""

from __future__ import annotations

import argparse
import multiprocessing
from pathlib import Path
import pickle
import time
from typing import Any

from episodes import run_episode, run_main, train_extra
from feedback import count, layer
import numpy as np
from rich.progress import track
from train_gait import COMMAND_S, EVALUATED, log, tuned

from lunar_rover_sim.autonomy.learning.policy_file import save_policy
from lunar_rover_sim.autonomy.learning.task import RoverTask
from lunar_rover_sim.autonomy.learning.tasks import make_task

with train_extra():
    import cma


def main() -> None:
    """Search, from no feedback or from the checkpoint of the folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('-o', '--output', type=Path, required=True)
    parser.add_argument('--ground', default='highland')
    parser.add_argument('--rover', default='quad')
    parser.add_argument('--gait', default='', metavar='POLICY',
                        help='a policy of Gait whose constant gait the feedback is added to')
    parser.add_argument('--generations', type=int, default=100)
    parser.add_argument('--minutes', type=float, default=120.0, help='stop after this time')
    parser.add_argument('--population', type=int, default=12)
    parser.add_argument('--episodes', type=int, default=2, help='of each candidate')
    parser.add_argument('--episode', type=float, default=6.0, help='length of each [s]')
    parser.add_argument('--workers', type=int, default=1, help='processes that walk')
    parser.add_argument('--sigma', type=float, default=0.1)
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    options = {'ground': args.ground, 'rover': args.rover, 'episode_s': args.episode,
               'command_s': COMMAND_S, **tuned(args.gait, args.rover)}
    task = make_task('walk', options)
    end_s = time.monotonic() + 60.0 * args.minutes
    kept = args.output / 'checkpoint.pickle'
    if kept.exists():
        search = pickle.loads(kept.read_bytes())
    else:
        search = cma.CMAEvolutionStrategy(np.zeros(count(task)), args.sigma, {
            'popsize': args.population, 'seed': args.seed, 'verbose': -9})
        log(args.output, {'generation': 0,
                          'evaluated': mean_return(task, search.mean, EVALUATED)})
    with multiprocessing.get_context('spawn').Pool(args.workers, begin, (options,)) as pool:
        for _ in track(range(search.countiter, args.generations), description='generations'):
            first = int(np.random.default_rng((args.seed, search.countiter)).integers(10_000))
            candidates = search.ask()
            seeds = range(first, first + args.episodes)
            returns = pool.starmap(walk, [(one, seeds) for one in candidates])
            search.tell(candidates, [-one for one in returns])
            kept.write_bytes(pickle.dumps(search))
            over = search.countiter == args.generations or time.monotonic() > end_s
            line = {'generation': search.countiter, 'best': max(returns),
                    'median': float(np.median(returns)), 'sigma': search.sigma}
            if search.countiter % 5 == 0 or over:
                line['evaluated'] = mean_return(task, search.mean, EVALUATED)
            log(args.output, {**line, 'mean': np.round(search.mean, 3).tolist()})
            save_policy(args.output / 'policy.onnx', [layer(task, search.mean)], task, {
                'algorithm': f'linear feedback by CMA-ES, {search.countiter} generations of '
                             f'{args.population}, added to the gait {args.gait or "packaged"}',
                'decisions': search.countiter * args.population * args.episodes * round(
                    args.episode * 1e9 / task.driver.decision_ns), 'seeds': [args.seed]})
            if over:
                break
    task.close()


def begin(options: dict[str, Any]) -> None:
    """Make the task of a process that walks."""
    global _task
    _task = make_task('walk', options)


def walk(numbers: np.ndarray, seeds: range) -> float:
    """Return the mean return of episodes with a feedback, in a process that walks."""
    return mean_return(_task, numbers, seeds)


def mean_return(task: RoverTask, numbers: np.ndarray, seeds: range) -> float:
    """Return the mean return of episodes with a feedback."""
    weight, bias = layer(task, numbers)
    return float(np.mean([run_episode(task, lambda observation: weight @ observation + bias,
                                      seed)[0] for seed in seeds]))


if __name__ == '__main__':
    run_main(main)
