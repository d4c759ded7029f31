"""Texels of one tile of tracks: slopes, its own shadows, and trodden soil."""

from __future__ import annotations

import dataclasses
import math
import zlib

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.ground.world.fine_relief import disc_share

LEVELS = 4                  # of the near window: texels of 5, 10, 20 and 40 mm
TILE = 40                   # samples of a tile of the textures, along one side
FAR_TEXELS = 5              # of a tile in the far window, along one side
REACH_M = 0.6               # shadows of rims are looked for up to this distance
_FIRST_M, _GROWTH = 0.004, 0.05
_LEAST_M = 1e-4             # smaller changes are not drawn
_FULLY_M = 1e-3             # of compaction from which on soil counts as compacted
_STEEPEST, _NO_HORIZON = 3.0, -0.1
_LEAST_TANGENT = 1e-3       # of a horizon that counts
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

    Attributes:
        prints, soil: Of each level of the near window, (n, n, 4) and (n, n, 2) float16.
        far: (5, 5, 4).
        raised: Whether the ground differs in it.
        full: Whether there is anything to show.
    """

    prints: list[NDArray[np.float16]]
    soil: list[NDArray[np.float16]]
    far: NDArray[np.float16]
    raised: bool
    full: bool


@dataclasses.dataclass(frozen=True)
class Surroundings:
    """The samples that the texels of a tile depend on.

    Attributes:
        height: (ny, nx) height changes [m].
        corner: The tile's first sample in it, ix and iy.
        compaction: (TILE, TILE) that of the tile [m].
        reach_m: How far shadows may come from.
    """

    height: Array
    corner: tuple[int, int]
    compaction: Array
    reach_m: float

    @classmethod
    def of(cls, overlay: Overlay, tile: tuple[int, int], sun: TrackSun) -> Surroundings:
        """Return those of a tile (tx, ty)."""
        x, y = tile[0] * TILE, tile[1] * TILE
        far = math.ceil(REACH_M / CELL_M) + 2
        # One sample for slopes, more towards the sun for shadows.
        west, east = (far, 2) if sun.heading[0] < 0.0 else (2, far)
        south, north = (far, 2) if sun.heading[1] < 0.0 else (2, far)
        height, compaction = overlay.window(x - west, y - south, TILE + west + east,
                                            TILE + south + north)
        own = height[south:south + TILE, west:west + TILE]
        # The ground itself may lean by as much as half of the sun's elevation.
        reach = min(REACH_M, (float(height.max()) - float(own.min()))
                    / (0.5 * max(sun.tangent, 0.01)))
        less = far - 2 - math.ceil(reach / CELL_M)
        cut = slice(less if south == far else 0, -less or None if north == far else None), \
            slice(less if west == far else 0, -less or None if east == far else None)
        corner = west - (less if west == far else 0), south - (less if south == far else 0)
        return cls(np.ascontiguousarray(height[cut]), corner,
                   compaction[south:south + TILE, west:west + TILE], reach)

    @property
    def checksum(self) -> int:
        """A number that differs if the samples do."""
        return zlib.crc32(self.compaction.tobytes(), zlib.crc32(self.height.tobytes()))


def track_texels(around: Surroundings, sun: TrackSun) -> TrackTexels:
    """Return the texels of a tile."""
    height, (west, south) = around.height, around.corner
    inner = slice(south, south + TILE), slice(west, west + TILE)
    own = height[inner]
    slopes = [np.clip((height[south + dy:south + dy + TILE, west + dx:west + dx + TILE]
                       - height[south - dy:south - dy + TILE, west - dx:west - dx + TILE])
                      / (2.0 * CELL_M), -_STEEPEST, _STEEPEST) for dx, dy in ((1, 0), (0, 1))]
    horizon = _horizon(height, west, south, around.reach_m, *sun.heading)
    width = sun.radius_rad * (1.0 + sun.tangent ** 2)
    seen = disc_share((sun.tangent - horizon) / width)
    pressed = np.clip(around.compaction / _FULLY_M, 0.0, 1.0)
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
    # The samples at its edges count.
    relief = np.abs(height[south:south + TILE + 1, west:west + TILE + 1]) > _LEAST_M
    raised = bool(relief.any() or pressed.any())
    return TrackTexels([p.astype(np.float16) for p in prints],
                       [s.astype(np.float16) for s in soil], far_texels.astype(np.float16),
                       raised, raised or bool((seen < 1.0).any()))


@compiled
def _horizon(height, west, south, reach_m, heading_x, heading_y):  # type: ignore[no-untyped-def]
    """Return the tangent of the horizon towards the sun over the untouched ground, (TILE, TILE).

    Where nothing stands higher it is below 0.

    Args:
        height, west, south, reach_m: As those of `Surroundings`.
        heading_x, heading_y: As that of `TrackSun`.
    """
    highest = np.full((TILE, TILE), _NO_HORIZON)
    way = _FIRST_M
    while way < reach_m:
        x, y = way / CELL_M * heading_x, way / CELL_M * heading_y
        column, row = int(np.floor(x)), int(np.floor(y))
        u, v = x - column, y - row
        for j in range(TILE):
            for i in range(TILE):
                r, c = south + row + j, west + column + i
                there = ((1.0 - u) * (1.0 - v) * height[r, c] + u * (1.0 - v) * height[r, c + 1]
                         + (1.0 - u) * v * height[r + 1, c] + u * v * height[r + 1, c + 1])
                highest[j, i] = max(highest[j, i], (there - height[south + j, west + i]) / way)
        way += max(CELL_M, _GROWTH * way)
    for j in range(TILE):
        for i in range(TILE):
            if highest[j, i] < _LEAST_TANGENT:
                highest[j, i] = _NO_HORIZON
    return highest


def _halved(texels: Array) -> Array:
    n = len(texels) // 2
    halved: Array = texels.reshape(n, 2, n, 2, -1).mean(axis=(1, 3))
    return halved
