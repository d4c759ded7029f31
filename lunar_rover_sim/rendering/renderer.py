"""The renderer: world, sun and rover to stereo images and the truth beside them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from concurrent.futures import Future
import contextlib
import dataclasses
import logging
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.camera.distorted_image import padding
from lunar_rover_sim.camera.exposure import first_exposure_s
from lunar_rover_sim.camera.rig import StereoRig
from lunar_rover_sim.camera.sensor import SensorModel
from lunar_rover_sim.errors import LunarRoverSimError, RenderError
from lunar_rover_sim.frames import Array, sun_direction
from lunar_rover_sim.illumination.rock_shadow import sun_axes
from lunar_rover_sim.illumination.sunlight import Sunlight
from lunar_rover_sim.parameters import nearest
from lunar_rover_sim.rendering import lamp as lamps
from lunar_rover_sim.rendering.config import RenderConfig
from lunar_rover_sim.rendering.context import create_context, set_uniform
from lunar_rover_sim.rendering.frame import LAYERS, read_image, StereoFrame
from lunar_rover_sim.rendering.frame_targets import attachment, FrameTargets, Scene, Wanted, Window
from lunar_rover_sim.rendering.ground import Ground
from lunar_rover_sim.rendering.imager import AutoExposure, Imager
from lunar_rover_sim.rendering.lighting import lighting_constants
from lunar_rover_sim.rendering.programs import GROUND_PASSES, load_programs
from lunar_rover_sim.rendering.projection import clip_matrix, view_volume
from lunar_rover_sim.rendering.rock_meshes import RockMeshes
from lunar_rover_sim.rendering.rover_body import RoverBody
from lunar_rover_sim.rendering.surface import Surface, TileMaker
from lunar_rover_sim.rendering.terrain import ViewVolume
from lunar_rover_sim.rendering.view import View
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.world.model import World

log = logging.getLogger(__name__)

State = tuple[Array, Array]      # pose of the rover, leg angles

_TRUTH_LAYERS = {'normal', 'label'}
_LEFT_LAYERS = {'left', 'depth', 'radiance'} | _TRUTH_LAYERS
_SHADOW_UNIT, _LAMP_UNIT = 6, 7


class Renderer:
    """Draws what the rover's cameras see; owns the GL context. Use as a context manager.

    rig: the cameras; sun_direction: (3,) unit vector to the sun, world frame

    Raises RenderError if there is no usable EGL device or it cannot draw this size.
    """

    def __init__(self, world: World, rover: RoverDescription, config: RenderConfig,
                 seed: int = 0) -> None:
        self.world, self.rover, self.config, self.seed = world, rover, config, seed
        self.rig = StereoRig(rover, config.camera)
        self.sun_direction = sun_direction(config.sun.azimuth_deg, config.sun.elevation_deg)
        self.sensor = SensorModel(config.camera, config.sensor)
        # A distorted image takes light from outside the pinhole image: draw with a margin.
        self._pad = padding(config.camera)
        self._w = self.rig.width + 2 * self._pad[0]
        self._h = self.rig.height + 2 * self._pad[1]
        self._K = self.rig.K.copy()
        self._K[:2, 2] += self._pad
        self.exposure_s = first_exposure_s(self.sensor, config.sun, config.lamp,
                                           config.reflectance)
        self._auto = (AutoExposure(self.sensor) if config.sensor.exposure_mode == 'auto'
                      else None)
        self._context = create_context()
        self._closed = False
        try:
            with self._context:
                self._build()
        except Exception:
            self.close()
            raise

    def _build(self) -> None:
        context, config = self._context, self.config
        width, height = self._w, self._h
        limit = context.info['GL_MAX_TEXTURE_SIZE']
        if max(width, 2 * height) > limit:
            raise RenderError(f'camera size {width} x {height}: this device draws at most '
                              f'{limit} x {limit // 2}')
        self._tiles = TileMaker(config.detail, self.seed)
        tiles = self._tiles.start(self.sun_direction)
        # Left above right in one pair of attachments.
        self._radiance = attachment(context, (width, 2 * height))
        self._depth = attachment(context, (width, 2 * height))
        self._lighting = context.framebuffer([self._radiance, self._depth])
        self._targets = [FrameTargets(context, self._radiance, self._depth) for _ in range(2)]
        self._ahead: Scene | None = None

        self._ground = Ground(context, self.world, config.detail)
        self._lamp_eye = View(context)
        self._light_surface(tiles)
        self._rocks = RockMeshes(context, self.world.rocks, self.world.rock_shapes,
                                 self.sunlight.rock_light())
        self._rover = RoverBody(context, self.rover)
        self._lamp = lamps.Lamp(context, config.lamp) if config.lamp.power_w > 0.0 else None
        self._programs = load_programs(context, len(self.world.levels), self._lamp is not None)
        self._imager = Imager(context, self.rig, self.sensor, self.seed, self._pad)
        self._ground_passes = {name: context.vertex_array(self._programs[name], [])
                               for name in GROUND_PASSES}
        self._set_constants()

    def _light_surface(self, tiles: Future[Any]) -> None:
        """Compute what the sun sees."""
        self.sunlight = Sunlight(self.world, self.config.sun, self.config.reflectance,
                                 self.sun_direction, indirect=self.config.detail.bounce)
        self._sun_axes = sun_axes(self.sunlight.sun)
        self._surface = Surface(self._context, self.world, self.sunlight, *tiles.result())

    def set_sun(self, azimuth_deg: float, elevation_deg: float) -> None:
        """Move the sun; all that does not depend on it is kept."""
        sun = dataclasses.replace(self.config.sun, azimuth_deg=azimuth_deg,
                                  elevation_deg=elevation_deg)
        self.config = dataclasses.replace(self.config, sun=sun)
        self.sun_direction = sun_direction(azimuth_deg, elevation_deg)
        self._ahead = None
        with self._context:
            self._surface.release()
            self._light_surface(self._tiles.start(self.sun_direction))
            self._rocks.relight(self.sunlight.rock_light())
            self._set_constants()
        if self._auto is None:
            self.exposure_s = first_exposure_s(self.sensor, self.config.sun,
                                               self.config.lamp, self.config.reflectance)

    # Drawing

    def render(self, T_world_base: ArrayLike, joint_angle_rad: ArrayLike, frame_index: int = 0,
               layers: Collection[str] = ('left', 'right', 'depth'),
               then: Callable[[], State | None] | None = None) -> StereoFrame:
        """Draw the asked layers.

        T_world_base: (4, 4) pose of the rover; joint_angle_rad: (4,) leg angles in the order of
        LEG_NAMES; frame_index: makes the noise of each frame its own; then: is asked, while this
        frame is being drawn, for the pose and the leg angles of the next, if they are known, so
        that it can be begun. That saves time and changes nothing in the images.

        The same arguments give the same pixels; only automatic exposure also depends on the frames
        before. Raises RenderError if the context is lost, or for an unknown layer.
        """
        asked = set(layers)
        for name in asked.difference(LAYERS):
            raise RenderError(f'layer {name!r} is not valid; {nearest(name, LAYERS)}')
        state = _state(T_world_base, joint_angle_rad)
        eyes = []
        if asked & _LEFT_LAYERS:
            eyes.append(0)
        if 'right' in asked:
            eyes.append(1)
        if self._closed:
            raise RenderError('the renderer is closed')
        if not eyes:
            return StereoFrame(exposure_s=self.exposure_s)
        wanted = Wanted(tuple(eyes), bool(asked & {'left', 'right', 'radiance'}),
                        bool(asked & _TRUTH_LAYERS))
        scene, self._ahead = self._ahead, None
        if scene is None or not scene.shows(*state, wanted):
            with self._drawing():
                scene = self._begin(state, wanted)
                self._light(scene)
        following = then() if then is not None else None
        following = None if following is None else _state(*following)
        with self._drawing():
            ahead = None if following is None else self._begin(following, wanted)
            raw = self._read(scene, asked, int(frame_index))
            if ahead is not None:   # what was lit into has been read
                self._light(ahead)
                self._ahead = ahead
        return self._finish(raw, asked, wanted)

    @contextlib.contextmanager
    def _drawing(self) -> Iterator[None]:
        """Make the context current; what moderngl and the driver raise becomes a RenderError."""
        try:
            with self._context:  # another renderer may have made its own current
                yield
        except LunarRoverSimError:
            raise
        except Exception as error:
            raise RenderError(f'drawing failed, the GL context may be lost: {error}') from error

    def _begin(self, state: State, wanted: Wanted) -> Scene:
        """Choose what is in view and draw the geometry of the ground."""
        pose, joint_angle_rad = state
        self._targets.reverse()
        targets = self._targets[0]
        legs = self._rover.poses(pose, joint_angle_rad)
        # Both cameras decide what is drawn: an image does not depend on what else is asked.
        cameras = [pose @ self.rig.T_base_left, pose @ self.rig.T_base_right]
        K, w, h = self._K, self._w, self._h
        view = self._view(cameras, K, w, h)
        chosen = self._ground.choose(view)
        if self._lamp is not None and wanted.lit:
            self._draw_lamp_shadow(pose)
        windows = [(0, eye * h, w, h) for eye in range(len(cameras))]
        for eye in wanted.eyes:
            targets.eyes[eye].place(cameras[eye], self._clip(cameras[eye], K, w, h), K, view,
                                    window=windows[eye], size=targets.size)
            targets.eyes[eye].bind()
            _clear(targets.ground[eye], windows[eye])
            if eye == wanted.eyes[-1]:  # while the driver draws the other one
                shadow = self._rover.cast_shadow(legs, self._sun_axes, view, _SHADOW_UNIT)
                self._rocks.choose(view, self.rig.focal_px, self.config.detail.rock_min_px)
                body = self._body_light(legs) if self._rover.seen(legs, view) else None
                rows = self._ground.rows(chosen, cameras[0], K, h, self.config.camera.near_m)
            self._ground.draw(self._programs, chosen)
        return Scene(pose, joint_angle_rad, wanted, targets, legs, cameras, windows, rows, shadow,
                     body)

    def _light(self, scene: Scene) -> None:
        """Light the ground; draw rocks and the rover over it."""
        for program in self._programs.values():
            set_uniform(program, **scene.shadow)
        for draw in (self._light_ground, self._draw_objects):
            for eye in scene.wanted.eyes:
                scene.targets.eyes[eye].bind()
                if self._lamp is not None:
                    self._place_lamp(scene.T_world_base, scene.cameras[eye])
                draw(scene, eye)
        if scene.wanted.truth and 0 in scene.wanted.eyes:
            scene.targets.eyes[0].bind()
            self._draw_truth(scene)

    def _draw_lamp_shadow(self, pose: Array) -> None:
        """Draw depth as the lamp sees it: ground and rocks."""
        lamp = self._lamp
        assert lamp is not None
        place, size = pose @ lamp.T_base_lamp, lamps.MAP
        view = self._view([place], lamp.K, size, size)
        window = (0, 0, size, size)
        eye = self._lamp_eye
        eye.place(place, self._clip(place, lamp.K, size, size), lamp.K, view,
                  window=window, size=(size, size))
        eye.bind()
        _clear(lamp.ground_target, window)
        self._ground.draw(self._programs, self._ground.choose(view))
        lamp.object_target.use()
        lamp.object_target.viewport = window
        self._context.enable_only(self._context.DEPTH_TEST | self._context.CULL_FACE)
        self._surface.bind_rocks(self._programs['rock'])
        self._rocks.choose(view, float(lamp.K[0, 0]), 2.0)
        self._rocks.draw(self._programs['rock'])

    def _place_lamp(self, pose: Array, camera: Array) -> None:
        lamp = self._lamp
        assert lamp is not None
        place = pose @ lamp.T_base_lamp
        clip = self._clip(place, lamp.K, lamps.MAP, lamps.MAP)
        for program in self._programs.values():
            if 'u_lamp' in program:
                lamp.place(program, place, camera, clip, _LAMP_UNIT)

    def _light_ground(self, scene: Scene, eye: int) -> None:
        """Light what the meshes cover; where they may be coarser than the grid, refine it."""
        window = scene.windows[eye]
        _clear(self._lighting, window)
        self._context.enable_only(self._context.NOTHING)
        scene.targets.ground_depth.use(5)
        kind = '' if scene.wanted.lit else 'unlit '
        first, middle, last = scene.rows
        if first < middle:
            self._light_rows(kind + 'refined', window, first, middle)
        if middle < last:
            self._light_rows(kind + 'ground', window, middle, last)

    def _light_rows(self, name: str, window: Window, first: int,
                    last: int) -> None:
        program = self._programs[name]
        self._surface.bind(program)
        set_uniform(program, u_depth=5)
        if name.endswith('refined'):
            self._ground.bind_exact(program)
        self._lighting.viewport = (window[0], window[1] + first, window[2], last - first)
        self._ground_passes[name].render(vertices=3)

    def _body_light(self, legs: Array) -> dict[str, Any]:
        """Return the light on the rover, by the names of uniforms."""
        span = legs[0, 2, 3] + self._rover.radius_m * np.array([-0.5, 0.8])
        points = np.array([[*legs[0, :2, 3], z] for z in span])
        clearance, occluder = self.sunlight.light_of(points)
        surroundings = self.sunlight.surroundings_at(legs[0, :2, 3])
        return {'u_body_span': tuple(span),
                'u_body_light': (clearance[0], occluder[0], clearance[1], occluder[1]),
                'u_ground_light': self.config.sun.irradiance * surroundings}

    def _draw_objects(self, scene: Scene, eye: int, kind: str = '') -> None:
        """Draw rocks and the rover, if it is seen, over the lit ground; kind 'truth ' their truth.
        """
        context = self._context
        target = scene.targets.truth if kind else scene.targets.objects[eye]
        target.use()
        target.viewport = scene.windows[eye]
        context.enable_only(context.DEPTH_TEST | context.CULL_FACE)
        program = self._programs[kind + 'rock']
        self._surface.bind_rocks(program)
        self._rocks.draw(program)
        context.enable_only(context.DEPTH_TEST)
        if scene.body is not None:
            program = self._programs[kind + 'rover']
            set_uniform(program, **scene.body)
            self._rover.draw(program, scene.legs)

    def _draw_truth(self, scene: Scene) -> None:
        """Draw normals and labels of the left eye over the depth that is there."""
        context = self._context
        # Only the colour is cleared: what is nearest is known already.
        colour_only = context.framebuffer([scene.targets.truth.color_attachments[0]])
        _clear(colour_only, scene.windows[0])
        context.enable_only(context.NOTHING)
        scene.targets.ground_depth.use(5)
        program = self._programs['truth ground']
        self._surface.bind(program)
        set_uniform(program, u_depth=5)
        self._ground_passes['truth ground'].render(vertices=3)
        colour_only.release()
        context.depth_func = '<='
        try:
            self._draw_objects(scene, 0, 'truth ')
        finally:
            context.depth_func = '<'

    def _view(self, cameras: list[Array], K: Array, w: int, h: int) -> ViewVolume:
        middle = np.mean([c[:3, 3] for c in cameras], axis=0)
        ground = float(np.nan_to_num(self.world.height_at(middle[:2]), nan=middle[2]))
        return view_volume(cameras, K, w, h, ground)

    def _clip(self, camera: Array, K: Array, w: int, h: int) -> NDArray[np.float32]:
        return clip_matrix(camera, K, w, h, self.config.camera.near_m, self.config.camera.far_m)

    def _read(self, scene: Scene, asked: set[str], frame_index: int) -> dict[str, NDArray[Any]]:
        """Read what was drawn, the pixels of both eyes as 'developed'."""
        raw: dict[str, NDArray[Any]] = {}
        eyes = list(scene.wanted.eyes)
        if asked & {'left', 'right'}:
            if self._auto is not None:
                if not self._auto.started:
                    self._auto.start(self._image_of(self._lighting, 0, eyes[0]))
                self.exposure_s = self._auto.exposure_s
            raw['developed'] = self._imager.develop(self._radiance, eyes, self.exposure_s,
                                                    frame_index)
        for k, name in enumerate(('radiance', 'depth')):
            if name in asked:
                raw[name] = self._image_of(self._lighting, k, 0)
        if asked & _TRUTH_LAYERS:
            raw['truth'] = self._image_of(scene.targets.truth, 0, 0, 4)
        return raw

    def _finish(self, raw: dict[str, NDArray[Any]], asked: set[str],
                wanted: Wanted) -> StereoFrame:
        out: dict[str, NDArray[Any]] = {}
        if 'developed' in raw:
            for eye, name in enumerate(('left', 'right')):
                if name in asked:
                    image = raw['developed'][eye]
                    if self.config.sensor.encoding == 'rgb8':
                        image = np.repeat(image[..., None], 3, axis=2)
                    out[name] = image
            if self._auto is not None:
                self._auto.follow(raw['developed'][wanted.eyes[0]])
        if 'depth' in asked:
            out['depth_m'] = np.where(raw['depth'] == 0.0, np.float32(np.inf), raw['depth'])
        if 'radiance' in asked:
            out['radiance'] = np.ascontiguousarray(raw['radiance'])
        if 'normal' in asked:
            out['normal'] = np.ascontiguousarray(raw['truth'][..., :3])
        if 'label' in asked:
            out['label'] = np.rint(raw['truth'][..., 3]).astype(np.int32)
        return StereoFrame(**out, exposure_s=self.exposure_s)

    def _image_of(self, target: Any, attachment: int, eye: int,
                  components: int = 1) -> NDArray[np.float32]:
        return read_image(target, attachment, eye, (self._h, self._w), self._pad, components)

    def _set_constants(self) -> None:
        constants = lighting_constants(self.config, self.sun_direction)
        for program in self._programs.values():
            set_uniform(program, **constants)

    # Resources

    def close(self) -> None:
        """Release the GL context and all that was made in it."""
        if not self._closed:
            self._closed = True
            self._context.release()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 traceback: TracebackType | None) -> None:
        self.close()


def _state(T_world_base: ArrayLike, joint_angle_rad: ArrayLike) -> State:
    pose = np.asarray(T_world_base, dtype=float)
    if pose.shape != (4, 4) or not np.all(np.isfinite(pose)):
        raise RenderError('T_world_base: a pose is a finite 4 x 4 matrix')
    return pose, np.asarray(joint_angle_rad, dtype=float)


def _clear(target: Any, window: Window) -> None:
    """Make a framebuffer's window the target, and clear it."""
    target.use()
    target.viewport = window
    target.clear(viewport=window)
