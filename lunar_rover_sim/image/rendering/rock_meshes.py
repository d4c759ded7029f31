"""Triangle meshes that rocks are drawn with: the shapes themselves, and simpler ones far away."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.rocks import RockShape
from lunar_rover_sim.ground.world.shapes import hull_faces

F32 = NDArray[np.float32]

_SOFT = 0.25            # share of the direction from the middle in the normal of a solid
_SMOOTH = np.cos(np.radians(32.0))      # between faces that look like a round one


def coarse(shape: RockShape, vertices: int) -> RockShape:
    """Return a simpler, convex shape: the hull of a few vertices that are far apart.

    It is scaled to the same mean area of its outline. Over all directions, the mean outline of a
    convex body is a quarter of its surface (Cauchy's formula).
    """
    points = shape.vertices.astype(float)
    if len(points) <= vertices and not shape.pieces:
        return shape
    chosen = [int(np.argmax(np.linalg.norm(points, axis=1)))]
    apart = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < vertices:
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.linalg.norm(points - points[chosen[-1]], axis=1))
    kept = points[chosen]
    faces = _ordered(hull_faces(kept))
    kept *= np.sqrt(_outer_surface(shape) / _surface(kept, faces))
    return RockShape(shape.name, kept.astype(np.float32), faces.astype(np.int32))


# Solids that span a box of half sides 1. They stand for all rocks of a few pixels, and of one or
# two, with axes of their own, see `solid_axes`.
OCTAHEDRON = RockShape('octahedron', np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32),
                       np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2],
                                 [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]], np.int32))
TETRAHEDRON = RockShape('tetrahedron', np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]],
                                                np.float32),
                        np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], np.int32))


def solid_axes(solid: RockShape, shape: RockShape) -> Array:
    """Return the (3,) scales at which a solid has the mean outline of a shape."""
    points = shape.vertices.astype(float)
    axes = 0.5 * np.ptp(points, axis=0)
    surface = _surface(solid.vertices * axes, solid.faces)
    return np.asarray(axes * np.sqrt(_outer_surface(shape) / surface))


def _outer_surface(shape: RockShape) -> float:
    """Return the surface of the hull of a shape."""
    points = shape.vertices.astype(float)
    return _surface(points, hull_faces(points) if shape.pieces else shape.faces)


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


class Mesh(NamedTuple):
    """What the device draws; it computes a vertex that several faces have once.

    Attributes:
        vertices: (v, 6) as `facets` has them, none twice.
        corners: (3 f,) which of them are the corners of faces.
    """

    vertices: F32
    corners: NDArray[np.int32]


def solid_mesh(solid: RockShape) -> Mesh:
    """Return a solid with normals shorter than 1.

    The normal that light is computed with is their sum with that of the face: so each vertex is
    the same one in all its faces.
    """
    places = solid.vertices
    normals = places * np.float32(_SOFT / (1.0 - _SOFT) / np.linalg.norm(places[0]))
    return Mesh(np.concatenate([places, normals], axis=1), solid.faces.ravel())


def library_meshes(shapes: tuple[RockShape, ...], vertices: int) -> list[Mesh]:
    """Return meshes of shapes, one after the other: as it is, then coarse.

    Args:
        vertices: Of a coarse one.
    """
    result = []
    for shape in shapes:
        for mesh in (facets(shape), facets(coarse(shape, vertices))):
            rows, which = np.unique(mesh, axis=0, return_inverse=True)
            result.append(Mesh(rows, which.ravel().astype(np.int32)))
    return result


def facets(shape: RockShape) -> F32:
    """Return (3 f, 6) vertices of separate triangles with their normals.

    A normal is the mean of the faces around a vertex which bend little from this one: flat faces
    look flat, with edges between them, and round ones round.
    """
    corners = shape.vertices[shape.faces].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    smooth = np.zeros(corners.shape)
    for vertex in range(len(shape.vertices)):
        around, which = np.nonzero(shape.faces == vertex)
        near = np.einsum('fi,gi->fg', unit[around], unit[around]) > _SMOOTH
        smooth[around, which] = np.einsum('fg,gi->fi', near, normal[around])
    smooth /= np.maximum(np.linalg.norm(smooth, axis=2, keepdims=True), 1e-12)
    return np.concatenate([corners, smooth], axis=2).reshape(-1, 6).astype(np.float32)
