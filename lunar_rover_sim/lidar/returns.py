"""What comes back: signal, detection, noise of ranges, intensity.

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
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.illumination import hapke
from lunar_rover_sim.lidar.config import LidarConfig

_THRESHOLD = 6.0            # of the noise: a false alarm in a billion; a choice
_REFERENCE = _THRESHOLD + NormalDist().inv_cdf(0.9)
_COSINES, _ALBEDOS = 1024, 128
_MOST_ALBEDO = 4.0
_MOST_INTENSITY = 255.0
_OF_ROVER = 0.4             # foil, cells, aluminium: a choice


@dataclasses.dataclass(frozen=True)
class Returns:
    """What is measured of n beams.

    range_m: (n,) float32, NaN where nothing returns; intensity: (n,) float32, the reflectance of a
    diffuse surface at right angles that would return as much [%], at most 255
    """

    range_m: NDArray[np.float32]
    intensity: NDArray[np.float32]


class ReturnModel:
    """Measures ranges to ground and rocks."""

    def __init__(self, config: LidarConfig) -> None:
        self._optics, self._noise = config.optics, config.noise
        kinds = config.reflectance
        self._tables = np.concatenate(
            [_table(hapke.parameter_set(kinds.ground), config.laser_albedo * kinds.albedo_scale),
             _table(hapke.parameter_set(kinds.rocks), config.laser_albedo)]).astype(np.float32)

    def reflectance_factor(self, cos_incidence: Array, albedo: NDArray[np.floating],
                           is_rock: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Return pi r of surfaces that are seen where they are lit from; albedo: factors."""
        row = np.minimum((albedo * (_ALBEDOS / _MOST_ALBEDO)).astype(np.int32), _ALBEDOS - 1)
        column = (np.clip(cos_incidence, 0.0, 1.0) * _COSINES).astype(np.int32)
        place = (row + _ALBEDOS * is_rock) * (_COSINES + 1) + column
        return self._tables.ravel().take(place)

    def measure(self, distance_m: Array, cos_incidence: Array, albedo: NDArray[np.floating],
                is_rock: NDArray[np.bool_], rng: np.random.Generator,
                diffuse: NDArray[np.bool_] | None = None) -> Returns:
        """Return what is measured of (n,) targets; distance_m: inf where there is none.

        diffuse: targets that are no regolith, but of the reflectance _OF_ROVER, as Lambert has it
        """
        optics, count = self._optics, len(distance_m)
        # Half of all beams meet nothing. Draws are of all, so that each beam keeps its own.
        met = np.flatnonzero(np.isfinite(distance_m))
        distance: NDArray[np.floating] = distance_m[met].astype(np.float32)
        cos_incidence = cos_incidence[met]
        factor = self.reflectance_factor(cos_incidence, albedo[met], is_rock[met])
        if diffuse is not None:
            factor = np.where(diffuse[met], _OF_ROVER * np.clip(cos_incidence, 0.0, 1.0),
                              factor).astype(np.float32)
        signal = factor * (np.float32(optics.reference_range_m) / np.maximum(distance, 1e-3)) ** 2
        spread = distance * np.float32(1e-3 * optics.divergence_mrad / optics.pulse_m)
        cosine2 = np.clip(cos_incidence, 1e-3, 1.0).astype(np.float32) ** 2
        stretch2 = np.float32(1.0) + spread * spread * (np.float32(1.0) / cosine2 - 1)
        signal /= np.float32(optics.reference_reflectance) * np.sqrt(stretch2)
        seen = np.ones(len(met), np.bool_)
        if self._noise:
            amplitude = _REFERENCE * signal + rng.standard_normal(count, np.float32)[met]
            seen = amplitude > _THRESHOLD
            weak2 = np.float32(optics.limit_noise_m ** 2 - optics.noise_m ** 2)
            deviation = np.sqrt(np.float32(optics.noise_m ** 2)
                                + weak2 / np.maximum(signal, 1e-3) ** 2)
            distance = distance + deviation * rng.standard_normal(count, np.float32)[met]
            factor = factor * amplitude / np.maximum(_REFERENCE * signal, 1e-6)
            if optics.resolution_m > 0.0:
                step = np.float32(optics.resolution_m)
                distance = np.rint(distance / step) * step
        seen &= (distance >= optics.min_range_m) & (distance <= optics.max_range_m)
        range_m, intensity = np.full((2, count), np.nan, np.float32)
        range_m[met[seen]] = distance[seen]
        intensity[met[seen]] = np.clip(100.0 * factor[seen], 0.0, _MOST_INTENSITY)
        return Returns(range_m, intensity)


def _table(parameters: hapke.HapkeParameters, scale: float) -> Array:
    """Return pi r at the phase angle 0 over albedo factors (rows) and cosines of incidence."""
    albedo = (np.arange(_ALBEDOS) + 0.5) * (_MOST_ALBEDO / _ALBEDOS)
    cosine = (np.arange(_COSINES + 1) + 0.5) / _COSINES
    cosine = np.minimum(cosine, 1.0)
    return np.pi * hapke.reflectance(cosine, cosine, 1.0, parameters,
                                     albedo=scale * albedo[:, None])
