"""The rolling elevation map: heights with variance, robust to pitch and wrong matches.

Points of a frame are first averaged cell by cell, weighted by their errors. The frame is then
levelled: height, pitch and roll by which it deviates from what the map knows are fitted and taken
out, as far as the stated errors of the pose allow. The map takes over its part of them, and so
stays as level as the poses are over some seconds: else small errors of the frames would add up.
What remains enters the cells by a Kalman filter each. A height that contradicts its cell is
counted instead; several in a row replace it.

Where a front hides ground the matcher finds nothing, and around that hole the depth of the front:
it would fill ground that nobody sees. Such pixels are left out.

What neighbouring frames have wrong in common does not average out. It is kept apart, as the doubt
of a cell: a share of the errors of depth, and those of matches beside edges of depth, where the
window of the matcher covers both sides.
"""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.autonomy.navigation.config import MapConfig
from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.errors import brief, NavigationError
from lunar_rover_sim.base.files.state_file import attributes_but, restore_attributes
from lunar_rover_sim.base.frames import Array

F32 = NDArray[np.float32]
Index = NDArray[np.int64]

_STEP_CELLS = 8             # by which the map rolls
_JUMP_M, _MOST_MPS = 0.5, 1.0   # a pose that jumps by more, beyond this speed, begins the map anew
_LEAST_HITS = 3             # frames that must have seen a cell before it is known
_CONTRADICTIONS = 4         # frames in a row that contradict a cell before it takes their height
_LEAST_SHARE = 0.005        # of the pixels, or points, that renew the map: a covered lens does not
_RANGE_STDDEV_M = 0.01      # error of a range that does not grow with it: LiDAR, or calibration
_LEAST_COMMON = 60          # cells that a frame must share with the map to be levelled
_ROUNDS, _HUBER = 4, 2.0    # of levelling
_LEVEL_S = 10.0             # over which the map follows the poses: several steps of the walk
_RELIEF = 0.4               # of the range of heights around a cell: its standard deviation
_SHARED = 0.25              # of the variance of a depth: what the next frames have wrong as well
# Half the window of the matcher in pixels, at half and at full resolution; disparities that bend
# by more over them are wrong by this share of the rest. Measured against true depth.
_EDGE_PX, _BEND_PX, _EDGE_SHARE = (3, 6), 0.8, 0.7
# A front is nearer by this disparity than ground within a reach along its row. In an image of
# 640 px: that reach, and how far a front grows sideways and upwards, beside a hole of the matcher.
_FRONT_PX, _REACH_PX, _GROWN_PX = 0.8, 32.0, (6.0, 4.0)


@dataclasses.dataclass(frozen=True)
class Elevation:
    """A map at a stamp; row 0 south, column 0 west, axes of the frame of the poses.

    Attributes:
        stamp_ns: Of the newest depth in it [ns].
        origin_m: (2,) corner of the cell [0, 0] with the least x and y.
        cell_m: Side of a cell.
        height_m: (n, n) float32, NaN where unknown.
        variance_m2: (n, n) float32 of the errors of depth, NaN where unknown.
        doubt_m2: (n, n) float32 of the errors that frames share, NaN where unknown.
    """

    stamp_ns: int
    origin_m: Array
    cell_m: float
    height_m: F32
    variance_m2: F32
    doubt_m2: F32 | None = None

    @property
    def centres_m(self) -> tuple[Array, Array]:
        """x of the columns and y of the rows: the centres of the cells [m]."""
        n = len(self.height_m)
        steps = (np.arange(n) + 0.5) * self.cell_m
        return self.origin_m[0] + steps, self.origin_m[1] + steps

    def stddev_m(self) -> F32:
        """Return the standard deviation (n, n) of the mean height of a cell, NaN where unknown.

        To the errors of depth it adds those that frames share, and those of the relief: of a cell
        at a rock only a part is seen, its face or its top.
        """
        variance = self.variance_m2 + (_RELIEF * _relief(self.height_m)) ** 2
        if self.doubt_m2 is not None:
            variance = variance + self.doubt_m2
        return np.asarray(np.sqrt(variance), np.float32)


