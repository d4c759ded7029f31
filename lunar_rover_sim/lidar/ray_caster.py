"""Where rays meet the ground and the rocks: all rays of a scan at once, in NumPy.

A table of the surroundings brackets the hit of each ray (`ray_brackets`). The bracket is cut into
intervals of the size of a block of the pyramid (`height_pyramid`). Intervals in which the ray
stays above the block are dropped, the others are halved, down to single cells, all rays together.
What is left is tested against the two triangles of each cell, and against the rocks that stand
there. So a scan takes some hundred calls of NumPy, however many rays it has: a march cell by cell
takes ten times as many, and most of its time goes into calls for a few grazing rays.

Levels of the world follow one after the other, from the finest to the coarsest, as the renderer
draws them. Intervals are in float32 with positions in cells; hits are computed in float64.
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.lidar.height_pyramid import HeightPyramid
from lunar_rover_sim.lidar.ray_brackets import RayBrackets
from lunar_rover_sim.lidar.rock_hulls import RockHulls
from lunar_rover_sim.lidar.soft_cells import SoftCells

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
Index = NDArray[np.int64]

GROUND, NOTHING, ROVER = -1, -2, -3     # besides the numbers of rocks
_INTERVALS = 8              # at most, into which a bracket is cut at first
_LEAST = 1e-9               # of a component of a direction
_SLACK = 1e-9               # of distances [m] and places: neighbouring triangles leave no gap
_ROUNDING_M = np.float32(1e-4)      # of heights along a ray, in float32


@dataclasses.dataclass(frozen=True)
class Hits:
    """Where n rays meet the world.

    distance_m: (n,) inf where nothing is met; target: (n,) GROUND, NOTHING, a rock, or of
        a `Lidar` the ROVER
    normal: (n, 3) outward unit normals, world frame, 0 where nothing is met
    """

    distance_m: Array
    target: I32
    normal: Array

    @classmethod
    def none(cls, count: int) -> Hits:
        """Return rays that meet nothing."""
        return cls(np.full(count, np.inf), np.full(count, NOTHING, np.int32),
                   np.zeros((count, 3)))

    def note(self, ray: Index, distance: Array, target: I32, normal: Array) -> None:
        """Take over hits that are nearer; a ray may be named more than once."""
        np.minimum.at(self.distance_m, ray, distance)
        new = np.flatnonzero((distance == self.distance_m[ray]) & (distance < np.inf))
        self.target[ray[new]], self.normal[ray[new]] = target[new], normal[new]


class RayCaster:
    """Casts rays on a world.

    pyramids: of its levels, the finest first; soft: changed ground on the finest one
    """

    def __init__(self, pyramids: Sequence[HeightPyramid], hulls: RockHulls) -> None:
        self._pyramids, self._hulls = pyramids, hulls
        self.soft: SoftCells | None = None

    def cast(self, origin_m: Array, direction: Array, range_m: float) -> Hits:
        """Return the first hits of (n, 3) rays within a range [m].

        origin_m: (n, 3) world frame, on the finest level and above the ground, near one another
            (those of one scan); direction: (n, 3) unit length
        """
        hits = Hits.none(len(direction))
        # No ray is parallel to an axis: then no edge has to be told from one that is never met.
        direction = np.where(np.abs(direction) < _LEAST, _LEAST, direction)
        brackets = RayBrackets(self._pyramids, origin_m, range_m)
        begin, end = brackets.along(direction)
        end = np.minimum(end, range_m)
        for pyramid in self._pyramids:
            leave = _exit(origin_m, direction, pyramid.grid.half_extent_m)
            rays = np.flatnonzero((begin < np.minimum(end, leave)) & np.isinf(hits.distance_m))
            soft = self.soft if pyramid is self._pyramids[0] else None
            _Level(pyramid, self._hulls, soft, origin_m, direction, hits).search(
                rays, begin[rays], np.minimum(end, leave)[rays])
            begin = np.maximum(begin, leave)
        beyond = hits.distance_m > range_m
        hits.distance_m[beyond], hits.target[beyond] = np.inf, NOTHING
        hits.normal[beyond] = 0.0
        return hits


def _exit(o: Array, d: Array, half_m: float) -> Array:
    """Return how far rays go until they leave the square of half side half_m [m]."""
    return np.minimum(*((np.copysign(half_m, d[:, k]) - o[:, k]) / d[:, k] for k in (0, 1)))


class _Level:
    """Rays over one level; positions are in cells."""

    def __init__(self, pyramid: HeightPyramid, hulls: RockHulls, soft: SoftCells | None, o: Array,
                 d: Array, hits: Hits) -> None:
        self._pyramid, self._hulls, self._soft = pyramid, hulls, soft
        self._o, self._d, self._hits = o, d, hits
        cell, self._middle = pyramid.grid.cell_m, 0.5 * (pyramid.grid.n - 1)
        # Place, direction, stride, and up to where a ray is followed: one row for each ray.
        self._columns: F32 = np.zeros((len(d), 8), np.float32)
        self._columns[:, :2] = o[:, :2] / cell + self._middle
        self._columns[:, 2] = o[:, 2]
        self._columns[:, 3:5] = d[:, :2] / cell
        self._columns[:, 5] = d[:, 2]
        # The stride is a little less than one cell, so that rounding does not make it pass two
        # edges of one axis. A ray that points straight up or down never leaves its cell.
        across = np.maximum(*np.abs(self._columns[:, 3:5].T))
        self._columns[:, 6] = np.float32(0.999) / np.maximum(across, np.float32(1e-6))
        self._stride, self._until = self._columns[:, 6], self._columns[:, 7]
        self._rocks: list[Index] = []       # numbers of pairs of ray and rock

    def search(self, ray: Index, begin: Array, end: Array) -> None:
        """Note the first hits of rays between two distances."""
        pyramid, stride = self._pyramid, self._stride[ray]
        length = (end - begin).astype(np.float32)
        level = np.ceil(np.log2(length / (_INTERVALS * stride))).astype(np.int32)
        level = np.clip(level, 0, pyramid.levels - 1)
        step = np.ldexp(stride, level)
        count = np.minimum(np.ceil(length / step), 1e6).astype(np.int64)
        r = np.repeat(ray, count)
        serial = np.arange(len(r)) - np.repeat(np.cumsum(count) - count, count)
        t = np.repeat(begin.astype(np.float32), count) \
            + serial.astype(np.float32) * np.repeat(step, count)
        k = np.repeat(level, count)
        self._until[ray] = end
        while len(r):
            low = self._may_hit(r, t, k)
            r, t, k = r.take(low), t.take(low), k.take(low)
            finest = k == 0
            if finest.any():
                self._test(r[finest], t[finest])
                r, t, k = r[~finest], t[~finest], k[~finest]
            # Halves of an interval follow one another: those of a ray stay in order.
            open_ = np.flatnonzero(t < self._until.take(r))
            r, k = np.repeat(r.take(open_), 2), np.repeat(k.take(open_) - np.int32(1), 2)
            t = np.repeat(t.take(open_), 2)
            t[1::2] += np.ldexp(self._stride.take(r[1::2]), k[1::2])
        self._meet_rocks()

    def _may_hit(self, r: Index, t: F32, k: I32) -> Index:
        """Return the intervals, one block long from t on, in which a ray comes low enough."""
        pyramid = self._pyramid
        # Rows that lie together in memory: most of the time goes into fetching them.
        ox, oy, oz, dx, dy, dz, stride, until = self._columns.take(r, axis=0).T
        ix = (ox + t * dx).astype(np.int32) >> k
        iy = (oy + t * dy).astype(np.int32) >> k
        place = pyramid.first.take(k) + iy * pyramid.stride.take(k) + ix
        top, depth = pyramid.bounds.take(place, axis=0).T
        step = np.ldexp(stride, k)
        here = oz + t * dz
        stop = here + dz * step
        # Under the least height around, a ray has met the ground: what follows does not matter.
        under = np.flatnonzero(stop < -depth)
        np.minimum.at(self._until, r.take(under), (t + step).take(under))
        return np.flatnonzero((np.minimum(here, stop) <= top) & (t < until))

    def _test(self, r: Index, t: F32) -> None:
        """Test intervals of one cell's length against the cells that they pass."""
        columns = self._columns.take(r, axis=0)
        ox, oy, dx, dy, stride = (columns[:, k] for k in (0, 1, 3, 4, 6))
        x0, y0 = (ox + t * dx).astype(np.int32), (oy + t * dy).astype(np.int32)
        stop = t + stride
        x1, y1 = (ox + stop * dx).astype(np.int32), (oy + stop * dy).astype(np.int32)
        # A ray that changes column and row passes a third cell: which one, the nearer edge says.
        turned = (x0 != x1) & (y0 != y1)
        both = np.flatnonzero(turned)
        at_x = (np.maximum(x0, x1).take(both) - ox.take(both)) / dx.take(both)
        at_y = (np.maximum(y0, y1).take(both) - oy.take(both)) / dy.take(both)
        x_first = at_x < at_y
        middle_x = np.where(x_first, x1.take(both), x0.take(both))
        middle_y = np.where(x_first, y0.take(both), y1.take(both))
        # The last cell is the first one of the next interval, if that is tested too.
        follows = np.append((r[1:] == r[:-1]) & (t[1:] - t[:-1] < 1.5 * stride[:-1]), False)
        final = np.flatnonzero(((x0 != x1) | (y0 != y1)) & ~follows)
        row = np.concatenate([np.arange(len(r)), both, final])
        last = np.int32(self._pyramid.grid.n - 2)   # rounding may lead beyond the edge
        ix = np.clip(np.concatenate([x0, middle_x, x1.take(final)]), 0, last)
        iy = np.clip(np.concatenate([y0, middle_y, y1.take(final)]), 0, last)
        near = self._near_in_cells(columns.take(row, axis=0), ix, iy)
        ray, ix, iy = r.take(row.take(near)), ix.take(near), iy.take(near)
        self._list_rocks(ray, ix, iy)
        if self._soft is not None:
            touched = self._soft.touched[iy, ix]
            self._meet_soft_ground(ray[touched], ix[touched], iy[touched])
            ray, ix, iy = ray[~touched], ix[~touched], iy[~touched]
        self._meet_ground(ray, ix, iy)
        self._until[r] = np.minimum(self._until[r], self._hits.distance_m[r])

    def _near_in_cells(self, columns: F32, ix: I32, iy: I32) -> Index:
        """Return where rays are between the least and the greatest height of their cells."""
        pyramid = self._pyramid
        ox, oy, oz, dx, dy, dz = columns.T[:6]
        enter, leave = _over(ix, iy, ox, oy, dx, dy)
        bounds = pyramid.cells.reshape(-1, 2).take(iy * np.int32(pyramid.grid.n - 1) + ix, axis=0)
        first, second = oz + enter * dz, oz + leave * dz
        return np.flatnonzero((np.minimum(first, second) <= bounds[:, 0] + _ROUNDING_M)
                              & (first >= -bounds[:, 1] - _ROUNDING_M))

    def _meet_ground(self, ray: Index, ix: I32, iy: I32) -> None:
        """Test rays against the two triangles of cells."""
        grid = self._pyramid.grid
        cell, z = grid.cell_m, self._pyramid.heights_m.ravel()
        o, d = self._o.take(ray, axis=0), self._d.take(ray, axis=0)
        ox, oy = o[:, 0] / cell + self._middle, o[:, 1] / cell + self._middle
        du, dv, dz = d[:, 0] / cell, d[:, 1] / cell, d[:, 2]
        enter, leave = _over(ix, iy, ox, oy, du, dv)
        u, v = ox - ix, oy - iy
        corner = iy * np.int32(grid.n) + ix
        z00, z10 = z.take(corner).astype(float), z.take(corner + 1).astype(float)
        z01, z11 = (z.take(corner + np.int32(grid.n)).astype(float),
                    z.take(corner + np.int32(grid.n + 1)).astype(float))
        # The gap between ray and plane of either triangle is linear along the ray. The lower
        # triangle (u >= v) has the corner south-east, the upper one that north-west.
        height = o[:, 2] - z00
        across, start = du - dv, u - v
        best, found = np.full((2, len(ray)), np.inf), []
        for k, (sx, sy, side) in enumerate(((z10 - z00, z11 - z10, 1.0),
                                            (z11 - z01, z01 - z00, -1.0))):
            speed = dz - du * sx - dv * sy
            with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
                at = (u * sx + v * sy - height) / speed
                inside = side * (start + at * across) >= -_SLACK
            hit = np.flatnonzero(inside & (speed < 0.0) & (at >= enter - _SLACK)
                                 & (at <= leave + _SLACK))
            best[k, hit] = at.take(hit)
            found.append((sx, sy))
        lower = best[0] <= best[1]
        nearest = np.minimum(best[0], best[1])
        met = np.flatnonzero(nearest < np.inf)
        gx, gy = (np.where(lower[met], found[0][k].take(met), found[1][k].take(met))
                  for k in (0, 1))
        normal = np.stack([-gx / cell, -gy / cell, np.ones(len(met))], axis=1)
        normal /= np.sqrt(np.einsum('ij,ij->i', normal, normal))[:, None]
        self._hits.note(ray.take(met), nearest.take(met), np.full(len(met), GROUND, np.int32),
                        normal)

    def _meet_soft_ground(self, ray: Index, ix: I32, iy: I32) -> None:
        """Test rays against cells that the rover has changed."""
        assert self._soft is not None
        cell = self._pyramid.grid.cell_m
        o, d = self._o[ray], self._d[ray]
        enter, leave = _over(ix, iy, o[:, 0] / cell + self._middle, o[:, 1] / cell + self._middle,
                             d[:, 0] / cell, d[:, 1] / cell)
        # A ray straight down never leaves its cell.
        leave = np.minimum(leave, o[:, 2] + self._pyramid.cells[iy, ix, 1] + 1.0)
        distance, normal = self._soft.meet(o, d, enter, np.maximum(leave, enter))
        self._hits.note(ray, distance, np.full(len(ray), GROUND, np.int32), normal)

    def _list_rocks(self, ray: Index, ix: I32, iy: I32) -> None:
        """Note the rocks that stand in the cells that rays pass."""
        pyramid = self._pyramid
        cell = iy * np.int32(pyramid.grid.n - 1) + ix
        first = pyramid.rock_first.take(cell)
        count = pyramid.rock_first.take(cell + 1) - first
        some = np.flatnonzero(count)
        count, first = count.take(some), first.take(some)
        serial = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        rock = pyramid.rock_list.take(np.repeat(first, count) + serial)
        self._rocks.append(np.repeat(ray.take(some), count) * len(self._hulls.rocks) + rock)

    def _meet_rocks(self) -> None:
        """Test rays against the rocks noted; a ray passes many cells of a rock."""
        pairs = np.unique(np.concatenate(self._rocks)) if self._rocks else np.zeros(0, np.int64)
        if len(pairs):
            ray, rock = np.divmod(pairs, len(self._hulls.rocks))
            distance, normal = self._hulls.meet(rock, self._o[ray], self._d[ray])
            self._hits.note(ray, distance, rock.astype(np.int32), normal)


def _over(ix: I32, iy: I32, ox: NDArray, oy: NDArray, dx: NDArray,
          dy: NDArray) -> tuple[NDArray, NDArray]:
    """Return from where to where rays are over cells; from 0 on."""
    west, east = (ix - ox) / dx, (ix + 1 - ox) / dx
    south, north = (iy - oy) / dy, (iy + 1 - oy) / dy
    enter = np.maximum(np.minimum(west, east), np.minimum(south, north))
    leave = np.minimum(np.maximum(west, east), np.maximum(south, north))
    return np.maximum(enter, 0), leave
