"""Exposure times: the first one from the light and the ground, the next ones from the images."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.image.camera.sensor import SensorModel
from lunar_rover_sim.image.illumination.config import LampConfig, ReflectanceConfig, SunConfig
from lunar_rover_sim.image.illumination.hapke import parameter_set, reflectance
from lunar_rover_sim.image.illumination.lamp import peak_intensity

F32 = NDArray[np.float32]


def first_exposure_s(sensor: SensorModel, sun: SunConfig, lamp: LampConfig,
                     ground: ReflectanceConfig) -> float:
    """Return the exposure time of the first image [s]."""
    if sensor.config.exposure_mode != 'sunlit':
        return sensor.config.exposure_s
    return sensor.exposure_for(max(sunlit_radiance(sun, ground), lamplit_radiance(lamp, ground)))


def sunlit_radiance(sun: SunConfig, ground: ReflectanceConfig) -> float:
    """Return a typical radiance of lit ground [W m-2 sr-1].

    It is that of a slope of 14 deg that faces the sun, seen from the side at 60 deg from its
    normal.
    """
    if not sun.shines:
        return 0.0
    elevation = math.radians(min(max(sun.elevation_deg, 0.5) + 14.0, 90.0))
    kind = parameter_set(ground.ground)
    return sun.irradiance * float(reflectance(math.sin(elevation), 0.5, 0.5 * math.sin(elevation),
                                              kind, albedo=ground.albedo_scale))


def lamplit_radiance(lamp: LampConfig, ground: ReflectanceConfig) -> float:
    """Return the radiance [W m-2 sr-1] of level ground 0.7 m in front of the lamp."""
    distance, height = 0.7, lamp.position_m[2] + 0.09
    cosine = height / math.hypot(distance, height)
    irradiance = peak_intensity(lamp) / (distance**2 + height**2)
    return irradiance * float(reflectance(cosine, cosine, 0.998, parameter_set(ground.ground),
                                          albedo=ground.albedo_scale))


_KEPT_PERCENT, _KEPT_LEVEL = 99.7, 0.93     # of lit ground; of full scale, below which it is kept
_STEP_DOWN = 0.6                            # of the exposure while it is not


class AutoExposure:
    """Follows the brightness of lit ground, with lag.

    The 92nd percentile of the pixels that are not black is brought to twice the target level, at
    most 0.8 of full scale, and the 99.7th one is kept below full scale. Only ground counts: no
    sky, rocks and rover, as if a camera's region of interest followed the scene.

    Attributes:
        exposure_s: Exposure time of the next frame [s].
        started: Whether `start` was called.
    """

    def __init__(self, sensor: SensorModel) -> None:
        self._sensor = sensor
        self.exposure_s = sensor.config.exposure_s
        self.started = False

    @property
    def aim(self) -> float:
        """Level that the bright end is brought to, as a share of full scale."""
        return min(2.0 * self._sensor.config.target_level, 0.8)

    def start(self, radiance: F32) -> None:
        """Set the first exposure from the (h, w) ideal image [W m-2 sr-1], 0 but for the ground.
        """
        self.started = True
        light = radiance[radiance > 0.0]
        if len(light):
            # The sun is a million times brighter than the ground, but not in many pixels.
            lit = light[light > 0.02 * float(np.percentile(light, 99))]
            bright, brightest = np.percentile(lit, (92, _KEPT_PERCENT))
            self.exposure_s = self._bounded(
                min(self.aim / bright, _KEPT_LEVEL / brightest)
                * self._sensor.config.full_well_e / self._sensor.electrons_per_radiance_second)

    def follow(self, image: NDArray[Any], depth_m: F32 | None = None) -> None:
        """Take in an (h, w) image of the sensor, taken with the present exposure.

        Args:
            image: Its pixels; of colour sensors the mosaic.
            depth_m: (h, w) above 0 where they show ground; None: all do.
        """
        c = self._sensor.config
        # Every third pixel meets all colours of a mosaic. Counts of levels give percentiles ten
        # times as fast as sorting.
        pixels = image[::3, ::3]
        pixels = pixels.ravel() if depth_m is None else pixels[depth_m[::3, ::3] > 0.0]
        counts = np.bincount(pixels, minlength=np.iinfo(image.dtype).max + 1)
        signal = self._sensor.linear(np.arange(len(counts)).astype(image.dtype))
        counts[signal <= 0.02] = 0
        lit = int(counts.sum())
        # In the dark the exposure grows.
        bright = _quantile(signal, counts, 0.92) if lit > 50 else 0.05
        factor = self.aim / max(bright, 0.02)
        if lit > 50:
            brightest = _quantile(signal, counts, 0.01 * _KEPT_PERCENT)
            # How far beyond full scale they are is not seen.
            factor = min(factor, _KEPT_LEVEL / brightest if brightest < 0.99 else _STEP_DOWN)
        wanted = self._bounded(self.exposure_s * factor)
        self.exposure_s = float(self.exposure_s**c.auto_lag * wanted**(1.0 - c.auto_lag))

    def _bounded(self, exposure_s: float) -> float:
        return float(np.clip(exposure_s, 1e-5, self._sensor.config.auto_max_s))


def _quantile(values: F32, counts: NDArray[np.int64], share: float) -> float:
    """Return a quantile of increasing values, each of which occurs `counts` times."""
    last = np.cumsum(counts)
    rank = share * (last[-1] - 1)
    below = np.searchsorted(last, np.floor(rank), side='right')
    above = np.searchsorted(last, np.ceil(rank), side='right')
    return float(values[below] + (rank - np.floor(rank)) * (values[above] - values[below]))
