"""Plans over maps from orbit: what ground costs there, and ways that are made anew on news."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
import scipy.ndimage

from lunar_rover_sim.autonomy.navigation.config import GlobalPlanConfig
from lunar_rover_sim.autonomy.navigation.incremental_search import Cell, IncrementalSearch
from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.errors import brief, NavigationError
from lunar_rover_sim.base.frames import Array, distance_along
from lunar_rover_sim.ground.world.orbital_map import NO_PHOTO, OrbitalMap
from lunar_rover_sim.ground.world.shade import shadow

F32 = NDArray[np.float32]

# What a metre costs more: at a slope just below the limit; where the RMS of heights about the
# plane of a cell and its neighbours is _ROUGH_M; inside a mapped crater, whose walls may be
# steeper than the pixels show; on ground in shadow; in a cell where the rover found no way.
_SLOPE_COST, _ROUGH_M, _ROUGH_COST = 6.0, 0.5, 2.0
_CRATER_COST, _DARK_COST, _BLOCKED_COST = 3.0, 10.0, 20.0
_RIM = 1.2              # radii of a mapped crater that cost more
# A photo shows shadows where its sun is so near to that of the rover in azimuth and in elevation:
# its pixels that are darker than a share of what is bright, the quantile 0.9.
_SAME_SUN_DEG, _BRIGHT, _DARK = (10.0, 1.0), 0.9, 0.1
_SHOWN_CELLS = 8.0      # a crater of so many cells shows its walls in the heights
_ESCAPE = 50.0          # of a cell where the rover stands although it may not cross it
_SHORTCUT_CELLS = 24    # of a way that one straight line may replace
_BACK_M, _FORWARD_M = 5.0, 30.0     # of the way, where the rover is looked for
_AT_M = 0.5


@dataclasses.dataclass(frozen=True)
class GroundCosts:
    """What a metre costs from cell to cell, row 0 south; inf: not to be crossed.

    Attributes:
        cost: (rows, columns) float32.
        low_m: (2,) corner of the cell [0, 0] with the least x and y, site frame.
        cell_m: Side of a cell.
        known: (rows, columns) where the map has heights.
    """

    cost: F32
    low_m: tuple[float, float]
    cell_m: float
    known: NDArray[np.bool_]

    @staticmethod
    def of(orbital: OrbitalMap, config: GlobalPlanConfig = GlobalPlanConfig(),
           sun_deg: tuple[float, float] | None = None, hole_margin_m: float = 0.0) -> GroundCosts:
        """Return the costs of a map from orbit.

        Args:
            orbital: Heights, craters and photo; slopes count less what their errors make of them.
            config: Side of a cell, and the steepest slope.
            sun_deg: Azimuth and elevation of the sun, for shadows: those of the photo where it
                was taken under this sun, else those of the heights; None: no shadow is known.
            hole_margin_m: Ground nearer to a hole than this, in x or y, counts as a hole.
        """
        factor = max(1, round(config.cell_m / orbital.pixel_m))
        cell = factor * orbital.pixel_m
        heights = orbital.heights_m
        rows, columns = (n // factor for n in heights.shape)
        if min(rows, columns) < 2:
            raise NavigationError(f'far.cell_m: {config.cell_m:g} is not valid; valid is at most '
                                  'half of the map from orbit')
        means = heights[:rows * factor, :columns * factor].astype(float).reshape(
            rows, factor, columns, factor).mean(axis=(1, 3))
        known = np.isfinite(means)
        filled = _filled(means, known)
        dy, dx = np.gradient(filled, cell)
        errors = orbital.config
        # Noise of correlation exp(-(d / L)^2) has slopes of variance 2 s^2 / L^2 in x and in y;
        # differences over two cells show less of it.
        apart, length = 2.0 * cell, max(errors.correlation_m, 1e-9)
        noise = 4.0 * errors.height_stddev_m ** 2 * -math.expm1(-(apart / length) ** 2) / apart**2
        slope = np.sqrt(np.maximum(dx * dx + dy * dy - noise, 0.0))
        share = slope / math.tan(math.radians(config.max_slope_deg))
        cost = 1.0 + _SLOPE_COST * np.minimum(share, 1.0) ** 2
        rough = np.maximum(_roughness(filled) - _unresolved(errors.height_stddev_m, cell, length),
                           0.0)
        cost += _ROUGH_COST * np.minimum(rough / _ROUGH_M, 2.0) ** 2
        if not known.all():
            reach = 2 * math.ceil(hole_margin_m / cell) + 1
            known = scipy.ndimage.minimum_filter(known, reach, mode='nearest')
        west, south = orbital.bounds_m[:2]
        x, y = (low + (np.arange(n) + 0.5) * cell for low, n in ((west, columns), (south, rows)))
        _add_craters(cost, x, y, cell, orbital)
        if sun_deg is not None:
            seen = _seen_dark(orbital, sun_deg, (west, south), cell, cost.shape)
            cost += _DARK_COST * np.where(
                np.isnan(seen), shadow(filled.astype(np.float32), cell, *sun_deg), seen)
        cost[(share >= 1.0) | ~known] = np.inf
        return GroundCosts(cost.astype(np.float32), (west, south), cell, known)

    def cell_of(self, xy_m: ArrayLike) -> Cell | None:
        """Return row and column of a place (2,), None beyond the map."""
        x, y = (np.asarray(xy_m, float)[:2] - self.low_m) / self.cell_m
        rows, columns = self.cost.shape
        if not (0.0 <= x <= columns and 0.0 <= y <= rows):
            return None
        return min(int(y), rows - 1), min(int(x), columns - 1)

    def checked(self, goal: ArrayLike, border_m: float = 0.0) -> Array:
        """Return a goal (2,) as numbers.

        Args:
            border_m: Goals nearer to the edge of the map are refused.

        Raises:
            NavigationError: If it is none, lies beyond the map, or where no rover can stand.
        """
        try:
            point = np.asarray(goal, float)[:2]
        except (TypeError, ValueError):
            point = np.empty(0)
        if point.shape != (2,) or not np.isfinite(point).all():
            raise NavigationError(f'goal: {brief(goal)} is not valid; valid are finite x, y [m]')
        low = np.array(self.low_m) + border_m
        high = self.low_m + np.array(self.cost.shape[::-1]) * self.cell_m - border_m
        if (point < low).any() or (point > high).any():
            raise NavigationError(
                f'goal: x {point[0]:g} m, y {point[1]:g} m is beyond the map of the site; valid '
                f'are x of {low[0]:g} to {high[0]:g} m and y of {low[1]:g} to {high[1]:g} m')
        cell = self.cell_of(point)
        assert cell is not None
        if not np.isfinite(self.cost[cell]):
            why = ('is steeper than far.max_slope_deg' if self.known[cell]
                   else 'is in a hole of the map')
            raise NavigationError(f'goal: x {point[0]:g} m, y {point[1]:g} m {why}; valid is '
                                  'ground that the rover can cross')
        return point.copy()

    def centre_m(self, cells: NDArray[np.int64]) -> Array:
        """Return the middles (n, 2) of cells (n, 2), rows and columns."""
        return np.asarray(cells[:, ::-1] + 0.5) * self.cell_m + self.low_m

    def has_ground(self, x_m: float, y_m: float) -> bool:
        """Return whether the map knows the ground at a place."""
        return bool(self.known_at(np.array([x_m]), np.array([y_m]))[0, 0])

    def known_at(self, x_m: Array, y_m: Array) -> NDArray[np.bool_]:
        """Return where the map knows the ground, for columns x (n,) and rows y (m,) as (m, n)."""
        rows, columns = (np.floor((at - low) / self.cell_m).astype(int)
                         for at, low in zip((y_m, x_m), self.low_m[::-1]))
        return _looked_up(self.known, rows, columns, False)


def _looked_up(raster: NDArray[Any], rows: NDArray[np.int64], columns: NDArray[np.int64],
               beyond: int) -> NDArray[Any]:
    """Return the cells at rows (m,) and columns (n,) as (m, n), another value beyond them."""
    inside = [(k >= 0) & (k < size) for k, size in zip((rows, columns), raster.shape)]
    found = np.full((len(rows), len(columns)), beyond, raster.dtype)
    found[np.ix_(*inside)] = raster[np.ix_(rows[inside[0]], columns[inside[1]])]
    return found


def _filled(values: Array, known: NDArray[np.bool_]) -> Array:
    """Return values with the nearest known ones in holes."""
    if known.all() or not known.any():
        return np.nan_to_num(values)
    nearest = scipy.ndimage.distance_transform_edt(~known, return_distances=False,
                                                   return_indices=True)
    return np.asarray(values[tuple(nearest)])


def _roughness(heights: Array) -> Array:
    """Return the RMS about the plane of three by three cells."""
    def mean(values: Array) -> Array:
        return np.asarray(scipy.ndimage.uniform_filter(values, 3, mode='nearest'))

    dy, dx = np.gradient(heights)
    middle = mean(heights)
    spread = mean(heights * heights) - middle * middle
    # Of a plane with these slopes the nine heights have this variance.
    return np.sqrt(np.maximum(spread - (dx * dx + dy * dy) * 2.0 / 3.0, 0.0))


def _unresolved(stddev_m: float, cell_m: float, length_m: float) -> float:
    """Return how much of the errors of heights differs from cell to cell [m]."""
    return stddev_m * math.sqrt(-math.expm1(-(cell_m / length_m) ** 2))


def _seen_dark(orbital: OrbitalMap, sun_deg: tuple[float, float], low_m: tuple[float, float],
               cell_m: float, shape: tuple[int, ...]) -> Array:
    """Return how much of each cell is dark on the photo; NaN where that does not tell."""
    config, known = orbital.config, orbital.photo[orbital.photo != NO_PHOTO]
    azimuth = math.remainder(config.sun_azimuth_deg - sun_deg[0], 360.0)
    elevation = config.sun_elevation_deg - sun_deg[1]
    if not known.size or abs(azimuth) > _SAME_SUN_DEG[0] or abs(elevation) > _SAME_SUN_DEG[1]:
        return np.full(shape, np.nan)
    # Places along a side of a cell.
    count = max(1, round(cell_m / config.photo_pixel_m))
    rows, columns = (np.rint((low + (np.arange(n * count) + 0.5) * cell_m / count - first)
                             / config.photo_pixel_m).astype(int)
                     for n, low, first in zip(shape, low_m[::-1], orbital.photo_first_m[::-1]))
    values = _looked_up(orbital.photo, rows, columns, NO_PHOTO)

    def share(flags: NDArray[np.bool_]) -> Array:
        return np.asarray(flags.reshape(shape[0], count, shape[1], count).mean(axis=(1, 3)))

    seen = values != NO_PHOTO
    dark = seen & (values < _DARK * np.quantile(known, _BRIGHT))
    with np.errstate(invalid='ignore'):
        return share(dark) / share(seen)


def _add_craters(cost: Array, x_m: Array, y_m: Array, cell_m: float,
                 orbital: OrbitalMap) -> None:
    """Raise the costs within mapped craters, of small ones fully; in place."""
    margin = orbital.config.crater_place_m
    for (x, y), size in zip(orbital.craters.position_m, orbital.craters.diameter_m):
        extra = _CRATER_COST * max(1.0 - size / (_SHOWN_CELLS * cell_m), 0.0)
        reach = 0.5 * _RIM * size + margin
        columns, rows = (slice(*np.searchsorted(axis, (v - reach, v + reach)))
                         for axis, v in ((x_m, x), (y_m, y)))
        if extra == 0.0 or columns.start == columns.stop or rows.start == rows.stop:
            continue
        inside = np.hypot(x_m[columns] - x, y_m[rows, None] - y) <= reach
        part = cost[rows, columns]
        np.copyto(part, np.maximum(part, 1.0 + extra), where=inside)


class GlobalPlan:
    """A way over the map from orbit through way points to a goal; made anew where it is blocked.

    Attributes:
        points_m: (n, 2) from the rover on to the goal.
        goals_m: What is still to be reached, (2,) each.
        made: How many plans were made.
        costs: What ground costs, with what was reported.
    """

    def __init__(self, costs: GroundCosts, start_m: ArrayLike, goals_m: Sequence[ArrayLike],
                 config: GlobalPlanConfig = GlobalPlanConfig(), border_m: float = 0.0) -> None:
        """Plan from a place (2,) through way points to the last of the goals, site frame [m].

        Args:
            border_m: Goals nearer to the edge of the map are refused.

        Raises:
            NavigationError: If there is no goal, one lies beyond the map or where no rover can
                stand, or no way leads there.
        """
        self.costs, self.config = dataclasses.replace(costs, cost=costs.cost.copy()), config
        self.goals_m = tuple(costs.checked(goal, border_m) for goal in goals_m)
        if not self.goals_m:
            raise NavigationError('goals_m: none is given; valid is one or more')
        self.made = 0
        self._expanded = 0
        start = self._start(start_m)
        self._searches = [self._search(goal) for goal in self.goals_m]
        places = [start, *self.goals_m]
        self._legs = [self._leg(search, a, b)
                      for search, a, b in zip(self._searches, places, places[1:])]
        del self._searches[1:]      # those of later legs are made again when they begin
        self._joined()

    @property
    def expanded(self) -> int:
        """Cells that searches have looked at so far, for all plans of the present leg."""
        return self._expanded + self._searches[0].expanded

    @property
    def length_m(self) -> float:
        """Length of the whole plan [m]."""
        return float(self._along[-1])

    def left_m(self, position_m: ArrayLike) -> float:
        """Return how far it is from a place (2,) along the plan to the goal [m]."""
        along, off = self._place(position_m)
        return float(self._along[-1]) - along + off

    def ahead(self, position_m: ArrayLike, distance_m: float | None = None) -> Array:
        """Return the place (2,) on the plan that is so far on, at most the next of the goals.

        Args:
            distance_m: None: `ahead_m` of the configuration.
        """
        distance = self.config.ahead_m if distance_m is None else distance_m
        at = min(self._place(position_m)[0] + distance, self._leg_end_m)
        return np.array([np.interp(at, self._along, self.points_m[:, k]) for k in (0, 1)])

    def has_ground(self, x_m: float, y_m: float) -> bool:
        """Return whether the map knows the ground at a place."""
        return self.costs.has_ground(x_m, y_m)

    def reach(self, position_m: ArrayLike) -> None:
        """Go on to the next goal, from the present one."""
        self.goals_m = self.goals_m[1:]
        self._legs = self._legs[1:]
        self._searches = []
        if self.goals_m:
            self._searches = [self._search(self.goals_m[0])]
            self.replan(position_m)

    def report_blocked(self, points_m: ArrayLike, position_m: ArrayLike) -> bool:
        """Take in that no way was found through places (n, 2), and plan anew from another (2,).

        The cells of these places cost more from now on.

        Returns:
            Whether there is a new plan; the old one stays without.
        """
        costs = self.costs
        own = costs.cell_of(position_m)
        cells = {cell for xy in np.asarray(points_m, float).reshape(-1, 2)
                 if (cell := costs.cell_of(xy)) is not None}
        if len(cells) > 1:
            cells.discard(own)      # type: ignore[arg-type]
        if cells:
            rows, columns = np.array(sorted(cells)).T
            costs.cost[rows, columns] += np.float32(_BLOCKED_COST)
            self._searches[0].changed(rows, columns)
        return self.replan(position_m)

    def replan(self, position_m: ArrayLike) -> bool:
        """Plan anew from a place (2,); return whether there is a way: else the old one stays."""
        try:
            self._legs[0] = self._leg(self._searches[0], self._start(position_m),
                                      self.goals_m[0])
        except NavigationError:
            return False
        self._joined()
        return True

    def _start(self, start_m: ArrayLike) -> Array:
        start = np.asarray(start_m, float)[:2]
        cell = self.costs.cell_of(start) if np.isfinite(start).all() else None
        if cell is None:
            raise NavigationError(f'start: {brief(start_m)} is not on the map of the site')
        if not np.isfinite(self.costs.cost[cell]):
            # The map must be wrong here.
            self.costs.cost[cell] = _ESCAPE
            for search in getattr(self, '_searches', []):
                search.changed(np.array([cell[0]]), np.array([cell[1]]))
        return start

    def _search(self, goal: Array) -> IncrementalSearch:
        cell = self.costs.cell_of(goal)
        assert cell is not None
        return IncrementalSearch(self.costs.cost, cell)

    def _leg(self, search: IncrementalSearch, start: Array, goal: Array) -> Array:
        cell = self.costs.cell_of(start)
        assert cell is not None
        cells = search.way(cell)
        if cells is None:
            raise NavigationError(
                f'goal: no way leads from x {start[0]:g} m, y {start[1]:g} m to x {goal[0]:g} m, '
                f'y {goal[1]:g} m over ground that is known and less steep than '
                f'far.max_slope_deg {self.config.max_slope_deg:g}')
        self.made += 1
        kept = _straightened(self.costs.cost, cells, _SHORTCUT_CELLS)
        points = self.costs.centre_m(cells[kept])
        return np.concatenate([start[None], points[1:-1], goal[None]])

    def _joined(self) -> None:
        self.points_m = np.concatenate([self._legs[0], *(leg[1:] for leg in self._legs[1:])])
        self._along = distance_along(self.points_m)
        self._leg_end_m = float(self._along[len(self._legs[0]) - 1])
        self._at_m = 0.0

    def _place(self, position_m: ArrayLike) -> tuple[float, float]:
        """Return how far along the plan the rover is, and how far off it [m]; it only advances.

        It is looked for near where it was, so that another part that passes by is not taken.
        """
        position = np.asarray(position_m, float)[:2]
        s = np.arange(max(self._at_m - _BACK_M, 0.0),
                      min(self._at_m + _FORWARD_M, self._leg_end_m) + _AT_M, _AT_M)
        points = np.stack([np.interp(s, self._along, self.points_m[:, k]) for k in (0, 1)], -1)
        off = np.linalg.norm(points - position, axis=1)
        nearest = int(np.argmin(off))
        self._at_m = max(self._at_m, min(float(s[nearest]), self._leg_end_m))
        return self._at_m, float(off[nearest])


@compiled
def _along_line(cost, r0, c0, r1, c1):
    """Return what a straight line between the middles of two cells costs [cells]."""
    length = math.hypot(r1 - r0, c1 - c0)
    count = int(2.0 * length) + 1
    total = 0.0
    for k in range(count):
        t = (k + 0.5) / count
        total += cost[int(math.floor(r0 + t * (r1 - r0) + 0.5)),
                      int(math.floor(c0 + t * (c1 - c0) + 0.5))]
    return total * length / count


@compiled
def _straightened(cost, cells, most):
    """Return which cells of a way are its corners, where straight lines cost no more than it."""
    count = len(cells)
    total = np.zeros(count)
    for k in range(1, count):
        r0, c0, r1, c1 = cells[k - 1, 0], cells[k - 1, 1], cells[k, 0], cells[k, 1]
        total[k] = total[k - 1] + math.hypot(r1 - r0, c1 - c0) * 0.5 * (
            float(cost[r0, c0]) + float(cost[r1, c1]))
    kept = np.empty(count, np.int64)
    kept[0], found, at = 0, 1, 0
    while at < count - 1:
        best = at + 1
        for k in range(at + 2, min(at + most, count - 1) + 1):
            if _along_line(cost, cells[at, 0], cells[at, 1], cells[k, 0],
                           cells[k, 1]) <= total[k] - total[at] + 1e-6:
                best = k
        at = best
        kept[found] = at
        found += 1
    return kept[:found]
