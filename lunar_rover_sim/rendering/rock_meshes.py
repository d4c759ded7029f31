"""Triangle meshes of rock shapes, fine and coarse."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.world.rocks import RockShape
from lunar_rover_sim.world.shapes import hull_faces

F32 = NDArray[np.float32]


def coarse(shape: RockShape, vertices: int) -> RockShape:
    """Return a simpler shape: the convex hull of a few vertices that are far apart.

    It is scaled to the same mean area of its outline. Over all directions, the mean outline of a
    convex body is a quarter of its surface (Cauchy's formula).
    """
    points = shape.vertices.astype(float)
    if len(points) <= vertices:
        return shape
    chosen = [int(np.argmax(np.linalg.norm(points, axis=1)))]
    apart = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < vertices:
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.linalg.norm(points - points[chosen[-1]], axis=1))
    kept = points[chosen]
    faces = _ordered(hull_faces(kept))
    kept *= np.sqrt(_surface(points, shape.faces) / _surface(kept, faces))
    return RockShape(shape.name, kept.astype(np.float32), faces.astype(np.int32))


# Semi-axes 1. Rocks of a few pixels are octahedra with axes of their own, see octahedron_axes.
OCTAHEDRON = RockShape('octahedron', np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32),
                       np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2],
                                 [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]], np.int32))


def octahedron_axes(shape: RockShape) -> Array:
    """Return the (3,) semi-axes of an octahedron with the mean outline of a shape."""
    points = shape.vertices.astype(float)
    axes = 0.5 * np.ptp(points, axis=0)
    surface = _surface(OCTAHEDRON.vertices * axes, OCTAHEDRON.faces)
    return np.asarray(axes * np.sqrt(_surface(points, shape.faces) / surface))


def _surface(vertices: Array, faces: NDArray[np.integer[Any]]) -> float:
    """Return the surface of a mesh."""
    corners = vertices[faces]
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return 0.5 * float(np.linalg.norm(sides, axis=1).sum())


def _ordered(faces: NDArray[np.integer[Any]]) -> NDArray[np.integer[Any]]:
    """Return the same (f, 3) faces in an order that does not depend on Qhull's.

    Normals are sums over faces, so that their last bits depend on the order.
    """
    a, b, c = faces.T
    rising = (a - b) * (b - c) * (c - a) > 0        # the face is a rotation of its sorted corners
    corners = np.sort(faces, axis=1)
    order = np.lexsort((*corners.T[::-1], ~rising))
    return np.where(rising[order, None], corners[order], corners[order, ::-1])


def facets(shape: RockShape) -> F32:
    """Return (3 f, 6) vertices of separate triangles with their normals.

    Normals lie between that of the face and the mean of those around the vertex.
    """
    corners = shape.vertices[shape.faces].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.maximum(area, 1e-12)
    smooth = np.zeros(shape.vertices.shape)
    for k in range(3):
        np.add.at(smooth, shape.faces[:, k], normal * area)
    smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
    softness = 0.75 if shape.name.startswith('rounded') else 0.25
    mixed = (1.0 - softness) * normal[:, None] + softness * smooth[shape.faces]
    mixed /= np.linalg.norm(mixed, axis=2, keepdims=True)
    return np.concatenate([corners, mixed], axis=2).reshape(-1, 6).astype(np.float32)
