"""Tune the gait on `Gait` by CMA-ES: one constant action, judged over whole episodes.

    python examples/learning/train_gait.py -o runs/gait --ground highland

Needs `pip install -e '.[train]'`. A run that was stopped goes on where it was. It writes
`policy.onnx`, its card, and what TensorBoard shows. Training never sees the seeds of the study.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import pickle
import time

import cma
import gymnasium
import numpy as np
from rich.progress import track
from torch.utils.tensorboard import SummaryWriter

from lunar_rover_sim.learning.policy_file import constant_layers, save_policy

EVALUATED = 20_000      # first of the seeds that are neither trained on nor hidden


def main() -> None:
    """Tune, from the packaged gait or from the last generation of the folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('-o', '--output', type=Path, required=True)
    parser.add_argument('--ground', default='highland')
    parser.add_argument('--rover', default='quad')
    parser.add_argument('--speed', type=float, default=0.12)
    parser.add_argument('--generations', type=int, default=40)
    parser.add_argument('--minutes', type=float, default=120.0, help='stop after this time')
    parser.add_argument('--population', type=int, default=10)
    parser.add_argument('--episodes', type=int, default=2, help='of each candidate')
    parser.add_argument('--shaking', type=float, default=0.0, help='cost of pitch and roll rates')
    parser.add_argument('--sigma', type=float, default=0.25)
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    kept = args.output / 'checkpoint.pickle'
    options = {'ground': args.ground, 'rover': args.rover, 'randomise': False, 'episode_s': 11.0,
               'forward_mps': (args.speed, args.speed), 'shaking_weight': args.shaking}
    envs = gymnasium.make_vec('lunar_rover_sim.learning:lunar_rover_sim/Gait-v0',
                              num_envs=args.episodes, **options)
    count, n = envs.single_action_space.shape[0], args.episodes
    if kept.exists():
        search = pickle.loads(kept.read_bytes())
    else:
        search = cma.CMAEvolutionStrategy(np.zeros(count), args.sigma, {
            'popsize': args.population, 'seed': args.seed, 'bounds': [-1.0, 1.0],
            'verbose': -9})
    end_s = time.monotonic() + 60.0 * args.minutes
    with SummaryWriter(str(args.output / 'tensorboard')) as board:
        for _ in track(range(search.countiter, args.generations), description='generations'):
            seed = int(np.random.default_rng((args.seed, search.countiter)).integers(10_000))
            candidates = search.ask()
            costs = [-returned(envs, one, list(range(seed, seed + args.episodes)))
                     for one in candidates]
            search.tell(candidates, costs)
            board.add_scalar('cost/best', min(costs), search.countiter)
            board.add_scalar('cost/median', float(np.median(costs)), search.countiter)
            board.add_scalar('sigma', search.sigma, search.countiter)
            kept.write_bytes(pickle.dumps(search))
            if search.countiter % 5 == 0 or search.countiter == 1:
                cost = float(np.mean([-returned(envs, search.mean, list(range(first, first + n)))
                                      for first in range(EVALUATED, EVALUATED + 6, n)]))
                board.add_scalar('cost/evaluated', cost, search.countiter)
                line = {'generation': search.countiter, 'evaluated': cost, 'best': min(costs),
                        'sigma': search.sigma, 'mean': np.round(search.mean, 3).tolist()}
                with (args.output / 'log.jsonl').open('a', encoding='utf-8') as log:
                    log.write(json.dumps(line) + '\n')
            if time.monotonic() > end_s:
                break
    action = np.clip(search.mean, -1.0, 1.0)
    facts = {'algorithm': f'CMA-ES, {search.countiter} generations of {args.population}',
             'decisions': search.countiter * args.population * n * 55, 'seeds': [args.seed]}
    task = envs.tasks[0]
    save_policy(args.output / 'policy.onnx', constant_layers(task, action), task, facts)
    envs.close()
    print(f'{args.output / "policy.onnx"}: {dict(zip(names(envs), action.round(3).tolist()))}')


def names(envs: gymnasium.vector.VectorEnv) -> list[str]:
    """Return the names of the numbers of an action."""
    return [channel.name for channel in envs.actions]


def returned(envs: gymnasium.vector.VectorEnv, action: np.ndarray, seeds: list[int]) -> float:
    """Return the mean return of episodes with one constant action."""
    envs.reset(seed=seeds)
    total, alive = np.zeros(envs.num_envs), np.ones(envs.num_envs, bool)
    actions = np.tile(action, (envs.num_envs, 1))
    while alive.any():
        _, rewards, terminated, truncated, _ = envs.step(actions)
        total += np.where(alive, rewards, 0.0)
        # An episode that falls has no energy to pay any more: it gets the cost of a miss.
        total -= np.where(alive & terminated, 5.0, 0.0)
        alive &= ~(terminated | truncated)
    return float(total.mean())


if __name__ == '__main__':
    main()
