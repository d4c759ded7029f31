"""The renderer: world, sun and rover to stereo images and the truth beside them."""

from __future__ import annotations

import collections
from collections.abc import Collection, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
import contextlib
import dataclasses
from types import TracebackType

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import RenderError
from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.base.process import return_freed
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.world.follower import Follower
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.image.camera.config import (FurtherCameraConfig, MiscalibrationConfig,
                                                 SensorConfig)
from lunar_rover_sim.image.camera.fisheye import FisheyeCamera, geometry_of
from lunar_rover_sim.image.camera.mount import BodyMount, Mount, MountElsewhere
from lunar_rover_sim.image.camera.rig import PinholeCamera, StereoRig
from lunar_rover_sim.image.camera.sensor import SensorModel
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.rendering.camera_renderer import CameraRenderer
from lunar_rover_sim.image.rendering.canvas import FRAMES_UNDER_WAY
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.context import create_context
from lunar_rover_sim.image.rendering.drawn_window import DrawnWindow, WorldLight
from lunar_rover_sim.image.rendering.faces import check_size, padded_projection
from lunar_rover_sim.image.rendering.frame import StereoFrame
from lunar_rover_sim.image.rendering.labels import Numbers
from lunar_rover_sim.image.rendering.scene import checked_state, Request
from lunar_rover_sim.image.rendering.world_passes import WorldPasses
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import moved, Posed, RoverPose


