"""A fisheye, or a pair of equal ones, of a renderer: from a state to its images and truth."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera.fisheye import FisheyeCamera, FisheyeLens
from lunar_rover_sim.camera.hazard_config import HazardCameraConfig
from lunar_rover_sim.camera.mount import Mount, TurnedMount
from lunar_rover_sim.frames import Array
from lunar_rover_sim.illumination.config import SunConfig
from lunar_rover_sim.rendering.camera_renderer import check_size
from lunar_rover_sim.rendering.config import RenderConfig
from lunar_rover_sim.rendering.development import Development
from lunar_rover_sim.rendering.fisheye_faces import Face, faces
from lunar_rover_sim.rendering.fisheye_pass import FisheyePass
from lunar_rover_sim.rendering.frame import StereoFrame
from lunar_rover_sim.rendering.frame_targets import LitTargets, read_image
from lunar_rover_sim.rendering.gl_owner import GlOwner
from lunar_rover_sim.rendering.image_geometry import FisheyeImage
from lunar_rover_sim.rendering.motion_pass import LinkTargets, MotionPass
from lunar_rover_sim.rendering.scene import ImagedSun, LEFT, Request, RIGHT, Scene
from lunar_rover_sim.rendering.scene_passes import ScenePasses
from lunar_rover_sim.rendering.seen_links import seen_links
from lunar_rover_sim.rendering.world_passes import WorldPasses
from lunar_rover_sim.rover.description import LEG_NAMES, RoverDescription
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
        self._world, self._shared = shared.world, shared
        samples = config.detail.supersampling
        self._faces = faces(camera, config.camera, samples)
        self._axes = np.stack([face.R_camera_face[:, 2] for face in self._faces])
        self._lens = FisheyeLens(config.lens, config.camera)
        image = FisheyeImage(camera)
        check_size(context, image)
        for face in self._faces:
            check_size(context, face.projection)
        seen = _seen_links(shared.rover, mount, self._faces)
        self._scenes: list[Scene] = []
        with self._making():
            self._passes = [self._own(ScenePasses(
                context, shared, TurnedMount(mount, face.R_camera_face), config, face.projection,
                sees_rover=bool(seen), strays=functools.partial(self._strays, k)))
                for k, face in enumerate(self._faces)]
            self._fisheye = self._own(FisheyePass(context, image, alone=len(self._faces) == 1,
                                                  samples=samples))
            self._marked = [self._own(LinkTargets(context, passes.lit.radiance.size))
                            for passes in self._passes] if seen else []
            motion = self._own(MotionPass(context, shared.rover, config, image, mount, seen))
            self._development = self._own(Development(context, config, camera, image, motion,
                                                      self._lens, seed))

    @property
    def exposure_s(self) -> float:
        """Exposure time of the last frame, or of the first one before it [s]."""
        return self._development.exposure_s

    @property
    def lit(self) -> LitTargets:
        """Radiance and distance of the fisheye images that were drawn last."""
        return self._fisheye.lit

    def relight(self, sun: SunConfig) -> None:
        """Move the sun; the light of the world is moved by `WorldPasses.relight`."""
        self._config = dataclasses.replace(self._config, sun=sun)
        for passes in self._passes:
            passes.relight(self._config)
        self._development.relight(sun)

    def draw(self, state: RoverPose, request: Request) -> StereoFrame:
        """Return a frame."""
        sides, raw = request.sides, dict[str, NDArray[Any]]()
        self._scenes.clear()
        self._fisheye.clear(self.lit.framebuffer, sides)
        camera_m = self._mount.poses(state)[LEFT][:3, 3]
        above_m = float(np.nan_to_num(camera_m[2] - self._world.height_at(camera_m[:2])))
        # The ground is chosen once for all faces; each takes what it sees of it.
        around = self._shared.ground.choose(self._passes[0].surroundings(state))
        for face, passes in zip(self._faces, self._passes):
            scene = passes.draw_geometry(request, state, around)
            passes.light(scene)
            self._scenes.append(scene)
            self._fisheye.add(face, passes.lit, sides, above_m)
            for side in sides:
                if request.truth_of(side):
                    self._add_truth(raw, face, scene, side)
        size = self.camera.height, self.camera.width
        out = dict[str, NDArray[Any]]()
        for side in sides:
            if request.depth_of(side):
                distance = np.abs(read_image(self.lit.framebuffer, 1, side, size, (0, 0)))
                distance[distance == 0.0] = np.inf
                out[request.name('depth_m', side)] = distance
        if 'radiance' in request.layers:
            out['radiance'] = read_image(self.lit.framebuffer, 0, LEFT, size, (0, 0))
        out |= {name: image.astype(np.int32) if image.dtype == np.uint16 else image
                for name, image in raw.items()}
        if request.developed:
            pixels = self._development.take(self, self._whole(state), lambda: read_image(
                self.lit.framebuffer, 0, request.lit_sides[0], size, (0, 0)))
            out |= self._development.images(pixels, request)
        return StereoFrame(**out, exposure_s=self.exposure_s)

    def mark_rover(self, scene: Scene, target: moderngl.Framebuffer) -> None:
        """Draw which link of the rover each pixel of a lit scene shows, as `RoverPass.mark`."""
        sides = scene.request.sides
        self._fisheye.clear(target, sides)
        for face, passes, marked, part in zip(self._faces, self._passes, self._marked,
                                              self._scenes):
            if part.shows_rover:
                passes.mark_rover(part, marked.framebuffer)
                self._fisheye.add_links(face, marked.link, target, sides)

    def abandon(self) -> None:
        """Do nothing: no frame is under way between calls."""

    def _strays(self, index: int, direction: Array) -> bool:
        """Return whether sunlight strays in the lens, and this face is the one to draw it.

        direction: (3,) of the sun, in axes of the face
        """
        own = self._faces[index].R_camera_face @ direction
        return int(np.argmax(self._axes @ own)) == index and self._lens.strays(own)

    def _whole(self, state: RoverPose) -> Scene:
        """Return the scene of the fisheye images from those of their faces."""
        sun: ImagedSun | None = None
        for face, scene in zip(self._faces, self._scenes):
            # A disc on a seam is seen from two faces, which agree.
            if scene.sun is not None:
                sun = ImagedSun(face.R_camera_face @ scene.sun.direction, scene.sun.irradiance)
        return dataclasses.replace(
            self._scenes[0], T_world_cameras=self._mount.poses(state), sun=sun,
            pixels=dataclasses.replace(self._scenes[0].pixels, windows=[
                self._fisheye.window(side) for side in (LEFT, RIGHT)]),
            shows_rover=any(scene.shows_rover for scene in self._scenes))

    def _add_truth(self, raw: dict[str, NDArray[Any]], face: Face, scene: Scene,
                   side: int) -> None:
        """Fill in the truth of the pixels that a face shows, from the nearest pixel drawn."""
        projection = face.projection
        request = scene.request
        drawn = scene.pixels.targets.truth.read(
            request.truth_of(side), side, (projection.height, projection.width), (0, 0))
        part = slice(face.first[1], face.end[1]), slice(face.first[0], face.end[0])
        column, row = face.source[face.shows].T
        for layer, pixels in drawn.items():
            name = request.name(layer, side)
            if name not in raw:
                raw[name] = np.zeros((self.camera.height, self.camera.width, *pixels.shape[2:]),
                                     pixels.dtype)
            raw[name][part][face.shows] = pixels[row, column]


def _seen_links(rover: RoverDescription, mount: Mount,
                drawn: tuple[Face, ...]) -> tuple[int, ...]:
    """Return the links of the rover that may be in view; all if the camera is not on the rover."""
    if not mount.on_body:
        return tuple(range(1 + len(LEG_NAMES)))
    at_origin = RoverPose(np.eye(4))
    return tuple(sorted({link for face in drawn for link in seen_links(
        rover, TurnedMount(mount, face.R_camera_face).poses(at_origin), face.projection)}))
