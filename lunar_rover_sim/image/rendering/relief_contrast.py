"""How much contrast and shadow a camera sees in the relief below the grid, by rays.

By mip level of the fine tile, cosine of emission and azimuth between sun and view. Rays are cast
(relief_rays.py) for a few of each, under the two nearest of some heights of the sun; what lies
between is interpolated.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.kept_arrays import kept
from lunar_rover_sim.image.illumination import hapke
from lunar_rover_sim.image.rendering.relief_rays import ReliefRays
from lunar_rover_sim.image.rendering.relief_tiles import ReliefTiles

_RECIPE = 2             # rises with every change of what `_cast` returns
_SUNS_DEG = (0.6, 1.5, 3.0, 6.0, 10.0, 15.0, 25.0, 40.0, 60.0, 85.0)
_LEVELS = (2.0, 4.0, 6.0, 8.0)
# Cosines of emission at which cameras near the ground see pixels of each level.
_COSINES = ((0.12, 0.25, 0.45, 0.8), (0.05, 0.1, 0.2, 0.45), (0.025, 0.05, 0.1, 0.22),
            (0.018, 0.03, 0.06, 0.12))
_AZIMUTHS_DEG = (0.0, 12.0, 35.0, 75.0, 130.0, 180.0)
_PIXELS, _MOST_SAMPLES = 128, 8
# As grid_rows.py has them: how much longer a pixel may be than wide, how much of it is left out
# across the sun.
_LONGEST, _SHORTER, _OCTAVES, _SHARPER = 12.0, 0.34, 8.0, 0.05


class SeenRelief(NamedTuple):
    """What rays find.

    Attributes:
        contrast: Standard deviation over mean of pixels.
        dark: Share of the visible ground that no sun reaches.
    """

    contrast: Array
    dark: Array


def seen_relief(tiles: ReliefTiles, ground: hapke.HapkeParameters, albedo: float,
                recipe: list[Any], tangent: float, levels: Array, cosines: Array,
                azimuths_rad: Array) -> SeenRelief:
    """Return what is seen at all (levels, cosines, azimuths).

    Args:
        recipe: What the light on tiles follows from, but for the sun; as JSON can write it.
        tangent: Of the elevation of the sun.
    """
    suns = np.log(np.tan(np.radians(_SUNS_DEG)))
    k = int(np.clip(np.searchsorted(suns, math.log(tangent)) - 1, 0, len(suns) - 2))
    share = float(np.clip((math.log(tangent) - suns[k]) / (suns[k + 1] - suns[k]), 0.0, 1.0))

    def under(sun: int) -> Array:
        return np.asarray(kept('relief_contrast', [_RECIPE, *recipe, _SUNS_DEG[sun]],
                               lambda: _cast(ReliefRays(tiles, ground, albedo),
                                             math.exp(suns[sun]), tiles.fine.texel_m)), float)
    found = (1.0 - share) * under(k) + share * under(k + 1)
    return SeenRelief(*(_between(values, levels, cosines, azimuths_rad) for values in found))


def _cast(rays: ReliefRays, tangent: float, texel_m: float) -> NDArray[np.float32]:
    """Return (2, levels, cosines, azimuths) of contrast and dark share."""
    found = np.empty((2, len(_LEVELS), len(_COSINES[0]), len(_AZIMUTHS_DEG)), np.float32)
    for i, level in enumerate(_LEVELS):
        for j, cosine in enumerate(_COSINES[i]):
            for k, azimuth in enumerate(np.radians(_AZIMUTHS_DEG)):
                sine = math.sqrt(1.0 - cosine**2)
                view = np.array([sine * math.cos(azimuth), sine * math.sin(azimuth), cosine])
                longer = min(1.0 / cosine, _LONGEST)
                across = math.sin(azimuth)**2 * _SHORTER * min(2.0 - longer / _OCTAVES, 1.0)
                size = texel_m * 2.0**(level + _SHARPER - math.log2(longer) * (1.0 - across))
                found[:, i, j, k] = rays.contrast(
                    tangent, view, size, _PIXELS,
                    (2, min(max(round(0.5 / cosine), 2), _MOST_SAMPLES)))
    return found


def _between(values: Array, levels: Array, cosines: Array, azimuths_rad: Array) -> Array:
    """Interpolate in level, logarithm of the cosine, and azimuth; constant beyond the ends."""
    by_view = np.array([[[np.interp(azimuths_rad, np.radians(_AZIMUTHS_DEG), row)
                          for row in of_level]] for of_level in values])[:, 0]
    by_cosine = np.array([[np.interp(np.log(cosines), np.log(nodes), column)
                           for column in of_level.T]
                          for nodes, of_level in zip(_COSINES, by_view)])
    flat = by_cosine.reshape(len(_LEVELS), -1)
    by_level = np.array([np.interp(levels, _LEVELS, column) for column in flat.T])
    return by_level.T.reshape(len(levels), len(azimuths_rad), len(cosines)).transpose(0, 2, 1)
