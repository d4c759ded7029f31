"""Returns of pulses: signal, detection, noise of ranges, intensity.

The laser and the receiver are in one place, so the phase angle is 0 and the opposition effect is
at its peak. A beam that lies on a surface with the bidirectional reflectance r [1/sr], per normal
irradiance, returns the power P r A / R^2 to an aperture A: at oblique incidence its spot grows as
its irradiance falls. So the signal, relative to that of a diffuse target of reflectance rho at
right angles and the range R0, is s = (pi r / rho) (R0 / R)^2. At the phase angle 0 regolith has
nearly the same r at all incidences, as the full Moon shows, which has no darker limb. What
oblique incidence costs is the height of the pulse: ground across a beam of divergence a spreads it
by R a tan i, so that a pulse of length p is lower by (1 + (R a tan i / p)^2)^-1/2 (for pulse and
spot of Gaussian shape, whose widths add as squares; Wagner et al., ISPRS J. 60, 2006).

A pulse is detected if its amplitude, with Gaussian noise of standard deviation 1, exceeds a
threshold. The threshold is _THRESHOLD; the amplitude at the reference exceeds it by 1.28, which
makes 90 %. The deviation of ranges has a part that does not depend on the signal, and one that is
inversely proportional to it, as for every pulse whose time is found in noise.
"""

from __future__ import annotations

import dataclasses
import math
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled, read_only
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.illumination import hapke
from lunar_rover_sim.image.lidar.optics import LidarConfig
from lunar_rover_sim.image.lidar.ray_caster import RayHits, ROVER

_THRESHOLD = 6.0            # of the noise: a false alarm in a billion; a choice
_REFERENCE = _THRESHOLD + NormalDist().inv_cdf(0.9)
_COSINES, _ALBEDOS = 1024, 128
_MOST_ALBEDO = 4.0
_MOST_INTENSITY = 255.0
_OF_ROVER = 0.4             # foil, cells, aluminium: a choice


@dataclasses.dataclass(frozen=True)
class Returns:
    """What is measured of n beams.

    Attributes:
        range_m: (n,) float32, NaN where nothing returns.
        intensity: (n,) float32, the reflectance of a diffuse surface at right angles that would
            return as much [%], at most 255.
    """

    range_m: NDArray[np.float32]
    intensity: NDArray[np.float32]


class _Ranging(NamedTuple):
    """What the loop over beams needs of LidarOptics."""

    reference_range_m: float
    reference_reflectance: float
    divergence_mrad: float
    pulse_m: float
    noise_m: float
    limit_noise_m: float
    resolution_m: float
    min_range_m: float
    max_range_m: float


class ReturnModel:
    """Measures ranges to ground and rocks.

    Args:
        ground_albedo: (n, n) factors around the origin, `cell_m` apart.
        rock_albedo: (m,) factors.
    """

    def __init__(self, config: LidarConfig, ground_albedo: NDArray[np.float32], cell_m: float,
                 rock_albedo: NDArray[np.float32]) -> None:
        """Tabulate reflectances; compiles the loop over beams if no process has done so before."""
        self._noise = config.noise
        self._ranging = _Ranging(*(getattr(config.optics, name) for name in _Ranging._fields))
        self._ground_albedo, self._cell_m = read_only(ground_albedo, np.float32), cell_m
        self._rock_albedo = np.ascontiguousarray(rock_albedo, np.float32)
        kinds = config.reflectance
        self._tables = np.stack(
            [_table(hapke.parameter_set(kinds.ground), config.laser_albedo * kinds.albedo_scale),
             _table(hapke.parameter_set(kinds.rocks), config.laser_albedo)]).astype(np.float32)
        nothing = RayHits(np.full(1, np.inf), np.zeros(1, np.int32), np.zeros((1, 3)))
        self.measure(np.zeros((1, 3)), np.zeros((1, 3)), nothing, np.random.default_rng(0))

    def measure(self, origin_m: Array, direction: Array, hits: RayHits,
                rng: np.random.Generator) -> Returns:
        """Return what is measured of what (n, 3) beams meet; contiguous arrays in world frame."""
        count = len(direction)
        range_m, intensity = np.full((2, count), np.nan, np.float32)
        # Draws are of all, so that each beam keeps its own.
        noise = rng.standard_normal((2, count if self._noise else 0), np.float32)
        _measure(self._ranging, self._tables, self._ground_albedo, self._cell_m,
                 self._rock_albedo, ROVER, origin_m, direction, hits.distance_m, hits.target,
                 hits.normal, noise, range_m, intensity)
        return Returns(range_m, intensity)


