"""The tracks of an overlay as texels in two windows around the cameras, as far as they are seen.

Both windows wrap around: a tile always has the same place in them, which it shares with tiles far
away. A tile is computed when it comes into view, and again in view after it, or what casts a
shadow on it, has changed. Tracks behind the rover cost nothing, nor do those beyond the window of
the site.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.ground.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.image.rendering.projection import ViewVolume
from lunar_rover_sim.image.rendering.row_math import disc, wrapped
from lunar_rover_sim.image.rendering.track_texels import (FAR_TEXELS, LEVELS, REACH_M,
                                                          Surroundings, TILE, track_texels,
                                                          TrackSun, TrackTexels)

F32 = NDArray[np.float32]

TILE_M = TILE * CELL_M
NEAR_TILES, FAR_TILES = 40, 128
_COMMON_M = math.lcm(NEAR_TILES, FAR_TILES) * TILE_M    # a multiple of the extents of both
_SEAM_TILES = 2             # unused at the edges of a window, where tiles wrap around
_CORNERS = np.array([[i, j] for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0)])
_HEIGHT_M, _MARGIN_M = 0.06, 0.05    # of the boxes of tiles, upright and sideways
_RIM_M = 0.02               # greatest height of a rim that casts a shadow


class TrackArrays(NamedTuple):
    """The windows for compiled loops; those explain them.

    Attributes:
        windows, sizes, touched, near, near_first, near_side, far: Of `track_map.prints_of`.
    """

    windows: F32
    sizes: F32
    touched: NDArray[np.bool_]
    near: F32
    near_first: NDArray[np.int64]
    near_side: NDArray[np.int64]
    far: F32


NO_TRACKS = TrackArrays(
    np.zeros(8, np.float32), np.zeros(3, np.float32), np.zeros((1, 1), bool),
    np.zeros((1, 6), np.float32), np.zeros(1, np.int64), np.ones(1, np.int64),
    np.zeros((1, 1, 3), np.float32))


class TrackMap:
    """The texels of the tracks.

    Attributes:
        arrays: For compiled loops.
        keys: (n, 2) tiles of the window that have tracks, or may lie in their shadow; they count
            from the origin of the overlay.
        boxes: (n, 2, 3) in the frame of the window [m].
        near: (n,) whether they are in the near window.
        raised: (n,) whether the ground differs in them.
    """

    def __init__(self, ground: HeightGrid, overlay: Overlay, sun: TrackSun) -> None:
        """ground: the untouched one, in the frame of the overlay, which is read at every frame."""
        self._overlay, self._sun = overlay, sun
        self._seen = 0
        self._empty()
        self._checksums: dict[tuple[int, int], int] = {}
        self._around = _around(sun)
        side, far_side = NEAR_TILES * TILE, FAR_TILES * FAR_TEXELS
        self._untouched = _untouched()
        # Texels are what differs from untouched ground: few of the pages are ever written to.
        sides = np.array([side >> level for level in range(LEVELS)])
        near, far = NEAR_TILES * TILE_M, FAR_TILES * TILE_M
        self.arrays = TrackArrays(
            np.array([1.0 / near, 0.5 * near - _SEAM_TILES * TILE_M, 1.0 / far,
                      0.5 * far - _SEAM_TILES * TILE_M, 0.0, 0.0, 0.0, 0.0], np.float32),
            np.array([CELL_M, -math.log2(CELL_M), 0.0], np.float32),
            # Most pixels need not look any further than whether a tile has anything to show.
            np.zeros((FAR_TILES, FAR_TILES), bool),
            np.zeros((int((sides**2).sum()), 6), np.float32),
            np.cumsum([0, *sides[:-1]**2]), sides, np.zeros((far_side, far_side, 3), np.float32))
        self._lie_on(ground)

    def _empty(self) -> None:
        self._index: dict[tuple[int, int], int] = {}
        self.keys: NDArray[np.int64] = np.zeros((0, 2), np.int64)
        self.boxes = np.zeros((0, 2, 3))
        self.near, self._far = np.zeros(0, bool), np.zeros(0, bool)
        self._stale, self._full = np.zeros(0, bool), np.zeros(0, bool)
        self.raised = np.zeros(0, bool)

    def _lie_on(self, ground: HeightGrid) -> None:
        self._ground, self._middle_m = ground, np.array(ground.middle_m)
        # A multiple of the extents of both windows is left out: float32 holds the rest.
        self.arrays.windows[6:] = self._middle_m - _COMMON_M * np.round(self._middle_m / _COMMON_M)

    def enter(self, ground: HeightGrid) -> None:
        """Show the tracks in another window of the site; ground: as that of the constructor.

        Texels of tiles that are in both are kept.
        """
        self._lie_on(ground)
        keys, near, far = self.keys, self.near, self._far
        flags = np.stack([near, far, self._stale, self._full, self.raised])
        stays = self._within(keys)
        for k in np.flatnonzero(~stays):
            if near[k]:
                self._write_near(self._key(int(k)), self._untouched)
            if far[k]:
                self._write_far(self._key(int(k)), self._untouched.far, False)
            self._checksums.pop(self._key(int(k)), None)
        self._empty()
        self._append(keys[stays])
        self.near, self._far, self._stale, self._full, self.raised = flags[:, stays]
        written = np.array(self._overlay.tiles_since(0, TILE), np.int64).reshape(-1, 2)
        for key in map(tuple, written[self._within(written)].tolist()):
            if key not in self._index:
                self._add_around(key)

    def _within(self, keys: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which of (n, 2) tiles are in the window."""
        away = np.abs((keys + 0.5) * TILE_M - self._middle_m).max(axis=1, initial=0.0)
        return np.asarray(away < self._ground.half_extent_m + TILE_M)

    def relight(self, sun: TrackSun) -> None:
        """Move the sun: all shadows are computed again."""
        self._sun, self._around = sun, _around(sun)
        self._checksums.clear()
        self._stale[:] = True
        for key in list(self._index):
            self._add_around(key)

    def update(self, volume: ViewVolume, before: Callable[[], None]) -> None:
        """Bring what a view shows up to date with the overlay.

        Args:
            before: Called before anything changes that pixels show.
        """
        if self._overlay.writes > self._seen:
            for key in self._overlay.tiles_since(self._seen, TILE):
                self._add_around(key)
            self._seen = self._overlay.writes
        centre_m = np.round(volume.centre_m[:2] / TILE_M) * TILE_M
        away = np.abs((self.keys + 0.5) * TILE_M - self._middle_m - centre_m).max(
            axis=1, initial=0.0)
        inside = away < (NEAR_TILES // 2 - 1) * TILE_M
        inside_far = away < (FAR_TILES // 2 - 1) * TILE_M
        left, left_far = self.near & ~inside, self._far & ~inside_far
        seen = inside_far & volume.sees(self.boxes)
        stale = seen & (self._stale | ~self._far | (inside & ~self.near))
        if (left.any() or left_far.any() or stale.any()
                or np.any(self.arrays.windows[4:6] != centre_m.astype(np.float32))):
            before()
        self.arrays.windows[4:6] = centre_m
        for k in np.flatnonzero(left):
            self._write_near(self._key(int(k)), self._untouched)
            self.near[k] = False
        for k in np.flatnonzero(left_far):
            self._write_far(self._key(int(k)), self._untouched.far, False)
            self._far[k] = self._full[k] = False
            self._stale[k] = True
        for k in np.flatnonzero(stale):
            self._draw_tile(int(k), bool(inside[k]))

    def in_view(self, volume: ViewVolume) -> NDArray[np.bool_]:
        """Return (n,) whether a view may show a tile."""
        return self._full & volume.sees(self.boxes)

    def tiles(self, which: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return (FAR_TILES, FAR_TILES) whether a tile is one of these, (n,), as `touched` is."""
        result = np.zeros_like(self.arrays.touched)
        x, y = (self.keys[which] % FAR_TILES).T
        result[y, x] = True
        return result

    def _draw_tile(self, k: int, near: bool) -> None:
        """Compute a tile anew if anything has changed that it shows, and write it."""
        key = self._key(k)
        surroundings = Surroundings.of(self._overlay, key, self._sun)
        checksum = surroundings.checksum
        self._stale[k] = False
        if self._far[k] and (self.near[k] or not near) and self._checksums.get(key) == checksum:
            return
        self._checksums[key] = checksum
        texels = track_texels(surroundings, self._sun)
        self._full[k], self.raised[k], self._far[k] = texels.full, texels.raised, True
        self._write_far(key, texels.far, texels.full)
        if near:
            self._write_near(key, texels)
            self.near[k] = True

    def _key(self, k: int) -> tuple[int, int]:
        return int(self.keys[k, 0]), int(self.keys[k, 1])

    def _add_around(self, key: tuple[int, int]) -> None:
        """Note that a tile has changed, with its neighbours and those in its shadow."""
        tiles = {(key[0] + i, key[1] + j) for i, j in self._around}
        new = np.array(sorted(tiles - self._index.keys()), np.int64).reshape(-1, 2)
        new = new[self._within(new)]
        if len(new):
            self._append(new)
        self._stale[[self._index[tile] for tile in tiles if tile in self._index]] = True

    def _append(self, keys: NDArray[np.int64]) -> None:
        for n, key in enumerate(map(tuple, keys.tolist())):
            self._index[key] = len(self.keys) + n
        last, own = self._ground.half_extent_m - 0.5 * TILE_M, self._middle_m
        middle = np.clip((keys + 0.5) * TILE_M - own, -last, last) + own
        corners = self._ground.height_at(middle[:, None] + 0.4 * TILE_M * _CORNERS)
        low = np.hstack([keys * TILE_M - own - _MARGIN_M, np.nanmin(corners, axis=1, keepdims=True)
                         - _HEIGHT_M])
        high = np.hstack([(keys + 1) * TILE_M - own + _MARGIN_M,
                          np.nanmax(corners, axis=1, keepdims=True) + _HEIGHT_M])
        self.keys = np.concatenate([self.keys, keys])
        self.boxes = np.concatenate([self.boxes, np.stack([low, high], axis=1)])
        none = np.zeros(len(keys), bool)
        self.near, self._far = np.append(self.near, none), np.append(self._far, none)
        self._stale, self._full = np.append(self._stale, ~none), np.append(self._full, none)
        self.raised = np.append(self.raised, none)

    def _write_near(self, key: tuple[int, int], texels: TrackTexels) -> None:
        x, y = key[0] % NEAR_TILES, key[1] % NEAR_TILES
        arrays = self.arrays
        for level, (first, side) in enumerate(zip(arrays.near_first.tolist(),
                                                  arrays.near_side.tolist())):
            window = arrays.near[first:first + side * side].reshape(side, side, 6)
            size = TILE >> level
            tile = window[y * size:(y + 1) * size, x * size:(x + 1) * size]
            prints, untouched = (part.prints[level].astype(np.float32)
                                 for part in (texels, self._untouched))
            tile[..., :3] = prints[..., :3] - untouched[..., :3]
            tile[..., 3] = untouched[..., 3] - prints[..., 3]
            tile[..., 4:] = texels.soil[level]

    def _write_far(self, key: tuple[int, int], texels: NDArray[np.float16], full: bool) -> None:
        x, y = key[0] % FAR_TILES, key[1] % FAR_TILES
        self.arrays.touched[y, x] = full
        size = FAR_TEXELS
        self.arrays.far[y * size:(y + 1) * size, x * size:(x + 1) * size] = (
            texels[..., :3].astype(np.float32) - self._untouched.far[..., :3])


def _untouched() -> TrackTexels:
    sun = TrackSun((1.0, 0.0), 1.0, 0.005)
    return track_texels(Surroundings.of(Overlay(), (0, 0), sun), sun)


def _around(sun: TrackSun) -> list[tuple[int, int]]:
    """Return a tile, its neighbours, and those in its shadow, relative to it."""
    tiles = {(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)}
    reach = min(REACH_M, _RIM_M / max(sun.tangent, 0.01))
    for step in np.arange(0.5 * TILE_M, reach + TILE_M, 0.5 * TILE_M):
        x, y = (0.5 - step / TILE_M * component for component in sun.heading)
        tiles |= {(math.floor(x + dx), math.floor(y + dy)) for dx in (-0.5, 0.5)
                  for dy in (-0.5, 0.5)}
    return sorted(tiles)


_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
_THOUSAND, _NOWHERE = np.float32(1000.0), np.float32(-0.1)


@compiled
def prints_of(at, level, windows, sizes, touched,  # type: ignore[no-untyped-def]
              near, near_first, near_side, far, any_level, prints):
    """Look up tracks at each pixel of a band.

    Args:
        at: (7, n) as `ground_band.place` fills it in.
        level: (n,) as `grid_rows.light_of_grid` fills it in.
        windows: 1 / extent [1/m] and half extent [m] of the near window, the far one; centre [m];
            place of the frame in both, x and y [m].
        sizes: Of a sample [m]; log2 of samples per metre; of a texel of the far window [m].
        touched: (tiles, tiles) whether a tile has anything to show.
        near: (texels, 6) slopes, tangent of the horizon less that of untouched ground, share of
            the sun that is hidden, height change [m], share that is compacted. Levels begin at
            `near_first` and are `near_side` along a side.
        far: (n, n, 3) sunlight over that on level ground less 1, compacted, loose.
        any_level: Whether mip levels count; otherwise the finest one is read.
        prints: (8, n) filled in but for the last: slopes along x and y; tangent of the horizon
            less that of untouched ground; share of the sun that is seen; how far that share counts
            for the horizon; share that is compacted, that is loose.
    """
    depth, x, y = at[0], at[1], at[2]
    print_x, print_y, horizon, seen, coarse, pressed, loose = (
        prints[0], prints[1], prints[2], prints[3], prints[4], prints[5], prints[6])
    tiles, values = len(touched), np.empty(6, np.float32)
    for k in range(len(depth)):
        print_x[k] = print_y[k] = coarse[k] = pressed[k] = loose[k] = _ZERO
        horizon[k], seen[k] = _NOWHERE, _ONE
        if depth[k] <= _ZERO:
            continue
        east_m, north_m = x[k] + windows[6], y[k] + windows[7]
        p, q = east_m * windows[2], north_m * windows[2]
        i, j = wrapped(p, tiles, _ZERO)[0], wrapped(q, tiles, _ZERO)[0]
        if not touched[j, i]:
            continue
        away = max(abs(x[k] - windows[4]), abs(y[k] - windows[5]))
        if away < windows[1]:
            own = min(max(level[k] + sizes[1], _ZERO), np.float32(len(near_side) - 1))
            if not any_level:
                own = _ZERO
            lower = np.int64(own)
            part = own - np.float32(lower)
            values[:] = _ZERO
            for turn in range(2 if part > _ZERO else 1):
                share = part if turn else (_ONE - part)
                n, first = near_side[lower + turn], near_first[lower + turn]
                # The first sample lies at the origin.
                moved = _HALF / np.float32(near_side[0])
                west, east, f = wrapped(east_m * windows[0] + moved, n, _HALF)
                south, north, g = wrapped(north_m * windows[0] + moved, n, _HALF)
                a, b = first + south * n + west, first + south * n + east
                d, e = first + north * n + west, first + north * n + east
                for channel in range(6):
                    low = near[a, channel] + f * (near[b, channel] - near[a, channel])
                    high = near[d, channel] + f * (near[e, channel] - near[d, channel])
                    values[channel] += share * (low + g * (high - low))
            print_x[k], print_y[k] = values[0], values[1]
            horizon[k], seen[k] = _NOWHERE + values[2], _ONE - values[3]
            coarse[k], pressed[k] = min(own, _ONE), values[5]
            loose[k] = min(abs(values[4]) * _THOUSAND, _ONE) * (_ONE - values[5])
        else:
            horizon[k], coarse[k] = _ZERO, _ONE
            if away <= windows[3]:
                n = len(far)
                offset = _HALF * sizes[0] * windows[2]
                west, east, f = wrapped(p + offset, n, _HALF)
                south, north, g = wrapped(q + offset, n, _HALF)
                for channel in range(3):
                    low = far[south, west, channel] + f * (far[south, east, channel]
                                                           - far[south, west, channel])
                    high = far[north, west, channel] + f * (far[north, east, channel]
                                                            - far[north, west, channel])
                    low += g * (high - low)
                    if channel == 0:
                        seen[k] = _ONE + low
                    elif channel == 1:
                        pressed[k] = low
                    else:
                        loose[k] = low


@compiled
def add_prints(depth, prints, sun, grid):  # type: ignore[no-untyped-def]
    """Add the slopes of tracks to those of the grid; fill in the sunlight that tracks leave.

    Args:
        depth: (n,), 0 where there is no ground [m].
        prints: (8, n) as `prints_of` fills it in; the last is filled in here.
        sun: Unit vector to it; to it over level ground; radius of its disc [rad].
        grid: As `grid_rows.light_of_grid` fills it in; its slopes are added to.
    """
    print_x, print_y, horizon, seen, coarse, beside = (prints[0], prints[1], prints[2], prints[3],
                                                       prints[4], prints[7])
    slope_x, slope_y = grid[0], grid[1]
    for k in range(len(depth)):
        if depth[k] <= _ZERO:
            continue
        untouched = sun[5] - slope_x[k] * sun[3] - slope_y[k] * sun[4]
        width = sun[6] * (_ONE + untouched * untouched)
        own = disc(untouched - horizon[k], width)
        beside[k] = own + coarse[k] * (seen[k] - own)
        slope_x[k] += print_x[k]
        slope_y[k] += print_y[k]
