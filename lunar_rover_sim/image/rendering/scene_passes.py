"""The passes of a frame in their order: rocks, rover, truth; what is read; then the ground."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.camera.development import LitImage
from lunar_rover_sim.image.camera.encoding import has_colour
from lunar_rover_sim.image.camera.flow import FlowModel, Moved
from lunar_rover_sim.image.camera.mosaic import TINT_ONE
from lunar_rover_sim.image.camera.mount import CameraPoses
from lunar_rover_sim.image.camera.outlines import smooth_outlines
from lunar_rover_sim.image.rendering.canvas import Canvas, Drawing
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.context import clear_window
from lunar_rover_sim.image.rendering.earth_image import EarthImage
from lunar_rover_sim.image.rendering.frame import FLOWS
from lunar_rover_sim.image.rendering.frame_targets import LinkTargets, read_image
from lunar_rover_sim.image.rendering.gl_owner import GlOwner
from lunar_rover_sim.image.rendering.ground_picture import (cover, cover_depth, far_ground,
                                                            GroundPicture, Part, tell)
from lunar_rover_sim.image.rendering.labels import link_label
from lunar_rover_sim.image.rendering.projection import Projection, ViewVolume
from lunar_rover_sim.image.rendering.rock_pass import GroundSeen
from lunar_rover_sim.image.rendering.scene import LEFT, LOWEST_M, Request, Scene, SceneLight
from lunar_rover_sim.image.rendering.sun_pass import Occluders, SunPass
from lunar_rover_sim.image.rendering.world_passes import WorldPasses
from lunar_rover_sim.rover.pose import RoverPose


@dataclasses.dataclass(frozen=True)
class Drawn:
    """What was read of a scene, by side.

    Attributes:
        samples: Radiance and depth, with several samples a pixel where that is wanted.
        depth_m: (h, w) of pixels, as in `LitImage`; those of the samples where these are pixels.
        truth: Layers of truth but depth, (h, w) or (h, w, 3) of pixels.
        link: (h, w) as in `LitImage`, where links of the rover were asked for and are in view.
    """

    samples: dict[int, LitImage]
    depth_m: dict[int, NDArray[np.float32]]
    truth: dict[int, dict[str, NDArray[Any]]]
    link: dict[int, NDArray[np.uint8]]


class ScenePasses(GlOwner):
    """Draws the world, as a pair of cameras sees it, into radiance, depth and truth.

    With supersampling radiance is drawn at several samples a pixel and averaged. Depth and truth
    are drawn at the centres of pixels.
    """

    def __init__(self, context: moderngl.Context, shared: WorldPasses, mount: CameraPoses,
                 config: RenderConfig, projection: Projection, *, sees_rover: bool,
                 strays: Callable[[Array], bool], samples: int = 1) -> None:
        """Make targets and passes of these cameras.

        Args:
            shared: What draws the world.
            mount: Carries the cameras.
            projection: Of both.
            sees_rover: Whether the rover may show in the images.
            strays: As for `SunPass`.
            samples: Along a side of a pixel.
        """
        super().__init__()
        self._context, self._config, self._shared = context, config, shared
        self._mount, self._sees_rover, self._strays = mount, sees_rover, strays
        with self._making():
            self._build(projection, samples)

    def _build(self, projection: Projection, samples: int) -> None:
        context, config = self._context, self._config
        self._colour = has_colour(config.sensor.encoding)
        colour = samples == 1 and self._colour
        self._pixels = self._samples = self._own(Canvas(context, projection, colour=colour))
        self._times = samples
        if samples > 1:
            self._samples = self._own(Canvas(context, projection.finer(samples),
                                             colour=self._colour))
        self._marked = (self._own(LinkTargets(context, self._pixels.lit.radiance.size))
                        if self._sees_rover else None)
        projection = self._samples.projection
        self._earth = EarthImage(projection, config)
        self._sun = self._own(SunPass(context, projection, config, self._strays))

    def relight(self, config: RenderConfig) -> None:
        """Move the sun in the sky; config: differs in the sun only."""
        self._config = config
        self._earth.relight(config)
        self._sun.relight(config.sun)

    def begin(self, request: Request, state: RoverPose) -> Scene:
        """Place the cameras of a frame, and choose what is in view."""
        projection, T_world_base = self._samples.projection, state.T_world_base
        shared = self._shared
        if any(request.truth_of(side) for side in request.sides):
            shared.prepare_truth()
        links = shared.body.poses(T_world_base, state.joint_angle_rad)
        # Both cameras decide what is drawn: an image does not depend on the other layers.
        cameras = self._mount.poses(state)
        volume = projection.view_volume(cameras, shared.world)
        sources = shared.sources if request.lit else (shared,)
        for source in sources:
            if source.tracks is not None:
                source.tracks.update(volume, shared.make_waiting)
        shared.ground.update(volume, shared.make_waiting)
        scene = Scene(request, *self._drawings(request), state, links, cameras,
                      above_m=max(volume.above_m, LOWEST_M),
                      tracks=shared.ground.tracks_in(volume))
        if request.lit:
            if shared.lamp is not None:
                scene.lamp = shared.lamp.draw(T_world_base, shared.world, shared.ground,
                                              shared.rocks, shared.workers)
            self._sun.look(scene, volume, Occluders(shared.ground, shared.rocks, shared.body,
                                                    shared.sunlight, shared.workers))
        for drawing in scene.drawings:
            for side in drawing.sides:
                drawing.targets.views[side].place(cameras[side], drawing.projection,
                                                  volume.centre_m, drawing.targets.size)
        scene.depth_m = shared.ground.depths(
            {(number, side): (drawing.targets.views[side].numbers, drawing.projection)
             for number, drawing in enumerate(scene.drawings) for side in drawing.sides},
            scene.tracks, shared.workers)
        scene.shows_rover = self._sees_rover and shared.body.is_in_view(links, volume)
        scene.lights = [self._choose_lit(source, scene, volume) for source in sources]
        return scene

    def _drawings(self, request: Request) -> tuple[Drawing, Drawing]:
        """Return the drawings of pixels and of samples, which may be one."""
        if self._samples is self._pixels:
            both = self._pixels.begin(request.sides, request.lit_sides)
            return both, both
        return (self._pixels.begin(request.sides, ()),
                self._samples.begin(request.lit_sides, request.lit_sides))

    def _choose_lit(self, source: WorldPasses, scene: Scene, volume: ViewVolume) -> SceneLight:
        """Return what the light of a source needs; choose rocks, draw the rover's shadow map."""
        links = scene.T_world_links
        source.rocks.choose(volume, self._samples.projection.focal_px,
                            self._config.detail.rock_min_px, [
                                GroundSeen(scene.T_world_cameras[side],
                                           scene.drawings[number].projection, depth_m)
                                for (number, side), depth_m in scene.depth_m.items()])
        shadow = source.rover_shadow
        cast = shadow.cast(links, source.sun_axes, source.rocks.boxes)
        body = None
        if scene.shows_rover:
            body = source.body.light(links, shadow.radius_m, source.sunlight,
                                     source.config.sun.irradiance)
        return SceneLight(cast, body)

    def light(self, scene: Scene) -> None:
        """Draw rocks and the rover with the truth of pixels; the ground waits for its light."""
        for source, light in zip(self._shared.sources, scene.lights):
            source.set_uniforms(**light.shadow.uniforms)
            if light.body is not None:
                source.body.cast(scene.T_world_links, source.sun_axes,
                                 source.rover_shadow.radius_m)
        for drawing in scene.drawings:
            for side in drawing.sides:
                self._look_from(scene, drawing, side)
                self._draw_objects(scene, drawing, side)
                self._add_objects(scene, drawing, side)
        self._sun.read(scene)
        scene.ground = self._ground(scene)
        self._shared.waiting.append(scene.ground)

    def _ground(self, scene: Scene) -> GroundPicture:
        """Return the ground of a scene, which is not made yet."""
        shared = self._shared
        parts = {}
        for number, drawing in enumerate(scene.drawings):
            for side in drawing.sides:
                truth = self._truth_of(scene, drawing, side)
                sources = [source.light_on_ground(light, None if k else scene.lamp)
                           for k, (source, light) in enumerate(self._lights(scene, drawing, side))]
                lit = side in drawing.lit_sides or 'shadow' in truth
                parts[number, side] = Part(
                    drawing, side, scene.depth_m[number, side], lit, self._colour, truth,
                    shared.ground.relief, scene.tracks.lit, sources,
                    shared.crater_lists() if 'crater' in truth else None)
        return GroundPicture(shared.workers, parts)

    def read(self, scene: Scene, *, links: bool) -> Drawn:
        """Read what was drawn of a scene that has just been lit; links: those too."""
        request = scene.request
        depth_m = {side: _read(self._pixels, 1, side) for side in request.sides}
        one = self._samples is self._pixels
        samples = {side: LitImage(_read(self._samples, 0, side), depth_m[side] if one
                                  else _read(self._samples, 1, side),
                                  tint=_tint(self._samples, side) if self._colour else None)
                   for side in request.lit_sides}
        size = self._pixels.projection.height, self._pixels.projection.width
        truth = {side: scene.pixels.targets.truth.read(request.truth_of(side), side, size)
                 for side in request.sides if request.truth_of(side)}
        return Drawn(samples, depth_m, truth,
                     self._links(scene) if links and scene.shows_rover else {})

    def finish(self, scene: Scene, drawn: Drawn) -> dict[int, LitImage]:
        """Return the lit images of a scene, by side: with smooth outlines, Earth and sun.

        The ground is added to what was drawn.
        """
        samples, ground, workers = drawn.samples, scene.ground, self._shared.workers
        assert ground is not None
        ground.make()
        if ground in self._shared.waiting:
            self._shared.waiting.remove(ground)
        last = len(scene.drawings) - 1
        pixel = 1.0 / self._samples.projection.focal_px
        far_m = far_ground(pixel, scene.above_m)
        for side, image in samples.items():
            cover(image, ground.images[0, side], workers, far_m)
        for side, depth_m in drawn.depth_m.items():
            own = ground.images[last, side]
            if last or side not in samples:
                cover_depth(depth_m, own.depth_m, workers)
            if side in drawn.link:      # what the ground hides of the rover
                drawn.link[side][depth_m > 0.0] = 0
            if side in drawn.truth:
                tell(drawn.truth[side], depth_m, own)
        self._earth.draw(scene, samples.values())   # before outlines in front of it are smoothed
        if self._config.detail.smooth_outlines:
            for image in samples.values():
                smooth_outlines(image.radiance, image.depth_m, pixel, scene.above_m, workers)
        self._sun.draw(scene, samples)
        return {side: LitImage(_averaged(image.radiance, self._times), drawn.depth_m[side],
                               drawn.link.get(side), _averaged_tint(image, self._times))
                for side, image in samples.items()}

    @staticmethod
    def _truth_of(scene: Scene, drawing: Drawing, side: int) -> set[str]:
        """Return the layers of truth that are drawn in a drawing of a camera."""
        return scene.request.truth_of(side) if drawing is scene.pixels else set()

    def _target(self, scene: Scene, drawing: Drawing, side: int) -> moderngl.Framebuffer:
        """Return what a camera is lit into, with attachments for truth if that is drawn."""
        targets = drawing.targets
        if self._truth_of(scene, drawing, side):
            return targets.truth.framebuffers[side]
        return targets.lit[side]

    def _lights(self, scene: Scene, drawing: Drawing,
                side: int) -> list[tuple[WorldPasses, SceneLight]]:
        """Return the sources of light of a camera; the sun alone where only truth is drawn."""
        every = list(zip(self._shared.sources, scene.lights))
        return every if side in drawing.lit_sides else every[:1]

    def _add_objects(self, scene: Scene, drawing: Drawing, side: int) -> None:
        """Add the light of sources but the sun to rocks and the rover, which are drawn."""
        self._context.depth_func = '<='
        try:
            for source, light in self._lights(scene, drawing, side)[1:]:
                target = drawing.targets.added[side]
                target.use()
                target.viewport = drawing.windows[side]
                source.rover_shadow.bind()
                source.rocks.draw(add=True)
                if light.body is not None:
                    source.body.draw(scene.T_world_links, light.body, add=True)
        finally:
            self._context.depth_func = '<'

    def _links(self, scene: Scene) -> dict[int, NDArray[np.uint8]]:
        """Return which link of the rover each pixel of a lit scene shows, as `LitImage.link`."""
        assert self._marked is not None
        target, result = self._marked.framebuffer, {}
        for side in scene.request.lit_sides:
            scene.pixels.targets.views[side].bind()
            clear_window(target, scene.pixels.windows[side])
            self._shared.body.mark(scene.T_world_links, self._pixels.lit.depth)
            result[side] = read_image(target, 0, side, (
                self._pixels.projection.height, self._pixels.projection.width), kind='f1')
        return result

    def _look_from(self, scene: Scene, drawing: Drawing, side: int) -> None:
        """Draw for a camera from now on."""
        drawing.targets.views[side].bind()
        if self._shared.lamp is not None:
            self._shared.lamp.bind(self._shared.programs, scene.state.T_world_base,
                                   scene.T_world_cameras[side])

    def _draw_objects(self, scene: Scene, drawing: Drawing, side: int) -> None:
        truth = bool(self._truth_of(scene, drawing, side))
        target = self._target(scene, drawing, side)
        clear_window(target, drawing.windows[side])
        self._shared.rover_shadow.bind()
        self._shared.rocks.draw(truth=truth)
        body = scene.lights[0].body
        if body is not None:
            self._shared.body.draw(scene.T_world_links, body, truth=truth)

    def flow(self, scene: Scene, K: Array, depth_m: NDArray[np.float32],
             label: NDArray[np.uint16]) -> dict[str, NDArray[np.float32]]:
        """Return the flows that a scene asks for, by layer, to its other state.

        Args:
            K: (3, 3) intrinsics [px] of these (h, w) images of the left camera.
        """
        other = scene.request.other
        assert other is not None
        links = self._shared.body.poses(other.T_world_base, other.joint_angle_rad)
        seen = range(len(links)) if scene.shows_rover else ()
        model = FlowModel(K, depth_m, scene.T_world_cameras[LEFT], self._mount.poses(other)[LEFT],
                          [Moved(label == link_label(link), scene.T_world_links[link],
                                 links[link]) for link in seen])
        flows = {'optical_flow': model.optical_flow, 'scene_flow': model.scene_flow}
        return {name: flows[name]() for name in scene.request.layers.intersection(FLOWS)}


