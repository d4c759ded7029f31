"""What a photo from orbit tells of slopes: how bright facets of the ground are on it.

The photo shows craters that are too small for the map of heights. Its sun is known; the law of
Lommel and Seeliger (Hapke, Theory of Reflectance and Emittance Spectroscopy, 2nd ed., 2012, 8.3)
says how bright a slope is. The albedo varies, and rocks and their shadows are not predicted: their
pixels are off by any amount, so brightness is compared up to a limit.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array, sun_direction
from lunar_rover_sim.ground.world.orbital_map import NO_PHOTO, OrbitalMap
from lunar_rover_sim.judge.slam.graph.relief import Facets

_MOST = 0.5                 # logarithms of brightness over that of the plain are cut there
_LEAST_COSINE = 0.02
# Standard deviations of the logarithm: of a facet that is a plane; of the albedo, which is alike
# over some metres; and the share of the spread of a facet by which its slope is off.
_FACET, _ALBEDO, _ALIKE_M, _SEEN_PART = 0.05, 0.04, 15.0, 1.5


@dataclasses.dataclass(frozen=True)
class Photo:
    """The logarithm of the brightness, over that of the plain.

    Attributes:
        values: (rows, columns); NaN without data.
        first_m: (2,) place of the middle of the pixel [0, 0].
        pixel_m: Side of a pixel.
        to_sun: (3,) direction.
    """

    values: NDArray[np.float32]
    first_m: tuple[float, float]
    pixel_m: float
    to_sun: Array

    @classmethod
    def of(cls, orbital: OrbitalMap) -> Photo | None:
        """Return that of a map; None where it has none."""
        photo, config = orbital.photo.astype(np.float32), orbital.config
        known = photo != NO_PHOTO
        if not known.any():
            return None
        plain = np.median(photo[known])
        values = np.clip(np.log(np.maximum(photo, 1.0) / plain), -_MOST, _MOST)
        values = values.astype(np.float32)
        values[~known] = np.nan
        return cls(values, orbital.photo_first_m, config.photo_pixel_m,
                   sun_direction(config.sun_azimuth_deg, config.sun_elevation_deg))

    def expected(self, facets: Facets) -> tuple[Array, Array]:
        """Return the values (n,) of facets and their covariance (n, n)."""
        slope = facets.gradient @ self.to_sun[:2]
        cosine = (self.to_sun[2] - slope) / np.sqrt(1.0 + np.sum(facets.gradient**2, axis=1))
        cosine = np.maximum(cosine, _LEAST_COSINE)
        plain = self.to_sun[2]
        value = np.log(cosine / (1.0 + cosine) / (plain / (1.0 + plain)))
        # How the logarithm changes with the slope towards the sun.
        rate = np.hypot(*self.to_sun[:2]) / (cosine * (1.0 + cosine))
        apart = np.linalg.norm(facets.xy_m[:, None] - facets.xy_m[None], axis=2)
        covariance = _ALBEDO**2 * np.exp(-(apart / _ALIKE_M)**2) + np.diag(
            _FACET**2 + (rate * _SEEN_PART * facets.spread)**2)
        return np.clip(value, -_MOST, _MOST), covariance
