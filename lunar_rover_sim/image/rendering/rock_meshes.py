"""Triangle meshes of rock shapes, fine and coarse."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.kept_arrays import kept
from lunar_rover_sim.ground.world.rocks import RockShape
from lunar_rover_sim.ground.world.shapes import hull_faces

F32 = NDArray[np.float32]

_RECIPE = 2             # rises with every change of what `library_meshes` keeps


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


_WORN_FACES = 320       # a hull has fewer
_SOFT = 0.25            # share of the mean around a vertex in the normal of a broken face


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


def worn(shape: RockShape, level: int) -> RockShape:
    """Return a shape of the library as it is drawn: its edges worn, its faces with relief.

    The faces of the hull are met by rays from the centroid, and blend at the edges. Lumps and
    hollows of three sizes are added to their distance. The mean outline is that of the hull, from
    which the surface differs by at most `MOST_APART` diameters; physics and shadows keep the hull.
    Other shapes, such as those of tests, are drawn as they are.

    Args:
        shape: Convex, its centroid at the origin.
        level: Of the sphere of rays: 20 4^level triangles.
    """
    kind = shape.name.partition('_')[0]
    if kind not in _WEAR:
        return shape
    sharpness, strength = _WEAR[kind]
    rays, faces = _sphere(level)
    normals, distances = _planes(shape)
    # The largest of n.d / distance is one over the way to the hull; this power of sums is smooth.
    ratio = np.maximum(rays @ normals.T, 0.0) / distances
    radius = (ratio**sharpness).sum(axis=1)**(-1.0 / sharpness)
    points = rays * radius[:, None]
    number = sum(shape.name.encode())
    relief = sum(share * _noise(points / size + 17.0 * number, number + k)
                 for k, (size, share) in enumerate(_LUMPS))
    # Hollows are rounder than the lumps between them.
    radius = radius * (1.0 + strength * (np.sqrt(relief * relief + 0.02) - 0.35))
    points = rays * radius[:, None]
    points *= np.sqrt(_surface(shape.vertices.astype(float), shape.faces)
                      / _surface(_smooth_sphere(points, faces), faces))
    return RockShape(shape.name, points.astype(np.float32), faces)


# Of the kinds of shapes: how sharp edges are, and how strong relief is, over the radius.
_WEAR = {'faceted': (24.0, 0.18), 'rounded': (10.0, 0.12)}
# Lumps: size over the diameter of the rock, and share.
_LUMPS = ((0.30, 1.0), (0.14, 0.5), (0.065, 0.28))
MOST_APART = 0.09       # of the drawn surface from the hull, in diameters


def _smooth_sphere(points: Array, faces: NDArray[np.integer[Any]]) -> Array:
    """Return points without their finest relief, whose area says nothing about the outline."""
    total, count = points.copy(), np.ones(len(points))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        np.add.at(total, faces[:, a], points[faces[:, b]])
        np.add.at(count, faces[:, a], 1.0)
    return np.asarray(total / count[:, None])


def _planes(shape: RockShape) -> tuple[Array, Array]:
    """Return (n, 3) normals and (n,) distances of the faces, those in one plane once."""
    corners = shape.vertices[shape.faces].astype(float)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    normals, corners = normals[area > 1e-9] / area[area > 1e-9, None], corners[area > 1e-9]
    distances = np.einsum('ij,ij->i', normals, corners[:, 0])
    _, first = np.unique(np.round(np.column_stack([normals, distances]), 2), axis=0,
                         return_index=True)
    return normals[first], np.maximum(distances[first], 1e-3)


@functools.cache
def _sphere(level: int) -> tuple[Array, NDArray[np.int32]]:
    """Return (v, 3) unit vectors and (f, 3) triangles of an icosahedron, divided `level` times."""
    g = 0.5 * (1.0 + 5.0**0.5)
    points = np.array([[-1, g, 0], [1, g, 0], [-1, -g, 0], [1, -g, 0], [0, -1, g], [0, 1, g],
                       [0, -1, -g], [0, 1, -g], [g, 0, -1], [g, 0, 1], [-g, 0, -1], [-g, 0, 1]])
    faces = np.array([[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9],
                      [5, 11, 4], [11, 10, 2], [10, 7, 6], [7, 1, 8], [3, 9, 4], [3, 4, 2],
                      [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10],
                      [8, 6, 7], [9, 8, 1]])
    for _ in range(level):
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]))
        unique, which = np.unique(edges, axis=0, return_inverse=True)
        ab, bc, ca = np.split(which.ravel() + len(points), 3)
        points = np.concatenate([points, 0.5 * (points[unique[:, 0]] + points[unique[:, 1]])])
        a, b, c = faces.T
        faces = np.concatenate([np.stack(triangle, axis=1) for triangle in (
            (a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points, faces.astype(np.int32)


def _noise(points: Array, seed: int) -> Array:
    """Return smooth noise at (n, 3) points, between -1 and 1: corners of cells, interpolated."""
    lattice = np.random.default_rng([seed, *b'rock']).uniform(-1.0, 1.0, (16, 16, 16))
    cell = np.floor(points).astype(int)
    part = points - cell
    part = part * part * (3.0 - 2.0 * part)
    total = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(np.array(corner), part, 1.0 - part).prod(axis=1)
        x, y, z = ((cell + corner) % 16).T
        total += weight * lattice[x, y, z]
    return total


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


def library_meshes(shapes: tuple[RockShape, ...], levels: tuple[int, ...],
                   vertices: int) -> list[Mesh]:
    """Return meshes of shapes, one after the other: worn at each level, then coarse.

    Args:
        vertices: Of a coarse one.
    """
    def rows() -> F32:
        meshes = [facets(mesh) for shape in shapes
                  for mesh in (*(worn(shape, level) for level in levels), coarse(shape, vertices))]
        number = np.repeat(np.arange(len(meshes)), [len(mesh) for mesh in meshes])
        # Which are equal is found once for all renderers: it takes 0.2 s.
        which = [np.unique(mesh, axis=0, return_inverse=True)[1].ravel() for mesh in meshes]
        return np.column_stack([number, np.concatenate(which),
                                np.concatenate(meshes)]).astype(np.float32)
    recipe = [[shape.name, shape.vertices.tolist(), shape.faces.tolist()] for shape in shapes]
    made = kept('rock_meshes', [_RECIPE, recipe, levels, vertices], rows)
    result = []
    for part in np.split(made[:, 1:], np.flatnonzero(np.diff(made[:, 0])) + 1):
        corners = part[:, 0].astype(np.int32)
        mesh = Mesh(np.empty((corners.max() + 1, 6), np.float32), corners)
        mesh.vertices[corners] = part[:, 1:]
        result.append(mesh)
    return result


def facets(shape: RockShape) -> F32:
    """Return (3 f, 6) vertices of separate triangles with their normals.

    Normals lie between that of the face and the mean of those around the vertex; those of worn
    shapes are that mean.
    """
    corners = shape.vertices[shape.faces].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.maximum(area, 1e-12)
    smooth = np.zeros(shape.vertices.shape)
    for k in range(3):
        np.add.at(smooth, shape.faces[:, k], normal * area)
    smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
    softness = 1.0 if len(shape.faces) >= _WORN_FACES else (
        0.75 if shape.name.startswith('rounded') else _SOFT)
    mixed = (1.0 - softness) * normal[:, None] + softness * smooth[shape.faces]
    mixed /= np.linalg.norm(mixed, axis=2, keepdims=True)
    return np.concatenate([corners, mixed], axis=2).reshape(-1, 6).astype(np.float32)
