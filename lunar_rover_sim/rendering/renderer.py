"""The renderer: world, sun and rover to stereo images and the truth beside them."""

from __future__ import annotations

import collections
from collections.abc import Collection, Iterator
import contextlib
import dataclasses
import math
from types import TracebackType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera.distorted_image import padding
from lunar_rover_sim.camera.exposure import AutoExposure, first_exposure_s
from lunar_rover_sim.camera.lens import Lens
from lunar_rover_sim.camera.rig import StereoRig
from lunar_rover_sim.camera.sensor import SensorModel
from lunar_rover_sim.errors import LunarRoverSimError, RenderError
from lunar_rover_sim.frames import sun_direction
from lunar_rover_sim.regolith.overlay import Overlay
from lunar_rover_sim.rendering.checked_state import checked_state
from lunar_rover_sim.rendering.config import RenderConfig
from lunar_rover_sim.rendering.context import create_context
from lunar_rover_sim.rendering.frame import StereoFrame
from lunar_rover_sim.rendering.frame_targets import read_image
from lunar_rover_sim.rendering.motion_pass import MotionPass
from lunar_rover_sim.rendering.optics_pass import OpticsPass
from lunar_rover_sim.rendering.projection import Projection
from lunar_rover_sim.rendering.scene import LEFT, Request, Scene
from lunar_rover_sim.rendering.scene_passes import FRAMES_UNDER_WAY, ScenePasses
from lunar_rover_sim.rendering.sensor_pass import SensorPass
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import Posed
from lunar_rover_sim.world.model import World


class Seeded(Protocol):
    """What all nodes of a scenario share."""

    @property
    def seed(self) -> int:
        """Seed of everything random."""


class RenderedScenario(Protocol):
    """What `Renderer.from_scenario` needs of a scenario."""

    @property
    def shared(self) -> Seeded:
        """Parameters of all nodes."""

    @property
    def rover(self) -> RoverDescription:
        """The rover."""

    @property
    def render_node(self) -> RenderConfig:
        """Camera, light and detail."""

    def load_world(self) -> World:
        """Return the world, built if need be."""


