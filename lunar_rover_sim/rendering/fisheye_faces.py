"""The planes that a fisheye image is drawn on: the faces of a cube, as far as they are seen.

What is drawn is made of triangles, which a fisheye would bend. So each face is drawn as a pinhole
image from the same place, and the fisheye image is sampled from them. A face has at least as many
pixels per solid angle as the fisheye has anywhere within it, and more with supersampling. Four
faces beside the front one show up to 35 deg beyond the plane of the lens.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera import equidistant
from lunar_rover_sim.camera.fisheye import FisheyeCamera
from lunar_rover_sim.camera.hazard_config import HazardCameraConfig
from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.projection import Projection

_ALONE_RAD = math.radians(52.0)     # up to this angle to the axis one face shows all
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

    R_camera_face: (3, 3) its axes in those of the fisheye; projection: what is drawn
    first, end: column and row of the first pixel, and after the last one, of that part
    shows: (rows, columns) which pixels within are its own; source: (rows, columns, 2) int, column
        and row in the face nearest to what they show
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

    samples: of a face along a side of a pixel of the fisheye, at least
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
