"""Train a policy on `Walk` by PPO or SAC of Stable-Baselines3.

    python examples/learning/train_walk.py -o runs/walk --ground rigid --speed 0.12 --calm

PPO trains the feedback of `feedback.py`, SAC a network; both add to the packaged gait. With
`--algorithm sac --set action=speeds` the network gives the speeds of the legs.

Needs `pip install -e '.[train]'`. A run that was stopped goes on where it was. It writes
`policy.onnx`, its card, and what TensorBoard shows. Training never sees the seeds of the study.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import time
from typing import Any

from episodes import run_episode, run_main, train_extra
import numpy as np
import yaml

from lunar_rover_sim.autonomy.learning.export import save_sb3
from lunar_rover_sim.autonomy.learning.tasks import make_task

with train_extra():
    from feedback_policy import FeedbackPolicy, policy_options
    from sb3_vector import Sb3Vector
    from stable_baselines3 import PPO, SAC
    from stable_baselines3.common.callbacks import BaseCallback, CallbackList, ProgressBarCallback
    import torch
    from train_gait import tuned

EVALUATED = tuple(range(20_000, 20_004))     # neither trained on nor hidden
SMOOTHING_S = 0.3   # of actions: without it their noise costs more than any gait can gain


def main() -> None:
    """Train, from nothing or from the checkpoint of the folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('-o', '--output', type=Path, required=True)
    parser.add_argument('--algorithm', choices=('ppo', 'sac'), default='ppo',
                        help='ppo trains feedback on a gait, sac a network')
    parser.add_argument('--ground', default='highland')
    parser.add_argument('--rover', default='quad')
    parser.add_argument('--decisions', type=int, default=1_000_000)
    parser.add_argument('--envs', type=int, default=8)
    parser.add_argument('--batch', type=int, default=8192, help='decisions of an update of PPO')
    parser.add_argument('--every', type=int, default=50_000, help='decisions between evaluations')
    parser.add_argument('--minutes', type=float, default=120.0, help='stop after this time')
    parser.add_argument('--gait', default='', metavar='POLICY',
                        help='a policy of Gait whose constant gait the actions are added to')
    parser.add_argument('--speed', type=float, metavar='MPS',
                        help='straight on at this speed; by default commands are drawn')
    parser.add_argument('--calm', action='store_true', help='randomise nothing but the relief')
    parser.add_argument('--set', action='append', default=[], metavar='NAME=VALUE',
                        type=assignment, help='a parameter of the task, as YAML')
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    torch.set_num_threads(1)
    options = {'ground': args.ground, 'rover': args.rover, 'smoothing_s': SMOOTHING_S,
               'randomise': not args.calm, **tuned(args.gait, args.rover),
               **dict(args.set)}
    if args.speed is not None:
        options.update(forward_mps=(args.speed, args.speed), yaw_rate_radps=(0.0, 0.0))
    envs = Sb3Vector('Walk', args.envs, **options)
    envs.seed(1000 * args.seed)
    kept = args.output / 'checkpoint.zip'
    watch = Evaluation(args, options, kept)
    kinds = {'ppo': PPO, 'sac': SAC}
    if kept.exists():
        model = kinds[args.algorithm].load(kept, env=envs)
    elif args.algorithm == 'ppo':
        # Linear feedback, and noise that holds for 0.64 s: what moves a leg pays after a second.
        model = PPO(FeedbackPolicy, envs, n_steps=args.batch // args.envs,
                    batch_size=min(args.batch, 1024), n_epochs=10, gamma=0.99, gae_lambda=0.95,
                    learning_rate=1e-3, target_kl=0.05, seed=args.seed, use_sde=True,
                    sde_sample_freq=32, tensorboard_log=str(args.output / 'tensorboard'),
                    policy_kwargs=policy_options(watch.task))
    else:
        model = SAC('MlpPolicy', envs, gamma=0.98, seed=args.seed, learning_starts=5000,
                    tensorboard_log=str(args.output / 'tensorboard'),
                    policy_kwargs={'net_arch': [64, 64], 'activation_fn': torch.nn.Tanh})
    args.output.mkdir(parents=True, exist_ok=True)      # what is refused leaves no folder
    left = args.decisions - model.num_timesteps
    if left > 0:
        model.learn(left, CallbackList([ProgressBarCallback(), watch]),
                    reset_num_timesteps=not kept.exists())
    watch.keep(model)
    envs.close()


def assignment(text: str) -> tuple[str, Any]:
    """Return name and value of `NAME=VALUE`."""
    name, equals, value = text.partition('=')
    try:
        if equals:
            return name.strip(), yaml.safe_load(value)
    except yaml.YAMLError:
        pass
    raise argparse.ArgumentTypeError(f'{text!r} is not NAME=VALUE')


class Evaluation(BaseCallback):
    """Evaluates without noise on fixed seeds, and keeps checkpoint and policy."""

    def __init__(self, args: argparse.Namespace, options: dict, kept: Path) -> None:
        super().__init__()
        self._args, self._kept, self._next = args, kept, 0
        self._end_s = time.monotonic() + 60.0 * args.minutes
        self.task = make_task('walk', options)

    def _on_step(self) -> bool:
        if self.num_timesteps >= self._next:
            self._next = self.num_timesteps + self._args.every
            self.keep(self.model)
        return time.monotonic() < self._end_s

    def keep(self, model: PPO | SAC) -> None:
        """Evaluate, and write checkpoint, policy and a line of the log."""
        returns = [run_episode(self.task, lambda observation: model.predict(
            observation, deterministic=True)[0], seed)[0] for seed in EVALUATED]
        self.task.close()
        line = {'decisions': int(model.num_timesteps), 'return': float(np.mean(returns)),
                'returns': np.round(returns, 2).tolist()}
        with (self._args.output / 'log.jsonl').open('a', encoding='utf-8') as log:
            log.write(json.dumps(line) + '\n')
        model.logger.record('evaluation/return', line['return'])
        model.save(self._kept)
        save_sb3(self._args.output / 'policy.onnx', model, self.task, {
            'algorithm': f'{self._args.algorithm.upper()} of Stable-Baselines3',
            'decisions': int(model.num_timesteps), 'seeds': [self._args.seed]})


if __name__ == '__main__':
    run_main(main)
