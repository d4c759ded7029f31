"""Looking at ground that no camera has seen: turns to it, and stands while images come.

It reads no clock.
"""

from __future__ import annotations

import math

import numpy as np

from lunar_rover_sim.autonomy.navigation.command import NavigatorCommand, Status, still
from lunar_rover_sim.autonomy.navigation.config import NavigatorConfig
from lunar_rover_sim.autonomy.navigation.planner import Disc, Ground, REMEMBERED_NS
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.seconds import NS_PER_S

_FACING_RAD = math.radians(12.0)
_LOOK_FOR_S = 30.0          # of turning towards what is unknown, at most
_AROUND_TURNS = 6           # of a sixth of a circle each, where no way is seen
_SHADOW_BEYOND_M, _SHADOW_RADIUS_M = 0.3, 0.6   # of what it has looked at
_SETTLED_NS = NS_PER_S      # after which a walking body is at rest


class Looking:
    """Looks at one place, all around, or ahead at every stop."""

    def __init__(self, config: NavigatorConfig) -> None:
        self._config = config
        self._stop_ns: int | None = None        # when it stopped to look, and where
        self._stopped_at: Array | None = None
        self.forget()

    def forget(self) -> None:
        """Look at nothing, and count the looks around from here on."""
        self._look: tuple[int, float, Array | None] | None = None   # since, heading, what
        self._facing_ns: int | None = None
        self._around = 0

    @property
    def is_on(self) -> bool:
        """Whether it looks at something."""
        return self._look is not None

    @property
    def stands(self) -> bool:
        """Whether it looks at something, and has turned to it."""
        return self._look is not None and self._facing_ns is not None

    def begin(self, now_ns: int, heading_rad: float, text: str,
              what: Array | None = None) -> NavigatorCommand:
        """Begin to look in a direction; return the command.

        Args:
            what: (2,) place that it looks at; None: it looks for a way.
        """
        self._look = now_ns, heading_rad, what
        self._facing_ns = None
        return still(Status.LOOKING, text)

    def begin_around(self, now_ns: int, heading_rad: float) -> NavigatorCommand | None:
        """Begin to look further around; None: it has looked all around."""
        if self._around >= _AROUND_TURNS:
            return None
        self._around += 1
        return self.begin(now_ns, heading_rad + 2.0 * math.pi / _AROUND_TURNS,
                          'sees no way to the goal, and looks around')

    def found_way(self) -> None:
        """Count the looks around from here on."""
        self._around = 0

    def cancel(self) -> None:
        """End a look that has shown nothing yet."""
        self._look = None

    def go_on(self, now_ns: int, heading_rad: float) -> NavigatorCommand | None:
        """Return the command; None where it has looked for long enough."""
        assert self._look is not None
        since, wanted, _ = self._look
        off = math.remainder(wanted - heading_rad, 2.0 * math.pi)
        if self._facing_ns is None:
            if abs(off) > _FACING_RAD and now_ns - since < _LOOK_FOR_S * 1e9:
                return NavigatorCommand(
                    0.0, math.copysign(self._config.max_yaw_rate_radps, off), Status.LOOKING,
                    'turns towards what it does not know')
            self._facing_ns = now_ns
        if now_ns - self._facing_ns < self._config.look_s * 1e9:
            return still(Status.LOOKING, 'looks')
        return None

    def end(self, now_ns: int) -> list[Disc]:
        """End the look; return the ground that it has looked at, which may be unknown still."""
        assert self._look is not None
        _, wanted, what = self._look
        self._look = self._facing_ns = None
        if what is None:
            return []
        # What is still unknown then is in shadow, or hidden.
        x, y = what + _SHADOW_BEYOND_M * np.array([math.cos(wanted), math.sin(wanted)])
        return [Disc(float(x), float(y), _SHADOW_RADIUS_M, Ground.SHADOW, now_ns + REMEMBERED_NS)]

    def stops(self, now_ns: int, position: Array, map_ns: int) -> bool:
        """Return whether it stands to look ahead, as it does every `stop_every_m`.

        Args:
            map_ns: Stamp of the newest map.
        """
        every_m = self._config.stop_every_m
        if not every_m:
            return False
        if self._stop_ns is None:
            if (self._stopped_at is not None
                    and np.linalg.norm(position[:2] - self._stopped_at) < every_m):
                return False
            self._stop_ns, self._stopped_at = now_ns, position[:2].copy()
        if map_ns < self._stop_ns + _SETTLED_NS:
            return True
        self._stop_ns = None
        return False
