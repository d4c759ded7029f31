"""Exposure, motion blur, lens and sensor: from radiance and depth of images to pixels."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.workers import Workers
from lunar_rover_sim.image.camera.config import SensorConfig
from lunar_rover_sim.image.camera.fisheye import FisheyeCamera
from lunar_rover_sim.image.camera.image_geometry import ImageGeometry
from lunar_rover_sim.image.camera.lens import Lens
from lunar_rover_sim.image.camera.miscalibration import Miscalibration
from lunar_rover_sim.image.camera.mosaic import interpolated
from lunar_rover_sim.image.camera.motion_blur import MotionBlur, Movement
from lunar_rover_sim.image.camera.rig import PinholeCamera
from lunar_rover_sim.image.camera.sensor import ImageSensor, SensorModel, Tint
from lunar_rover_sim.image.camera.stray_light import ImagedSun, StrayLight
from lunar_rover_sim.image.illumination.config import LampConfig, ReflectanceConfig, SunConfig
from lunar_rover_sim.image.illumination.hapke import parameter_set, reflectance

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
    irradiance = lamp.peak_intensity / (distance**2 + height**2)
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


@dataclasses.dataclass(frozen=True)
class LitImage:
    """What falls on a camera at the stamp of a frame, padding included.

    Attributes:
        radiance: (h, w) ideal image [W m-2 sr-1].
        depth_m: (h, w) along the optical axis, of a fisheye the distance; 0 is the sky, and rocks
            and the rover are negative.
        link: (h, w) 0, or 1 + the index of the link of the rover that a pixel shows; None where
            no link is seen.
        tint: (h, w) its colour, as `sensor.Tint`; None for sensors without colour.
    """

    radiance: F32
    depth_m: F32
    link: NDArray[np.uint8] | None = None
    tint: NDArray[np.uint32] | None = None


@dataclasses.dataclass(frozen=True)
class Light:
    """What the first exposure follows from."""

    sun: SunConfig
    lamp: LampConfig
    ground: ReflectanceConfig


class Development:
    """Exposure, motion, lens and sensor of a camera, or of a pair of equal ones.

    Attributes:
        sensor: Constants of their image sensors.
        exposure_s: Exposure time of the last frame, or of the first one before it [s].
    """

    def __init__(self, camera: PinholeCamera | FisheyeCamera, image: ImageGeometry, lens: Lens,
                 config: SensorConfig, light: Light, seed: int,
                 wrong: Miscalibration = Miscalibration(), *, on_body: bool,
                 workers: Workers) -> None:
        """Prepare all that does not depend on the image.

        Args:
            camera: Geometry of the images of the sensor.
            image: Geometry of what falls on it, with the padding that distortion needs.
            lens: The lens of either camera.
            config: The image sensors.
            light: Of the first exposure.
            seed: Of all noise.
            wrong: With the right camera of a pair.
            on_body: Whether the cameras move with the body of the rover.
            workers: Threads for rows of images.
        """
        self.sensor = SensorModel(lens.camera, config, lens.config)
        self._auto = AutoExposure(self.sensor) if config.exposure_mode == 'auto' else None
        self._padding = (image.width - camera.width) // 2, (image.height - camera.height) // 2
        self._blur = MotionBlur(lens.camera, config, image, workers, on_body=on_body)
        # Only the sun itself is brighter than a white surface under the sun.
        self._lens = StrayLight(lens, image, light.sun.irradiance or math.inf, workers)
        self._chip = ImageSensor(camera, self.sensor, seed, self._padding, wrong, workers)
        self.exposure_s = 0.0
        self.meter(light)

    def meter(self, light: Light) -> None:
        """Set the exposure of the first frame under this light, unless it follows the images."""
        if self._auto is None or self.exposure_s == 0.0:
            self.exposure_s = first_exposure_s(self.sensor, light.sun, light.lamp, light.ground)

    def expose(self, config: SensorConfig, light: Light) -> None:
        """Take other parameters of the exposure, from the next image on.

        Args:
            config: The image sensors; all but their exposure must be as before.
            light: Of the first exposure.
        """
        self.sensor = SensorModel(self.sensor.camera, config)
        self._auto = AutoExposure(self.sensor) if config.exposure_mode == 'auto' else None
        self.meter(light)

    @property
    def exposure(self) -> tuple[float, float, bool]:
        """The exposure times of the last frame and the next [s], and whether one was exposed."""
        auto = self._auto
        return (self.exposure_s, self.exposure_s, True) if auto is None else (
            self.exposure_s, auto.exposure_s, auto.started)

    @exposure.setter
    def exposure(self, exposure: tuple[float, float, bool]) -> None:
        self.exposure_s = exposure[0]
        if self._auto is not None:
            _, self._auto.exposure_s, self._auto.started = exposure

    def inside(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return the part of a padded image that the camera shows."""
        x, y = self._padding
        return image[y:len(image) - y, x:image.shape[1] - x]

    def blurs(self, movement: Movement) -> bool:
        """Return whether motion is seen in the next image."""
        started = self._auto is None or self._auto.started
        return self._blur.is_seen(movement, self._next_exposure_s() if started else math.inf)

    def _next_exposure_s(self) -> float:
        return self.exposure_s if self._auto is None else self._auto.exposure_s

    def take(self, lit: Mapping[int, LitImage], movements: Mapping[int, Movement],
             sun: ImagedSun | None, frame_index: int) -> dict[int, NDArray[Any]]:
        """Return the (h, w) pixels, or (h, w, 3) of rgb8, of both sides or one of a frame.

        The colour of a pixel is that at the stamp; its light is gathered along its path.
        Automatic exposure follows the first of them.

        Args:
            lit: What falls on the cameras, by side: 0 left, 1 right.
            movements: Of the cameras, by side.
            sun: What the cameras see of the sun, None if it cannot reach their lenses.
            frame_index: Gives each frame its own noise.
        """
        first = min(lit)
        if self._auto is not None and not self._auto.started:
            self._auto.start(self.inside(np.where(
                lit[first].depth_m > 0.0, lit[first].radiance, np.float32(0.0))))
        self.exposure_s = self._next_exposure_s()
        result = {}
        for side, image in lit.items():
            mean = self._blur.mean(image.radiance, image.depth_m, movements[side],
                                   self.exposure_s, image.link)
            passed = self._lens.passed_on(mean, image.depth_m, sun, side)
            tint = None if image.tint is None else Tint(image.tint, mean)
            result[side] = self._chip.pixels(passed, side, self.exposure_s, frame_index, tint)
        if self._auto is not None:
            self._auto.follow(result[first], self.inside(lit[first].depth_m))
        if self.sensor.config.encoding == 'rgb8':
            return {side: interpolated(pixels) for side, pixels in result.items()}
        return result