class Renderer:
    """Draws what the rover's cameras see. It owns the GL context: use it as a context manager.

    Poses are in the frame of the world that it is given, a window of a site: that of the site.
    What depends on the place in the site looks the same from all windows.

    Args:
        config: Parameters of the drawing.
        seed: Of the noise of the sensors.
        follower: Draws each state in the window of the site that it gives; without one the window
            changes by `enter` alone.

    Attributes:
        world: The window that is drawn.
        rig: The cameras.
        sensor: Their image sensors.
        sun_direction: (3,) unit vector to the sun, world frame.
        exposure_s: Exposure time of the last frame, or of the first one before it [s].
        follows: Whether tracks are drawn.

    Raises:
        RenderError: If there is no usable EGL device or if it cannot draw this image size.
    """

    def __init__(self, world: World, rover: RoverDescription, config: RenderConfig,
                 seed: int = 0, follower: Follower | None = None) -> None:
        """Prepare all that does not depend on the state; seed: of noise and relief."""
        self.world, self.config, self.seed = world, config, seed
        self._legs = len(rover.legs.each)
        self.rig = StereoRig(rover, config.camera)
        self.sun_direction = sun_direction(config.sun.azimuth_deg, config.sun.elevation_deg)
        self._follower = follower
        self._further: list[FurtherCamera] = []
        self._context = create_context()
        self._owned = contextlib.ExitStack()
        self._closed = self.follows = False
        self._pool = ThreadPoolExecutor(1)
        self._coming: tuple[World, Future[tuple[DrawnWindow, WorldLight]]] | None = None
        self._early = collections.deque[StereoFrame]()  # finished before a window was entered
        try:
            with self._context:
                projection = padded_projection(self.rig, config)
                # Before what takes seconds.
                check_size(self._context, projection, config.detail.supersampling)
                self._shared = WorldPasses(self._context, *self._prepared(world), rover, config,
                                           seed)
                self._owned.callback(self._shared.release)
                self._pair = CameraRenderer(self._context, self._shared, BodyMount(self.rig),
                                            self.rig, config, seed)
                self._owned.callback(self._pair.release)
        except Exception:
            self.close()
            raise

    @property
    def sensor(self) -> SensorModel:
        """Image sensors of the pair."""
        return self._pair.sensor

    @property
    def exposure_s(self) -> float:
        """Exposure time of the last pair, or of the first one before it [s]."""
        return self._pair.exposure_s

    @property
    def exposure(self) -> tuple[float, float, bool]:
        """What the exposure of the pair goes on from: of the last frame, of the next [s], begun.

        It is all that images depend on besides the arguments of `begin`, the window and tracks.
        """
        return self._pair.exposure

    @exposure.setter
    def exposure(self, exposure: tuple[float, float, bool]) -> None:
        self._pair.exposure = exposure

    @property
    def numbers(self) -> tuple[Numbers, Numbers]:
        """See `WorldPasses.numbers`."""
        return self._shared.numbers

    @numbers.setter
    def numbers(self, numbers: tuple[Numbers, Numbers]) -> None:
        self._shared.numbers = numbers

    def add_camera(self, config: FurtherCameraConfig, mount: Mount, seed: int | None = None,
                   samples: int = 1) -> FurtherCamera:
        """Return a further camera in the same world, which the renderer owns.

        At most one frame of the pair may be under way.

        Args:
            config: A `ChaseConfig`, a `HazardConfig` with its mount, or the plain one.
            seed: Of its noise; by default that of the renderer and the number of the camera.
            samples: See `DetailConfig.with_samples`.

        Raises:
            RenderError: If the device cannot draw this size.
            ConfigError: If `samples` is not valid.
        """
        self._check_open()
        self._check_one_under_way('add_camera')
        own = dataclasses.replace(self.config, camera=config.camera, lens=config.lens,
                                  sensor=config.sensor, miscalibration=MiscalibrationConfig(),
                                  detail=self.config.detail.with_samples(samples))
        seed = self.seed + len(self._further) + 1 if seed is None else seed
        camera = geometry_of(config)
        if not mount.on_body:
            mount = MountElsewhere(mount, lambda: self._shared.offset_m)
        with self._drawing():
            drawn = CameraRenderer(self._context, self._shared, mount, camera, own, seed)
            self._owned.callback(drawn.release)
        self._further.append(FurtherCamera(self, drawn, camera, mount))
        return self._further[-1]

    def set_sun(self, azimuth_deg: float, elevation_deg: float) -> None:
        """Move the sun; all that does not depend on it is kept.

        Raises:
            RenderError: Between `begin` and `finish`.
        """
        self._check_idle('set_sun')
        self.show_sun(self.light_of(dataclasses.replace(
            self.config.sun, azimuth_deg=azimuth_deg, elevation_deg=elevation_deg)))

    def light_of(self, sun: SunConfig) -> WorldLight:
        """Compute the light of another sun, for `show_sun`.

        It takes seconds and draws nothing: it may run in a thread of its own beside frames.

        Args:
            sun: Its diameter must be that of the present one.
        """
        return self._shared.light_of(sun)

    def show_sun(self, light: WorldLight) -> None:
        """Move the sun.

        Args:
            light: As `light_of` returned it. If another window has been entered since, the light
                of that is computed now.

        Raises:
            RenderError: Between `begin` and `finish`.
        """
        self._check_idle('show_sun')
        if light.sunlight.world is not self._shared.world:
            light = self.light_of(light.sun)
        self.config = dataclasses.replace(self.config, sun=light.sun)
        self.sun_direction = sun_direction(light.sun.azimuth_deg, light.sun.elevation_deg)
        with self._drawing():
            self._shared.relight(light)
            for camera in (self._pair, *(further.drawn for further in self._further)):
                camera.relight(light.sun)

    def expose(self, sensor: SensorConfig) -> None:
        """Take other parameters of the exposure of the pair, from the next image on.

        Args:
            sensor: The image sensors; all but their exposure must be as before.
        """
        self.config = dataclasses.replace(self.config, sensor=sensor)
        self._pair.expose(sensor)

    def follow(self, overlay: Overlay | None) -> None:
        """Draw the tracks in an overlay, such as `Simulation.overlay`, from now on.

        `begin` draws the ground as the overlay is then. None, rigid ground, changes nothing.

        Raises:
            RenderError: Between `begin` and `finish`, or if tracks are followed already.
        """
        self._check_idle('follow')
        if overlay is None:
            return
        if self.follows:
            raise RenderError('follow: the renderer follows an overlay already; make another one')
        self.follows = True
        with self._drawing():
            self._shared.follow(overlay)

    # Windows of a site

    def ahead(self, world: World) -> None:
        """Begin to prepare another window of the site in a thread, beside the drawing.

        `enter` takes a few tenths of a second then.
        """
        self._check_open()
        if self._coming is None or self._coming[0] is not world:
            self._coming = world, self._pool.submit(self._prepared, world)

    def enter(self, world: World) -> None:
        """Draw another window of the site from now on; nothing else changes.

        Frames that are under way are those of the window before.

        Args:
            world: In the same frame as that of the constructor, with the same shapes of rocks.

        Raises:
            RenderError: If it is of another site, if the renderer is closed, or if the context is
                lost.
        """
        self._check_open()
        before = self._shared.world.rock_shapes
        if len(before) != len(world.rock_shapes) or not all(
                np.array_equal(a.vertices, b.vertices) and np.array_equal(a.faces, b.faces)
                for a, b in zip(before, world.rock_shapes)):
            raise RenderError('enter: the world has other shapes of rocks; valid is a window of '
                              'the same site')
        coming, self._coming = self._coming, None
        window, light = (coming[1].result() if coming is not None and coming[0] is world
                         else self._prepared(world))
        if light.sun != self.config.sun:    # it has moved meanwhile
            light = window.light(self.config, self.seed)
        with self._drawing():
            while self._pair.under_way:
                self._early.append(self._pair.finish())
            self._shared.enter(window, light)
        self.world = world
        for further in self._further:
            further.mount.enter(world)
        del window, light
        return_freed()

    def _follow(self, state: Posed) -> None:
        """Enter the window of a state, and prepare the next one before it is needed."""
        if self._follower is None:
            return
        world = self._follower.at(*state.T_world_base[:2, 3].tolist())
        if world is not self.world:
            self.enter(world)
        elif (coming := self._follower.next) is not None:
            self.ahead(coming)

    def _prepared(self, world: World) -> tuple[DrawnWindow, WorldLight]:
        """Return all of a window that needs no GL."""
        window = DrawnWindow.of(world, self.config)
        light = window.light(self.config, self.seed)
        return_freed()
        return window, light

    # What is in it

    @property
    def rocks(self) -> Rocks:
        """The rocks that are drawn, near and far, in the frame of the site."""
        rocks = self._shared.rocks.rocks
        return dataclasses.replace(rocks, position_m=rocks.position_m + self._shared.offset_m)

    @property
    def rock_labels(self) -> NDArray[np.uint16]:
        """(m,) labels of `rocks`; a rock keeps its own in all windows, see `labels.Numbers`."""
        return self._shared.rock_labels

    @property
    def crater_numbers(self) -> NDArray[np.uint16]:
        """(m,) numbers of `world.craters` in the layer crater."""
        return self._shared.crater_numbers

    @property
    def device(self) -> str:
        """Name of the device that draws."""
        return str(self._context.info['GL_RENDERER'])

    # Frames

    def render(self, state: Posed, frame_index: int = 0,
               layers: Collection[str] = ('left', 'right', 'depth'),
               other: Posed | None = None) -> StereoFrame:
        """Draw a frame: `begin` and `finish` in one call."""
        self._check_idle('render')
        self.begin(state, frame_index, layers, other)
        return self.finish()

    def begin(self, state: Posed, frame_index: int = 0,
              layers: Collection[str] = ('left', 'right', 'depth'),
              other: Posed | None = None) -> None:
        """Begin to draw a frame; `finish` returns it. Two frames may be under way at a time.

        The device draws in the background. Beginning the next frame before the present one is
        finished keeps it busy while images are read; it does not change them.

        The same arguments give the same pixels; automatic exposure also depends on the frames
        before.

        Args:
            state: Pose and motion: a `physics.state.RoverState` or a `rover.pose.RoverPose`.
            frame_index: Gives each frame its own noise.
            layers: Names from `frame.LAYERS` and `frame.FLOWS`.
            other: The state that optical flow and scene flow lead to.

        Raises:
            RenderError: If the state or a layer is not valid, if two frames are under way, if the
                renderer is closed, or if the context is lost.
        """
        request = Request.of(layers, frame_index,
                             None if other is None else checked_state(other, self._legs))
        checked = checked_state(state, self._legs)
        self._check_open()
        if self._under_way == FRAMES_UNDER_WAY:
            raise RenderError(f'begin: {FRAMES_UNDER_WAY} frames are under way; finish one first')
        self._follow(checked)
        if request.other is not None:
            request = dataclasses.replace(request, other=self._here(request.other))
        with self._drawing():
            self._pair.begin(self._here(checked), request)

    def finish(self) -> StereoFrame:
        """Return the frame that was begun first.

        Raises:
            RenderError: If none is under way, or if the context is lost.
        """
        if self._early:
            return self._early.popleft()
        if not self._pair.under_way:
            raise RenderError('finish: no frame is under way; begin one first')
        with self._drawing():
            return self._pair.finish()

    def render_further(self, camera: CameraRenderer, state: Posed,
                       frame_index: int, layers: Collection[str]) -> StereoFrame:
        """Draw a frame of a camera made by `add_camera`; `FurtherCamera.render` calls it."""
        request = Request.of(layers, frame_index)
        checked = checked_state(state, self._legs)
        self._check_open()
        self._check_one_under_way('render')
        self._follow(checked)
        with self._drawing():
            return camera.draw(self._here(checked), request)

    def _here(self, state: RoverPose) -> RoverPose:
        """Return a state in the frame that is drawn in, which single precision holds."""
        return moved(state, -self._shared.offset_m)

    @property
    def _under_way(self) -> int:
        return self._pair.under_way + len(self._early)

    def _check_open(self) -> None:
        if self._closed:
            raise RenderError('the renderer is closed')

    def _check_one_under_way(self, name: str) -> None:
        if self._pair.under_way > 1:    # the second one has not been lit
            raise RenderError(f'{name}: two frames are under way; finish one first')

    def _check_idle(self, name: str) -> None:
        if self._under_way:
            raise RenderError(f'{name}: a frame is under way; finish it first')

    @contextlib.contextmanager
    def _drawing(self) -> Iterator[None]:
        """Make the context current; errors of moderngl and the driver become RenderErrors."""
        try:
            with self._context:     # another renderer may have made its own current
                yield
        except Exception as error:
            self._abandon()
            # moderngl raises bare Exceptions, too. Any other is a defect of ours.
            if type(error) not in (Exception, moderngl.Error):
                raise
            raise RenderError(f'drawing failed, the GL context may be lost: {error}') from error

    def _abandon(self) -> None:
        self._early.clear()
        for camera in (self._pair, *(further.drawn for further in self._further)):
            camera.abandon()

    # Resources

    def __repr__(self) -> str:
        camera, sun = self.config.camera, self.config.sun
        return (f'Renderer({camera.width} x {camera.height} px, sun at {sun.azimuth_deg:g} and '
                f'{sun.elevation_deg:g} deg{", closed" if self._closed else ""})')

    def close(self) -> None:
        """Release all GL objects and the context."""
        if not self._closed:
            self._closed = True
            self._pool.shutdown(cancel_futures=True)
            if self._follower is not None:
                self._follower.close()
            with self._context:
                self._owned.close()
            self._context.release()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 _: TracebackType | None) -> None:
        self.close()


class FurtherCamera:
    """A camera besides the pair, made by `Renderer.add_camera`.

    Args:
        camera: Its intrinsics.
        drawn: What draws it.
        mount: What carries it.
    """

    def __init__(self, renderer: Renderer, drawn: CameraRenderer,
                 camera: PinholeCamera | FisheyeCamera, mount: Mount) -> None:
        self._renderer, self.drawn, self.camera, self.mount = renderer, drawn, camera, mount

    def render(self, state: Posed, frame_index: int = 0,
               layers: Collection[str] = ('left',)) -> StereoFrame:
        """Draw a frame; its image is the layer 'left'. Arguments as those of `Renderer.render`.

        A pair has the layer 'right', too. The depth of a fisheye is the distance from it, and all
        layers of a fisheye are those of its image. At most one frame of the pair may be under way.

        Raises:
            RenderError: As `Renderer.render`.
        """
        return self._renderer.render_further(self.drawn, state, frame_index, layers)
