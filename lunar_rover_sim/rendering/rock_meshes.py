"""Rocks as GL meshes: instances of the shape library, culled by view and size."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array, matrix_from_wxyz
from lunar_rover_sim.rendering.terrain import ViewVolume
from lunar_rover_sim.world.rocks import Rocks, RockShape
from lunar_rover_sim.world.shapes import hull_faces

if TYPE_CHECKING:
    import moderngl

F32 = NDArray[np.float32]

_INSTANCE = '3f 3f 3f 3f 4f 2f /i'
_NAMES = ('i_position', 'i_x', 'i_y', 'i_z', 'i_light', 'i_matter')
_FLOATS = 18
# Levels of detail: smaller rocks than so many pixels are drawn as hulls of so few vertices.
_COARSE = ((14.0, 10), (4.0, 6))
_LEVELS = 1 + len(_COARSE)


class RockMeshes:
    """GL objects of all rocks."""

    def __init__(self, context: moderngl.Context, rocks: Rocks,
                 shapes: tuple[RockShape, ...], light: F32) -> None:
        """Prepare rocks; light: (m, 4) clearance, distance [m] at the foot and at the top."""
        self._context = context
        self.rocks = rocks
        rotation = matrix_from_wxyz(rocks.orientation_wxyz) if len(rocks) else np.zeros((0, 3, 3))
        columns = rotation * rocks.diameter_m[:, None, None]
        self._data = np.concatenate(
            [rocks.position_m, columns[:, :, 0], columns[:, :, 1], columns[:, :, 2], light,
             rocks.albedo[:, None], np.arange(len(rocks))[:, None]], axis=1).astype(np.float32)
        self._radius = 0.75 * rocks.diameter_m
        # Of each kind: a shape at one level of detail.
        self._instances: dict[int, moderngl.Buffer] = {}
        self._counts: dict[int, int] = {}
        self._arrays: dict[tuple[int, int], moderngl.VertexArray] = {}
        self._vertices: list[moderngl.Buffer] = []
        for shape in shapes:
            for mesh in (shape, *(coarse(shape, vertices) for _, vertices in _COARSE)):
                self._vertices.append(context.buffer(facets(mesh).tobytes()))

    def relight(self, light: F32) -> None:
        """Take (m, 4) clearance, distance [m] at the foot and at the top under another sun."""
        self._data[:, 12:16] = light

    def choose(self, view: ViewVolume, focal_px: float, least_px: float) -> None:
        """Choose what `draw` draws: rocks that are in view and look larger than `least_px`."""
        visible = self.visible(view, focal_px, least_px)
        distance = np.linalg.norm(self.rocks.position_m[visible] - view.camera_m, axis=1)
        size = self.rocks.diameter_m[visible] * focal_px
        kind_of = _LEVELS * self.rocks.shape[visible]
        for least, _ in _COARSE:
            kind_of = kind_of + (size < least * distance)
        order = np.argsort(kind_of, kind='stable')
        data = self._data[visible[order]]
        kinds, starts, counts = np.unique(kind_of[order], return_index=True, return_counts=True)
        self._counts = dict(zip(kinds.tolist(), counts.tolist()))
        for kind, start, count in zip(kinds.tolist(), starts, counts):
            if kind not in self._instances:
                members = int((self.rocks.shape == kind // _LEVELS).sum())
                self._instances[kind] = self._context.buffer(reserve=4 * _FLOATS * members,
                                                             dynamic=True)
            self._instances[kind].write(data[start:start + count].tobytes())

    def draw(self, program: moderngl.Program) -> None:
        """Draw the chosen rocks."""
        for kind, count in self._counts.items():
            key = (program.glo, kind)
            if key not in self._arrays:
                self._arrays[key] = self._context.vertex_array(
                    program, [(self._vertices[kind], '3f 3f', 'a_position', 'a_normal'),
                              (self._instances[kind], _INSTANCE, *_NAMES)], skip_errors=True)
            self._arrays[key].render(instances=count)

    def visible(self, view: ViewVolume, focal_px: float, least_px: float) -> NDArray[np.int64]:
        """Return the indices of rocks to draw."""
        offset = self.rocks.position_m - view.camera_m
        distance = np.linalg.norm(offset, axis=1)
        seen = self.rocks.diameter_m * focal_px > least_px * np.maximum(distance, 1e-3)
        for plane in view.planes:
            seen &= offset @ plane[:3] + plane[3] > -self._radius
        return np.flatnonzero(seen)

    def release(self) -> None:
        """Release the GL objects."""
        items: list[Any] = [*self._arrays.values(), *self._instances.values(), *self._vertices]
        for item in items:
            item.release()


def coarse(shape: RockShape, vertices: int) -> RockShape:
    """Return the convex hull of a few far-apart vertices of a shape, grown to its mean outline.

    The mean outline of a convex body, over all directions, is a quarter of its surface (Cauchy).
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


def _surface(vertices: Array, faces: NDArray[np.integer[Any]]) -> float:
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
    """Return (3 f, 6) vertices of separate triangles with their normals."""
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
