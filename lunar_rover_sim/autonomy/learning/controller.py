"""A policy on the rover, without ROS: from joint states and IMU to leg speeds, stamp by stamp."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lunar_rover_sim.autonomy.learning.follow import FollowConfig
from lunar_rover_sim.autonomy.learning.gait_task import GaitDriver, GaitTaskConfig
from lunar_rover_sim.autonomy.learning.policy_file import COMMANDS, Policy, RUNNABLE
from lunar_rover_sim.autonomy.learning.senses import Sample
from lunar_rover_sim.autonomy.learning.task import Driver, TaskConfig
from lunar_rover_sim.autonomy.learning.walk import WalkConfig, WalkDriver
from lunar_rover_sim.base.errors import LearningError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.gait.controller import check_velocity, LegCommand

CMD_TIMEOUT_S = 0.5     # a velocity command older than this stops the rover
_OUTSIDE_NS = 1_000_000_000     # for which commands leave the range before it is reported


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
        config = policy.config()
        self.driver = driver_of(config, rover)
        assert isinstance(config, FollowConfig)     # as all that have such a driver
        self._ranges = [getattr(config, name) for _, _, name in COMMANDS]
        self._reported = [False] * len(COMMANDS)
        self._reports: list[str] = []
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
        # Since when each commanded quantity is out of its range.
        self._outside_ns: list[float | None] = [None] * len(COMMANDS)
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
        check_velocity(forward_mps, yaw_rate_radps)
        self._command_ns = np.inf if stamp_ns is None else stamp_ns
        self._velocity = (forward_mps, yaw_rate_radps)
        self._watch_range()

    def take_reports(self) -> list[str]:
        """Return, once, which commands the policy was not trained for."""
        reports, self._reports = self._reports, []
        return reports

    def on_ground(self, ground: str) -> list[str]:
        """Return what is to be reported of walking on a ground, rigid or a soil."""
        trained = self.policy.card.ground
        return [] if ground == trained else [
            f'policy {self.policy.path.stem} was trained on {trained}; here is {ground}']

    def update(self, sample: Sample) -> LegCommand:
        """Return the command for a sample; where time goes backward, the controller is reset.

        Raises:
            LearningError: A value is not finite, or there is not one for each leg; or the policy
                gives no number.
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
            action = (np.zeros(len(driver.actions)) if asked == (0.0, 0.0)
                      else self.policy.act(self.observed))
            if not np.isfinite(action).all():
                raise LearningError(f'{self.policy.path}: gives {action} at {now_ns / 1e9:.3f} s; '
                                    'valid are finite numbers')
            driver.decide(action)
        speeds, angles = driver.legs()
        self._answer = LegCommand(speeds, angles, self._answer.phase)
        return self._answer

    def _watch_range(self) -> None:
        """Report a command that stays out of the range of the training; to stand is in it."""
        for k, ((words, unit, _), (low, high), asked) in enumerate(zip(
                COMMANDS, self._ranges, self._velocity)):
            if low - 1e-6 <= asked <= high + 1e-6 or self._velocity == (0.0, 0.0):
                self._outside_ns[k] = None
                continue
            since_ns = self._outside_ns[k]
            if since_ns is None:
                since_ns = self._outside_ns[k] = self._command_ns
            # A command without a stamp holds for ever.
            holds = self._command_ns == np.inf or self._command_ns - since_ns >= _OUTSIDE_NS
            if holds and not self._reported[k]:
                self._reported[k] = True
                self._reports.append(
                    f'policy {self.policy.path.stem} was trained for a {words} of {low:g} to '
                    f'{high:g} {unit}; {asked:g} is commanded')

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
