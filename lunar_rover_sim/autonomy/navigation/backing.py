"""Backing off from where the rover is stuck or tilts: how far, where to, and what it remembers.

It reads no clock.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from lunar_rover_sim.autonomy.navigation.command import NavigatorCommand, Status
from lunar_rover_sim.autonomy.navigation.config import NavigatorConfig
from lunar_rover_sim.autonomy.navigation.planner import Disc, Ground, Planner, REMEMBERED_NS
from lunar_rover_sim.base.frames import Array

_BACK_MPS = -0.08
_LEAST_BACK_M = 0.05        # less is not worth backing off
_BUMP_AHEAD_M, _BUMP_RADIUS_M = 0.28, 0.10
_EDGE_RADIUS_M = 0.4        # of ground beyond an edge over which it leans: a small crater
_BEHIND = -math.sin(math.radians(15.0))     # ahead of it or aside is what is less behind it
_TRAIL_M = 0.1              # from place to place of the trail, which is known ground


@dataclasses.dataclass(frozen=True)
class _Retreat:
    """One way back; place: of the trail, (2,), to which it leads; None: straight back."""

    since_ns: int
    start_m: Array
    way_m: float
    text: str
    place: Array | None


class Backing:
    """Backs off, straight or on the trail of where the rover has stood.

    Attributes:
        trail: Where it has stood: known ground, oldest first.
    """

    def __init__(self, config: NavigatorConfig, radius_m: float) -> None:
        """Begin without a trail.

        Args:
            radius_m: Of the circle around the rover and its spokes.
        """
        self._config, self._radius_m = config, radius_m
        self._room_m = radius_m + config.plan.margin_m
        self.trail: list[Disc] = []
        self._retreat: _Retreat | None = None

    @property
    def is_on(self) -> bool:
        """Whether it backs off."""
        return self._retreat is not None

    def stop(self) -> None:
        """Back off no more."""
        self._retreat = None

    def begin_trail(self, at: Array) -> None:
        """Forget the trail, and begin another where the rover stands, (2,)."""
        self.trail = [_stood(at, max(self._config.plan.start_m, self._radius_m))]

    def add_to_trail(self, at: Array) -> None:
        """Take note of where the rover stands, (2,): that ground is known."""
        if math.hypot(at[0] - self.trail[-1].x_m, at[1] - self.trail[-1].y_m) > _TRAIL_M:
            self.trail.append(_stood(at, self._radius_m))

    def edge(self, now_ns: int, position: Array, heading_rad: float, lean: Array,
             goals: list[Array]) -> Disc | None:
        """Return the ground beyond an edge over which it leans, as over the rim of a crater.

        None where it does not lean ahead or sideways, or a goal lies there: it has to go there.

        Args:
            lean: (2,) level part of the axis that points up from the body.
        """
        size = float(np.linalg.norm(lean))
        ahead = lean[0] * math.cos(heading_rad) + lean[1] * math.sin(heading_rad)
        if size < 0.5 * math.sin(math.radians(self._config.tilt_limit_deg)) \
                or ahead < _BEHIND * size:
            return None
        x, y = position[:2] + _EDGE_RADIUS_M * lean / size
        if min(math.dist(goal, (x, y)) for goal in goals) < _EDGE_RADIUS_M + self._room_m:
            return None
        return Disc(float(x), float(y), _EDGE_RADIUS_M, Ground.BUMP, now_ns + REMEMBERED_NS)

    def begin(self, now_ns: int, position: Array, heading_rad: float, planner: Planner | None,
              text: str, edge: Disc | None) -> tuple[str, list[Disc]]:
        """Begin to back off, if there is room; return a note and the ground to keep off.

        Args:
            planner: Of the newest map; None: it knows of no room.
            text: Why.
            edge: Ground of which it gets clear with all of its legs; None: it leans over none.
        """
        wanted = self._config.back_off_m
        if edge is not None:
            # It stands at the edge: straight back to where its circle and that ground just touch.
            off = edge.x_m - position[0], edge.y_m - position[1]
            ahead = off[0] * math.cos(heading_rad) + off[1] * math.sin(heading_rad)
            apart = edge.radius_m + self._room_m
            wanted = max(wanted, math.sqrt(ahead ** 2 + apart ** 2 - edge.radius_m ** 2) - ahead)
        way = 0.0 if planner is None else planner.clear_back_m(position, heading_rad, wanted)
        place = self._trail_back(position, wanted, planner, edge) if way < 0.5 * wanted else None
        bumps: tuple[float, ...] = _BUMP_AHEAD_M, _BUMP_AHEAD_M + _BUMP_RADIUS_M
        if place is not None:
            way, bumps = math.dist(place, position[:2]), (0.0,)
        if way >= _LEAST_BACK_M:
            self._retreat = _Retreat(now_ns, position.copy(), way, text, place)
        return (f'backs off by {way:.2f} m{"" if place is None else " on its trail"}: {text}',
                [*(Disc(float(position[0]) + ahead * math.cos(heading_rad),
                        float(position[1]) + ahead * math.sin(heading_rad),
                        _BUMP_RADIUS_M, Ground.BUMP, now_ns + REMEMBERED_NS) for ahead in bumps),
                 *([] if edge is None else [edge])])

    def go_on(self, now_ns: int, position: Array, heading_rad: float) -> NavigatorCommand | None:
        """Return the command; None where it is back, or it has tried for long enough."""
        assert self._retreat is not None
        retreat, place = self._retreat, self._retreat.place
        gone = float(np.linalg.norm(position[:2] - retreat.start_m[:2]))
        most_ns = 3.0e9 * retreat.way_m / -_BACK_MPS
        if gone >= retreat.way_m or now_ns - retreat.since_ns >= most_ns:
            return None
        if place is None:
            return NavigatorCommand(_BACK_MPS, 0.0, Status.BACKING, retreat.text)
        # On an arc to that place, with whichever end is nearer to it.
        off = place - position[:2]
        angle = math.remainder(math.atan2(off[1], off[0]) - heading_rad, 2.0 * math.pi)
        forward = -_BACK_MPS if abs(angle) < 0.5 * math.pi else _BACK_MPS
        bend = math.sin(angle) if forward > 0.0 else -math.sin(angle)
        most = self._config.max_yaw_rate_radps
        rate = 2.0 * -_BACK_MPS * bend / max(float(np.linalg.norm(off)), _LEAST_BACK_M)
        return NavigatorCommand(forward, min(max(rate, -most), most), Status.BACKING, retreat.text)

    def _trail_back(self, position: Array, least_m: float, planner: Planner | None,
                    edge: Disc | None) -> Array | None:
        """Return the place of its trail to which it backs off, and forget the trail from there on.

        It has been there: that ground carries it, whatever the map says. Of the places far enough
        off it is the last one with room around it, else the last one.
        """
        places = np.array([(disc.x_m, disc.y_m) for disc in self.trail]).reshape(-1, 2)
        far = np.linalg.norm(places - position[:2], axis=1) >= least_m
        if edge is not None:
            far &= np.linalg.norm(places - (edge.x_m, edge.y_m), axis=1) \
                >= edge.radius_m + self._room_m
        if not far.any():
            return None
        roomy = far & (planner is not None and planner.has_room(places))
        last = int(np.flatnonzero(roomy if roomy.any() else far)[-1])
        del self.trail[last + 1:]
        return np.asarray(places[last])


def _stood(at: Array, radius_m: float) -> Disc:
    return Disc(float(at[0]), float(at[1]), radius_m, Ground.STOOD)
