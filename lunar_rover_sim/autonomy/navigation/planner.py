"""Plans over a grid of costs, by scikit-image's `MCP_Geometric`."""

from __future__ import annotations

import dataclasses
import enum
import math

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d
from skimage.graph import MCP_Geometric

from lunar_rover_sim.autonomy.navigation.config import PlanConfig
from lunar_rover_sim.autonomy.navigation.overview import Overview, WALL_COST
from lunar_rover_sim.autonomy.navigation.traversability import LETHAL, Traversability, UNKNOWN
from lunar_rover_sim.base.frames import Array, path_length
from lunar_rover_sim.base.seconds import NS_PER_S

REMEMBERED_NS = 180 * NS_PER_S     # a bump, or a shadow that was looked at
_SHADOW_COST = 3.0      # of a shadow that the rover creeps over
_ESCAPE = 20.0          # cost of ground that is too near to an obstacle while the rover leaves it
_SMOOTH_CELLS = 2.5
_SEARCH_M = 1.0         # a goal on an obstacle is replaced by a place this near to it
_BACK_STEP_M = 0.05


class Ground(enum.Enum):
    """What the rover knows of a disc of ground beyond the map."""

    BUMP = 'bump'           # it bumped there, or tilted
    SHADOW = 'shadow'       # it has looked at it; what is unknown of it stays unknown
    STOOD = 'stood'         # it stands or has stood there: known, whatever its cameras see


@dataclasses.dataclass(frozen=True)
class Disc:
    """Ground that the rover knows more of than the map; until_ns [ns]: when it is forgotten."""

    x_m: float
    y_m: float
    radius_m: float
    ground: Ground
    until_ns: int = 1 << 62


@dataclasses.dataclass(frozen=True)
class Plan:
    """A way to the goal, or to the edge of the map towards it.

    Attributes:
        points_m: (n, 2) from the rover on.
        cost: Of the way and, where it ends before the goal, of the rest over what was seen there.
        reaches_goal: Whether it ends at the goal itself.
        off_goal_m: How far from a goal that cannot be reached it ends; 0 if it goes on beyond
            the map.
    """

    points_m: Array
    cost: float
    reaches_goal: bool
    off_goal_m: float = 0.0

    @property
    def length_m(self) -> float:
        """Length of the way [m]."""
        return path_length(self.points_m)


