"""What a camera sees of the relief below the grid, by rays cast against the heights of its tiles.

What is drawn (relief_rows.py) is of slopes and horizons alone. Rays also know what hides what: at
a low view only faces that look towards the camera are seen, up-sun those in shadow.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.illumination import hapke
from lunar_rover_sim.image.rendering.relief_tiles import FINER, ReliefTiles

F32 = NDArray[np.float32]

_STEPS_PER_TEXEL = 1.0      # along the ground
_SEARCH = 8                 # halvings of the last step
_LIFT = np.float32(1e-4)    # of where a ray to the sun starts [m]


class ReliefRays:
    """The heights of both tiles together, periodic, and rays against them.

    Attributes:
        theta_deg: Roughness that the slopes of these heights leave to the law.
    """

    def __init__(self, tiles: ReliefTiles, ground: hapke.HapkeParameters,
                 albedo: float) -> None:
        """Lay the fine tile beside itself on the coarse one, at the texels of that."""
        coarse, fine = tiles.coarse, tiles.fine
        side = len(fine.heights) >> FINER
        part = fine.heights.reshape(side, 1 << FINER, side, 1 << FINER).mean(axis=(1, 3))
        times = len(coarse.heights) // side
        self._heights = np.ascontiguousarray(
            coarse.heights + np.tile(part, (times, times)), np.float32)
        self._texel_m = coarse.period_m / len(coarse.heights)
        self._ground, self._albedo = ground, albedo
        slopes = [np.diff(self._heights, axis=k) / self._texel_m for k in (0, 1)]
        variance = sum(float(np.mean(slope**2)) for slope in slopes)
        self.theta_deg = math.degrees(math.atan(math.sqrt(max(
            math.tan(math.radians(ground.theta_deg))**2 - 0.25 * math.pi * variance, 0.0))))

    def contrast(self, sun_tangent: float, view: Array, size_m: float, count: int,
                 samples: tuple[int, int]) -> tuple[float, float]:
        """Return standard deviation over mean of pixels, and the dark share; as for `pixels`.

        What few rays a pixel add to the variance is taken off.
        """
        light, dark = self._cast(sun_tangent, view, size_m, count, samples, 0)
        within = light.var(axis=1, ddof=1).mean() / light.shape[1]
        between = max(float(light.mean(axis=1).var(ddof=1) - within), 0.0)
        return math.sqrt(between) / max(float(light.mean()), 1e-9), float(dark.mean())

    def pixels(self, sun_tangent: float, view: Array, size_m: float, count: int,
               samples: tuple[int, int], seed: int = 0) -> Array:
        """Return the radiance over irradiance of (count,) pixels.

        Args:
            sun_tangent: Of the sun, which stands towards x.
            view: Unit vector to the camera.
            size_m: Side of the pixels, across the view.
            samples: Rays across a pixel, and along it.
        """
        return self._cast(sun_tangent, view, size_m, count, samples, seed)[0].mean(axis=1)

    def _cast(self, sun_tangent: float, view: Array, size_m: float, count: int,
              samples: tuple[int, int], seed: int) -> tuple[Array, NDArray[np.bool_]]:
        """Return radiance of all rays, and whether they end in the dark, (count, samples)."""
        rng = np.random.default_rng(seed)
        sun = np.array([1.0, 0.0, sun_tangent]) / math.hypot(1.0, sun_tangent)
        right = np.array([-view[1], view[0], 0.0]) if abs(view[2]) < 0.999 else np.array(
            [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        up = np.cross(view, right)
        middle = rng.random((count, 1, 1, 2)) * (len(self._heights) * self._texel_m)
        across, along_it = ((np.arange(n) + 0.5) / n - 0.5 for n in samples)
        # On the plane of mean height, as far as a pixel reaches.
        offset = size_m * (across[:, None, None] * right + along_it[None, :, None] * up)
        along = offset[..., 2] / view[2]
        xy = (middle + (offset - along[..., None] * view)[None, ..., :2]).reshape(-1, 2)
        out = np.empty((len(xy), 2), np.float32)
        _cast(self._heights, np.float32(self._texel_m), xy.astype(np.float32),
              view.astype(np.float32), sun.astype(np.float32), out)
        light = hapke.reflectance(out[:, 0], out[:, 1], float(view @ sun), self._ground,
                                  albedo=self._albedo, theta_deg=self.theta_deg)
        shape = count, samples[0] * samples[1]
        return light.reshape(shape), (out[:, 0] <= 0.0).reshape(shape)


@compiled
def _height(heights, x, y):  # type: ignore[no-untyped-def]
    """Return the height at a place in texels."""
    n = len(heights)
    column, row = math.floor(x), math.floor(y)
    u, v = np.float32(x - column), np.float32(y - row)
    i, j = int(column) & (n - 1), int(row) & (n - 1)
    east, north = (i + 1) & (n - 1), (j + 1) & (n - 1)
    low = heights[j, i] + u * (heights[j, east] - heights[j, i])
    high = heights[north, i] + u * (heights[north, east] - heights[north, i])
    return low + v * (high - low)


@compiled
def _cast(heights, texel, xy, view, sun, out):  # type: ignore[no-untyped-def]
    """Fill in cosines of incidence and emission, (n, 2), where rays meet; 0 in the dark.

    Args:
        xy: (n, 2) where rays meet the plane of height 0 [m].
        view, sun: Unit vectors to the camera and to the sun.
    """
    top, bottom = heights.max(), heights.min()
    across = max(math.hypot(view[0], view[1]), 0.05)
    step = np.float32(_STEPS_PER_TEXEL * texel / across)
    of_sun = np.float32(_STEPS_PER_TEXEL * texel / max(math.hypot(sun[0], sun[1]), 0.05))
    for k in range(len(xy)):
        t = top / view[2]       # towards the camera
        end = bottom / view[2]
        while t > end:
            x, y = xy[k, 0] + t * view[0], xy[k, 1] + t * view[1]
            above = t * view[2] - _height(heights, x / texel, y / texel)
            if above <= 0.0:
                break
            # No slope is steeper than about 3 / 2.
            t -= max(step, np.float32(0.3) * above)
        low, high = t, t + step
        for _ in range(_SEARCH):
            middle = np.float32(0.5) * (low + high)
            x, y = xy[k, 0] + middle * view[0], xy[k, 1] + middle * view[1]
            if middle * view[2] <= _height(heights, x / texel, y / texel):
                low = middle
            else:
                high = middle
        x, y = (xy[k, 0] + high * view[0]) / texel, (xy[k, 1] + high * view[1]) / texel
        z = high * view[2] + _LIFT
        half = np.float32(0.5)
        p = (_height(heights, x + half, y) - _height(heights, x - half, y)) / texel
        q = (_height(heights, x, y + half) - _height(heights, x, y - half)) / texel
        up = np.float32(1.0) / math.sqrt(p * p + q * q + np.float32(1.0))
        mu0 = up * (sun[2] - p * sun[0] - q * sun[1])
        mu = up * (view[2] - p * view[0] - q * view[1])
        if mu0 > 0.0:
            away = of_sun
            while z + away * sun[2] < top:
                above = (z + away * sun[2]
                         - _height(heights, x + away * sun[0] / texel, y + away * sun[1] / texel))
                if above < 0.0:
                    mu0 = np.float32(0.0)
                    break
                away += max(of_sun, np.float32(0.3) * above)
        out[k, 0], out[k, 1] = max(mu0, np.float32(0.0)), max(mu, np.float32(0.02))
