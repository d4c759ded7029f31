"""The library of rock shapes: convex, closed, of unit size; faceted ones and rounded ones.

Fresh blocks are angular, and meteoroids round them with time. Rocks broken by impacts have a mean
axial ratio near 1 : 0.8 : 0.6 (Fujiwara et al. 1978; Capaccioni et al. 1984).
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray
import scipy  # its parts when they are used

from lunar_rover_sim.ground.world.grid import on_lattice
from lunar_rover_sim.ground.world.rocks import RockShape

FACETED, ROUNDED = 9, 7
_STEP = 2.0**-20        # lattice of the corners
_SEED = 1969            # the library is the same in all worlds, so that meshes can be shared


@functools.cache
def library() -> tuple[RockShape, ...]:
    """Return the shapes: the same 16 at every call."""
    rng = np.random.default_rng(_SEED)
    shapes = [hull(f'faceted_{i:02d}', _cut_block(rng, planes=9 + i)) for i in range(FACETED)]
    shapes += [hull(f'rounded_{i:02d}', _worn_block(rng)) for i in range(ROUNDED)]
    return tuple(shapes)


def hull(name: str, points: NDArray[np.float64]) -> RockShape:
    """Return the convex hull of (n, 3) points as a shape, the same for each order of its faces.

    Its centroid is moved to the origin and its largest horizontal diameter is scaled to 1.
    """
    points = on_lattice(points, _STEP)
    triangles = _in_order(hull_faces(points))
    used = np.unique(triangles)
    vertices = points[used]
    faces = np.searchsorted(used, triangles).astype(np.int32)
    # Signed tetrahedra from the origin give volume and centroid.
    corners = vertices[faces]
    volume = np.einsum('ij,ij->i', corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    centroid = (volume[:, None] * corners.sum(axis=1)).sum(axis=0) / (4.0 * volume.sum())
    vertices = vertices - centroid
    flat = vertices[:, :2]
    diameter = np.linalg.norm(flat[:, None] - flat[None], axis=-1).max()
    unit = on_lattice(vertices / diameter, _STEP).astype(np.float32)
    unit.setflags(write=False)
    faces.setflags(write=False)
    return RockShape(name, unit, faces)


def hull_faces(points: NDArray[np.float64]) -> NDArray[np.integer[Any]]:
    """Return the (f, 3) triangles of the convex hull of (n, 3) points.

    They index the points, counter-clockwise seen from outside.
    """
    shell = scipy.spatial.ConvexHull(points)
    faces = shell.simplices.copy()
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum('ij,ij->i', normals, shell.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return faces


def _turn(rpy_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(scipy.spatial.transform.Rotation.from_euler('xyz', rpy_rad).as_matrix())


def _in_order(faces: NDArray[np.integer[Any]]) -> NDArray[np.integer[Any]]:
    """Return triangles sorted by their corners, the least first; their sense stays."""
    turned = np.array([np.roll(face, -int(face.argmin())) for face in faces])
    return turned[np.lexsort(turned.T[::-1])]


def _axes(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the (3,) semi-axes of a block."""
    return np.array([1.0, rng.uniform(0.68, 0.95), rng.uniform(0.62, 0.85)])


def _cut_block(rng: np.random.Generator, planes: int) -> NDArray[np.float64]:
    """Return the (n, 3) corners of a block that is cut by planes in random directions."""
    normals = _spread(rng, planes)
    distance = rng.uniform(0.75, 1.1, planes)
    box = np.concatenate([np.eye(3), -np.eye(3)])
    halfspaces = np.concatenate([np.column_stack([normals, -distance]),
                                 np.column_stack([box, np.full(6, -1.25)])])
    corners = scipy.spatial.HalfspaceIntersection(halfspaces, np.zeros(3)).intersections
    # Qhull finds each corner more than once, in an order of its own.
    corners = np.unique(on_lattice(corners[np.all(np.isfinite(corners), axis=1)], _STEP), axis=0)
    # Corners are chipped: cutting each back a little gives small faces between the large ones.
    centre = corners.mean(axis=0)
    neighbours = corners + 0.12 * (np.roll(corners, 1, axis=0) - corners)
    chipped = np.concatenate([centre + 0.97 * (corners - centre), neighbours])
    tilt = _turn(rng.uniform(-0.3, 0.3, 3))
    return (chipped * _axes(rng)) @ tilt.T


def _worn_block(rng: np.random.Generator, points: int = 72) -> NDArray[np.float64]:
    """Return (n, 3) points on a dented superellipsoid, between a sphere and a box."""
    directions = _spread(rng, points, jitter=0.25)
    power = rng.uniform(2.2, 3.2)
    radius = np.sum(np.abs(directions) ** power, axis=1) ** (-1.0 / power)
    for _ in range(4):
        lobe = rng.standard_normal(3)
        lobe /= np.linalg.norm(lobe)
        radius = radius * (1.0 - rng.uniform(0.03, 0.16)
                           * np.clip(directions @ lobe, 0.0, 1.0) ** 2)
    turn = _turn(rng.uniform(-0.4, 0.4, 3))
    return (directions * radius[:, None] * _axes(rng)) @ turn.T


def _spread(rng: np.random.Generator, count: int, jitter: float = 0.45) -> NDArray[np.float64]:
    """Return (count, 3) unit vectors: a Fibonacci lattice, randomly turned and jittered."""
    i = np.arange(count) + 0.5
    z = 1.0 - 2.0 * i / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * i
    ring = np.sqrt(1.0 - z * z)
    vectors = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])
    scale = jitter * np.sqrt(4.0 * np.pi / count)
    turn = scipy.spatial.transform.Rotation.from_rotvec(rng.uniform(-np.pi, np.pi, 3))
    vectors = vectors @ turn.as_matrix().T
    vectors += scale * rng.uniform(-0.5, 0.5, vectors.shape)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
