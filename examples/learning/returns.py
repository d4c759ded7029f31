"""What the actions of a policy of `Walk` gain: returns with them, and of the gait alone.

    python examples/learning/returns.py feedback --grounds rigid highland

Both walk the same episodes, of the length and the randomisation of the training, on seeds that are
neither trained on nor hidden, or with --hidden on reliefs that nothing else walks on.
"""

from __future__ import annotations

import argparse

from episodes import run_episode
import numpy as np

from lunar_rover_sim.autonomy.learning.policy_file import Policy
from lunar_rover_sim.autonomy.learning.tasks import make_task
from lunar_rover_sim.judge.evaluation.statistics import Comparison, Mean

FIRST = 20_000
HIDDEN = (90_000, 99_999)       # seeds of reliefs, of which the study has the first


def main() -> None:
    """Print means and the paired test for each ground."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('policy', help='a packaged policy or a file')
    parser.add_argument('--grounds', nargs='+', default=['rigid', 'highland'])
    parser.add_argument('--episodes', type=int, default=20)
    parser.add_argument('--hidden', action='store_true', help='on reliefs of hidden seeds')
    args = parser.parse_args()
    policy = Policy(args.policy)
    for ground in args.grounds:
        options = {**policy.card.options, 'ground': ground}
        if args.hidden:
            options['randomise'] = {**options['randomise'], 'terrain_seed': HIDDEN}
        task = make_task(policy.card.task, options)
        still = np.zeros(len(task.actions))
        alone, learned = np.array([[run_episode(task, act, FIRST + k)[0]
                                    for k in range(args.episodes)]
                                   for act in (lambda _: still, policy.act)])
        task.close()
        print(f'{ground}: gait alone {Mean.of(alone).text(2)}, with actions '
              f'{Mean.of(learned).text(2)}; {Comparison.of(learned, alone).text()}', flush=True)


if __name__ == '__main__':
    main()
