"""The ground as compiled loops see it: heights of all grids, relief below them, tracks on them.

Depth is found by rays of pixels that step over the heights until they meet the ground.
A column of an image is followed from its lowest row up. The ray of a row clears whatever the one
below has cleared, so that it begins where that one has met the ground: a column costs about as
many steps as the ground that it shows is long, however many rows it has. Several columns are
followed at a time, each at its own row: loops over them are compiled to vector instructions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled, inlined, read_only, vectorised
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.workers import Workers
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.rendering.config import DetailConfig
from lunar_rover_sim.image.rendering.projection import Projection, ViewNumbers, ViewVolume
from lunar_rover_sim.image.rendering.relief_map import NO_RELIEF, ReliefMap, ReliefShape
from lunar_rover_sim.image.rendering.row_math import shape_share, wrapped
from lunar_rover_sim.image.rendering.surface import Surface
from lunar_rover_sim.image.rendering.track_map import NO_TRACKS, TrackMap

F32 = NDArray[np.float32]

Key = TypeVar('Key')

_NOWHERE = np.array([np.inf, -np.inf, np.inf, -np.inf], np.float32)


class SeenTracks(NamedTuple):
    """Where tracks are that a view may show: (4,) least and greatest x and y [m].

    Attributes:
        lit: Of all tracks.
        raised: Of those near enough to have a shape of their own.
        tiles: As `TrackMap.tiles`; a ray above others, which were seen before, does not mind them.
    """

    lit: F32 = _NOWHERE
    raised: F32 = _NOWHERE
    tiles: NDArray[np.bool_] = NO_TRACKS.touched


class GroundHeights(NamedTuple):
    """The heights of all grids of a world, as compiled loops take them.

    Attributes:
        heights, levels, offsets: Of `ground.cast`.
        steepest: Greatest slope of the grids.
    """

    heights: F32
    levels: F32
    offsets: NDArray[np.int64]
    steepest: float

    @classmethod
    def of(cls, world: World) -> GroundHeights:
        """Gather the heights of a world in a frame of its own."""
        grids = world.levels
        return cls(
            read_only(np.concatenate([grid.heights_m.ravel() for grid in grids]), np.float32),
            np.array([[1.0 / grid.cell_m, 0.5 * (grid.n - 1), grid.n - 2.0, grid.half_extent_m]
                      for grid in grids], np.float32),
            np.cumsum([0, *(grid.n**2 for grid in grids)]), max(map(_steepest, grids)))


class Ground:
    """The ground of a world, and the depth of it in an image.

    Attributes:
        relief: The shape of the relief below the grid.
    """

    def __init__(self, world: World, detail: DetailConfig, surface: Surface,
                 heights: GroundHeights | None = None) -> None:
        """Gather the heights, unless they are given; surface: has the relief below the grid."""
        reach_m = 0.0 if surface.tiles.flat else detail.relief_shape_m
        self._relief = ReliefMap(surface, reach_m) if reach_m > 0.0 else None
        self._tracks: TrackMap | None = None
        self.enter(world, GroundHeights.of(world) if heights is None else heights)

    def enter(self, world: World, heights: GroundHeights) -> None:
        """Be the ground of another window of the site; heights: its own."""
        self._heights = heights
        if self._relief is not None:
            self._relief.enter(world.ground)

    @property
    def relief(self) -> ReliefShape:
        """The shape of the relief below the grid; `NO_RELIEF` where it has none."""
        return NO_RELIEF if self._relief is None else self._relief.shape

    def follow(self, tracks: TrackMap) -> None:
        """Have tracks from now on."""
        self._tracks = tracks

    def update(self, volume: ViewVolume, before: Callable[[], None]) -> None:
        """Bring the shape of the relief below the grid up to date for a view.

        Args:
            before: Called before anything changes.
        """
        if self._relief is not None:
            self._relief.update(volume, before)

    def tracks_in(self, volume: ViewVolume) -> SeenTracks:
        """Return where tracks are that a view may show."""
        if self._tracks is None:
            return SeenTracks()
        tracks, seen = self._tracks, self._tracks.in_view(volume)
        return SeenTracks(_around(tracks.boxes[seen]),
                          _around(tracks.boxes[seen & tracks.near & tracks.raised]),
                          tracks.tiles(seen))

    def depth(self, view: ViewNumbers, projection: Projection, tracks: SeenTracks,
              workers: Workers) -> F32:
        """Return the (h, w) depth of the ground in an image, 0 where there is none [m]."""
        return self.depths({0: (view, projection)}, tracks, workers)[0]

    def depths(self, images: Mapping[Key, tuple[ViewNumbers, Projection]], tracks: SeenTracks,
               workers: Workers) -> dict[Key, F32]:
        """Return the depths of several images."""
        # With a row below that is not of the image.
        result = {key: np.zeros((projection.height + 1, projection.width), np.float32)
                  for key, (_, projection) in images.items()}
        workers.map(self._cast, [(*share, result[key], *image, tracks)
                                 for key, image in images.items()
                                 for share in workers.shares(image[1].width)])
        return {key: depth[:-1] for key, depth in result.items()}

    def _cast(self, first: int, last: int, depth: F32, view: ViewNumbers, projection: Projection,
              tracks: SeenTracks) -> None:
        """Fill in columns of the depth of an image, from `first` to before `last`."""
        arrays = NO_TRACKS if self._tracks is None else self._tracks.arrays
        relief, box = self.relief, tracks.raised
        cast(depth, first, last, view.numbers,
             np.array([projection.near_m, projection.far_m, self._heights.steepest], np.float32),
             *self._heights[:3], relief.shape, relief.numbers,
             np.array([*view.middle, relief.reach_m], np.float32), bool(box[0] <= box[1]), box,
             arrays.windows, tracks.tiles, arrays.near, int(arrays.near_side[0]))


def _steepest(grid: HeightGrid) -> float:
    """Return the greatest slope of the triangles of a grid, or a little more."""
    z = grid.heights_m
    return float(np.hypot(*(np.abs(np.diff(z, axis=axis)).max() for axis in (0, 1)))) / grid.cell_m


def _around(boxes: Array) -> F32:
    """Return least and greatest x and y of (m, 2, 3) boxes."""
    if not len(boxes):
        return _NOWHERE
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    return np.array([low[0], high[0], low[1], high[1]], np.float32)


_N, _PAGE = 64, 80      # columns that are followed at a time
# Of each column: depth of the next point to look at, of the last one above the ground and of the
# first one below it, with heights over the ground; how often it has been looked between the two.
_T, _LOW, _F_LOW, _HIGH, _F_HIGH, _TURN = (k * _PAGE for k in range(6))
_ROW, _RX, _RY, _RZ, _AX, _AY, _AZ = (k * _PAGE for k in range(6, 13))
# Of its ray: horizontal length to depth 1, and a step that is safe over the height that it has.
_ACROSS, _FALLS = 13 * _PAGE, 14 * _PAGE
_X, _Y, _HEIGHT, _KEPT, _U, _V, _MET, _ON, _FINE = (k * _PAGE for k in range(15, 24))
_A, _B, _C = (k * _PAGE for k in range(24, 27))           # corners around a place
_INDEX, _CORNER, _EAST, _NORTH, _BOTH = (k * _PAGE for k in range(5))

_ZERO, _HALF, _ONE, _TWO, _TINY, _FAR = (np.float32(x) for x in (0.0, 0.5, 1.0, 2.0, 1e-9, 1e9))
# Looks between points above and below the ground, at most, and how close is close enough [px].
_TURNS, _CLOSE = np.float32(4.0), np.float32(0.02)
# A step is a pixel long, or more: a part of a cell of the finest grid, also over the size of a
# pixel; where relief below the grid or tracks have shape, some millimetres [m]. It is at most some
# pixels long, and as often as long as the ray is high over the ground: of what lies between two
# steps something may be missed that is that much lower than they are long.
_CELLS, _CELLS_OF_PIXEL, _FINE_M = np.float32(0.2), np.float32(90.0), np.float32(0.003)
_PIXELS, _FINE_PIXELS, _OVER = np.float32(10.0), np.float32(1.2), np.float32(16.0)
_TRACKS_M = np.float32(0.03)        # most that tracks rise over the grid
# Of the way to where the ground is met if it goes on as it was: how far the first look is.
_AHEAD = np.float32(1.25)
# Slant of the planes that rays turn up in, over a column a row, that still have such an order.
_MOST_SLANT = np.float32(0.6)
_BESIDE, _THOUSAND = np.float32(0.6), np.float32(1000.0)
_WORD, _MIDDLE, _HEIGHTS = np.uint32(0xffff), np.float32(32768.0), np.float32(1.0 / 131072.0)


@inlined
def _step(t, f, across, falls, fine, cell, pixel, lifted):  # type: ignore[no-untyped-def]
    """Return how far a ray goes on whose point is so high above the ground.

    Args:
        across, falls: As _ACROSS and _FALLS.
        fine: Above 0 where relief or tracks have shape; elsewhere `cell` is the least step.
        pixel: Size of one at depth 1; `lifted`: most that relief and tracks rise over the grid.
    """
    least = max((_FINE_M if fine > _ZERO else cell) / max(across, _HALF), pixel * t)
    most = (_FINE_PIXELS if fine > _ZERO else _PIXELS) * pixel * t
    return max(max(least, min(most, _OVER * f)), (f - lifted) * falls)


@vectorised
def _grid_heights(s, place, heights, levels, offsets):  # type: ignore[no-untyped-def]
    """Look up the heights of the triangles of the finest grid that holds each place.

    Beyond all grids nothing is there to be met.
    """
    for j in range(_N):
        s[_HEIGHT + j] = -_FAR
    inner, before = -_ONE, 0
    for k in range(len(levels)):
        scale, half, last, extent = levels[k, 0], levels[k, 1], levels[k, 2], levels[k, 3]
        within = 0
        for j in range(_N):
            within += max(abs(s[_X + j]), abs(s[_Y + j])) <= extent
        if within > before:
            one, n = np.uint32(1), np.uint32(np.uint32(last) + np.uint32(2))
            across, grid = np.uint32(n + one), heights[offsets[k]:offsets[k + 1]]
            for j in range(_N):
                u, v = s[_X + j] * scale + half, s[_Y + j] * scale + half
                column = min(max(np.floor(u), _ZERO), last)
                row = min(max(np.floor(v), _ZERO), last)
                u, v = u - column, v - row
                s[_U + j], s[_V + j] = max(u, v), min(u, v)
                index = np.uint32(np.uint32(np.int32(row)) * n + np.uint32(np.int32(column)))
                place[_INDEX + j] = index
                place[_CORNER + j] = np.uint32(index + (one if u >= v else n))
            for j in range(_N):
                s[_A + j], s[_B + j] = grid[place[_INDEX + j]], grid[place[_CORNER + j]]
                s[_C + j] = grid[np.uint32(place[_INDEX + j] + across)]
            for j in range(_N):
                low, corner, high = s[_A + j], s[_B + j], s[_C + j]
                height = low + s[_U + j] * (corner - low) + s[_V + j] * (high - corner)
                away = max(abs(s[_X + j]), abs(s[_Y + j]))
                s[_HEIGHT + j] = (height if (inner < away) & (away <= extent)
                                  else s[_HEIGHT + j])
        if within == _N:
            break
        inner, before = extent, within


@compiled
def _soil_at(x, y, windows, touched, near, n):  # type: ignore[no-untyped-def]
    """Return height change [m], and the share of the relief below the grid that is left there."""
    tiles = len(touched)
    east_m, north_m = x + windows[6], y + windows[7]
    i, _, _ = wrapped(east_m * windows[2], tiles, _ZERO)
    j, _, _ = wrapped(north_m * windows[2], tiles, _ZERO)
    if not touched[j, i] or max(abs(x - windows[4]), abs(y - windows[5])) >= windows[1]:
        return _ZERO, _ONE
    i, east, u = wrapped(east_m * windows[0], n, _ZERO)
    j, north, v = wrapped(north_m * windows[0], n, _ZERO)
    rise, pressed = _ZERO, _ZERO
    for k in range(4, 6):
        low = near[j * n + i, k] + u * (near[j * n + east, k] - near[j * n + i, k])
        high = near[north * n + i, k] + u * (near[north * n + east, k] - near[north * n + i, k])
        low += v * (high - low)
        if k == 4:
            rise = low
        else:
            pressed = low
    buried = _BESIDE * min(abs(rise) * _THOUSAND, _ONE) * (_ONE - pressed)
    return rise, _ONE - max(pressed, buried)


@compiled
def _add_tracks(s, box, windows, touched, near, side):  # type: ignore[no-untyped-def]
    """Add the height changes of tracks, and note what they leave of the relief below the grid."""
    for j in range(_N):
        x, y = s[_X + j], s[_Y + j]
        s[_KEPT + j] = _ONE
        if box[0] <= x <= box[1] and box[2] <= y <= box[3]:
            s[_FINE + j] = _ONE
            rise, kept = _soil_at(x, y, windows, touched, near, side)
            s[_HEIGHT + j] += rise
            s[_KEPT + j] = kept


@vectorised
def _add_relief(s, place, shape, scale, half, centre):  # type: ignore[no-untyped-def]
    """Add the relief below the grid where it has shape."""
    shaped, middle_x, middle_y, reach = 0, centre[0], centre[1], centre[2]
    for j in range(_N):
        share = shape_share(s[_X + j] - middle_x, s[_Y + j] - middle_y, reach)
        s[_ON + j] = share if max(abs(s[_X + j]), abs(s[_Y + j])) < half else _ZERO
    for j in range(_N):
        shaped += s[_ON + j] > _ZERO
    if shaped == 0:
        return
    for j in range(_N):
        s[_FINE + j] = max(s[_FINE + j], s[_ON + j])
        s[_ON + j] *= s[_KEPT + j]
    texels = shape.ravel()
    n, wide = np.int32(shape.shape[0]), np.uint32(shape.shape[1])
    size = np.float32(n)
    for j in range(_N):
        u, v = s[_X + j] * scale, s[_Y + j] * scale
        u, v = u - np.floor(u), v - np.floor(v)
        u, v = u * size - _HALF, v * size - _HALF
        column, row = np.floor(u), np.floor(v)
        s[_U + j], s[_V + j] = u - column, v - row
        # It wraps around.
        west = np.int32(column) if column >= _ZERO else np.int32(n - 1)
        south = np.int32(row) if row >= _ZERO else np.int32(n - 1)
        east = np.int32(west + 1) if west < n - 1 else np.int32(0)
        north = np.int32(south + 1) if south < n - 1 else np.int32(0)
        low, high = np.uint32(np.uint32(south) * wide), np.uint32(np.uint32(north) * wide)
        place[_INDEX + j] = np.uint32(low + np.uint32(west))
        place[_EAST + j] = np.uint32(low + np.uint32(east))
        place[_NORTH + j] = np.uint32(high + np.uint32(west))
        place[_BOTH + j] = np.uint32(high + np.uint32(east))
    for j in range(_N):
        place[_INDEX + j], place[_EAST + j] = texels[place[_INDEX + j]], texels[place[_EAST + j]]
        place[_NORTH + j], place[_BOTH + j] = texels[place[_NORTH + j]], texels[place[_BOTH + j]]
    for j in range(_N):
        a = np.float32(np.int32(place[_INDEX + j] & _WORD))
        b = np.float32(np.int32(place[_EAST + j] & _WORD))
        c = np.float32(np.int32(place[_NORTH + j] & _WORD))
        d = np.float32(np.int32(place[_BOTH + j] & _WORD))
        a += s[_U + j] * (b - a)
        c += s[_U + j] * (d - c)
        a += s[_V + j] * (c - a)
        s[_HEIGHT + j] += s[_ON + j] * (a - _MIDDLE) * _HEIGHTS


@vectorised
def _cast(depth, first, end, view, limits, heights, levels,  # type: ignore[no-untyped-def]
          offsets, shape, relief, centre, has_tracks, box, windows, touched, near, side):
    """Fill in at most _N columns of an image; the arguments are those of `cast`."""
    h, w = len(depth) - 1, depth.shape[1]
    s, place = np.zeros(27 * _PAGE, np.float32), np.zeros(5 * _PAGE, np.uint32)
    image, wide, outside = depth.ravel(), np.uint32(w), np.float32(h)
    ex, ey, ez, right_x, right_y = view[9], view[10], view[11], view[3], view[4]
    down_x, down_y, down_z = view[6], view[7], view[8]
    nearest, farthest, steepest = limits[0], limits[1], limits[2]
    pixel = view[15]
    cell = min(_CELLS, _CELLS_OF_PIXEL * pixel) / levels[0, 0]
    shaped = centre[2] > _ZERO
    lifted = max(relief[1] if shaped else _ZERO, _TRACKS_M if has_tracks else _ZERO)
    for j in range(_N):
        column = np.float32(min(first + j, end - 1))    # the last one again, beyond them
        s[_AX + j] = view[0] + view[3] * column
        s[_AY + j] = view[1] + view[4] * column
        s[_AZ + j] = view[2] + view[5] * column
        # As after a ray that met nothing, out of any order.
        s[_ROW + j], s[_MET + j], s[_RZ + j], s[_KEPT + j] = outside, _TWO, _FAR, _ONE
    going = _N
    while going > 0:
        # Rays that have met the ground, or that meet none, go on with the row above.
        for j in range(_N):
            z0, t0, across0 = s[_RZ + j], s[_T + j], s[_ACROSS + j]
            row = s[_ROW + j] - _ONE
            rx = s[_AX + j] + down_x * row
            ry = s[_AY + j] + down_y * row
            rz = s[_AZ + j] + down_z * row
            across = np.sqrt(rx * rx + ry * ry)
            turned = abs(ry * down_x - rx * down_y)
            order = _ONE if rz * across0 > z0 * across else _ZERO
            order = order if turned <= _MOST_SLANT * abs(rx * right_y - ry * right_x) else _ZERO
            t = t0 * across0 / max(across, _TINY)
            falls = _ONE / max(steepest * across - rz, _TINY)
            # Over where the ray below has met the ground; how fast that grows, as it did there.
            f = rz * t - z0 * t0
            slope = ((s[_F_LOW + j] - s[_F_HIGH + j]) / max(s[_HIGH + j] - s[_LOW + j], _TINY)
                     + z0 - rz)
            ahead = _AHEAD * f / max(slope, _TINY)
            changes, hit = s[_MET + j], s[_MET + j] == _ONE
            begins = order if hit else _ZERO
            # Above a ray that meets nothing is nothing to be met.
            row = row if begins == order else -_ONE
            s[_ROW + j] = row if changes > _ZERO else s[_ROW + j]
            s[_RX + j] = rx if changes > _ZERO else s[_RX + j]
            s[_RY + j] = ry if changes > _ZERO else s[_RY + j]
            s[_RZ + j] = rz if changes > _ZERO else z0
            s[_ACROSS + j] = across if changes > _ZERO else across0
            s[_FALLS + j] = falls if changes > _ZERO else s[_FALLS + j]
            s[_U + j], s[_V + j], s[_ON + j] = t, f, begins
            s[_X + j] = ahead
        for j in range(_N):
            t, f, begins, changes = s[_U + j], s[_V + j], s[_ON + j], s[_MET + j]
            step = _step(t, f, s[_ACROSS + j], s[_FALLS + j], s[_FINE + j], cell, pixel, lifted)
            first_t = t + min(step, s[_X + j])
            t, f = (t if begins > _ZERO else nearest), (f if begins > _ZERO else _ONE)
            s[_LOW + j] = t if changes > _ZERO else s[_LOW + j]
            s[_F_LOW + j] = f if changes > _ZERO else s[_F_LOW + j]
            s[_TURN + j] = _ZERO if changes > _ZERO else s[_TURN + j]
            t = first_t if begins > _ZERO else nearest
            s[_T + j] = t if changes > _ZERO else s[_T + j]
            s[_FINE + j] = _ZERO
        for j in range(_N):
            s[_X + j] = ex + s[_RX + j] * s[_T + j]
            s[_Y + j] = ey + s[_RY + j] * s[_T + j]
        _grid_heights(s, place, heights, levels, offsets)
        if has_tracks:
            _add_tracks(s, box, windows, touched, near, side)
        if shaped:
            _add_relief(s, place, shape, relief[0], relief[2], centre)
        for j in range(_N):
            t, turn = s[_T + j], s[_TURN + j]
            f = ez + s[_RZ + j] * t - s[_HEIGHT + j]
            low, f_low = (t if f > _ZERO else s[_LOW + j]), (f if f > _ZERO else s[_F_LOW + j])
            high, f_high = (s[_HIGH + j] if f > _ZERO else t), (s[_F_HIGH + j] if f > _ZERO else f)
            turn = turn + min(turn, _ONE) if f > _ZERO else turn + _ONE
            between = low + (high - low) * f_low / max(f_low - f_high, _TINY)
            further = t + _step(t, f, s[_ACROSS + j], s[_FALLS + j], s[_FINE + j], cell, pixel,
                                lifted)
            s[_LOW + j], s[_F_LOW + j], s[_HIGH + j], s[_F_HIGH + j] = low, f_low, high, f_high
            missed = _TWO if further > farthest else _ZERO
            s[_TURN + j], s[_T + j] = turn, between if turn > _ZERO else further
            close = _TURNS if abs(f) < _CLOSE * pixel * t else _ZERO
            met = _ONE if turn + (close if turn > _ONE else _ZERO) > _TURNS else _ZERO
            s[_MET + j] = met if turn > _ZERO else missed
        going = 0
        for j in range(_N):
            row, met = s[_ROW + j], s[_MET + j]
            going += row >= _ZERO
            s[_U + j] = s[_T + j] if met == _ONE else _ZERO
            row = row if row >= _ZERO else outside
            s[_V + j] = row
        for j in range(_N):
            place[_INDEX + j] = np.uint32(np.uint32(np.int32(s[_V + j])) * wide
                                          + np.uint32(min(first + j, end - 1)))
        for j in range(_N):
            image[place[_INDEX + j]] = s[_U + j]


@compiled
def cast(depth, first, last, view, limits, heights, levels,  # type: ignore[no-untyped-def]
         offsets, shape, relief, centre, has_tracks, box, windows, touched, near, side):
    """Fill in the depth of the ground in columns of an image.

    Args:
        depth: (h + 1, w), 0 where there is no ground; the last row is not of the image [m].
        first, last: First column, and the one after the last.
        view: As `ViewNumbers.numbers`.
        limits: Least and greatest depth [m]; greatest slope of the grids.
        heights: Of all grids, one after the other, the finest first; each begins at its one of
            `offsets`, which has their end, too [m].
        levels: (grids, 4): 1 / cell [1/m], half and last whole index of cells, half extent [m].
        shape, relief: Map of the relief below the grid as `row_math.packed_shape` has it; 1 / its
            extent [1/m], greatest height in it, half of the finest grid [m].
        centre: Place of the middle of all cameras [m], reach of relief with shape [m].
        has_tracks, box: Whether tracks are in view, and least and greatest x and y of them [m].
        windows, touched, near, side: As for `track_map.prints_of`; `side` of the finest level.
    """
    for column in range(first, last, _N):
        _cast(depth, column, min(column + _N, last), view, limits, heights, levels, offsets,
              shape, relief, centre, has_tracks, box, windows, touched, near, side)