class ElevationMap:
    """A map that rolls with the rover. The same calls give the same map."""

    def __init__(self, config: MapConfig) -> None:
        self.config = config
        n = config.cells
        self._height = np.zeros((n, n), np.float32)
        self._variance = np.zeros((n, n), np.float32)
        self._doubt = np.zeros((n, n), np.float32)
        self._hits = np.zeros((n, n), np.int32)
        self._misses = np.zeros((n, n), np.int32)
        self._sums = np.zeros((5, n, n), np.float64)
        self._corner: NDArray[np.int64] | None = None      # cell of [0, 0], in cells of the world
        self._last: tuple[int, Array] | None = None
        self._seen_ns: int | None = None
        self.begun_anew = 0

    def clear(self) -> None:
        """Forget everything."""
        self._hits[:] = 0
        self._misses[:] = 0
        self._corner = self._last = self._seen_ns = None

    def state(self) -> dict[str, Any]:
        """Return all that the map goes on from."""
        return attributes_but(self, 'config', '_sums')

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` has returned, of a map with the same parameters."""
        restore_attributes(self, state)

    @property
    def has_seen(self) -> bool:
        """Whether any frame has held depth."""
        return self._seen_ns is not None

    def add_depth(self, stamp_ns: int, depth_m: F32, K: ArrayLike, baseline_m: float,
                  T_map_camera: ArrayLike, position_m: ArrayLike) -> bool:
        """Take in a depth image.

        Args:
            stamp_ns: Of the image [ns].
            depth_m: (h, w) along the optical axis; what is not finite is not known.
            K: (3, 3) intrinsics of the rectified image [px].
            baseline_m: Of the stereo pair; 0: of a depth whose error does not grow with it.
            T_map_camera: (4, 4) pose of the camera, optical axes.
            position_m: (3,) of the rover, around which the map is kept.

        Returns:
            Whether the map was begun anew, since the pose had jumped.

        Raises:
            NavigationError: If an argument is not valid.
        """
        K = np.asarray(K, float)
        if depth_m.ndim != 2 or depth_m.dtype != np.float32:
            raise NavigationError(f'depth_m: {depth_m.dtype} {depth_m.shape} is not valid; valid '
                                  'is float32 (h, w)')
        T = _checked_pose('T_map_camera', T_map_camera)
        anew = self._follow(stamp_ns, position_m)
        h, w = depth_m.shape
        u = (np.arange(w) - K[0, 2]) / K[0, 0]
        v = (np.arange(h) - K[1, 2]) / K[1, 1]
        # Of a disparity of 1 px, the inverse depth [1/m].
        inverse = 1.0 / (K[0, 0] * baseline_m) if baseline_m else 0.0
        assert self._corner is not None
        self._sums[:] = 0.0
        config = self.config
        hole, scale = (~np.isfinite(depth_m)).astype(np.uint8), w / 640.0
        _scatter_depth(np.ascontiguousarray(depth_m),
                       _without_edges(depth_m, hole, int(config.hole_px * scale)),
                       _grown(hole, *(int(px * scale) for px in _GROWN_PX)),
                       int(_REACH_PX * scale), u, v, T, self._corner, config.cell_m,
                       config.min_range_m, config.max_range_m, inverse,
                       config.disparity_stddev_px, _RANGE_STDDEV_M, config.height_stddev_m,
                       config.grazing, self._sums)
        self._take_in(stamp_ns, depth_m.size, np.asarray(position_m, float))
        return anew

    def add_points(self, stamp_ns: int, points_m: ArrayLike, T_map_sensor: ArrayLike,
                   position_m: ArrayLike) -> bool:
        """Take in (n, 3) points in the frame of a LiDAR; else as `add_depth`."""
        points = np.asarray(points_m, float).reshape(-1, 3)
        T = _checked_pose('T_map_sensor', T_map_sensor)
        anew = self._follow(stamp_ns, position_m)
        assert self._corner is not None
        self._sums[:] = 0.0
        _scatter_points(points, T, self._corner, self.config.cell_m, self.config.min_range_m,
                        self.config.max_range_m, _RANGE_STDDEV_M,
                        self.config.height_stddev_m, self._sums)
        self._take_in(stamp_ns, len(points), np.asarray(position_m, float))
        return anew

    def elevation(self) -> Elevation:
        """Return the map as it is now; raise NavigationError before the first depth."""
        if self._corner is None or self._seen_ns is None:
            raise NavigationError('the map has seen nothing yet')
        known = self._hits >= _LEAST_HITS
        nan = np.float32(np.nan)
        origin = np.asarray(self._corner * self.config.cell_m, float)
        return Elevation(self._seen_ns, origin, self.config.cell_m,
                         *(np.where(known, array, nan)
                           for array in (self._height, self._variance, self._doubt)))

    def _follow(self, stamp_ns: int, position_m: ArrayLike) -> bool:
        """Roll the map to the rover; return whether the pose has jumped, and all is forgotten."""
        position = np.asarray(position_m, float)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise NavigationError(f'position_m: {brief(position_m)} is not valid; valid is three '
                                  'finite numbers [m]')
        config, jumped = self.config, False
        if self._last is not None:
            moved = float(np.linalg.norm(position - self._last[1]))
            seconds = (stamp_ns - self._last[0]) * 1e-9
            if seconds < 0.0 or moved > _JUMP_M + _MOST_MPS * seconds:
                self.clear()
                self.begun_anew += 1
                jumped = True
            else:
                self._variance += np.float32((config.drift * moved) ** 2)
        self._last = stamp_ns, position.copy()
        n = config.cells
        wanted = np.round(position[:2] / config.cell_m).astype(np.int64) - n // 2
        if self._corner is None:
            self._corner = wanted
        shift = wanted - self._corner
        if np.abs(shift).max() >= _STEP_CELLS:
            self._corner = wanted
            for array in (self._height, self._variance, self._doubt, self._hits,
                          self._misses):
                _roll(array, int(shift[1]), int(shift[0]))
        return jumped

    def _take_in(self, stamp_ns: int, samples: int, position: Array) -> None:
        config = self.config
        since_s = 0.0 if self._seen_ns is None else (stamp_ns - self._seen_ns) * 1e-9
        if self._sums[3].sum() > _LEAST_SHARE * samples:
            self._seen_ns = stamp_ns
        floor = config.height_stddev_m ** 2
        _average(self._sums, floor)
        variance, mean, spread, count, doubt = self._sums
        if config.level_stddev_m > 0.0 or config.level_stddev_deg > 0.0:
            self._level(mean, variance, np.nonzero(count), position, since_s)
        _fuse(mean, variance, spread, count, doubt, self._height, self._variance, self._doubt,
              self._hits, self._misses, config.gate, _CONTRADICTIONS, floor / 4.0)

    def _level(self, mean: Array, variance: Array, seen: tuple[Index, ...],
               position: Array, since_s: float) -> None:
        """Bring a frame and the map together where they differ by an error of the pose.

        Args:
            since_s: Time since the frame before.
        """
        config = self.config
        assert self._corner is not None
        rows, columns = seen
        shared = self._hits[seen] >= _LEAST_HITS
        if np.count_nonzero(shared) < _LEAST_COMMON:
            return
        x, y = (np.arange(config.cells) + 0.5 + self._corner[:, None]) * config.cell_m \
            - position[:2, None]
        design = np.stack([np.ones(len(rows)), x[columns], y[rows]], axis=1)
        common = rows[shared], columns[shared]
        A = design[shared]
        off = mean[common] - self._height[common]
        sigma = np.sqrt(variance[common] + self._variance[common])
        tilt = math.tan(math.radians(config.level_stddev_deg))
        prior = 1.0 / np.maximum([config.level_stddev_m, tilt, tilt], 1e-6) ** 2
        fitted = np.zeros(3)
        for _ in range(_ROUNDS):
            left = np.abs(off - A @ fitted) / sigma
            weight = np.minimum(1.0, _HUBER / np.maximum(left, 1e-9)) / sigma ** 2
            # Neighbouring cells err alike: as if one in ten were seen.
            weight *= 0.1
            fitted = np.linalg.solve((A * weight[:, None]).T @ A + np.diag(prior),
                                     A.T @ (weight * off))
        share = -math.expm1(-since_s / _LEVEL_S)
        self._height += (share * (fitted[0] + fitted[1] * x + fitted[2] * y[:, None])).astype(
            np.float32)
        mean[seen] -= (1.0 - share) * (design @ fitted)


def _without_edges(depth_m: F32, hole: NDArray[np.uint8], margin_px: int) -> F32:
    """Return a depth image without the pixels that near to a hole in it."""
    return np.where(_grown(hole, margin_px, margin_px), np.float32(np.nan), depth_m)


def _grown(image: NDArray, sideways: int, upwards: int) -> NDArray:
    """Return the largest value around each pixel, up to so many pixels away."""
    return np.asarray(cv2.dilate(image, np.ones((2 * upwards + 1, 2 * sideways + 1))))


def _checked_pose(name: str, pose: ArrayLike) -> Array:
    T = np.ascontiguousarray(pose, float)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise NavigationError(f'{name}: {brief(pose)} is not valid; valid is a finite (4, 4) pose')
    return T


def _roll(array: NDArray, rows: int, columns: int) -> None:
    """Move an array against the rover's way; what comes in is 0."""
    n = len(array)
    moved = np.zeros_like(array)
    if abs(rows) < n and abs(columns) < n:
        to = [slice(max(-k, 0), n - max(k, 0)) for k in (rows, columns)]
        of = [slice(max(k, 0), n - max(-k, 0)) for k in (rows, columns)]
        moved[to[0], to[1]] = array[of[0], of[1]]
    array[:] = moved


@compiled
def _relief(heights: F32) -> F32:
    """Return the range of the known heights of each cell and its eight neighbours."""
    found = np.full_like(heights, np.nan)
    rows, columns = heights.shape
    for r in range(rows):
        for c in range(columns):
            if not math.isfinite(heights[r, c]):
                continue
            low = high = heights[r, c]
            for i in range(max(r - 1, 0), min(r + 2, rows)):
                for j in range(max(c - 1, 0), min(c + 2, columns)):
                    if math.isfinite(heights[i, j]):
                        low, high = min(low, heights[i, j]), max(high, heights[i, j])
            found[r, c] = high - low
    return found


@compiled
def _add(sums: Array, row: int, column: int, height: float, variance: float,
         doubt: float) -> None:
    """Add a height to the weighted sums of a cell."""
    weight = 1.0 / variance
    sums[0, row, column] += weight
    sums[1, row, column] += weight * height
    sums[2, row, column] += weight * height * height
    sums[3, row, column] += 1.0
    sums[4, row, column] += weight * doubt


@compiled
def _bend(depth: F32, row: int, column: int, apart: int) -> float:
    """Return the larger second difference of 1 / depth along row and column; 0 on a plane."""
    rows, columns = depth.shape
    middle, most = 2.0 / depth[row, column], 0.0
    if apart <= row < rows - apart:
        most = abs(1.0 / depth[row - apart, column] + 1.0 / depth[row + apart, column] - middle)
        if not math.isfinite(most):
            most = 0.0
    if apart <= column < columns - apart:
        bend = abs(1.0 / depth[row, column - apart] + 1.0 / depth[row, column + apart] - middle)
        if math.isfinite(bend):
            most = max(most, bend)
    return most


@compiled
def _is_front(depth: F32, row: int, column: int, reach: int, bend: float) -> bool:
    """Return whether a pixel is nearer than one of its row, in 1 / depth, by more than a bend."""
    inverse = 1.0 / depth[row, column] - bend
    if inverse <= 0.0:
        return False
    farther = 1.0 / inverse
    for c in range(max(column - reach, 0), min(column + reach + 1, depth.shape[1]), 2):
        if farther < depth[row, c] < math.inf:
            return True
    return False


@compiled
def _scatter_depth(whole: F32, depth: F32, by_hole: NDArray[np.uint8], reach: int,
                   u: Array, v: Array, T: Array, corner: NDArray[np.int64], cell_m: float,
                   near_m: float, far_m: float, inverse_px: float, noise_px: float,
                   range_m: float, floor_m: float, grazing: float, sums: Array) -> None:
    noise = noise_px * inverse_px
    n = sums.shape[1]
    rows, columns = depth.shape
    apart = max(1, rows // 240)     # rows, between which a surface falls
    x0, y0 = corner[0] * cell_m, corner[1] * cell_m
    for r in range(rows):
        for c in range(columns):
            z = depth[r, c]
            if not (near_m <= z <= far_m):
                continue
            dx = T[0, 0] * u[c] + T[0, 1] * v[r] + T[0, 2]
            dy = T[1, 0] * u[c] + T[1, 1] * v[r] + T[1, 2]
            dz = T[2, 0] * u[c] + T[2, 1] * v[r] + T[2, 2]
            ix = int(math.floor((T[0, 3] + z * dx - x0) / cell_m))
            iy = int(math.floor((T[1, 3] + z * dy - y0) / cell_m))
            if ix < 0 or iy < 0 or ix >= n or iy >= n:
                continue
            if grazing < 1.0 and apart <= r < rows - apart:
                # Along a line of sight the way is z |d|, the height z dz: of the rows above, which
                # look farther, and below.
                far, near = depth[r - apart, c], depth[r + apart, c]
                step = apart * (v[1] - v[0])
                far_h = far * (dz - T[2, 1] * step)
                near_h = near * (dz + T[2, 1] * step)
                far_x = far * (dx - T[0, 1] * step) - near * (dx + T[0, 1] * step)
                far_y = far * (dy - T[1, 1] * step) - near * (dy + T[1, 1] * step)
                level = math.hypot(dx, dy)
                way = (far_x * dx + far_y * dy) / level
                sight = dz / level      # its slope, negative
                if sight < 0.0 and way > 0.0 and far_h - near_h < grazing * sight * way:
                    continue
            if noise > 0.0 and by_hole[r, c] \
                    and _is_front(whole, r, c, reach, _FRONT_PX * inverse_px):
                continue
            height = T[2, 3] + z * dz
            along = z * z * noise + range_m
            # Along the ray, and across it on ground that is not level (slopes of 0.1).
            upward = dz * dz + 0.01
            variance = along * along * upward + floor_m * floor_m
            doubt = 0.0
            if noise > 0.0:
                bend = max(_bend(whole, r, c, _EDGE_PX[0]), _bend(whole, r, c, _EDGE_PX[1]))
                edge = _EDGE_SHARE * z * z * max(bend - _BEND_PX * inverse_px, 0.0)
                doubt = (_SHARED * along * along + edge * edge) * upward
            _add(sums, iy, ix, height, variance, doubt)


@compiled
def _scatter_points(points: Array, T: Array, corner: NDArray[np.int64], cell_m: float,
                    near_m: float, far_m: float, range_m: float, floor_m: float,
                    sums: Array) -> None:
    n = sums.shape[1]
    for k in range(len(points)):
        x, y, z = points[k]
        distance = math.sqrt(x * x + y * y + z * z)
        if not (near_m <= distance <= far_m):
            continue
        ix = int(math.floor((T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / cell_m)) \
            - corner[0]
        iy = int(math.floor((T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / cell_m)) \
            - corner[1]
        if ix < 0 or iy < 0 or ix >= n or iy >= n:
            continue
        rise = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z
        height = rise + T[2, 3]
        variance = range_m * range_m * ((rise / distance) ** 2 + 0.01) + floor_m * floor_m
        _add(sums, iy, ix, height, variance, 0.0)


@compiled
def _average(sums: Array, floor: float) -> None:
    """Turn the sums of a frame into variance, mean, spread and doubt of the heights of a cell."""
    rows, columns = sums.shape[1:]
    for r in range(rows):
        for c in range(columns):
            count = sums[3, r, c]
            if count > 0.0:
                weight = sums[0, r, c]
                mean = sums[1, r, c] / weight
                # Points of one cell and frame share the errors of their matches: as good as four.
                sums[0, r, c] = count / (weight * min(count, 4.0)) + floor
                sums[1, r, c] = mean
                sums[2, r, c] = max(sums[2, r, c] / weight - mean * mean, 0.0)
                sums[4, r, c] /= weight


@compiled
def _fuse(mean: Array, variance: Array, spread: Array, count: Array, doubt: Array, height: F32,
          known_variance: F32, known_doubt: F32, hits: NDArray[np.int32],
          misses: NDArray[np.int32], gate: float, contradictions: int,
          least_variance: float) -> None:
    rows, columns = mean.shape
    for r in range(rows):
        for c in range(columns):
            if count[r, c] == 0.0:
                continue
            if hits[r, c] == 0:
                height[r, c] = mean[r, c]
                known_variance[r, c] = variance[r, c]
                known_doubt[r, c] = doubt[r, c]
                hits[r, c] = 1
                misses[r, c] = 0
                continue
            off = mean[r, c] - height[r, c]
            total = known_variance[r, c] + variance[r, c]
            # A rock within a cell is seen now from its side and now from above.
            if off * off <= gate * gate * (total + spread[r, c]):
                gain = known_variance[r, c] / total
                height[r, c] += gain * off
                known_doubt[r, c] += gain * (doubt[r, c] - known_doubt[r, c])
                known_variance[r, c] = max((1.0 - gain) * known_variance[r, c], least_variance)
                hits[r, c] += 1
                misses[r, c] = 0
            else:
                misses[r, c] += 1
                if misses[r, c] >= min(contradictions, hits[r, c] + 1):
                    height[r, c] = mean[r, c]
                    known_variance[r, c] = variance[r, c]
                    known_doubt[r, c] = doubt[r, c]
                    hits[r, c] = 1
                    misses[r, c] = 0
