"""One camera, or a pair of equal ones, of a renderer: from a state to its images and truth.

The scene is drawn on faces, pinhole images from the place of the camera: one, with the margin that
distortion needs, of a pinhole, and up to five of a fisheye (`fisheye_faces`). All that lens,
motion and sensor do happens in the image that the faces make.
"""

from __future__ import annotations

import collections
from collections.abc import Callable, Iterable
import dataclasses
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.base.workers import Workers
from lunar_rover_sim.image.camera.config import SensorConfig
from lunar_rover_sim.image.camera.development import Development, Light
from lunar_rover_sim.image.camera.fisheye import FisheyeCamera
from lunar_rover_sim.image.camera.miscalibration import Miscalibration
from lunar_rover_sim.image.camera.mount import Mount, TurnedMount
from lunar_rover_sim.image.camera.rig import PinholeCamera
from lunar_rover_sim.image.camera.sensor import SensorModel
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.context import GlOwner
from lunar_rover_sim.image.rendering.faces import check_size, FisheyeFaces, PinholeFace
from lunar_rover_sim.image.rendering.frame import StereoFrame
from lunar_rover_sim.image.rendering.projection import Projection
from lunar_rover_sim.image.rendering.scene import LEFT, Request, Scene, SeenSun
from lunar_rover_sim.image.rendering.scene_passes import ScenePasses
from lunar_rover_sim.image.rendering.world_passes import WorldPasses
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.rover.primitives import merge
from lunar_rover_sim.rover.visual import link_poses, visual_parts


