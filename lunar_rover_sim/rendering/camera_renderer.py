"""One camera, or a pair of equal ones, of a renderer: from a state to its images and truth."""

from __future__ import annotations

import collections
import dataclasses
from typing import Any, Protocol

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera.development import Development, Light
from lunar_rover_sim.camera.distorted_image import padding
from lunar_rover_sim.camera.image_geometry import PinholeImage
from lunar_rover_sim.camera.lens import Lens
from lunar_rover_sim.camera.motion_blur import Movement
from lunar_rover_sim.camera.mount import Mount
from lunar_rover_sim.camera.rig import PinholeCamera
from lunar_rover_sim.camera.sensor import SensorModel
from lunar_rover_sim.errors import RenderError
from lunar_rover_sim.illumination.config import SunConfig
from lunar_rover_sim.rendering.config import RenderConfig
from lunar_rover_sim.rendering.frame import StereoFrame
from lunar_rover_sim.rendering.gl_owner import GlOwner
from lunar_rover_sim.rendering.projection import Projection
from lunar_rover_sim.rendering.scene import LEFT, Request, Scene
from lunar_rover_sim.rendering.scene_passes import Drawn, ScenePasses
from lunar_rover_sim.rendering.world_passes import WorldPasses
from lunar_rover_sim.rover.pose import RoverPose


class CameraRenderer(GlOwner):
    """Draws what the cameras on one mount see. The caller makes the GL context current."""

    def __init__(self, context: moderngl.Context, shared: WorldPasses, mount: Mount,
                 camera: PinholeCamera, config: RenderConfig, seen: tuple[int, ...],
                 seed: int) -> None:
        """Prepare all that does not depend on the state.

        config: of these cameras; seen: links of the rover that may show, as `seen_links`
        Raises RenderError if the device cannot draw this image size.
        """
        super().__init__()
        self._context, self._config = context, config
        self._pad, self._K = padding(config.camera), camera.K
        self._projection = padded_projection(camera, config)
        check_size(context, self._projection, config.detail.supersampling)
        self._begun: collections.deque[Scene] = collections.deque()
        with self._making():
            self._build(shared, mount, camera, seen, seed)

    def _build(self, shared: WorldPasses, mount: Mount, camera: PinholeCamera,
               seen: tuple[int, ...], seed: int) -> None:
        config, drawn = self._config, self._projection
        lens, self._image = Lens(config.lens, config.camera), PinholeImage(
            drawn.K, drawn.width, drawn.height)
        self._mount, self._rover = mount, shared.rover
        # Links that move in the images.
        self._links = [link for link in seen if link > 0 or not mount.on_body]
        self._passes = self._own(ScenePasses(
            self._context, shared, mount, config, drawn, sees_rover=bool(seen),
            strays=lens.strays, samples=config.detail.supersampling))
        self._development = Development(camera, self._image, lens, config.sensor,
                                        light_of(config), seed, on_body=mount.on_body)

    @property
    def sensor(self) -> SensorModel:
        """Image sensors."""
        return self._development.sensor

    @property
    def exposure_s(self) -> float:
        """Exposure time of the last frame, or of the first one before it [s]."""
        return self._development.exposure_s

    @property
    def under_way(self) -> int:
        """Number of frames that are begun and not finished; the first of them is lit."""
        return len(self._begun)

    def relight(self, sun: SunConfig) -> None:
        """Move the sun; the light of the world is moved by `WorldPasses.relight`."""
        self._config = dataclasses.replace(self._config, sun=sun)
        self._passes.relight(self._config)
        self._development.meter(light_of(self._config))

    def draw(self, state: RoverPose, request: Request) -> StereoFrame:
        """Return a frame; none may be under way."""
        self.begin(state, request)
        return self.finish()

    def begin(self, state: RoverPose, request: Request) -> None:
        """Begin to draw a frame; at most `FRAMES_UNDER_WAY` may be under way."""
        scene = self._passes.draw_geometry(request, state)
        if not self._begun:
            self._passes.light(scene)
        self._begun.append(scene)

    def finish(self) -> StereoFrame:
        """Return the frame that was begun first; one must be under way."""
        scene = self._begun.popleft()
        request = scene.request
        movements = {side: scene.movement(side, self._mount, self._rover, self._image,
                                          self._links) for side in request.lit_sides}
        drawn = self._passes.read(scene, links=request.developed and any(
            self._development.blurs(movement) for movement in movements.values()))
        truth = self._read_truth(scene)
        if self._begun:     # it is lit into the targets that have just been read
            self._passes.light(self._begun[0])
        return self._compose(scene, drawn, truth, movements)

    def abandon(self) -> None:
        """Forget the frames under way."""
        self._begun.clear()

    def _read_truth(self, scene: Scene) -> dict[str, NDArray[Any]]:
        """Return the layers of truth but depth, as they were drawn."""
        request, truth = scene.request, dict[str, NDArray[Any]]()
        size = self._projection.height, self._projection.width
        for side in request.sides:
            wanted = request.truth_of(side)
            if wanted:
                drawn = scene.pixels.targets.truth.read(wanted, side, size, self._pad)
                truth |= {request.name(layer, side): pixels for layer, pixels in drawn.items()}
        return truth

    def _compose(self, scene: Scene, drawn: Drawn, truth: dict[str, NDArray[Any]],
                 movements: dict[int, Movement]) -> StereoFrame:
        """Return the frame, and let automatic exposure follow it."""
        request, out, develop = scene.request, dict[str, NDArray[Any]](), self._development
        lit = self._passes.finish(scene, drawn)
        if 'radiance' in request.layers:
            out['radiance'] = develop.inside(lit[LEFT].radiance).copy()
        if request.developed:
            out |= request.images(develop.take(lit, movements, scene.sun, request.frame_index))
        for side in request.sides:
            if request.depth_of(side):
                name = request.name('depth', side)
                depth_m = true_depth(develop.inside(drawn.depth_m[side]))
                if name in request.layers:
                    out[f'{name}_m'] = depth_m
                if side == LEFT and request.flow:
                    out |= self._passes.flow(scene, self._K, depth_m, truth['label'])
        for name in request.layers.intersection(truth):
            numbers = truth[name].dtype == np.uint16    # labels and craters
            out[name] = (truth[name].astype(np.int32) if numbers
                         else np.ascontiguousarray(truth[name]))
        return StereoFrame(**out, exposure_s=self.exposure_s)

    def release(self) -> None:
        """Release the GL objects."""
        self._begun.clear()
        super().release()


def light_of(config: RenderConfig) -> Light:
    """Return what the first exposure follows from."""
    return Light(config.sun, config.lamp, config.reflectance)


def true_depth(drawn_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return depth that was drawn, as the layer has it: positive, infinite in the sky."""
    depth_m = np.abs(drawn_m)
    depth_m[depth_m == 0.0] = np.inf
    return depth_m


def padded_projection(camera: PinholeCamera, config: RenderConfig) -> Projection:
    """Return the projection that is drawn for a camera.

    A distorted image takes light from outside the pinhole image: it is drawn with a margin.
    """
    pad = padding(config.camera)
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

    samples: along a side of a pixel
    """
    width, height = image.width, image.height
    limit = context.info['GL_MAX_TEXTURE_SIZE'] // samples
    if max(width, 2 * height) > limit:
        finer = f' with detail.supersampling {samples}' if samples > 1 else ''
        raise RenderError(f'camera size {width} x {height}{finer}: this device draws at most '
                          f'{limit} x {limit // 2}')
