"""What noise costs on `Walk`, and what a step along the policy gradient gains.

    python examples/learning/gradient_step.py --smoothing 0 0.3

For each time constant of the actions it makes 8,000 decisions with noise on the packaged gait and
estimates the gradient of a linear feedback as PPO does, with a critic that is linear in the
observations, and with one that has the products of leg phases, too. A step of fixed size walks on
reliefs that no training saw, against the gait alone. Nothing but the relief is random.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import itertools

from episodes import run_episode
from feedback import count, layer
import numpy as np

from lunar_rover_sim.autonomy.learning.randomisation import Randomisation
from lunar_rover_sim.autonomy.learning.task import RoverTask
from lunar_rover_sim.autonomy.learning.tasks import make_task
from lunar_rover_sim.judge.evaluation.statistics import Comparison, Mean

GAMMA, LAMBDA = 0.99, 0.95      # of PPO in `train_walk.py`
EPISODES, HOLD = 20, 32         # the noise, of standard deviation 1, holds for 0.64 s
FOLDS, RIDGE = 4, 100.0         # of the fits of the critic
STEP = 0.3                      # root mean square of the actions of a step
TRAINED, HIDDEN = (0, 9999), (90_000, 99_999)       # seeds of reliefs


def main() -> None:
    """Print returns with noise, and those of a step, beside the gait alone."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--smoothing', type=float, nargs='+', default=[0.0, 0.3], metavar='S')
    parser.add_argument('--ground', default='rigid')
    parser.add_argument('--seeds', type=int, default=20)
    args = parser.parse_args()
    for smoothing_s in args.smoothing:
        task, hidden = (make_task('walk', {
            'ground': args.ground, 'episode_s': 8.0, 'smoothing_s': smoothing_s,
            'forward_mps': (0.12, 0.12), 'yaw_rate_radps': (0.0, 0.0),
            'randomise': {**Randomisation.none().to_mapping(), 'terrain_seed': seeds}})
            for seeds in (TRAINED, HIDDEN))
        rng, legs = np.random.default_rng(7), len(task.actions)
        alone = judged(hidden, lambda _: np.zeros(legs), args.seeds)
        tell(f'smoothing {smoothing_s:g} s, gait alone', alone)
        tell('  white noise of 0.3', judged(hidden, lambda _: rng.normal(0.0, 0.3, legs),
                                            args.seeds), alone)
        made = tuple(np.array(column) for column in zip(*(roll_out(task, seed)
                                                          for seed in range(EPISODES))))
        for phases in (False, True):
            weight, bias = layer(task, gradient_step(task, *made, phases))
            tell(f'  a step, {"critic with products of phases" if phases else "linear critic"}',
                 judged(hidden, lambda observation: weight @ observation + bias, args.seeds),
                 alone)
        task.close()
        hidden.close()


def judged(task: RoverTask, act: Callable[[np.ndarray], np.ndarray], seeds: int) -> np.ndarray:
    """Return the returns of episodes."""
    return np.array([run_episode(task, act, seed)[0] for seed in range(seeds)])


def tell(name: str, returns: np.ndarray, alone: np.ndarray | None = None) -> None:
    """Print a mean, and the paired test against the gait alone."""
    compared = '' if alone is None else f'; {Comparison.of(returns, alone).text()}'
    print(f'{name}: {Mean.of(returns).text(2)}{compared}', flush=True)


def gradient_step(task: RoverTask, observed: np.ndarray, noise: np.ndarray, rewards: np.ndarray,
                  phases: bool) -> np.ndarray:
    """Return the numbers of a feedback: a step along the natural gradient at the gait alone.

    Args:
        task: Of the episodes.
        observed, noise, rewards: (episodes, decisions, n) twice, and (episodes, decisions).
        phases: Whether the critic has the products of leg phases.
    """
    spread = (observed - observed.mean(axis=(0, 1))) / (observed.std(axis=(0, 1)) + 1e-6)
    features = [np.ones((*rewards.shape, 1)), spread]
    if phases:
        columns = [k for k, one in enumerate(task.channels) if one.name.startswith('spoke_')]
        left, right = np.array(list(itertools.combinations_with_replacement(columns, 2))).T
        features.append(spread[..., left] * spread[..., right])
    advantage = advantages(rewards, np.concatenate(features, axis=2))
    # Of each number: what it adds to the actions, whose noise has variance 1.
    given = np.column_stack([observed.reshape(-1, observed.shape[2]), np.ones(rewards.size)])
    adds = np.array([given @ np.column_stack(layer(task, unit)).T for unit in np.eye(count(task))])
    gradient = (adds * noise.reshape(-1, noise.shape[2])).sum(axis=2) @ advantage / rewards.size
    fisher = np.einsum('int,jnt->ij', adds, adds) / rewards.size
    fisher += 0.03 * np.trace(fisher) / len(fisher) * np.eye(len(fisher))
    step = np.linalg.solve(fisher, gradient)
    return STEP * step / np.sqrt(np.mean(np.einsum('i,int->nt', step, adds) ** 2))


def roll_out(task: RoverTask, seed: int) -> tuple[list[np.ndarray], list[np.ndarray], list[float]]:
    """Return observations, noise and rewards of an episode."""
    rng, over = np.random.default_rng((99, seed)), False
    observation = task.reset(np.random.default_rng(seed))
    observed, noise, rewards = [], [], []
    while not over:
        noise.append(noise[-1] if len(noise) % HOLD else rng.normal(size=len(task.actions)))
        observed.append(observation)
        outcome = task.step(noise[-1])
        observation, over = outcome.observation, outcome.truncated
        rewards.append(outcome.reward)
    return observed, noise, rewards


def advantages(rewards: np.ndarray, features: np.ndarray) -> np.ndarray:
    """Return the normalised advantages (Schulman et al., ICLR 2016, eq. 16), flat.

    The critic of an episode is fitted to the others: least squares on `features`, (episodes,
    decisions, n). The end of an episode is none.
    """
    returns, onward = np.empty_like(rewards), rewards.mean(axis=1) / (1.0 - GAMMA)
    for k in reversed(range(rewards.shape[1])):
        onward = returns[:, k] = rewards[:, k] + GAMMA * onward
    value, folds = np.empty_like(rewards), np.arange(len(rewards)) % FOLDS
    for fold in range(FOLDS):
        known = features[folds != fold].reshape(-1, features.shape[2])
        value[folds == fold] = features[folds == fold] @ np.linalg.solve(
            known.T @ known + RIDGE * np.eye(known.shape[1]),
            known.T @ returns[folds != fold].ravel())
    explained = 1.0 - np.var(returns - value) / np.var(returns)
    print(f'  explained variance of the critic {explained:.2f}')
    missed = rewards + GAMMA * np.column_stack([value[:, 1:], value[:, -1]]) - value
    found, onward = np.empty_like(rewards), np.zeros(len(rewards))
    for k in reversed(range(rewards.shape[1])):
        onward = found[:, k] = missed[:, k] + GAMMA * LAMBDA * onward
    return ((found - found.mean()) / found.std()).ravel()


if __name__ == '__main__':
    main()
