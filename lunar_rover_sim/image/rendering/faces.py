"""The planes that a camera's image is drawn on: one of a pinhole, those of a cube of a fisheye.

What is drawn is made of triangles, which a fisheye would bend. So each face is drawn as a pinhole
image from the same place, and the fisheye image is sampled from them. A face has at least as many
pixels per solid angle as the fisheye has anywhere within it, and more with supersampling. Four
faces beside the front one show up to 35 deg beyond the plane of the lens.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.errors import RenderError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.camera import equidistant
from lunar_rover_sim.image.camera.development import LitImage
from lunar_rover_sim.image.camera.fisheye import FisheyeCamera, FisheyeLens
from lunar_rover_sim.image.camera.hazard import HazardCameraConfig
from lunar_rover_sim.image.camera.image_geometry import FisheyeImage, PinholeImage
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


def check_size(context: moderngl.Context, image: Projection | PinholeImage | FisheyeImage,
               samples: int = 1) -> None:
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


_ALONE_RAD = math.radians(52.0)     # up to this angle to the axis one face shows all
_STEEPEST = 3.5         # times the change of inverse depth from row to row of level ground
_MARGIN_PX = 4.0        # beyond the sampled part, so that edges are smooth up to its border
# Axes of the faces as columns: front, right, left, below, above.
_TURNS = (np.eye(3),
          np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
          np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
          np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
          np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))


@dataclasses.dataclass(frozen=True)
class Face:
    """One face and the part of the fisheye image that it shows.

    Attributes:
        R_camera_face: (3, 3) its axes in those of the fisheye.
        projection: What is drawn.
        first, end: Column and row of the first pixel, and after the last one, of that part.
        shows: (rows, columns) which pixels within are its own.
        source: (rows, columns, 2) int, column and row in the face nearest to what they show.
    """

    R_camera_face: Array
    projection: Projection
    first: NDArray[np.int64]
    end: NDArray[np.int64]
    shows: NDArray[np.bool_]
    source: NDArray[np.int64]


def faces(camera: FisheyeCamera, config: HazardCameraConfig,
          samples: int = 1) -> tuple[Face, ...]:
    """Return the faces that a fisheye needs, the front one first.

    Args:
        samples: Of a face along a side of a pixel of the fisheye, at least.
    """
    places = camera.pixels()
    directions = camera.directions(places)
    corners = camera.angles([(-0.5, -0.5)])
    turns = _TURNS[:1] if float(corners.max()) <= _ALONE_RAD else _TURNS
    ahead = np.stack([directions @ turn[:, 2] for turn in turns])
    nearest = np.argmax(np.where(np.isnan(ahead), -np.inf, ahead), axis=0)
    inside = ~np.isnan(directions[..., 0])
    result = []
    for k, turn in enumerate(turns):
        shown = inside & (nearest == k)
        if np.any(shown):
            result.append(_face(camera, config, turn, shown, directions @ turn, samples))
    return tuple(result)


class FaceSampler:
    """Samples the part of a fisheye image that a face shows."""

    def __init__(self, camera: FisheyeCamera, face: Face, places: int) -> None:
        """Compute which places of the face are sampled.

        Args:
            camera: The fisheye.
            face: What is drawn.
            places: Along a side of a pixel of the fisheye that its radiance is the mean of.
        """
        self._face = face
        rows, columns = np.nonzero(face.shows)
        self._rows, self._columns = rows + face.first[1], columns + face.first[0]
        self._nearest = face.source[face.shows]
        image, own = FisheyeImage(camera), np.stack([self._columns, self._rows], axis=-1)
        parts = (np.arange(places) + 0.5) / places - 0.5
        self._places = np.stack([self._in_face(image.rays(own + (x, y)))[0]
                                 for y in parts for x in parts], axis=1).astype(np.float32)
        self._middle, self._length = self._in_face(image.rays(own.astype(float)))

    def _in_face(self, rays: Array) -> tuple[Array, Array]:
        """Return (n, 2) places in the face of (n, 3) rays, and their lengths at depth 1."""
        seen = rays @ self._face.R_camera_face
        K = self._face.projection.K
        return (K[0, 0] * seen[:, :2] / seen[:, 2:] + K[:2, 2],
                np.linalg.norm(seen, axis=1) / seen[:, 2])

    def add_radiance(self, radiance: NDArray[np.float32], into: NDArray[np.float32]) -> None:
        """Fill in the mean radiance of the pixels that the face shows."""
        into[self._rows, self._columns] = _mean_at(radiance, self._places)

    def add_nearest(self, pixels: NDArray[Any], into: NDArray[Any]) -> None:
        """Fill in what the nearest pixels of the face show."""
        into[self._rows, self._columns] = pixels[self._nearest[:, 1], self._nearest[:, 0]]

    def add_distance(self, depth_m: NDArray[np.float32], above_m: float,
                     into: NDArray[np.float32]) -> None:
        """Fill in distances from the camera.

        Inverse depth is linear over a plane. Beside an outline it is that of the nearest pixel.

        Args:
            depth_m: Of the face, as in `LitImage`.
            above_m: Height of the camera above the ground.
            into: (h, w) distances, with the signs of depth.
        """
        # Inverse depth of level ground changes by 1 / (focal_px above_m) a pixel; see `outlines`.
        outline = _STEEPEST / (self._face.projection.focal_px * above_m)
        into[self._rows, self._columns] = _depth_at(depth_m, self._middle, outline) * self._length


class FisheyeFaces:
    """The faces of a fisheye, and how its image is made of them, as `PinholeFace`."""

    def __init__(self, camera: FisheyeCamera, config: RenderConfig) -> None:
        assert isinstance(config.camera, HazardCameraConfig)
        self._size, finer = (camera.height, camera.width), config.detail.supersampling
        self._faces = faces(camera, config.camera, finer)
        self._samplers = [FaceSampler(camera, face, 2 * finer) for face in self._faces]
        self.lens, self.image = FisheyeLens(config.lens, config.camera), FisheyeImage(camera)
        self.turns = tuple(face.R_camera_face for face in self._faces)
        self.projections = tuple(face.projection for face in self._faces)
        self.samples = 1    # a face has as many pixels as samples are asked for

    def gather(self, scenes: list[Scene], drawn: list[Drawn],
               lit: list[dict[int, LitImage]]) -> tuple[dict[int, LitImage],
                                                        dict[int, NDArray[np.float32]]]:
        """Return by side what falls on the sensor, and distances with the signs of depth."""
        request = scenes[0].request
        links = any(face.links for face in drawn)
        colour = any(image.tint is not None for images in lit for image in images.values())
        whole = {side: LitImage(np.zeros(self._size, np.float32), np.zeros(self._size, np.float32),
                                np.zeros(self._size, np.uint8) if links else None,
                                np.zeros(self._size, np.uint32) if colour else None)
                 for side in request.lit_sides}
        depth_m = {side: whole[side].depth_m if side in whole else np.zeros(self._size, np.float32)
                   for side in request.sides}
        for sampler, scene, face, images in zip(self._samplers, scenes, drawn, lit):
            for side, image in images.items():
                sampler.add_radiance(image.radiance, whole[side].radiance)
                tint, link = whole[side].tint, whole[side].link
                if image.tint is not None and tint is not None:
                    sampler.add_nearest(image.tint, tint)
                if image.link is not None and link is not None:
                    sampler.add_nearest(image.link, link)
            for side, drawn_m in face.depth_m.items():
                sampler.add_distance(drawn_m, scene.above_m, depth_m[side])
        return whole, depth_m

    def truth(self, scenes: list[Scene], drawn: list[Drawn]) -> dict[str, NDArray[Any]]:
        """Return layers of truth but depth, from the nearest pixels drawn."""
        request, result = scenes[0].request, dict[str, NDArray[Any]]()
        for sampler, face in zip(self._samplers, drawn):
            for side, layers in face.truth.items():
                for layer, pixels in layers.items():
                    into = result.setdefault(request.name(layer, side), np.zeros(
                        (*self._size, *pixels.shape[2:]), pixels.dtype))
                    sampler.add_nearest(pixels, into)
        return result


@compiled
def _mean_at(image, places):  # type: ignore[no-untyped-def]
    """Return the (n,) means of an image at (n, m, 2) places, column and row."""
    h, w = image.shape
    n, m = places.shape[:2]
    result = np.empty(n, np.float32)
    for k in range(n):
        total = 0.0
        for i in range(m):
            x, y = min(max(places[k, i, 0], 0.0), w - 1.001), min(max(places[k, i, 1], 0.0),
                                                                  h - 1.001)
            c, r = int(x), int(y)
            x, y = x - c, y - r
            upper = image[r, c] + x * (image[r, c + 1] - image[r, c])
            lower = image[r + 1, c] + x * (image[r + 1, c + 1] - image[r + 1, c])
            total += upper + y * (lower - upper)
        result[k] = total / m
    return result


@compiled
def _depth_at(depth, places, outline):  # type: ignore[no-untyped-def]
    """Return the (n,) depths at (n, 2) places, column and row.

    Args:
        outline: Least difference of inverse depths of two surfaces [1/m].
    """
    h, w = depth.shape
    result = np.empty(len(places), np.float32)
    for k in range(len(places)):
        x, y = min(max(places[k, 0], 0.0), w - 1.001), min(max(places[k, 1], 0.0), h - 1.001)
        own = depth[int(y + 0.5), int(x + 0.5)]
        result[k] = own
        if own == 0.0:
            continue
        c, r = int(x), int(y)
        nearness, one_surface = 0.0, True
        for i in range(4):
            there = depth[r + i // 2, c + i % 2]
            if there == 0.0 or abs(1.0 / there - 1.0 / own) > outline:
                one_surface = False
                break
            nearness += (((x - c) if i % 2 else (1.0 - x + c))
                         * ((y - r) if i // 2 else (1.0 - y + r)) / there)
        if one_surface:
            result[k] = 1.0 / nearness
    return result


def _face(camera: FisheyeCamera, config: HazardCameraConfig, turn: Array,
          shown: NDArray[np.bool_], directions: Array, samples: int) -> Face:
    """Return a face; directions: (h, w, 3) of all pixels in its axes."""
    rows, columns = np.nonzero(shown)
    first = np.array([columns.min(), rows.min()])
    end = np.array([columns.max(), rows.max()]) + 1
    seen = directions[shown]
    tangents = seen[:, :2] / seen[:, 2:]
    # Pixels per steradian of the fisheye, and of the face per square of its focal length.
    theta = camera.angles(np.stack([columns, rows], axis=-1).astype(float))
    theta = np.maximum(theta, 1e-6)
    dense = camera.focal_px**2 * (equidistant.radius(theta, camera.D) / np.sin(theta)
                                  * equidistant.radius_slope(theta, camera.D))
    focal = samples * math.sqrt(float(np.max(dense * seen[:, 2]**3)))
    # Samples lie within half a pixel of the fisheye from the centres of pixels.
    stride = focal / camera.focal_px * float(np.max(1.0 / seen[:, 2]**2))
    margin = 0.5 * stride + _MARGIN_PX
    low = np.floor(focal * tangents.min(axis=0) - margin)
    high = np.ceil(focal * tangents.max(axis=0) + margin)
    width, height = (high - low).astype(int) + 1
    K = np.array([[focal, 0.0, -low[0]], [0.0, focal, -low[1]], [0.0, 0.0, 1.0]])
    projection = Projection(K, int(width), int(height), config.near_m, config.far_m)
    part = slice(first[1], end[1]), slice(first[0], end[0])
    source = np.zeros((*shown[part].shape, 2), int)
    source[shown[part]] = np.rint(focal * tangents - low)
    return Face(turn, projection, first, end, shown[part], source)