class Planner:
    """Finds ways over the costs of one map."""

    def __init__(self, grid: Traversability, config: PlanConfig, radius_m: float,
                 rover_xy_m: ArrayLike, discs: tuple[Disc, ...] = (),
                 overview: Overview | None = None, creep: bool = False) -> None:
        """Prepare the costs of a map.

        Args:
            radius_m: Of the circle around the rover and its spokes.
            overview: What was seen beyond the map, and of what the map does not know; None: all
                beyond the map is free.
            creep: Whether shadows may be crossed.

        Attributes:
            room_m: What it needs to obstacles.
            unknown: (n, n) cells that neither map nor rover knows.
            dark: (n, n) cells in which too much under the rover would be unknown.
            blocked: (n, n) cells in which it would touch an obstacle.
        """
        self._overview, self._creep = overview, creep
        self._grid, self._rover = grid, np.asarray(rover_xy_m, float)[:2]
        self._radius_m = radius_m
        self.room_m = room = radius_m + config.margin_m
        self.unknown = grid.cost == UNKNOWN
        self.lethal = grid.cost >= LETHAL
        # Where it has stood grows with the way: most of it lies beyond the map.
        discs = tuple(disc for disc in discs if self._reaches(disc))
        for disc in discs:
            if disc.ground is Ground.STOOD:
                self.unknown[self._within((disc.x_m, disc.y_m), disc.radius_m)] = False
            elif disc.ground is Ground.BUMP:
                self.lethal[self._within((disc.x_m, disc.y_m), disc.radius_m)] = True
        self.dark = self._share_around(self.unknown, radius_m) > config.unknown_share
        share = np.clip(np.arange(-128.0, 128.0), 0.0, 99.0) / 99.0
        cost = np.take(1.0 + config.rough_cost * share, grid.cost.astype(np.int16) + 128)
        free = (~self.lethal).astype(np.uint8)
        apart = cv2.distanceTransform(free, cv2.DIST_L2, 5) * np.float32(grid.cell_m)
        self._apart = apart
        self.blocked = apart < room
        near = np.nonzero(apart < room + config.near_m)
        share = np.clip((room + config.near_m - apart[near]) / max(config.near_m, 1e-6), 0.0, 1.0)
        cost[near] += config.near_cost * share ** 2
        cost[self.dark] += config.unknown_cost
        if overview is not None:
            x, y = self._centre(np.arange(len(cost)), np.arange(len(cost)))
            cost[self.unknown & overview.closed_at(x, y)] += WALL_COST
        shadow = np.zeros_like(self.dark)
        for disc in discs:
            if disc.ground is Ground.SHADOW:
                shadow[self._within((disc.x_m, disc.y_m), disc.radius_m)] = True
        shadow &= self.dark
        if creep:
            cost[shadow] += _SHADOW_COST
            shadow[:] = False
        # The rover may stand where it would not go, and leaves it, but not over an obstacle.
        around = self._within(self._rover, room + 2.0 * grid.cell_m)
        cost[around] += _ESCAPE * self.blocked[around]
        closed = self.blocked | shadow
        closed[around] = self.lethal[around] | shadow[around]
        closed[self._within(self._rover, 0.5 * radius_m)] = False
        cost[closed] = -1.0             # not to be crossed
        self._cost = cost

    def plan(self, goal_xy_m: ArrayLike) -> Plan | None:
        """Return the cheapest way to a goal; None if there is none, or the rover is off the map.

        A goal beyond the map, or one that no way on the map leads to, is approached at the edge
        from which way and rest cost least. A goal on an obstacle is replaced by the nearest place
        that can be reached.
        """
        goal = np.asarray(goal_xy_m, float)[:2]
        start, end = self._cell(self._rover), self._cell(goal)
        if not self._inside(start):
            return None
        search = MCP_Geometric(self._cost, fully_connected=True)
        if self._inside(end) and self._cost[end] > 0.0:
            total, _ = search.find_costs([start], [end])
            if math.isfinite(total[end]):
                return self._made(search.traceback(end), goal, goal)
        total, _ = search.find_costs([start])
        n = len(total)
        rows, columns = np.mgrid[0:n, 0:n]
        x, y = self._centre(rows, columns)
        rest = np.hypot(x - goal[0], y - goal[1])
        if self._inside(end) and self._cost[end] < 0.0:
            # Where it may stand on known ground, or stands; only dark ground is looked at first.
            reached = np.isfinite(total) & (rest <= _SEARCH_M)
            fits = reached & ~self.blocked
            known = fits & ~self.dark
            known[start] = reached[start]
            near = np.where(known if known.any() else fits, rest, np.inf)
            best = np.unravel_index(int(np.argmin(near)), near.shape)
            if math.isfinite(near[best]):
                found = self._made(search.traceback(best), None, goal)
                return dataclasses.replace(found, off_goal_m=float(rest[best]))
        edge = np.full(total.shape, np.inf)
        for side in (np.s_[0, :], np.s_[-1, :], np.s_[:, 0], np.s_[:, -1]):
            points = np.stack([x[side], y[side]], axis=-1)
            edge[side] = (total[side] * self._grid.cell_m + rest[side]
                          + self._detour_m(points, goal))
        best = np.unravel_index(int(np.argmin(edge)), edge.shape)
        if not math.isfinite(edge[best]) or self._inside(end) and (
                self._overview is None or not self._overview.is_open(
                    (x[best], y[best]), goal)):
            return None
        return self._made(search.traceback(best), None, goal)

    def cost_along(self, points_m: Array, goal_xy_m: ArrayLike) -> float:
        """Return the cost of a way (n, 2), and of the rest to the goal; inf if blocked."""
        goal = np.asarray(goal_xy_m, float)[:2]
        if len(points_m) < 2:
            return math.inf
        steps = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
        cost = self._at(self._cost, points_m[1:], 1.0)
        if np.any(cost < 0.0):
            return math.inf
        return float(np.sum(steps * cost)) + self._rest_m(points_m[-1], goal)

    def is_clear(self, points_m: Array) -> bool:
        """Return whether the rover fits on a way (n, 2) over known ground, or as at its start."""
        apart = self._at(self._apart, points_m, np.inf)
        dark = self._at(self.dark, points_m, True)
        return bool(apart.min() >= min(self.room_m - 0.5 * self._grid.cell_m, apart[0])
                    and (self._creep or dark[0] or not dark.any()))

    def is_blocked(self, xy_m: ArrayLike) -> bool:
        """Return whether the rover would touch an obstacle at a place (2,)."""
        return bool(self._at(self.blocked, np.asarray(xy_m, float)[None, :2], False)[0])

    def clear_back_m(self, position_m: ArrayLike, heading_rad: float, wanted_m: float) -> float:
        """Return how far the rover may back off, at most as far as wanted [m]."""
        position = np.asarray(position_m, float)[:2]
        steps = np.arange(0.0, wanted_m + 0.5 * _BACK_STEP_M, _BACK_STEP_M)
        points = position - steps[:, None] * [math.cos(heading_rad), math.sin(heading_rad)]
        apart = self._at(self._apart, points, 0.0)
        # It may leave what it is too near to, never come nearer.
        bad = (apart < np.minimum(self.room_m, apart[0])) | self._at(self.dark, points, True)
        bad[0] = False
        last = int(np.argmax(bad)) - 1 if bad.any() else len(steps) - 1
        if apart[last] <= apart[0] < self._radius_m:
            return 0.0      # a slope on which it stands goes on there
        return float(min(steps[last], wanted_m))

    def has_room(self, points_m: Array) -> NDArray[np.bool_]:
        """Return for places (n, 2) on the map whether nothing that is closed is too near (n,)."""
        return np.asarray(self._at(self._apart, points_m, 0.0) >= self.room_m)

    def dark_along_m(self, points_m: Array, from_m: float, to_m: float) -> tuple[float, Array]:
        """Return how much of a part of a way is dark [m], and where that begins (2,) [m]."""
        steps = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        if along[-1] <= from_m:
            return 0.0, points_m[-1]
        at = np.arange(from_m, min(to_m, along[-1]), 0.5 * self._grid.cell_m)
        points = np.stack([np.interp(at, along, points_m[:, k]) for k in (0, 1)], axis=-1)
        dark = self._at(self.dark, points, False)
        first = points[int(np.argmax(dark))] if dark.any() else points_m[-1]
        return 0.5 * self._grid.cell_m * float(np.count_nonzero(dark)), first

    def _made(self, cells: list[tuple[int, int]], end_m: Array | None, goal: Array) -> Plan:
        rows, columns = np.array(cells).T
        points = np.stack(self._centre(rows, columns), axis=-1)
        points[0] = self._rover
        if end_m is not None:
            points[-1] = end_m
        if len(points) < 2:
            points = np.stack([self._rover, points[-1]])
        smooth = points.copy()
        for k in (0, 1):
            smooth[1:-1, k] = gaussian_filter1d(points[:, k], _SMOOTH_CELLS,
                                                mode='nearest')[1:-1]
        if not np.any(self._at(self._cost, smooth[1:-1], 1.0) < 0.0):
            points = smooth
        return Plan(points, self.cost_along(points, goal), end_m is not None)

    def _rest_m(self, end_m: Array, goal: Array) -> float:
        """Return what it costs from the end of a way (2,) to a goal."""
        straight = float(np.linalg.norm(end_m - goal))
        return straight if self._inside(self._cell(goal)) \
            else straight + float(self._detour_m(end_m[None], goal)[0])

    def _detour_m(self, points_m: Array, goal: Array) -> Array:
        """Return what ways from (n, 2) to a goal beyond the map cost more than straight ones."""
        return (np.zeros(len(points_m)) if self._overview is None
                else self._overview.detour_m(points_m, goal))

    def _share_around(self, cells: NDArray[np.bool_], radius_m: float) -> NDArray[np.float32]:
        """Return of which share of a circle around each cell holds what is true."""
        k = max(1, math.ceil(radius_m / self._grid.cell_m))
        off = np.arange(-k, k + 1) * self._grid.cell_m
        circle = (np.hypot(off[:, None], off) <= radius_m).astype(np.float32)
        return np.asarray(cv2.filter2D(cells.astype(np.float32), -1, circle / circle.sum(),
                                       borderType=cv2.BORDER_REPLICATE), np.float32)

    def _cell(self, xy_m: ArrayLike) -> tuple[int, int]:
        column, row = np.floor((np.asarray(xy_m, float) - self._grid.origin_m)
                               / self._grid.cell_m).astype(int)
        return int(row), int(column)

    def _inside(self, cell: tuple[int, int]) -> bool:
        n = len(self._grid.cost)
        return 0 <= cell[0] < n and 0 <= cell[1] < n

    def _centre(self, rows: NDArray, columns: NDArray) -> tuple[Array, Array]:
        cell, origin = self._grid.cell_m, self._grid.origin_m
        return origin[0] + (columns + 0.5) * cell, origin[1] + (rows + 0.5) * cell

    def _reaches(self, disc: Disc) -> bool:
        """Return whether a disc may reach the map."""
        half = 0.5 * len(self._grid.cost) * self._grid.cell_m
        reach = half + disc.radius_m
        x, y = self._grid.origin_m
        return abs(disc.x_m - x - half) <= reach and abs(disc.y_m - y - half) <= reach

    def _within(self, xy_m: ArrayLike, radius_m: float) -> tuple[NDArray, NDArray]:
        """Return rows and columns of the cells whose centres lie in a circle."""
        n, cell = len(self._grid.cost), self._grid.cell_m
        middle = (np.asarray(xy_m, float)[:2] - self._grid.origin_m) / cell - 0.5
        low, high = (np.clip(middle + sign * radius_m / cell, 0, n).astype(int) + (sign > 0)
                     for sign in (-1.0, 1.0))
        columns, rows = (np.arange(a, min(b, n)) for a, b in zip(low, high))
        r, c = np.nonzero(np.hypot(rows[:, None] - middle[1], columns - middle[0])
                          <= radius_m / cell)
        return rows[r], columns[c]

    def _at(self, values: NDArray, points_m: Array, outside: float) -> NDArray:
        cells = np.floor((points_m - self._grid.origin_m) / self._grid.cell_m).astype(int)
        n = len(values)
        inside = np.all((cells >= 0) & (cells < n), axis=-1)
        columns, rows = np.clip(cells, 0, n - 1).T
        return np.where(inside, values[rows, columns], outside)
