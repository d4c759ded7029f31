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
from lunar_rover_sim.image.camera.mount import TurnedMount
from lunar_rover_sim.image.camera.outlines import smooth_outlines
from lunar_rover_sim.image.rendering.canvas import (Canvas, DEPTH, Drawing, FACE, read_image,
                                                    SURFACE)
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.context import clear_window, GlOwner
from lunar_rover_sim.image.rendering.frame import FLOWS
from lunar_rover_sim.image.rendering.ground_picture import (cover, cover_depth, far_ground,
                                                            GroundPicture, Part, tell)
from lunar_rover_sim.image.rendering.labels import link_label
from lunar_rover_sim.image.rendering.object_light import ObjectSource, Surfaces, tell_objects
from lunar_rover_sim.image.rendering.projection import Projection
from lunar_rover_sim.image.rendering.rock_pass import GroundSeen, ROCK_MIN_PX
from lunar_rover_sim.image.rendering.scene import LEFT, LOWEST_M, Request, Scene, SceneLight
from lunar_rover_sim.image.rendering.sun_pass import EarthImage, SunPass
from lunar_rover_sim.image.rendering.world_passes import WorldPasses
from lunar_rover_sim.rover.pose import RoverPose


@dataclasses.dataclass(frozen=True)
class Drawn:
    """What was read of a scene, by side.

    Attributes:
        samples: Images that are lit, with several samples a pixel where that is wanted.
        depth_m: (h, w) of pixels, as in `LitImage`; those of the samples where these are pixels.
        truth: Layers of truth but depth, (h, w) or (h, w, 3) of pixels.
        surfaces: By the number of the drawing and the side, where light or truth is wanted.
        face: (h, w, 3) true normals of rocks and the rover, of pixels.
        links: Whether links of the rover are asked for.
    """

    samples: dict[int, LitImage]
    depth_m: dict[int, NDArray[np.float32]]
    truth: dict[int, dict[str, NDArray[Any]]]
    surfaces: dict[tuple[int, int], Surfaces]
    face: dict[int, NDArray[np.float32]]
    links: bool


