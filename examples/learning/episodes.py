"""One episode of a task without exploration, for what trains and judges policies here."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import sys

import numpy as np

from lunar_rover_sim.autonomy.learning.task import RoverTask
from lunar_rover_sim.base.errors import LunarRoverSimError


def run_main(main: Callable[[], None]) -> None:
    """Run a script; an error of the package is one line."""
    try:
        main()
    except LunarRoverSimError as error:
        sys.exit(f'{sys.argv[0]}: {error}')


@contextmanager
def train_extra() -> Iterator[None]:
    """Import what the extra `train` installs; what is missing is said in one line."""
    try:
        yield
    except ModuleNotFoundError as error:
        sys.exit(f"{sys.argv[0]}: {error}; install it by pip install -e '.[train]'")


def run_episode(task: RoverTask, act: Callable[[np.ndarray], np.ndarray],
                seed: int) -> tuple[float, bool]:
    """Return the sum of rewards of an episode, and whether it was terminated early.

    Args:
        task: It is reset first.
        act: Observation → action.
        seed: Of the episode.
    """
    observation, total, over = task.reset(np.random.default_rng(seed)), 0.0, False
    while not over:
        outcome = task.step(act(observation))
        observation, total = outcome.observation, total + outcome.reward
        over = outcome.terminated or outcome.truncated
    return total, outcome.terminated
