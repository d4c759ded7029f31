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
from lunar_rover_sim.image.camera.exposure import AutoExposure, first_exposure_s
from lunar_rover_sim.image.camera.image_geometry import ImageGeometry
from lunar_rover_sim.image.camera.lens import Lens
from lunar_rover_sim.image.camera.miscalibration import Miscalibration
from lunar_rover_sim.image.camera.mosaic import interpolated
from lunar_rover_sim.image.camera.motion_blur import MotionBlur, Movement
from lunar_rover_sim.image.camera.sensor import DevelopedCamera, ImageSensor, SensorModel, Tint
from lunar_rover_sim.image.camera.stray_light import ImagedSun, StrayLight
from lunar_rover_sim.image.illumination.config import LampConfig, ReflectanceConfig, SunConfig

F32 = NDArray[np.float32]


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

    def __init__(self, camera: DevelopedCamera, image: ImageGeometry, lens: Lens,
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