class ScenePasses(GlOwner):
    """Draws the world, as a pair of cameras sees it, into radiance, depth and truth.

    With supersampling radiance is drawn at several samples a pixel and averaged. Depth and truth
    are drawn at the centres of pixels.
    """

    def __init__(self, context: moderngl.Context, shared: WorldPasses, mount: TurnedMount,
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
        self._pixels = self._samples = self._own(Canvas(context, projection))
        self._times = samples
        if samples > 1:
            self._samples = self._own(Canvas(context, projection.finer(samples)))
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
            self._sun.look(scene, volume, shared)
        for drawing in scene.drawings:
            for side in drawing.sides:
                drawing.targets.views[side].place(cameras[side], drawing.projection,
                                                  volume.centre_m)
        scene.depth_m = shared.ground.depths(
            {(number, side): (drawing.targets.views[side].numbers, drawing.projection)
             for number, drawing in enumerate(scene.drawings) for side in drawing.sides},
            scene.tracks, shared.workers)
        scene.shows_rover = self._sees_rover and shared.body.is_in_view(links, volume)
        shared.rocks.choose(volume, projection.focal_px, ROCK_MIN_PX, [
            GroundSeen(cameras[side], scene.drawings[number].projection, depth_m)
            for (number, side), depth_m in scene.depth_m.items()])
        scene.lights = [self._light_of(source, scene) for source in sources]
        return scene

    def _drawings(self, request: Request) -> tuple[Drawing, Drawing]:
        """Return the drawings of pixels and of samples, which may be one."""
        if self._samples is self._pixels:
            both = self._pixels.begin(request.sides, request.lit_sides)
            return both, both
        return (self._pixels.begin(request.sides, ()),
                self._samples.begin(request.lit_sides, request.lit_sides))

    @staticmethod
    def _light_of(source: WorldPasses, scene: Scene) -> SceneLight:
        """Return what the light of a source needs."""
        links, shadow = scene.T_world_links, source.rover_shadow
        body = None
        if scene.shows_rover:
            body = source.body.light(links, shadow.radius_m, source.sunlight,
                                     source.config.sun.irradiance, source.sun_axes)
        return SceneLight(shadow.cast(links, source.sun_axes), body)

    def light(self, scene: Scene) -> None:
        """Draw what is where of rocks and the rover; light is computed when they are read."""
        for k, (source, light) in enumerate(zip(self._shared.sources, scene.lights)):
            if light.body is not None:
                scene.lights[k] = SceneLight(light.shadow, source.body.cast(scene.T_world_links,
                                                                            light.body))
        for drawing in scene.drawings:
            for side in drawing.sides:
                drawing.targets.views[side].bind()
                clear_window(self._target(scene, drawing, side), drawing.windows[side])
                self._shared.rocks.draw()
                if scene.shows_rover:
                    self._shared.body.draw(scene.T_world_links)
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
                sources = [source.ground for source in self._sources(scene, drawing, side)]
                lit = side in drawing.lit_sides or 'shadow' in truth
                parts[number, side] = Part(
                    drawing, side, scene.depth_m[number, side], lit, self._colour, truth,
                    shared.ground.relief, scene.tracks.lit, sources,
                    shared.crater_lists() if 'crater' in truth else None)
        return GroundPicture(shared.workers, parts)

    def read(self, scene: Scene, *, links: bool) -> Drawn:
        """Read what was drawn of a scene; links: whether those are asked for."""
        request, surfaces, depths = scene.request, {}, {}
        face, truth = {}, {}
        last = len(scene.drawings) - 1
        for number, drawing in enumerate(scene.drawings):
            size = drawing.projection.height, drawing.projection.width
            for side in drawing.sides:
                target, told = self._target(scene, drawing, side), self._truth_of(scene, drawing,
                                                                                  side)
                depth_m = depths[number, side] = read_image(target, DEPTH, side, size)
                if side in drawing.lit_sides or told or links:
                    surfaces[number, side] = Surfaces(
                        depth_m, read_image(target, SURFACE, side, size, 2, 'u4'),
                        drawing.targets.views[side].numbers)
                if told:
                    truth[side] = _blank_truth(told, size)
                if 'normal' in told:
                    face[side] = read_image(target, FACE, side, size, 3)
        samples = {}
        for side in request.lit_sides:
            shape = depths[0, side].shape
            samples[side] = LitImage(np.zeros(shape, np.float32), depths[0, side],
                                     tint=np.zeros(shape, np.uint32) if self._colour else None)
        return Drawn(samples, {side: depths[last, side] for side in request.sides}, truth,
                     surfaces, face, links and scene.shows_rover)

    def finish(self, scene: Scene, drawn: Drawn) -> dict[int, LitImage]:
        """Return the lit images of a scene, by side: with smooth outlines, Earth and sun."""
        samples, ground, workers = drawn.samples, scene.ground, self._shared.workers
        assert ground is not None
        ground.make()
        if ground in self._shared.waiting:
            self._shared.waiting.remove(ground)
        last, parts = len(scene.drawings) - 1, self._shared.body.parts
        pixel = 1.0 / self._samples.projection.focal_px
        far_m = far_ground(pixel, scene.above_m)
        link = {}
        for side, image in samples.items():
            cover(image, ground.images[0, side], workers, far_m)
            shadow = None if last else drawn.truth.get(side, {}).get('shadow')
            drawn.surfaces[0, side].light(self._sources(scene, scene.samples, side), workers,
                                          image.radiance, image.tint, shadow)
        for side, depth_m in drawn.depth_m.items():
            own = ground.images[last, side]
            if last or side not in samples:
                cover_depth(depth_m, own.depth_m, workers)
                if 'shadow' in drawn.truth.get(side, {}):
                    drawn.surfaces[last, side].light(
                        self._sources(scene, scene.pixels, side)[:1], workers, None, None,
                        drawn.truth[side]['shadow'])
            if drawn.links:     # what the ground does not hide of the rover
                link[side] = drawn.surfaces[last, side].links(parts)
            if side in drawn.truth:
                tell_objects(drawn.truth[side], drawn.surfaces[last, side], parts,
                             self._shared.rock_labels, drawn.face.get(side))
                tell(drawn.truth[side], depth_m, own)
        self._earth.draw(scene, samples.values())   # before outlines in front of it are smoothed
        if self._config.detail.smooth_outlines:
            for image in samples.values():
                smooth_outlines(image.radiance, image.depth_m, pixel, scene.above_m, workers)
        self._sun.draw(scene, samples)
        return {side: LitImage(_averaged(image.radiance, self._times), drawn.depth_m[side],
                               link.get(side), _averaged_tint(image, self._times))
                for side, image in samples.items()}

    @staticmethod
    def _truth_of(scene: Scene, drawing: Drawing, side: int) -> set[str]:
        """Return the layers of truth that are drawn in a drawing of a camera."""
        return scene.request.truth_of(side) if drawing is scene.pixels else set()

    def _target(self, scene: Scene, drawing: Drawing, side: int) -> moderngl.Framebuffer:
        """Return what a camera is drawn into, with true normals if those are wanted."""
        return drawing.targets.of(side, faces='normal' in self._truth_of(scene, drawing, side))

    def _sources(self, scene: Scene, drawing: Drawing, side: int) -> list[ObjectSource]:
        """Return the sources of light of a camera; the sun alone where only truth is drawn."""
        every = [source.source(light, None if k else scene.lamp, scene.T_world_links)
                 for k, (source, light) in enumerate(zip(self._shared.sources, scene.lights))]
        return every if side in drawing.lit_sides else every[:1]

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


def _blank_truth(layers: set[str], size: tuple[int, int]) -> dict[str, NDArray[Any]]:
    """Return layers of truth of the sky."""
    kinds: dict[str, tuple[type, tuple[int, ...]]] = {
        'label': (np.uint16, ()), 'crater': (np.uint16, ()), 'normal': (np.float32, (3,)),
        'shadow': (np.uint8, (3,))}
    return {name: np.zeros((*size, *kinds[name][1]), kinds[name][0]) for name in layers}


def _averaged(radiance: NDArray[np.float32], times: int) -> NDArray[np.float32]:
    """Return the means of the times x times samples of each pixel."""
    if times == 1:
        return radiance
    # A tenth of the time of `mean` over axes of so few.
    rows = (sum(radiance[i::times, j::times] for j in range(times)) for i in range(times))
    return np.asarray(sum(rows) / times**2, np.float32)


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
