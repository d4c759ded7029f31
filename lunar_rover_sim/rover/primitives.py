"""Closed triangle meshes of simple solids: (vertices (v, 3) [m], faces (f, 3)).

Faces are counter-clockwise seen from outside. Flat faces have their own vertices at sharp edges.
The meshes have no normals; the renderer computes them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.frames import Array

Mesh = tuple[Array, NDArray[np.int64]]


def box(size_m: ArrayLike, centre_m: ArrayLike = (0.0, 0.0, 0.0), bevel: float = 0.0) -> Mesh:
    """Return a box; `bevel` [m] cuts the four upper and four lower edges of its sides."""
    half = 0.5 * np.asarray(size_m, dtype=float)
    if bevel <= 0.0:
        rings = [(half[0], half[1], -half[2]), (half[0], half[1], half[2])]
    else:
        rings = [(half[0] - bevel, half[1] - bevel, -half[2]),
                 (half[0], half[1], -half[2] + bevel),
                 (half[0], half[1], half[2] - bevel),
                 (half[0] - bevel, half[1] - bevel, half[2])]
    loops = [np.array([[x, y, z], [-x, y, z], [-x, -y, z], [x, -y, z]]) for x, y, z in rings]
    return _lofted(loops, np.asarray(centre_m, dtype=float))


def cylinder(start_m: ArrayLike, end_m: ArrayLike, radius_m: float, sides: int) -> Mesh:
    """Return a cylinder between the centres of its two ends."""
    start, end = np.asarray(start_m, dtype=float), np.asarray(end_m, dtype=float)
    axis = end - start
    axis = axis / np.linalg.norm(axis)
    helper = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    u = np.cross(axis, helper)
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    angle = np.arange(sides) * 2.0 * np.pi / sides
    ring = radius_m * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v)
    return _lofted([start + ring, end + ring], np.zeros(3))


def sphere(centre_m: ArrayLike, radius_m: float, sides: int, rings: int) -> Mesh:
    """Return a sphere of `rings` rows of faces with `sides` columns each."""
    polar = np.linspace(0.0, np.pi, rings + 1)[1:-1]
    angle = np.arange(sides) * 2.0 * np.pi / sides
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = [np.array([[0.0, 0.0, -1.0]])]
    vertices += [np.column_stack([np.sin(p) * ring, np.full(sides, -np.cos(p))]) for p in polar]
    vertices.append(np.array([[0.0, 0.0, 1.0]]))
    faces = []
    last = 1 + (len(polar) - 1) * sides
    top = last + sides
    for i in range(sides):
        j = (i + 1) % sides
        faces.append((0, 1 + j, 1 + i))
        faces.append((top, last + i, last + j))
        for row in range(len(polar) - 1):
            a, b = 1 + row * sides, 1 + (row + 1) * sides
            faces += [(a + i, a + j, b + j), (a + i, b + j, b + i)]
    return (np.asarray(centre_m, dtype=float) + radius_m * np.concatenate(vertices),
            np.array(faces))


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """Return several meshes as one."""
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in meshes[:-1]])
    return (np.concatenate([vertices for vertices, _ in meshes]),
            np.concatenate([faces + offset for (_, faces), offset in zip(meshes, offsets)]))


def transformed(mesh: Mesh, T_to_mesh: Array) -> Mesh:
    """Return the mesh with its vertices mapped by a (4, 4) rigid transform."""
    vertices, faces = mesh
    return vertices @ T_to_mesh[:3, :3].T + T_to_mesh[:3, 3], faces


def _lofted(loops: Sequence[Array], offset: Array) -> Mesh:
    """Return the solid between equal-sized convex loops, counter-clockwise seen from the end.

    Each quadrilateral and both end caps have their own vertices, so that edges stay sharp.
    """
    vertices: list[Array] = []
    faces: list[tuple[int, int, int]] = []

    def polygon(points: Array) -> None:
        first = sum(len(v) for v in vertices)
        vertices.append(points)
        faces.extend((first, first + k, first + k + 1) for k in range(1, len(points) - 1))

    n = len(loops[0])
    for lower, upper in zip(loops[:-1], loops[1:]):
        for i in range(n):
            j = (i + 1) % n
            polygon(np.stack([lower[i], lower[j], upper[j], upper[i]]))
    polygon(loops[0][::-1])
    polygon(loops[-1])
    return np.concatenate(vertices) + offset, np.array(faces)
