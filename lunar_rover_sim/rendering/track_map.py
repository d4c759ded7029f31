"""The tracks of an overlay as textures in two windows around the cameras, as far as they are seen.

Both windows wrap around: a tile always has the same place in them, which it shares with tiles far
away. A tile is computed when it comes into view, and again in view after it, or what casts a
shadow on it, has changed. Tracks behind the rover cost nothing.
"""

from __future__ import annotations

import math

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.rendering import texture_units
from lunar_rover_sim.rendering.context import release_all, set_uniform
from lunar_rover_sim.rendering.projection import ViewVolume
from lunar_rover_sim.rendering.track_texels import (FAR_TEXELS, LEVELS, REACH_M, Surroundings,
                                                    TILE, track_texels, TrackSun, TrackTexels)
from lunar_rover_sim.world.grid import HeightGrid

TILE_M = TILE * CELL_M
NEAR_TILES, FAR_TILES = 40, 128
DEFINES = {'PRINT_OFFSET': f'{0.5 / (NEAR_TILES * TILE):.9f}',
           'PRINT_LOG2': f'{-math.log2(CELL_M):.6f}', 'PRINT_CELL': f'{CELL_M:.6f}',
           'FAR_OFFSET': f'{0.5 * CELL_M / (FAR_TILES * TILE_M):.9f}'}
_SEAM_TILES = 2             # unused at the edges of a window, where tiles wrap around
_CORNERS = np.array([[i, j] for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0)])
_HEIGHT_M, _MARGIN_M = 0.06, 0.05    # of the boxes of tiles, upright and sideways
_RIM_M = 0.02               # greatest height of a rim that casts a shadow


