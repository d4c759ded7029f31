"""A policy on the rover, without ROS: from joint states and IMU to leg speeds, stamp by stamp."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lunar_rover_sim.autonomy.learning.gait_task import GaitDriver, GaitTaskConfig
from lunar_rover_sim.autonomy.learning.policy_file import Policy, RUNNABLE
from lunar_rover_sim.autonomy.learning.senses import Sample
from lunar_rover_sim.autonomy.learning.task import Driver, TaskConfig
from lunar_rover_sim.autonomy.learning.walk import WalkConfig, WalkDriver
from lunar_rover_sim.base.errors import GaitError, LearningError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.gait.controller import LegCommand, MAX_COMMAND

CMD_TIMEOUT_S = 0.5     # a velocity command older than this stops the rover


class PolicyController:
    """Answers each sample with leg speeds, as `GaitController` answers joint states.

    The policy decides at stamps that are multiples of its period; between them its decision
    holds. Without a fresh velocity command the gait below the policy stands, and its actions are
    left out.

    Attributes:
        driver: What makes its observations and follows its actions.
        observed: What the policy saw at its last decision; None before the first.
    """

    def __init__(self, policy: Policy, rover: RoverDescription) -> None:
        """Stand, until the first command.

        Args:
            policy: For this rover.

        Raises:
            LearningError: The policy is for another rover, task, rate or observation.
        """
        self.policy = policy
        self.driver = driver_of(policy.config(), rover)
        policy.check(self.driver, rover.name, rover.legs.names)
        self._legs = len(rover.legs.each)
        self._command_ns: float = -np.inf
        self._velocity = (0.0, 0.0)
        self.reset()

    @classmethod
    def load(cls, name_or_path: str | Path, rover: RoverDescription) -> PolicyController:
        """Return the controller of a policy file, or of a packaged policy."""
        return cls(Policy(name_or_path), rover)

    def reset(self) -> None:
        """Forget everything but the policy: the next sample is the first."""
        self._last_ns: int | None = None
        self.observed: np.ndarray | None = None
        self._answer = LegCommand(np.zeros(self._legs), np.zeros(self._legs),
                                  np.zeros(self._legs))
        self.driver.reset()
        self.driver.set_velocity(0.0, 0.0)
        self._driven = (0.0, 0.0)

    def set_velocity(self, forward_mps: float, yaw_rate_radps: float,
                     stamp_ns: int | None = None) -> None:
        """Command a velocity; it holds for `CMD_TIMEOUT_S` after its stamp.

        Raises:
            GaitError: A value is no number, or beyond any walk; the command in force is kept.
        """
        if not (abs(forward_mps) <= MAX_COMMAND and abs(yaw_rate_radps) <= MAX_COMMAND):
            raise GaitError(f'velocity: {forward_mps} m/s and {yaw_rate_radps} rad/s is not valid;'
                            f' valid is -{MAX_COMMAND:g} to {MAX_COMMAND:g}')
        self._command_ns = np.inf if stamp_ns is None else stamp_ns
        self._velocity = (forward_mps, yaw_rate_radps)

    def take_reports(self) -> list[str]:
        """Return nothing: there is nothing to report."""
        return []

    def update(self, sample: Sample) -> LegCommand:
        """Return the command for a sample; where time goes backward, the controller is reset.

        Raises:
            LearningError: A value is not finite, or there is not one for each leg.
        """
        self._check(sample)
        now_ns = sample.stamp_ns
        if self._last_ns is not None and now_ns < self._last_ns:
            self.reset()
        first, self._last_ns = self._last_ns is None, now_ns
        driver = self.driver
        if not (first or now_ns % driver.follow_ns == 0):
            return self._answer
        asked = (self._velocity if now_ns - self._command_ns <= CMD_TIMEOUT_S * 1e9
                 else (0.0, 0.0))
        if asked != self._driven:
            self._driven = asked
            driver.set_velocity(*asked)
        driver.feel(sample)
        if first or now_ns % driver.decision_ns == 0:
            self.observed = driver.observation()
            driver.decide(np.zeros(len(driver.actions)) if asked == (0.0, 0.0)
                          else self.policy.act(self.observed))
        speeds, angles = driver.legs()
        self._answer = LegCommand(speeds, angles, self._answer.phase)
        return self._answer

    def _check(self, sample: Sample) -> None:
        for name, count in (('angle_rad', self._legs), ('speed_radps', self._legs),
                            ('torque_nm', self._legs), ('rate_radps', 3), ('force_mps2', 3)):
            values: Array = getattr(sample, name)
            if np.shape(values) != (count,) or not np.isfinite(values).all():
                raise LearningError(f'{name}: {values} is not valid; valid are {count} finite '
                                    'numbers')


def driver_of(config: TaskConfig, rover: RoverDescription) -> Driver:
    """Return the driver of a task on a rover.

    Raises:
        LearningError: The task needs more than the rover senses.
    """
    if isinstance(config, WalkConfig):
        return WalkDriver(config, rover)
    if isinstance(config, GaitTaskConfig):
        return GaitDriver(config, rover)
    raise LearningError(f'a policy for this task cannot be a leg controller; valid are policies '
                        f'for {", ".join(RUNNABLE)}')
