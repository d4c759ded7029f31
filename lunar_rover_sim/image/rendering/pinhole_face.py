"""What is drawn for a pinhole camera: one image, with the margin that distortion needs."""

from __future__ import annotations

from typing import Any, Protocol

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import RenderError
from lunar_rover_sim.image.camera.development import LitImage
from lunar_rover_sim.image.camera.image_geometry import PinholeImage
from lunar_rover_sim.image.camera.lens import Lens
from lunar_rover_sim.image.camera.miscalibration import margin
from lunar_rover_sim.image.camera.rig import PinholeCamera
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.projection import Projection
from lunar_rover_sim.image.rendering.scene import Scene
from lunar_rover_sim.image.rendering.scene_passes import Drawn


class PinholeFace:
    """The one face of a pinhole: its image, with a margin where that is distorted.

    Attributes:
        lens: Of the camera.
        image: Geometry of what falls on the sensor, with the padding that distortion needs.
        turns: (3, 3) axes of each face in those of the camera.
        projections: What is drawn of each face.
        samples: Along a side of a pixel of a face.
    """

    def __init__(self, camera: PinholeCamera, config: RenderConfig) -> None:
        projection = padded_projection(camera, config)
        self._pad = margin(config.camera, config.miscalibration)
        self.lens = Lens(config.lens, config.camera)
        self.image = PinholeImage(projection.K, projection.width, projection.height)
        self.turns, self.projections = (np.eye(3),), (projection,)
        self.samples = config.detail.supersampling

    def gather(self, scenes: list[Scene], drawn: list[Drawn],
               lit: list[dict[int, LitImage]]) -> tuple[dict[int, LitImage],
                                                        dict[int, NDArray[np.float32]]]:
        """Return by side what falls on the sensor, and depth with its signs."""
        return lit[0], drawn[0].depth_m

    def truth(self, scenes: list[Scene], drawn: list[Drawn]) -> dict[str, NDArray[Any]]:
        """Return layers of truth but depth, as they were drawn, of the camera's own image."""
        request, (x, y) = scenes[0].request, self._pad
        h, w = self.projections[0].height, self.projections[0].width
        return {request.name(layer, side): pixels[y:h - y, x:w - x]
                for side, layers in drawn[0].truth.items() for layer, pixels in layers.items()}


def padded_projection(camera: PinholeCamera, config: RenderConfig) -> Projection:
    """Return the projection that is drawn for a camera.

    A distorted image takes light from outside the pinhole image: it is drawn with a margin.
    """
    pad = margin(config.camera, config.miscalibration)
    K = camera.K.copy()
    K[:2, 2] += pad
    return Projection(K, camera.width + 2 * pad[0], camera.height + 2 * pad[1],
                      config.camera.near_m, config.camera.far_m)


class Sized(Protocol):
    """What has the size of an image [px]."""

    @property
    def width(self) -> int:
        """Its columns."""

    @property
    def height(self) -> int:
        """Its rows."""


def check_size(context: moderngl.Context, image: Sized, samples: int = 1) -> None:
    """Raise RenderError if the device cannot draw a pair of images of this size.

    Args:
        samples: Along a side of a pixel.
    """
    width, height = image.width, image.height
    limit = context.info['GL_MAX_TEXTURE_SIZE'] // samples
    if max(width, 2 * height) > limit:
        finer = f' with detail.supersampling {samples}' if samples > 1 else ''
        raise RenderError(f'camera size {width} x {height}{finer}: this device draws at most '
                          f'{limit} x {limit // 2}')
