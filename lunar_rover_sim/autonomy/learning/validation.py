"""A policy file against its environment, term by term: does the node see what was trained on?

One rover walks in the environment, another as the nodes make it walk: a state every 5 ms, each
answered by `PolicyController`. Both have the same ground, and an IMU without noise.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from lunar_rover_sim.autonomy.learning.controller import PolicyController
from lunar_rover_sim.autonomy.learning.follow import FollowConfig
from lunar_rover_sim.autonomy.learning.policy_file import Policy
from lunar_rover_sim.autonomy.learning.randomisation import Randomisation
from lunar_rover_sim.autonomy.learning.senses import Sample
from lunar_rover_sim.autonomy.learning.task import RoverTask, STATE_HZ
from lunar_rover_sim.autonomy.learning.tasks import TASKS
from lunar_rover_sim.base.errors import LearningError

TOLERANCE = 1e-6        # of a scaled number
DURATION_S = 4.0


@dataclasses.dataclass(frozen=True)
class TermCheck:
    """One number of an observation, of the environment and of the node, compared over a walk.

    Attributes:
        name: Of the channel.
        difference: The greatest, of scaled numbers.
        span: Greatest less least number in the environment: a term that never moves is no test.
    """

    name: str
    difference: float
    span: float

    @property
    def holds(self) -> bool:
        """Whether both agree."""
        return self.difference <= TOLERANCE


def validate_policy(policy: Policy, duration_s: float = DURATION_S,
                    seed: int = 1) -> list[TermCheck]:
    """Walk twice and compare.

    Args:
        duration_s: Of the walk.
        seed: Of ground and command.

    Raises:
        LearningError: The policy does not fit, or its walk ends early.
    """
    config = dataclasses.replace(policy.config(), randomise=Randomisation.none(), privileged=False,
                                 imu_noise=False, episode_s=duration_s)
    if isinstance(config, FollowConfig):    # one command: nodes hear of another one at a state
        config = dataclasses.replace(config, command_s=duration_s + 1.0)
    kind = TASKS[policy.card.task][0]
    trained, run = kind(config), kind(config)
    try:
        seen = _in_environment(trained, policy, seed)
        found = _in_nodes(run, policy, seed, len(seen))
    finally:
        trained.close()
        run.close()
    return [TermCheck(channel.name, float(difference), float(span))
            for channel, difference, span in zip(
                policy.card.observation, np.abs(seen - found).max(axis=0), np.ptp(seen, axis=0))]


def _in_environment(task: RoverTask, policy: Policy, seed: int) -> np.ndarray:
    """Return the (n, channels) observations of an episode."""
    observation = task.reset(np.random.default_rng(seed))
    policy.check(task.driver, task.rover.name, task.rover.legs.names)
    seen, over = [], False
    while not over:
        seen.append(observation)
        outcome = task.step(policy.act(observation))
        if outcome.ending is not None:
            raise LearningError(f'{policy.path}: its walk ends early: {outcome.ending.words}')
        observation, over = outcome.observation, outcome.truncated
    return np.array(seen)


def _in_nodes(task: RoverTask, policy: Policy, seed: int, count: int) -> np.ndarray:
    """Return the (count, channels) observations of a walk at the rates of the nodes."""
    task.reset(np.random.default_rng(seed))
    simulation = task.simulation
    assert simulation is not None
    controller = PolicyController(policy, task.rover)
    controller.set_velocity(*task.commanded)
    steps = 1_000_000_000 // STATE_HZ // simulation.config.step_ns
    state = simulation.state
    seen: list[np.ndarray | None] = []
    while len(seen) < count:
        legs = controller.update(Sample.of(state))
        if state.stamp_ns % controller.driver.decision_ns == 0:
            seen.append(controller.observed)
        simulation.command(legs.velocity_radps)
        state = simulation.advance(steps)
    return np.array(seen)