class Renderer:
    """Draws what the rover's cameras see. It owns the GL context: use it as a context manager.

    rig: the cameras; sensor: their image sensors; config, seed: as given
    sun_direction: (3,) unit vector to the sun, world frame
    exposure_s: exposure time of the last frame, or of the first one before it [s]
    follows: whether tracks are drawn

    Raises RenderError if there is no usable EGL device or if it cannot draw this image size.
    """

    def __init__(self, world: World, rover: RoverDescription, config: RenderConfig,
                 seed: int = 0) -> None:
        """Prepare all that does not depend on the state; seed: of noise and relief."""
        self.world, self.config, self.seed = world, config, seed
        self.rig = StereoRig(rover, config.camera)
        self.sensor = SensorModel(config.camera, config.sensor)
        self.sun_direction = sun_direction(config.sun.azimuth_deg, config.sun.elevation_deg)
        self.exposure_s = first_exposure_s(self.sensor, config.sun, config.lamp,
                                           config.reflectance)
        self._auto = (AutoExposure(self.sensor) if config.sensor.exposure_mode == 'auto'
                      else None)
        # A distorted image takes light from outside the pinhole image: draw with a margin.
        self._pad = padding(config.camera)
        K = self.rig.K.copy()
        K[:2, 2] += self._pad
        self._projection = Projection(K, self.rig.width + 2 * self._pad[0],
                                      self.rig.height + 2 * self._pad[1], config.camera.near_m,
                                      config.camera.far_m)
        self._begun: collections.deque[Scene] = collections.deque()
        self._context = create_context()
        self._owned = contextlib.ExitStack()
        self._closed = self.follows = False
        try:
            with self._context:
                self._build(rover)
        except Exception:
            self.close()
            raise

    @classmethod
    def from_scenario(cls, scenario: RenderedScenario, world: World | None = None) -> Renderer:
        """Return the renderer of a scenario; world: loaded from the scenario if it is None."""
        return cls(scenario.load_world() if world is None else world, scenario.rover,
                   scenario.render_node, scenario.shared.seed)

    def _build(self, rover: RoverDescription) -> None:
        context = self._context
        width, height = self._projection.width, self._projection.height
        limit = context.info['GL_MAX_TEXTURE_SIZE']
        if max(width, 2 * height) > limit:
            raise RenderError(f'camera size {width} x {height}: this device draws at most '
                              f'{limit} x {limit // 2}')
        self._passes = ScenePasses(context, self.world, rover, self.config, self._projection,
                                   self.seed)
        self._owned.callback(self._passes.release)
        self._motion = MotionPass(context, rover, self.config, self._projection,
                                  self._passes.seen)
        self._owned.callback(self._motion.release)
        # No ground and no lamp is brighter than a white surface under the sun, but the sun is.
        most = self.config.sun.irradiance or math.inf
        self._optics = OpticsPass(context, Lens(self.config.lens, self.config.camera),
                                  self._projection, most)
        self._owned.callback(self._optics.release)
        self._sensor_pass = SensorPass(context, self.rig, self.sensor, self.seed, self._pad)
        self._owned.callback(self._sensor_pass.release)

    def set_sun(self, azimuth_deg: float, elevation_deg: float) -> None:
        """Move the sun; all that does not depend on it is kept.

        Raises RenderError between `begin` and `finish`.
        """
        self._check_idle('set_sun')
        sun = dataclasses.replace(self.config.sun, azimuth_deg=azimuth_deg,
                                  elevation_deg=elevation_deg)
        self.config = dataclasses.replace(self.config, sun=sun)
        self.sun_direction = sun_direction(azimuth_deg, elevation_deg)
        with self._drawing():
            self._passes.relight(self.config)
        if self._auto is None:
            self.exposure_s = first_exposure_s(self.sensor, self.config.sun, self.config.lamp,
                                               self.config.reflectance)

    def follow(self, overlay: Overlay | None) -> None:
        """Draw the tracks in an overlay, such as `Simulation.overlay`, from now on.

        `begin` draws the ground as the overlay is then. None, rigid ground, changes nothing.
        Raises RenderError between `begin` and `finish`, or if tracks are followed already.
        """
        self._check_idle('follow')
        if overlay is None:
            return
        if self.follows:
            raise RenderError('follow: the renderer follows an overlay already; make another one')
        self.follows = True
        with self._drawing():
            self._passes.follow(overlay)

    @property
    def device(self) -> str:
        """Name of the device that draws."""
        return str(self._context.info['GL_RENDERER'])

    # Frames

    def render(self, state: Posed, frame_index: int = 0,
               layers: Collection[str] = ('left', 'right', 'depth')) -> StereoFrame:
        """Draw a frame: `begin` and `finish` in one call."""
        self._check_idle('render')
        self.begin(state, frame_index, layers)
        return self.finish()

    def begin(self, state: Posed, frame_index: int = 0,
              layers: Collection[str] = ('left', 'right', 'depth')) -> None:
        """Begin to draw a frame; `finish` returns it. Two frames may be under way at a time.

        The device draws in the background. Beginning the next frame before the present one is
        finished keeps it busy while images are read; it does not change them.

        state: pose and motion: a `physics.state.RoverState` or a `rover.pose.RoverPose`
        frame_index: gives each frame its own noise
        layers: names from `frame.LAYERS`

        The same arguments give the same pixels; automatic exposure also depends on the frames
        before. Raises RenderError if the state or a layer is not valid, if two frames are under
        way, if the renderer is closed, or if the context is lost.
        """
        request = Request.of(layers, frame_index)
        checked = checked_state(state)
        if self._closed:
            raise RenderError('the renderer is closed')
        if len(self._begun) == FRAMES_UNDER_WAY:
            raise RenderError(f'begin: {FRAMES_UNDER_WAY} frames are under way; finish one first')
        with self._drawing():
            scene = self._passes.draw_geometry(request, checked)
            if not self._begun:
                self._passes.light(scene)
        self._begun.append(scene)

    def finish(self) -> StereoFrame:
        """Return the frame that was begun first.

        Raises RenderError if none is under way, or if the context is lost.
        """
        if not self._begun:
            raise RenderError('finish: no frame is under way; begin one first')
        with self._drawing():
            scene = self._begun.popleft()
            raw = self._read(scene)
            if self._begun:     # it is lit into the targets that have just been read
                self._passes.light(self._begun[0])
        return self._compose(raw, scene.request)

    def _check_idle(self, name: str) -> None:
        if self._begun:
            raise RenderError(f'{name}: a frame is under way; finish it first')

    @contextlib.contextmanager
    def _drawing(self) -> Iterator[None]:
        """Make the context current; errors of moderngl and the driver become RenderErrors."""
        try:
            with self._context:     # another renderer may have made its own current
                yield
        except Exception as error:
            self._begun.clear()
            if isinstance(error, LunarRoverSimError):
                raise
            raise RenderError(f'drawing failed, the GL context may be lost: {error}') from error

    def _read(self, scene: Scene) -> dict[str, NDArray[Any]]:
        """Read what was drawn; 'pixels' are those of both sensors."""
        request, raw = scene.request, {}
        size = self._projection.height, self._projection.width
        lit = self._passes.lit
        for index, name in enumerate(('radiance', 'depth')):
            if name in request.layers:
                raw[name] = read_image(lit.framebuffer, index, LEFT, size, self._pad)
        if request.developed:
            if self._auto is not None:
                if not self._auto.started:
                    self._auto.start(read_image(lit.framebuffer, 0, request.sides[0], size,
                                                self._pad))
                self.exposure_s = self._auto.exposure_s
            radiance, smear = self._motion.draw(self._passes, scene, self.exposure_s)
            self._optics.draw(radiance, request.sides, scene.sun)
            raw['pixels'] = self._sensor_pass.draw(radiance, request.sides, self.exposure_s,
                                                   request.frame_index, smear)
        if request.truth:
            raw['truth'] = read_image(scene.targets.truth.framebuffer, 0, LEFT, size, self._pad, 4)
        return raw

    def _compose(self, raw: dict[str, NDArray[Any]], request: Request) -> StereoFrame:
        """Return the frame, and let automatic exposure follow it."""
        out: dict[str, NDArray[Any]] = {}
        exposure_s = self.exposure_s
        if request.developed:
            for side, name in enumerate(('left', 'right')):
                if name in request.layers:
                    image = raw['pixels'][side]
                    if self.config.sensor.encoding == 'rgb8':
                        image = np.repeat(image[..., None], 3, axis=2)
                    out[name] = image
            if self._auto is not None:
                self._auto.follow(raw['pixels'][request.sides[0]])
        if 'depth' in request.layers:
            out['depth_m'] = np.where(raw['depth'] == 0.0, np.float32(np.inf), raw['depth'])
        if 'radiance' in request.layers:
            out['radiance'] = np.ascontiguousarray(raw['radiance'])
        if 'normal' in request.layers:
            out['normal'] = np.ascontiguousarray(raw['truth'][..., :3])
        if 'label' in request.layers:
            out['label'] = np.rint(raw['truth'][..., 3]).astype(np.int32)
        return StereoFrame(**out, exposure_s=exposure_s)

    # Resources

    def close(self) -> None:
        """Release all GL objects and the context."""
        if not self._closed:
            self._closed = True
            self._begun.clear()
            with self._context:
                self._owned.close()
            self._context.release()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 _: TracebackType | None) -> None:
        self.close()
