"""What the rover waits for: a pose, or depth; and how it looks for what it does not see.

It reads no clock.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.autonomy.navigation.command import NavigatorCommand, Status
from lunar_rover_sim.autonomy.navigation.config import NavigatorConfig
from lunar_rover_sim.autonomy.navigation.local_plan import ALIGNED_RAD
from lunar_rover_sim.autonomy.navigation.traversability import Traversability


class Waiting:
    """Stands while something is missing, and turns to where something was seen.

    Attributes:
        turns_back: Whether the last command was to turn to where something was seen, or to stand
            there.
    """

    def __init__(self, config: NavigatorConfig) -> None:
        self._config = config
        self._since_ns: int | None = None
        self._seeing_heading: float | None = None       # when the newest depth came
        self.turns_back = False

    @property
    def is_on(self) -> bool:
        """Whether something is missing."""
        return self._since_ns is not None

    def end(self) -> None:
        """Take it that nothing is missing."""
        self._since_ns = None

    def note_seeing(self, heading_rad: float) -> None:
        """Take note of the heading at which depth came."""
        self._seeing_heading = heading_rad

    def missing_pose(self, now_ns: int, pose_ns: int | None, position: ArrayLike,
                     orientation: ArrayLike) -> str | None:
        """Return what is wrong with the newest pose; None: nothing."""
        if pose_ns is None:
            return 'no pose yet'
        age_s = (now_ns - pose_ns) * 1e-9
        if age_s > self._config.pose_age_s:
            return f'no pose for {age_s:.1f} s'
        if not (np.isfinite(np.asarray(position, float)).all()
                and np.isfinite(np.asarray(orientation, float)).all()):
            return 'the pose is not finite'
        return None

    def missing_depth(self, now_ns: int, grid: Traversability | None) -> str | None:
        """Return what is wrong with the newest map; None: nothing."""
        if grid is None:
            return 'no map yet'
        age_s = (now_ns - grid.stamp_ns) * 1e-9
        return f'no depth for {age_s:.1f} s' if age_s > self._config.map_age_s else None

    def go_on(self, now_ns: int, missing: str,
              heading_rad: float | None) -> NavigatorCommand | None:
        """Return the command; None where it has waited for too long.

        A rover that has turned into the dark turns back to where it saw something. Where there is
        nothing to be seen any more, or it has seen nothing yet, it looks around on the spot, where
        the ground is known.

        Args:
            heading_rad: None: the pose is missing, too, and it does not turn.
        """
        if self._since_ns is None:
            self._since_ns = now_ns
        config, waited_s = self._config, (now_ns - self._since_ns) * 1e-9
        turn_s = 2.0 * math.pi / config.max_yaw_rate_radps
        # An image comes a while after the turn that shows something.
        back_s = (0.0 if heading_rad is None or self._seeing_heading is None
                  else 0.5 * turn_s + config.map_age_s)
        around_s = 0.0 if heading_rad is None else turn_s
        if waited_s > config.lost_s + back_s + around_s:
            return None
        yaw_rate = 0.0
        self.turns_back = heading_rad is not None and waited_s < back_s
        if self.turns_back:
            assert self._seeing_heading is not None and heading_rad is not None
            off = math.remainder(self._seeing_heading - heading_rad, 2.0 * math.pi)
            if abs(off) > ALIGNED_RAD:
                yaw_rate = math.copysign(config.max_yaw_rate_radps, off)
        elif heading_rad is not None \
                and back_s + config.map_age_s < waited_s < back_s + config.map_age_s + around_s:
            yaw_rate = config.max_yaw_rate_radps
        return NavigatorCommand(0.0, yaw_rate, Status.WAITING, missing)
