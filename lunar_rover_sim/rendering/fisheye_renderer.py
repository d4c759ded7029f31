"""A fisheye, or a pair of equal ones, of a renderer: from a state to its images and truth."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera.development import Development, LitImage
from lunar_rover_sim.camera.fisheye import FisheyeCamera, FisheyeLens
from lunar_rover_sim.camera.hazard import HazardCameraConfig
from lunar_rover_sim.camera.image_geometry import FisheyeImage
from lunar_rover_sim.camera.mount import Mount, TurnedMount
from lunar_rover_sim.frames import Array
from lunar_rover_sim.illumination.config import SunConfig
from lunar_rover_sim.rendering.camera_renderer import check_size, light_of, true_depth
from lunar_rover_sim.rendering.config import RenderConfig
from lunar_rover_sim.rendering.fisheye_faces import Face, faces, FaceSampler
from lunar_rover_sim.rendering.frame import StereoFrame
from lunar_rover_sim.rendering.gl_owner import GlOwner
from lunar_rover_sim.rendering.scene import LEFT, Request, Scene, SeenSun
from lunar_rover_sim.rendering.scene_passes import ScenePasses
from lunar_rover_sim.rendering.seen_links import seen_links
from lunar_rover_sim.rendering.world_passes import WorldPasses
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import RoverPose


class FisheyeRenderer(GlOwner):
    """Draws what fisheyes on one mount see. The caller makes the GL context current.

    The scene is drawn and lit on faces (`fisheye_faces`); all that lens, motion and sensor do
    happens in the fisheye image. The layer depth is the distance from the camera.

    camera: the geometry of either
    """

    def __init__(self, context: moderngl.Context, shared: WorldPasses, mount: Mount,
                 camera: FisheyeCamera, config: RenderConfig, seed: int) -> None:
        """Prepare all that does not depend on the state; config: of these cameras.

        Raises RenderError if the device cannot draw this image size.
        """
        super().__init__()
        assert isinstance(config.camera, HazardCameraConfig)
        self.camera, self._config, self._mount = camera, config, mount
        self._shared = shared
        samples = config.detail.supersampling
        self._faces = faces(camera, config.camera, samples)
        self._axes = np.stack([face.R_camera_face[:, 2] for face in self._faces])
        self._lens = FisheyeLens(config.lens, config.camera)
        self._image = FisheyeImage(camera)
        check_size(context, self._image)
        for face in self._faces:
            check_size(context, face.projection)
        seen = _seen_links(shared.rover, mount, self._faces)
        self._links = [link for link in seen if link > 0 or not mount.on_body]
        self._samplers = [FaceSampler(camera, face, 2 * samples) for face in self._faces]
        self._development = Development(camera, self._image, self._lens, config.sensor,
                                        light_of(config), seed, on_body=mount.on_body)
        with self._making():
            self._passes = [self._own(ScenePasses(
                context, shared, TurnedMount(mount, face.R_camera_face), config, face.projection,
                sees_rover=bool(seen), strays=functools.partial(self._strays, k)))
                for k, face in enumerate(self._faces)]

    @property
    def exposure_s(self) -> float:
        """Exposure time of the last frame, or of the first one before it [s]."""
        return self._development.exposure_s

    def relight(self, sun: SunConfig) -> None:
        """Move the sun; the light of the world is moved by `WorldPasses.relight`."""
        self._config = dataclasses.replace(self._config, sun=sun)
        for passes in self._passes:
            passes.relight(self._config)
        self._development.meter(light_of(self._config))

    def draw(self, state: RoverPose, request: Request) -> StereoFrame:
        """Return a frame."""
        scenes = list[Scene]()
        # The ground is chosen once for all faces; each takes what it sees of it.
        around = self._shared.ground.choose(self._passes[0].surroundings(state))
        for passes in self._passes:
            scenes.append(passes.draw_geometry(request, state, around))
            passes.light(scenes[-1])
        whole = self._whole(scenes, state)
        movements = {side: whole.movement(side, self._mount, self._shared.rover, self._image,
                                          self._links) for side in request.lit_sides}
        links = request.developed and any(self._development.blurs(movement)
                                          for movement in movements.values())
        lit, depth_m, truth = self._read(scenes, request, links and whole.shows_rover)
        out: dict[str, NDArray[Any]] = {
            name: image.astype(np.int32) if image.dtype == np.uint16 else image
            for name, image in truth.items()}
        for side in request.sides:
            if request.depth_of(side):
                out[request.name('depth_m', side)] = true_depth(depth_m[side])
        if 'radiance' in request.layers:
            out['radiance'] = lit[LEFT].radiance.copy()
        if request.developed:
            out |= request.images(self._development.take(lit, movements, whole.sun,
                                                         request.frame_index))
        return StereoFrame(**out, exposure_s=self.exposure_s)

    def _read(self, scenes: list[Scene], request: Request, links: bool) -> tuple[
            dict[int, LitImage], dict[int, NDArray[np.float32]], dict[str, NDArray[Any]]]:
        """Return lit images and distances by side, and layers of truth but depth.

        links: whether to read which pixels show which link
        """
        size = self.camera.height, self.camera.width
        lit = {side: LitImage(np.zeros(size, np.float32), np.zeros(size, np.float32),
                              np.zeros(size, np.uint8) if links else None)
               for side in request.lit_sides}
        depth_m = {side: lit[side].depth_m if side in lit else np.zeros(size, np.float32)
                   for side in request.sides}
        truth = dict[str, NDArray[Any]]()
        for face, sampler, passes, scene in zip(self._faces, self._samplers, self._passes,
                                                scenes):
            drawn = passes.read(scene, links=links)
            for side, image in passes.finish(scene, drawn).items():
                sampler.add_radiance(image.radiance, lit[side].radiance)
                link = lit[side].link
                if image.link is not None and link is not None:
                    sampler.add_nearest(image.link, link)
            for side, drawn_m in drawn.depth_m.items():
                sampler.add_distance(drawn_m, scene.above_m, depth_m[side])
            for side in request.sides:
                if request.truth_of(side):
                    self._add_truth(truth, face, sampler, scene, side)
        return lit, depth_m, truth

    def abandon(self) -> None:
        """Do nothing: no frame is under way between calls."""

    def _strays(self, index: int, direction: Array) -> bool:
        """Return whether sunlight strays in the lens, and this face is the one to draw it.

        direction: (3,) of the sun, in axes of the face
        """
        own = self._faces[index].R_camera_face @ direction
        return int(np.argmax(self._axes @ own)) == index and self._lens.strays(own)

    def _whole(self, scenes: list[Scene], state: RoverPose) -> Scene:
        """Return the scene of the fisheye images from those of their faces."""
        sun: SeenSun | None = None
        for face, scene in zip(self._faces, scenes):
            # A disc on a seam is seen from two faces, which agree.
            if scene.sun is not None:
                sun = SeenSun(face.R_camera_face @ scene.sun.direction, scene.sun.irradiance)
        return dataclasses.replace(
            scenes[0], T_world_cameras=self._mount.poses(state), sun=sun,
            shows_rover=any(scene.shows_rover for scene in scenes))

    def _add_truth(self, truth: dict[str, NDArray[Any]], face: Face, sampler: FaceSampler,
                   scene: Scene, side: int) -> None:
        """Fill in the truth of the pixels that a face shows, from the nearest pixel drawn."""
        projection, request = face.projection, scene.request
        drawn = scene.pixels.targets.truth.read(
            request.truth_of(side), side, (projection.height, projection.width), (0, 0))
        for layer, pixels in drawn.items():
            name = request.name(layer, side)
            if name not in truth:
                truth[name] = np.zeros((self.camera.height, self.camera.width, *pixels.shape[2:]),
                                       pixels.dtype)
            sampler.add_nearest(pixels, truth[name])


def _seen_links(rover: RoverDescription, mount: Mount,
                drawn: tuple[Face, ...]) -> tuple[int, ...]:
    """Return the links of the rover that may be in view; all if the camera is not on the rover."""
    if not mount.on_body:
        return tuple(range(1 + len(rover.legs.each)))
    at_origin = RoverPose(np.eye(4))
    return tuple(sorted({link for face in drawn for link in seen_links(
        rover, TurnedMount(mount, face.R_camera_face).poses(at_origin), face.projection)}))