class CameraRenderer(GlOwner):
    """Draws what the cameras on one mount see. The caller makes the GL context current.

    The layer depth of a fisheye is the distance from the camera.
    """

    def __init__(self, context: moderngl.Context, shared: WorldPasses, mount: Mount,
                 camera: PinholeCamera | FisheyeCamera, config: RenderConfig, seed: int) -> None:
        """Prepare all that does not depend on the state.

        Args:
            context: What draws.
            shared: Passes of the world.
            mount: Carries the cameras.
            camera: Geometry of either.
            config: Of these cameras.
            seed: Of their noise.

        Raises:
            RenderError: If the device cannot draw this image size.
        """
        super().__init__()
        self._config, self._mount, self._shared, self._K = config, mount, shared, camera.K
        self._faces = faces = _faces(camera, config)
        check_size(context, faces.image)
        for projection in faces.projections:
            check_size(context, projection, faces.samples)
        seen = self._seen_links()
        # Links that move in the images.
        self._links = [link for link in seen if link > 0 or not mount.on_body]
        self._begun: collections.deque[tuple[RoverPose, list[Scene]]] = collections.deque()
        self._axes = np.stack([turn[:, 2] for turn in faces.turns])
        with self._making():
            self._passes = [self._own(ScenePasses(
                context, shared, TurnedMount(mount, turn), config, projection,
                sees_rover=bool(seen), strays=self._strays_to(k), samples=faces.samples))
                for k, (turn, projection) in enumerate(zip(faces.turns, faces.projections))]
            self._development = Development(
                camera, faces.image, faces.lens, config.sensor, light_of(config), seed,
                Miscalibration.drawn(config.miscalibration, seed), on_body=mount.on_body,
                workers=shared.workers)

    def _seen_links(self) -> tuple[int, ...]:
        """Return the links of the rover that may be in view; all if the mount is not on it."""
        rover = self._shared.rover
        if not self._mount.on_body:
            return tuple(range(1 + len(rover.legs.each)))
        at_origin = RoverPose(np.eye(4))
        return tuple(sorted({
            link for turn, projection in zip(self._faces.turns, self._faces.projections)
            for link in seen_links(rover, TurnedMount(self._mount, turn).poses(at_origin),
                                   projection)}))

    def _strays_to(self, index: int) -> Callable[[Array], bool]:
        """Return whether sunlight strays in the lens, and a face is the one to draw it.

        Args:
            index: Of the face; the result takes the (3,) direction to the sun in its axes.
        """
        def strays(direction: Array) -> bool:
            own = self._faces.turns[index] @ direction
            return int(np.argmax(self._axes @ own)) == index and self._faces.lens.strays(own)
        return strays

    @property
    def sensor(self) -> SensorModel:
        """Image sensors."""
        return self._development.sensor

    @property
    def exposure_s(self) -> float:
        """Exposure time of the last frame, or of the first one before it [s]."""
        return self._development.exposure_s

    @property
    def exposure(self) -> tuple[float, float, bool]:
        """See `Development.exposure`."""
        return self._development.exposure

    @exposure.setter
    def exposure(self, exposure: tuple[float, float, bool]) -> None:
        self._development.exposure = exposure

    @property
    def under_way(self) -> int:
        """Number of frames that are begun and not finished; the first of them is lit."""
        return len(self._begun)

    def relight(self, sun: SunConfig) -> None:
        """Move the sun; the light of the world is moved by `WorldPasses.relight`."""
        self._config = dataclasses.replace(self._config, sun=sun)
        for passes in self._passes:
            passes.relight(self._config)
        self._development.meter(light_of(self._config))

    def expose(self, sensor: SensorConfig) -> None:
        """Take other parameters of the exposure; see `Development.expose`."""
        self._config = dataclasses.replace(self._config, sensor=sensor)
        self._development.expose(sensor, light_of(self._config))

    def draw(self, state: RoverPose, request: Request) -> StereoFrame:
        """Return a frame; none may be under way."""
        self.begin(state, request)
        return self.finish()

    def begin(self, state: RoverPose, request: Request) -> None:
        """Begin to draw a frame.

        At most `FRAMES_UNDER_WAY` may be under way of a camera with one face, and one of others.
        """
        scenes = list[Scene]()
        for passes in self._passes:
            scenes.append(passes.begin(request, state))
            if not self._begun:     # what was chosen for a face holds until the next one
                passes.light(scenes[-1])
        self._begun.append((state, scenes))

    def finish(self) -> StereoFrame:
        """Return the frame that was begun first; one must be under way."""
        state, scenes = self._begun.popleft()
        whole = self._whole(scenes, state)
        request, develop = whole.request, self._development
        movements = {side: whole.movement(side, self._mount, self._shared.rover,
                                          self._faces.image, self._links)
                     for side in request.lit_sides}
        links = request.developed and any(map(develop.blurs, movements.values()))
        drawn = [passes.read(scene, links=links) for passes, scene in zip(self._passes, scenes)]
        if self._begun:     # it is lit into the targets that have just been read
            for passes, scene in zip(self._passes, self._begun[0][1]):
                passes.light(scene)
        images = [passes.finish(scene, read)
                  for passes, scene, read in zip(self._passes, scenes, drawn)]
        lit, depth_m = self._faces.gather(scenes, drawn, images)
        truth = self._faces.truth(scenes, drawn)
        out = dict[str, NDArray[Any]]()
        if 'radiance' in request.layers:
            out['radiance'] = develop.inside(lit[LEFT].radiance).copy()
        if request.developed:
            out |= request.images(develop.take(lit, movements, whole.sun, request.frame_index))
        for side in request.sides:
            if request.depth_of(side):
                name, depth = request.name('depth', side), develop.inside(depth_m[side])
                true_m = true_depth(depth, self._shared.workers)
                if name in request.layers:
                    out[f'{name}_m'] = true_m
                if side == LEFT and request.flow:
                    out |= self._passes[0].flow(scenes[0], self._K, true_m, truth['label'])
        for name in request.layers.intersection(truth):
            numbers = truth[name].dtype == np.uint16    # labels and craters
            out[name] = (truth[name].astype(np.int32) if numbers
                         else np.ascontiguousarray(truth[name]))
        return StereoFrame(**out, exposure_s=self.exposure_s,
                           encoding=self._config.sensor.encoding)

    def _whole(self, scenes: list[Scene], state: RoverPose) -> Scene:
        """Return the scene of the camera's image from those of its faces."""
        sun: SeenSun | None = None
        for turn, scene in zip(self._faces.turns, scenes):
            # A disc on a seam is seen from two faces, which agree.
            if scene.sun is not None:
                sun = scene.sun if len(scenes) == 1 else SeenSun(turn @ scene.sun.direction,
                                                                 scene.sun.irradiance)
        return dataclasses.replace(
            scenes[0], T_world_cameras=self._mount.poses(state), sun=sun,
            shows_rover=any(scene.shows_rover for scene in scenes))

    def abandon(self) -> None:
        """Forget the frames under way."""
        self._begun.clear()

    def release(self) -> None:
        """Release the GL objects."""
        self._begun.clear()
        super().release()