def _read(canvas: Canvas, index: int, side: int) -> NDArray[np.float32]:
    """Return radiance (0) or depth (1) of a camera, as it was lit."""
    size = canvas.projection.height, canvas.projection.width
    return read_image(canvas.lit.framebuffer, index, side, size)


def _tint(canvas: Canvas, side: int) -> NDArray[np.uint32]:
    """Return the colour of a camera, as it was lit."""
    size = canvas.projection.height, canvas.projection.width
    return read_image(canvas.lit.framebuffer, 2, side, size, components=2,
                      kind='nu2').view(np.uint32)[..., 0]


def _averaged(radiance: NDArray[np.float32], times: int) -> NDArray[np.float32]:
    """Return the means of the times x times samples of each pixel."""
    if times == 1:
        return radiance
    h, w = radiance.shape
    return radiance.reshape(h // times, times, w // times, times).mean(axis=(1, 3))


def _averaged_tint(image: LitImage, times: int) -> NDArray[np.uint32] | None:
    """Return the colour of the light of the times x times samples of each pixel."""
    if image.tint is None or times == 1:
        return image.tint
    # The sky has no colour: its light is white.
    codes = image.tint[..., None].view(np.uint16)
    ratio = np.where(codes == 0, TINT_ONE * 65535.0, codes).astype(np.float32)
    light = np.maximum(image.radiance, np.float32(1e-9))
    mean = np.maximum(_averaged(light, times), np.float32(1e-9))
    means = [_averaged(light * ratio[..., k], times) / mean for k in range(2)]
    codes = np.rint(np.minimum(np.stack(means, axis=-1), 65535.0)).astype(np.uint16)
    return codes.view(np.uint32)[..., 0]
