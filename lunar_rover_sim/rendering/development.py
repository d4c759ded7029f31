"""Exposure, motion blur, lens and sensor: from radiance images to pixels."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera.exposure import AutoExposure, first_exposure_s
from lunar_rover_sim.camera.lens import Lens
from lunar_rover_sim.camera.sensor import SensorModel
from lunar_rover_sim.illumination.config import SunConfig
from lunar_rover_sim.rendering.config import RenderConfig
from lunar_rover_sim.rendering.gl_owner import GlOwner
from lunar_rover_sim.rendering.image_geometry import ImageGeometry
from lunar_rover_sim.rendering.motion_pass import LitPasses, MotionPass
from lunar_rover_sim.rendering.optics_pass import OpticsPass
from lunar_rover_sim.rendering.scene import Request, Scene
from lunar_rover_sim.rendering.sensor_pass import DevelopedCamera, SensorPass


class Development(GlOwner):
    """Exposure, motion, lens and sensor of the cameras on one mount, a pinhole or a fisheye.

    sensor: their image sensors
    exposure_s: exposure time of the last frame, or of the first one before it [s]
    """

    def __init__(self, context: moderngl.Context, config: RenderConfig, camera: DevelopedCamera,
                 image: ImageGeometry, motion: MotionPass, lens: Lens, seed: int,
                 padding: tuple[int, int] = (0, 0)) -> None:
        """Compile the programs of lens and sensor.

        image: that is drawn; padding: columns and rows that it has beyond those of the camera
        motion: of the cameras; its owner is the caller
        """
        super().__init__()
        self._config, self._motion = config, motion
        self.sensor = SensorModel(config.camera, config.sensor)
        self._auto = (AutoExposure(self.sensor) if config.sensor.exposure_mode == 'auto'
                      else None)
        self.exposure_s = first_exposure_s(self.sensor, config.sun, config.lamp,
                                           config.reflectance)
        with self._making():
            # Only the sun itself is brighter than a white surface under the sun.
            most = config.sun.irradiance or math.inf
            self._optics = self._own(OpticsPass(context, lens, image, most))
            self._sensor_pass = self._own(SensorPass(context, camera, self.sensor, seed, padding))

    def relight(self, sun: SunConfig) -> None:
        """Move the sun."""
        if self._auto is None:
            self.exposure_s = first_exposure_s(self.sensor, sun, self._config.lamp,
                                               self._config.reflectance)

    def take(self, passes: LitPasses, scene: Scene,
             read: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """Return the (2, h, w) pixels of a scene that has just been lit; valid on its lit sides.

        read: returns the radiance of the first lit side, for the first exposure
        """
        request = scene.request
        if self._auto is not None:
            if not self._auto.started:
                self._auto.start(read())
            self.exposure_s = self._auto.exposure_s
        radiance, smear = self._motion.draw(passes, scene, self.exposure_s)
        self._optics.draw(radiance, passes.lit.depth, request.lit_sides, scene.sun)
        return self._sensor_pass.draw(radiance, request.lit_sides, self.exposure_s,
                                      request.frame_index, smear)

    def images(self, pixels: NDArray[Any], request: Request) -> dict[str, NDArray[Any]]:
        """Return the images that are asked for, by layer; automatic exposure follows them."""
        result = {}
        for side, name in enumerate(('left', 'right')):
            if name in request.layers:
                image = pixels[side]
                if self._config.sensor.encoding == 'rgb8':
                    image = np.repeat(image[..., None], 3, axis=2)
                result[name] = image
        if self._auto is not None:
            self._auto.follow(pixels[request.lit_sides[0]])
        return result