def _faces(camera: PinholeCamera | FisheyeCamera,
           config: RenderConfig) -> PinholeFace | FisheyeFaces:
    """Return the faces of a camera."""
    if isinstance(camera, FisheyeCamera):
        return FisheyeFaces(camera, config)
    return PinholeFace(camera, config)


def light_of(config: RenderConfig) -> Light:
    """Return what the first exposure follows from."""
    return Light(config.sun, config.lamp, config.reflectance)


def true_depth(drawn_m: NDArray[np.float32], workers: Workers) -> NDArray[np.float32]:
    """Return depth that was drawn, as the layer has it: positive, infinite in the sky."""
    depth_m = np.empty(drawn_m.shape, np.float32)
    workers.rows(_true_depth, len(depth_m), drawn_m, depth_m)
    return depth_m


@compiled
def _true_depth(first, last, drawn, depth):  # type: ignore[no-untyped-def]
    """Fill in rows of (h, w) depth."""
    for r in range(first, last):
        own, out = drawn[r], depth[r]
        for c in range(len(own)):
            out[c] = abs(own[c]) if own[c] != 0.0 else np.inf


_ANGLES = 36            # of a leg that turns once
_BEYOND = 0.02          # of half the field of view: what comes in between two angles


def seen_links(rover: RoverDescription, T_base_cameras: Iterable[Array],
               projection: Projection) -> tuple[int, ...]:
    """Return the indices of links that may show in the images: 0 base_link, then the legs.

    A link counts if a camera sees one of its triangles at any leg angle, or nearly so.

    Args:
        T_base_cameras: (4, 4) poses of the optical frames.
    """
    links, parts = list(link_poses(rover)), visual_parts(rover)
    meshes = [merge([(part.vertices.astype(float), part.faces.astype(np.int64))
                     for part in parts if part.link == link]) for link in links]
    cameras = [inverse(T) for T in T_base_cameras]
    planes = _planes(projection)
    seen = set()
    for angle in np.linspace(0.0, 2.0 * np.pi, _ANGLES, endpoint=False):
        poses = link_poses(rover, np.full(len(links) - 1, angle))
        for index, (link, (vertices, faces)) in enumerate(zip(links, meshes)):
            if index in seen or (index == 0 and angle > 0.0):
                continue
            for T_camera_base in cameras:
                T = T_camera_base @ poses[link]
                within = (vertices @ T[:3, :3].T + T[:3, 3]) @ planes.T
                within[:, -1] -= projection.near_m
                inside = within > 0.0
                if not np.all(np.any(inside, axis=0)):      # all of it is beyond one plane
                    continue
                a, b, c = inside[faces.T]
                if np.any(np.all(a | b | c, axis=1)):
                    seen.add(index)
                    break
    return tuple(sorted(seen))


def _planes(projection: Projection) -> Array:
    """Return (5, 3) normals, inwards, of the sides of the view volume and of its near end."""
    K, w, h = projection.K, projection.width, projection.height
    grow = 1.0 + _BEYOND
    return np.array([[1.0, 0.0, grow * (K[0, 2] + 0.5) / K[0, 0]],
                     [-1.0, 0.0, grow * (w - K[0, 2] - 0.5) / K[0, 0]],
                     [0.0, 1.0, grow * (K[1, 2] + 0.5) / K[1, 1]],
                     [0.0, -1.0, grow * (h - K[1, 2] - 0.5) / K[1, 1]], [0.0, 0.0, 1.0]])
