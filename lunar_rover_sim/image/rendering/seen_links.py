"""Links of the rover that its own cameras can see."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.image.rendering.projection import Projection
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.primitives import merge
from lunar_rover_sim.rover.visual import link_poses, visual_parts

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
