"""What the shaders need of one tile of tracks: slopes, its own shadows, and trodden soil."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.regolith.overlay import CELL_M, Overlay, TILE
from lunar_rover_sim.world.fine_relief import disc_share

LEVELS = 4                  # of the near window: texels of 5, 10, 20 and 40 mm
BLOCK = TILE // 2           # samples of a block of the mesh, along one side
FAR_TEXELS = 5              # of a tile in the far window, along one side
REACH_M = 0.6               # shadows of rims are looked for up to this distance
_FIRST_M, _GROWTH = 0.004, 0.05
_LEAST_M = 1e-4             # smaller changes are not drawn
_FULLY_M = 1e-3             # of compaction from which on soil counts as compacted
_STEEPEST, _NO_HORIZON = 3.0, -0.1
_BRIGHTEST = 3.0


@dataclasses.dataclass(frozen=True)
class TrackSun:
    """The sun over tracks: its azimuth as a unit vector, tangent of its elevation, its radius."""

    heading: tuple[float, float]
    tangent: float
    radius_rad: float

    @classmethod
    def of(cls, direction: Array, radius_rad: float) -> TrackSun:
        """Return the sun in a direction (3,)."""
        flat = max(math.hypot(direction[0], direction[1]), 1e-6)
        return cls((float(direction[0] / flat), float(direction[1] / flat)),
                   float(direction[2] / flat), radius_rad)


@dataclasses.dataclass(frozen=True)
class TrackTexels:
    """Texels of a tile.

    prints, soil: of each level of the near window, (n, n, 4) and (n, n, 2) float16; far: (5, 5, 4)
    blocks: (2, 2) whether a block [iy, ix] has relief; the samples at its edges count
    low_m, high_m: least and greatest height change
    """

    prints: list[NDArray[np.float16]]
    soil: list[NDArray[np.float16]]
    far: NDArray[np.float16]
    blocks: NDArray[np.bool_]
    low_m: float
    high_m: float


def track_texels(overlay: Overlay, tile: tuple[int, int], sun: TrackSun) -> TrackTexels:
    """Return the texels of a tile (tx, ty) of an overlay."""
    far = math.ceil(REACH_M / CELL_M) + 2
    # Samples around the tile: one for slopes, more towards the sun for shadows.
    west, east = (far, 2) if sun.heading[0] < 0.0 else (2, far)
    south, north = (far, 2) if sun.heading[1] < 0.0 else (2, far)
    height, compaction = overlay.window(tile[0] * TILE - west, tile[1] * TILE - south,
                                        TILE + west + east, TILE + south + north)
    inner = slice(south, south + TILE), slice(west, west + TILE)
    own = height[inner]
    slopes = [np.clip((height[south + dy:south + dy + TILE, west + dx:west + dx + TILE]
                       - height[south - dy:south - dy + TILE, west - dx:west - dx + TILE])
                      / (2.0 * CELL_M), -_STEEPEST, _STEEPEST) for dx, dy in ((1, 0), (0, 1))]
    horizon = _horizon(height, (west, south), sun)
    width = sun.radius_rad * (1.0 + sun.tangent ** 2)
    seen = disc_share((sun.tangent - horizon) / width)
    pressed = np.clip(compaction[inner] / _FULLY_M, 0.0, 1.0)
    loose = np.clip(np.abs(own) / _FULLY_M, 0.0, 1.0) * (1.0 - pressed)
    facing = 1.0 - (slopes[0] * sun.heading[0] + slopes[1] * sun.heading[1]) / max(sun.tangent,
                                                                                   0.01)
    light = np.clip(seen * facing, 0.0, _BRIGHTEST)
    prints = [np.stack([*slopes, horizon, seen], axis=-1)]
    soil = [np.stack([own, pressed], axis=-1)]
    for _ in range(LEVELS - 1):
        prints.append(_halved(prints[-1]))
        soil.append(_halved(soil[-1]))
    distant = np.stack([light, pressed, loose, np.zeros_like(light)], axis=-1)
    side = TILE // FAR_TEXELS
    far_texels = distant.reshape(FAR_TEXELS, side, FAR_TEXELS, side, 4).mean(axis=(1, 3))
    relief = np.abs(height[south:south + TILE + 1, west:west + TILE + 1]) > _LEAST_M
    blocks = np.array([[relief[j:j + BLOCK + 1, i:i + BLOCK + 1].any() for i in (0, BLOCK)]
                       for j in (0, BLOCK)])
    return TrackTexels([p.astype(np.float16) for p in prints],
                       [s.astype(np.float16) for s in soil], far_texels.astype(np.float16),
                       blocks, float(own.min()), float(own.max()))


def _horizon(height: Array, corner: tuple[int, int], sun: TrackSun) -> Array:
    """Return the tangent of the horizon towards the sun over the untouched ground, (TILE, TILE).

    height: changes on the samples around the tile, whose first sample is at the corner [ix, iy].
    Where nothing stands higher it is below 0.
    """
    own = height[corner[1]:corner[1] + TILE, corner[0]:corner[0] + TILE]
    highest = np.full(own.shape, _NO_HORIZON)
    top = float(height.max()) - float(own.min())
    way = _FIRST_M
    while way < REACH_M and top > 0.25 * sun.tangent * way:
        x, y = way / CELL_M * sun.heading[0], way / CELL_M * sun.heading[1]
        ix, iy = math.floor(x), math.floor(y)
        u, v = x - ix, y - iy
        there = np.zeros(own.shape)
        for dx, dy, weight in ((0, 0, (1.0 - u) * (1.0 - v)), (1, 0, u * (1.0 - v)),
                               (0, 1, (1.0 - u) * v), (1, 1, u * v)):
            j, i = corner[1] + iy + dy, corner[0] + ix + dx
            there += weight * height[j:j + TILE, i:i + TILE]
        np.maximum(highest, (there - own) / way, out=highest)
        way += max(CELL_M, _GROWTH * way)
    highest[highest < 1e-3] = _NO_HORIZON
    return highest


def _halved(texels: Array) -> Array:
    n = len(texels) // 2
    halved: Array = texels.reshape(n, 2, n, 2, -1).mean(axis=(1, 3))
    return halved