class TrackMap:
    """The textures of the tracks.

    Attributes:
        keys: (n, 2) tiles that have tracks, or may lie in their shadow.
        blocks: (n, 2, 2) which of their blocks have relief.
        boxes: (n, 2, 3) [m].
        near: (n,) whether they are in the near window.
    """

    def __init__(self, context: moderngl.Context, ground: HeightGrid, overlay: Overlay,
                 sun: TrackSun) -> None:
        """ground: the untouched one; overlay: read whenever a frame is drawn."""
        self._overlay, self._ground, self._sun = overlay, ground, sun
        self._seen = 0
        self._index: dict[tuple[int, int], int] = {}
        self.keys: NDArray[np.int64] = np.zeros((0, 2), np.int64)
        self.boxes, self.blocks = np.zeros((0, 2, 3)), np.zeros((0, 2, 2), bool)
        self.near, self._far = np.zeros(0, bool), np.zeros(0, bool)
        self._stale, self._full = np.zeros(0, bool), np.zeros(0, bool)
        self._checksums: dict[tuple[int, int], int] = {}
        self._around = _around(sun)
        self.centre_m = np.zeros(2)
        side, far_side = NEAR_TILES * TILE, FAR_TILES * FAR_TEXELS
        self._prints = _texture(context, side, 4, LEVELS)
        self._soil = _texture(context, side, 2, LEVELS)
        self._far_prints = _texture(context, far_side, 4, 1)
        self._untouched = _untouched()
        for level in range(LEVELS):
            for texture, data in ((self._prints, self._untouched.prints),
                                  (self._soil, self._untouched.soil)):
                texture.write(np.tile(data[level], (NEAR_TILES, NEAR_TILES, 1)), level=level)
        self._far_prints.write(np.tile(self._untouched.far, (FAR_TILES, FAR_TILES, 1)))
        # Which tiles have anything to show: most pixels need not look any further.
        self._touched = context.texture((FAR_TILES, FAR_TILES), 1, bytes(FAR_TILES ** 2),
                                        alignment=1, dtype='f1')
        self._touched.filter = (context.NEAREST, context.NEAREST)

    def relight(self, sun: TrackSun) -> None:
        """Move the sun: all shadows are computed again."""
        self._sun, self._around = sun, _around(sun)
        self._checksums.clear()
        self._stale[:] = True
        for key in list(self._index):
            self._add_around(key)

    def update(self, volume: ViewVolume) -> None:
        """Bring what a view shows up to date with the overlay."""
        if self._overlay.writes > self._seen:
            for key in self._overlay.tiles_since(self._seen, TILE):
                self._add_around(key)
            self._seen = self._overlay.writes
        self.centre_m = np.round(volume.centre_m[:2] / TILE_M) * TILE_M
        away = np.abs((self.keys + 0.5) * TILE_M - self.centre_m).max(axis=1, initial=0.0)
        inside = away < (NEAR_TILES // 2 - 1) * TILE_M
        inside_far = away < (FAR_TILES // 2 - 1) * TILE_M
        for k in np.flatnonzero(self.near & ~inside):
            self._write_near(self._key(int(k)), self._untouched)
            self.near[k] = False
        for k in np.flatnonzero(self._far & ~inside_far):
            self._write_far(self._key(int(k)), self._untouched.far, False)
            self._far[k] = self._full[k] = False
            self._stale[k] = True
        seen = inside_far & volume.sees(self.boxes)
        for k in np.flatnonzero(seen & (self._stale | ~self._far | (inside & ~self.near))):
            self._draw_tile(int(k), bool(inside[k]))

    def in_view(self, volume: ViewVolume) -> NDArray[np.bool_]:
        """Return (n,) whether a view may show a tile."""
        return self._full & volume.sees(self.boxes)

    def bind(self, program: moderngl.Program) -> None:
        """Bind the textures for a program that draws or lights tracks."""
        for texture, unit in ((self._touched, texture_units.TOUCHED),
                              (self._prints, texture_units.PRINTS),
                              (self._soil, texture_units.SOIL),
                              (self._far_prints, texture_units.FAR_PRINTS)):
            texture.use(unit)
        near, far = NEAR_TILES * TILE_M, FAR_TILES * TILE_M
        set_uniform(program, u_touched=texture_units.TOUCHED, u_prints=texture_units.PRINTS,
                    u_soil=texture_units.SOIL,
                    u_far_prints=texture_units.FAR_PRINTS,
                    u_windows=(1.0 / near, 0.5 * near - _SEAM_TILES * TILE_M, 1.0 / far,
                               0.5 * far - _SEAM_TILES * TILE_M),
                    u_window_centre=tuple(self.centre_m.tolist()))

    def release(self) -> None:
        """Release the GL objects."""
        release_all(self._prints, self._soil, self._far_prints, self._touched)

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
        self.blocks[k], self._full[k], self._far[k] = texels.blocks, texels.full, True
        self._write_far(key, texels.far, texels.full)
        if near:
            self._write_near(key, texels)
            self.near[k] = True

    def _key(self, k: int) -> tuple[int, int]:
        return int(self.keys[k, 0]), int(self.keys[k, 1])

    def _add_around(self, key: tuple[int, int]) -> None:
        """Note that a tile has changed, with its neighbours and those in its shadow."""
        tiles = {(key[0] + i, key[1] + j) for i, j in self._around}
        new = sorted(tiles - self._index.keys())
        if new:
            self._append(np.array(new))
        self._stale[[self._index[tile] for tile in tiles]] = True

    def _append(self, keys: NDArray[np.int64]) -> None:
        count = len(keys)
        for n, key in enumerate(map(tuple, keys.tolist())):
            self._index[key] = len(self.keys) + n
        last = self._ground.half_extent_m - 0.5 * TILE_M
        middle = np.clip((keys + 0.5) * TILE_M, -last, last)
        corners = self._ground.height_at(middle[:, None] + 0.4 * TILE_M * _CORNERS)
        low = np.hstack([keys * TILE_M - _MARGIN_M, np.nanmin(corners, axis=1, keepdims=True)
                         - _HEIGHT_M])
        high = np.hstack([(keys + 1) * TILE_M + _MARGIN_M,
                          np.nanmax(corners, axis=1, keepdims=True) + _HEIGHT_M])
        self.keys = np.concatenate([self.keys, keys])
        self.boxes = np.concatenate([self.boxes, np.stack([low, high], axis=1)])
        self.blocks = np.concatenate([self.blocks, np.zeros((count, 2, 2), bool)])
        none = np.zeros(count, bool)
        self.near, self._far = np.append(self.near, none), np.append(self._far, none)
        self._stale, self._full = np.append(self._stale, ~none), np.append(self._full, none)

    def _write_near(self, key: tuple[int, int], texels: TrackTexels) -> None:
        for level in range(LEVELS):
            side = TILE >> level
            area = key[0] % NEAR_TILES * side, key[1] % NEAR_TILES * side, side, side
            for texture, data in ((self._prints, texels.prints), (self._soil, texels.soil)):
                texture.write(np.ascontiguousarray(data[level]), area, level=level)

    def _write_far(self, key: tuple[int, int], texels: NDArray[np.float16], full: bool) -> None:
        place = key[0] % FAR_TILES, key[1] % FAR_TILES, 1, 1
        self._touched.write(b'\xff' if full else b'\0', place, alignment=1)
        side = FAR_TEXELS
        self._far_prints.write(np.ascontiguousarray(texels), (
            key[0] % FAR_TILES * side, key[1] % FAR_TILES * side, side, side))


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


def _texture(context: moderngl.Context, side: int, components: int,
             levels: int) -> moderngl.Texture:
    texture = context.texture((side, side), components, dtype='f2')
    if levels > 1:
        texture.build_mipmaps(0, levels - 1)
        texture.filter = (context.LINEAR_MIPMAP_LINEAR, context.LINEAR)
    else:
        texture.filter = (context.LINEAR, context.LINEAR)
    texture.repeat_x = texture.repeat_y = True
    return texture