@compiled
def _measure(of, tables, ground_albedo, cell_m, rock_albedo, rover, origin_m, direction,
             distance_m, target, normal, noise, range_m, intensity):
    """Fill in range_m and intensity of the beams that return, as `Returns` has them."""
    n, cells_per_m = len(ground_albedo), 1.0 / cell_m
    strength_m2 = of.reference_range_m ** 2 / of.reference_reflectance
    spread_per_m = 1e-3 * of.divergence_mrad / of.pulse_m
    strong2, weak2 = of.noise_m ** 2, of.limit_noise_m ** 2 - of.noise_m ** 2
    steps_per_m = 1.0 / of.resolution_m if of.resolution_m > 0.0 else 0.0
    noisy = noise.shape[1] > 0
    for i in range(len(distance_m)):
        distance = distance_m[i]
        if distance == np.inf:
            continue
        cosine = -(normal[i, 0] * direction[i, 0] + normal[i, 1] * direction[i, 1]
                   + normal[i, 2] * direction[i, 2])
        cosine = min(max(cosine, 0.0), 1.0)
        if target[i] == rover:
            factor = _OF_ROVER * cosine
        else:
            albedo = 1.0        # beyond the ground of the rover
            if target[i] >= 0:
                albedo = rock_albedo[target[i]]
            else:
                x = origin_m[i, 0] + distance * direction[i, 0]
                y = origin_m[i, 1] + distance * direction[i, 1]
                ix = int(math.floor(x * cells_per_m + 0.5 * n))
                iy = int(math.floor(y * cells_per_m + 0.5 * n))
                if 0 <= ix < n and 0 <= iy < n:
                    albedo = ground_albedo[iy, ix]
            row = min(int(albedo * (_ALBEDOS / _MOST_ALBEDO)), _ALBEDOS - 1)
            factor = tables[int(target[i] >= 0), row, int(cosine * _COSINES)]
        spread = distance * spread_per_m
        stretch = math.sqrt(1.0 + spread * spread * (1.0 / max(cosine, 1e-3) ** 2 - 1.0))
        signal = strength_m2 * factor / (stretch * max(distance, 1e-3) ** 2)
        if noisy:
            amplitude = _REFERENCE * signal + noise[0, i]
            if not amplitude > _THRESHOLD:
                continue
            factor *= amplitude / (_REFERENCE * signal)
            distance += math.sqrt(strong2 + weak2 / signal ** 2) * noise[1, i]
            if steps_per_m > 0.0:
                distance = math.floor(distance * steps_per_m + 0.5) * of.resolution_m
        if of.min_range_m <= distance <= of.max_range_m:
            range_m[i] = distance
            intensity[i] = min(max(100.0 * factor, 0.0), _MOST_INTENSITY)


def _table(parameters: hapke.HapkeParameters, scale: float) -> Array:
    """Return pi r at the phase angle 0 over albedo factors (rows) and cosines of incidence."""
    albedo = (np.arange(_ALBEDOS) + 0.5) * (_MOST_ALBEDO / _ALBEDOS)
    cosine = (np.arange(_COSINES + 1) + 0.5) / _COSINES
    cosine = np.minimum(cosine, 1.0)
    return np.pi * hapke.reflectance(cosine, cosine, 1.0, parameters,
                                     albedo=scale * albedo[:, None])
