"""The pass of the rocks: meshes of the shape library, and instances chosen by view and size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz
from lunar_rover_sim.ground.world.rocks import Rocks, RockShape
from lunar_rover_sim.ground.world.shapes import hull_faces
from lunar_rover_sim.image.rendering.context import load_program, release_all
from lunar_rover_sim.image.rendering.projection import Projection, ViewVolume

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


_INSTANCE = '3f 3f 3f 3f 1f /i'
_NAMES = ('i_position', 'i_x', 'i_y', 'i_z', 'i_number')
_FLOATS = 13
# Rocks are drawn as they are; those that look smaller than _COARSE_PX as hulls of _COARSE_VERTICES
# vertices, those smaller than _SOLIDS_PX as solids.
_COARSE_PX, _COARSE_VERTICES = 14.0, 10
_SOLIDS, _SOLIDS_PX = (OCTAHEDRON, TETRAHEDRON), (5.0, 2.0)
_KINDS = 2              # of a shape
_RADIUS = 0.75          # of a ball around a rock of diameter 1
ROCK_MIN_PX = 0.7       # rocks that look smaller are not drawn, in samples with supersampling
_REACH = 1.1            # of what is drawn far away, over that of the shape, at most


class GroundSeen(NamedTuple):
    """The ground in an image.

    Attributes:
        T_world_camera: (4, 4).
        depth_m: (h, w), 0 where there is none.
    """

    T_world_camera: Array
    projection: Projection
    depth_m: F32


def rock_table(rocks: Rocks, light: F32, ground_m: Array) -> F32:
    """Return what the light of rocks follows from, (m, 21), for `object_rows.rock_surface`.

    Args:
        light: (m, 5) as `Sunlight.rock_light`.
        ground_m: (m,) height of the ground under each rock.
    """
    rotation = matrix_from_wxyz(rocks.orientation_wxyz) if len(rocks) else np.zeros((0, 3, 3))
    return np.concatenate(
        [rocks.position_m, rotation.transpose(0, 2, 1).reshape(-1, 9), rocks.diameter_m[:, None],
         rocks.albedo[:, None], ground_m[:, None], light, _looks(rocks)[:, None]],
        axis=1).astype(np.float32)


def _looks(rocks: Rocks) -> NDArray[np.uint32]:
    """Return (m,) numbers that shift the texture of each rock; float32 holds their fractions."""
    return (rocks.key & np.uint64(0xffff)).astype(np.uint32)


class RockPass:
    """Draws where the rocks are."""

    def __init__(self, context: moderngl.Context, rocks: Rocks,
                 shapes: tuple[RockShape, ...]) -> None:
        """Make meshes and the program."""
        self._context = context
        self._program = load_program(context, 'rock', 'surface')
        self._shapes = shapes
        self._axes = np.array([[solid_axes(one, shape) for shape in shapes] for one in _SOLIDS],
                              np.float32)
        # A kind is a shape with its detail; the last kinds are solids, which stand for all.
        self._first_solid = _KINDS * len(shapes)
        self._instances: dict[int, moderngl.Buffer] = {}
        self._counts: dict[int, int] = {}
        self._arrays: dict[int, moderngl.VertexArray] = {}
        self._meshes = [[context.buffer(part.tobytes()) for part in mesh] for mesh in (
            *library_meshes(shapes, _COARSE_VERTICES), *map(solid_mesh, _SOLIDS))]
        self.enter(rocks)

    def enter(self, rocks: Rocks) -> None:
        """Have other rocks, of the same shapes."""
        release_all(*self._arrays.values(), *self._instances.values())
        self._arrays.clear()
        self._instances.clear()
        self._counts.clear()
        self.rocks = rocks
        rotation = matrix_from_wxyz(rocks.orientation_wxyz) if len(rocks) else np.zeros((0, 3, 3))
        columns = rotation * rocks.diameter_m[:, None, None]
        self._data = np.concatenate(
            [rocks.position_m, columns.transpose(0, 2, 1).reshape(-1, 9),
             np.arange(len(rocks))[:, None]], axis=1).astype(np.float32)
        self._position = np.ascontiguousarray(rocks.position_m.T, np.float32)
        self._diameter = rocks.diameter_m.astype(np.float32)
        # Half of boxes around the rocks, in axes of the world; coarse ones may reach farther.
        reach = np.stack([np.abs(shape.vertices).max(axis=0) for shape in self._shapes])
        self._half = _REACH * np.einsum('nij,nj->ni', np.abs(columns), reach[rocks.shape])

    def choose(self, volume: ViewVolume, focal_px: float, least_px: float,
               grounds: Sequence[GroundSeen] = ()) -> None:
        """Choose what `draw` draws: rocks that are in view and look larger than `least_px`.

        Args:
            grounds: Images in which the ground may hide rocks; none are without any.
        """
        visible, distance = self._visible(volume, focal_px, least_px)
        if grounds and len(visible):
            shows = np.any([self._over(visible, *ground) for ground in grounds], axis=0)
            visible, distance = visible[shows], distance[shows]
        size = self._diameter[visible] * np.float32(focal_px)
        shape = self.rocks.shape[visible]
        kind_of = _KINDS * shape + (size < _COARSE_PX * distance)
        for solid, limit in enumerate(_SOLIDS_PX):
            kind_of[size < limit * distance] = self._first_solid + solid
        order = np.argsort(kind_of, kind='stable')
        data = self._data[visible[order]]
        kinds, starts, counts = np.unique(kind_of[order], return_index=True, return_counts=True)
        self._counts = dict(zip(kinds.tolist(), counts.tolist()))
        for kind, start, count in zip(kinds.tolist(), starts, counts):
            part = data[start:start + count]
            if kind >= self._first_solid:  # the axes take the place of the vertices of the shape
                axes = self._axes[kind - self._first_solid, shape[order[start:start + count]]]
                part[:, 3:12] *= np.repeat(axes, 3, axis=1)
            self._write(kind, part)

    def _over(self, visible: NDArray[np.int64], T_world_camera: Array, projection: Projection,
              ground_m: F32) -> NDArray[np.bool_]:
        """Return which rocks show over the ground in an image, or may."""
        K, camera = projection.K, T_world_camera
        middle = (self.rocks.position_m[visible] - camera[:3, 3]) @ camera[:3, :3]
        half = self._half[visible] @ np.abs(camera[:3, :3])
        return np.asarray(_shows(middle, half, K, ground_m))

    def _write(self, kind: int, data: F32) -> None:
        """Write the instances of one kind."""
        if kind not in self._instances:
            members = len(self.rocks) if kind >= self._first_solid else \
                int((self.rocks.shape == kind // _KINDS).sum())
            self._instances[kind] = self._context.buffer(reserve=4 * _FLOATS * members,
                                                         dynamic=True)
        self._instances[kind].write(data.tobytes())

    def any_in_cone(self, T_world_view: Array, width: float) -> bool:
        """Return whether any rock may reach into a cone around the axis of a view.

        Args:
            width: Radius of the cone at depth 1.
        """
        offset = self._position - T_world_view[:3, 3:].astype(np.float32)
        ahead = T_world_view[:3, 2].astype(np.float32) @ offset
        radius = np.float32(_RADIUS) * self._diameter
        reach = radius + np.float32(width) * np.maximum(ahead, 0.0)
        aside2 = (offset**2).sum(axis=0) - ahead**2
        return bool(np.any((ahead > -radius) & (aside2 < reach**2)))

    def draw(self) -> None:
        """Draw the chosen rocks into the framebuffer in use."""
        self._context.enable_only(self._context.DEPTH_TEST | self._context.CULL_FACE)
        for kind, count in self._counts.items():
            if kind not in self._arrays:
                vertices, corners = self._meshes[kind]
                self._arrays[kind] = self._context.vertex_array(
                    self._program, [(vertices, '3f 3f', 'a_position', 'a_normal'),
                                    (self._instances[kind], _INSTANCE, *_NAMES)], corners)
            self._arrays[kind].render(instances=count)

    def _visible(self, volume: ViewVolume, focal_px: float,
                 least_px: float) -> tuple[NDArray[np.int64], F32]:
        """Return the indices of the rocks to draw, and their distances [m]."""
        offset = self._position - volume.centre_m[:, None].astype(np.float32)
        distance = np.sqrt(np.einsum('ij,ij->j', offset, offset))
        seen = self._diameter * np.float32(focal_px / least_px if least_px else np.inf) > distance
        radius = np.float32(-_RADIUS) * self._diameter
        for a, b, c, d in volume.planes.astype(np.float32):
            seen &= a * offset[0] + b * offset[1] + (c * offset[2] + d) > radius
        visible = np.flatnonzero(seen)
        return visible, np.maximum(distance[visible], np.float32(1e-3))

    def release(self) -> None:
        """Release the GL objects."""
        release_all(*self._arrays.values(), *self._instances.values(),
                    *(buffer for mesh in self._meshes for buffer in mesh), self._program)


@compiled
def _shows(middle, half, K, ground):  # type: ignore[no-untyped-def]
    """Return which boxes have a pixel at which the ground, if any, does not lie before them.

    Args:
        middle, half: (n, 3) middles and halves of boxes in axes of the camera [m].
        K: (3, 3) intrinsics [px].
        ground: (h, w) depth, 0 where there is none [m].
    """
    h, w = ground.shape
    size = (w, h)
    result = np.zeros(len(middle), np.bool_)
    first, end = np.zeros(2, np.int64), np.zeros(2, np.int64)
    for k in range(len(middle)):
        nearest, farthest = middle[k, 2] - half[k, 2], middle[k, 2] + half[k, 2]
        if nearest <= 0.0:
            result[k] = farthest > 0.0
            continue
        for n in range(2):
            low, high = middle[k, n] - half[k, n], middle[k, n] + half[k, n]
            low = K[n, n] * low / (nearest if low < 0.0 else farthest) + K[n, 2]
            high = K[n, n] * high / (nearest if high > 0.0 else farthest) + K[n, 2]
            first[n] = int(min(max(np.ceil(low), 0.0), size[n]))
            end[n] = int(min(max(np.floor(high), -1.0), size[n] - 1.0)) + 1
        for row in range(first[1], end[1]):
            for column in range(first[0], end[0]):
                depth = ground[row, column]
                if depth == 0.0 or depth > nearest:
                    result[k] = True
                    break
            if result[k]:
                break
    return result
