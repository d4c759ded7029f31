"""The rover as the cameras and the sun see it: its meshes, and the shadow that it casts.

All its parts are built of convex pieces. Their outlines towards the sun make one map, the
rover's silhouette as a signed distance; how far the ground lies behind the piece gives the
penumbra, sharp at the feet and wide far away.
"""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.terrain import ViewVolume
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.visual import link_poses, visual_parts, VisualPart

if TYPE_CHECKING:
    import moderngl

F32 = NDArray[np.float32]

MAP = 320               # pixels along a side of the silhouette map
_MARGIN_M = 0.06        # around the rover
_HIDDEN_M = 0.004       # pieces that stand out of others by less are left out of the shadow
_NOWHERE_M = 1e6
_SHADOW_M = 200.0       # beyond, the rover hides less than a tenth of the sun's disc
_SUB = 4                # fractional bits of outline corners


class RoverBody:
    """Meshes and GL objects of the rover."""

    def __init__(self, context: moderngl.Context, rover: RoverDescription) -> None:
        self._rover = rover
        parts = visual_parts(rover)
        self._links = list(link_poses(rover, np.zeros(4)))
        pieces = _standing_out([(self._links.index(part.link), vertices, faces) for part in parts
                                for vertices, faces in _pieces(part)])
        pieces.sort(key=lambda piece: piece[0])
        # Corners of all pieces, by link; where each piece begins; how many corners a link has.
        self._corners = np.concatenate([vertices for _, vertices, _ in pieces])
        self._starts = np.cumsum([0, *(len(vertices) for _, vertices, _ in pieces)])
        self._shares = [sum(len(vertices) for of, vertices, _ in pieces if of == link)
                        for link in range(len(self._links))]
        reach = float(np.linalg.norm(self._corners, axis=1).max()) + max(
            float(np.linalg.norm(pose[:3, 3])) for pose in link_poses(rover, np.zeros(4)).values())
        self.radius_m = reach
        self._half_m = reach + _MARGIN_M    # half extent of the silhouette map
        data = np.concatenate([_triangles(part, self._links.index(part.link)) for part in parts])
        self._count = len(data)
        self._boxes = np.stack([_box_corners(data[data[:, 7] == k, :3])
                                for k in range(len(self._links))])
        self._vertices = context.buffer(data.astype(np.float32).tobytes())
        self._context = context
        self._arrays: dict[int, moderngl.VertexArray] = {}
        self._map: Any = None

    def poses(self, T_world_base: Array, joint_angle_rad: ArrayLike) -> Array:
        """Return the (links, 4, 4) world poses of all links."""
        local = link_poses(self._rover, joint_angle_rad)
        return np.stack([T_world_base @ local[link] for link in self._links])

    def seen(self, poses: Array, view: ViewVolume) -> bool:
        """Return whether the box around any link may reach into the view volume."""
        corners = self._boxes @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
        within = (corners - view.camera_m) @ view.planes[:, :3].T + view.planes[:, 3] > 0.0
        return bool(np.any(np.all(np.any(within, axis=1), axis=1)))

    def draw(self, program: moderngl.Program, poses: Array) -> None:
        """Draw the rover; the program has an array of poses."""
        program['u_links'].write(np.ascontiguousarray(  # type: ignore[union-attr]
            poses.transpose(0, 2, 1), np.float32).tobytes())
        if program.glo not in self._arrays:
            self._arrays[program.glo] = self._context.vertex_array(
                program, [(self._vertices, '3f 3f 1f 1f', 'a_position', 'a_normal', 'a_albedo',
                           'a_link')], skip_errors=True)
        self._arrays[program.glo].render(vertices=self._count)

    def cast_shadow(self, poses: Array, sun_axes: Array, view: ViewVolume,
                    unit: int) -> dict[str, Any]:
        """Bind the map of the shadow; return where it is, by the names of uniforms.

        sun_axes: (3, 3) as `rock_shadow.sun_axes`
        """
        right, up, to_sun = sun_axes
        centre = poses[0, :3, 3]
        if self._may_shade(centre, to_sun, view):
            self._upload(self.silhouette(poses, sun_axes))
        else:
            centre = centre + _NOWHERE_M * up
        if self._map is not None:
            self._map.use(unit)
        return {'u_rover_map': unit, 'u_rover_right': tuple(right / self._half_m),
                'u_rover_up': tuple(up / self._half_m), 'u_rover_centre': tuple(centre)}

    def _upload(self, silhouette: F32) -> None:
        # A new texture: to write to one that is in use would wait for all drawing under way.
        if self._map is not None:
            self._map.release()
        self._map = self._context.texture((MAP, MAP), 2, silhouette, dtype='f4')
        self._map.repeat_x = self._map.repeat_y = False

    def _may_shade(self, centre: Array, to_sun: Array, view: ViewVolume) -> bool:
        """Return whether any place behind the map, as the sun sees it, may be in view."""
        normals = view.planes[:, :3]
        reach = normals @ (centre - view.camera_m) + np.sqrt(2.0) * self._half_m
        reach += _SHADOW_M * np.maximum(-normals @ to_sun, 0.0)
        return bool(np.all(reach + view.planes[:, 3] > 0.0))

    def silhouette(self, poses: Array, sun_axes: Array) -> F32:
        """Return the rover as the sun sees it.

        (MAP, MAP, 2): signed distance to the outline [m], < 0 inside; and the position of the
        piece along the sun ray, relative to the rover [m].
        """
        centre, half = poses[0, :3, 3], self._half_m
        scale = 0.5 * MAP / half
        offsets = (poses[:, :3, 3] - centre) @ sun_axes.T
        seen = np.repeat(offsets, self._shares, axis=0)
        for of, turn in zip(np.split(np.arange(len(seen)), np.cumsum(self._shares)[:-1]),
                            sun_axes @ poses[:, :3, :3]):
            seen[of] += self._corners[of] @ turn.T
        flat = (seen[:, :2] * scale + (0.5 * MAP - 0.5)).astype(np.float32) * (1 << _SUB)
        shapes = []
        for first, end in zip(self._starts[:-1], self._starts[1:]):
            outline = cv2.convexHull(flat[first:end])[:, 0]
            shapes.append((float(seen[first:end, 2].mean()), np.rint(outline).astype(np.int32)))
        free = np.full((MAP, MAP), 255, np.uint8)
        depth = np.full((MAP, MAP), -half, np.float32)
        for along, outline in sorted(shapes, key=lambda item: item[0]):
            cv2.fillConvexPoly(free, outline, 0, cv2.LINE_8, _SUB)
            cv2.fillConvexPoly(depth, outline, along, cv2.LINE_8, _SUB)
        taken = cv2.bitwise_not(free)
        outside = cv2.distanceTransform(free, cv2.DIST_L2, 5)
        x, y, width, height = cv2.boundingRect(taken)
        part = np.s_[max(y - 1, 0):y + height + 1, max(x - 1, 0):x + width + 1]
        inside = np.zeros((MAP, MAP), np.float32)
        inside[part] = cv2.distanceTransform(np.ascontiguousarray(taken[part]), cv2.DIST_L2, 5)
        # The transform measures to the centre of the next pixel of the other kind.
        middle = np.where(free > 0, np.float32(0.5), np.float32(-0.5))
        distance = (outside - inside - middle) * np.float32(1.0 / scale)
        spread = cv2.dilate(depth, np.ones((25, 25), np.uint8))
        return np.dstack([distance, np.where(free > 0, spread, depth)]).astype(np.float32)

    def release(self) -> None:
        """Release the GL objects."""
        for array in self._arrays.values():
            array.release()
        self._vertices.release()
        if self._map is not None:
            self._map.release()


def _box_corners(points: Array) -> Array:
    """Return the (8, 3) corners of the box around (n, 3) points."""
    ends = np.stack([points.min(axis=0), points.max(axis=0)])
    return np.stack(np.meshgrid(*ends.T, indexing='ij'), axis=-1).reshape(8, 3)


def _triangles(part: VisualPart, link: int) -> Array:
    """Return (3 f, 8): position, face normal, grey albedo, link."""
    corners = part.vertices[part.faces].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    grey = float(np.dot(part.albedo, (0.2126, 0.7152, 0.0722)))
    rest = np.broadcast_to([grey, float(link)], (len(corners), 3, 2))
    return np.concatenate([corners, np.repeat(normal[:, None], 3, axis=1), rest],
                          axis=2).reshape(-1, 8)


def _pieces(part: VisualPart) -> list[tuple[Array, NDArray[np.int32]]]:
    """Split a mesh into its connected pieces; vertices at one place count as one."""
    places, index = np.unique(np.round(part.vertices.astype(float), 7), axis=0,
                              return_inverse=True)
    faces = index.reshape(-1)[part.faces]
    sides = faces[:, [0, 1, 1, 2]].reshape(-1, 2).T
    graph = coo_array((np.ones(sides.shape[1]), sides), shape=(len(places), len(places)))
    count, label = connected_components(graph, directed=False)
    result = []
    for k in range(count):
        members = np.flatnonzero(label == k)
        own = faces[label[faces[:, 0]] == k]
        result.append((places[members], np.searchsorted(members, own).astype(np.int32)))
    return result


def _standing_out(pieces: list[tuple[int, Array, NDArray[np.int32]]]) \
        -> list[tuple[int, Array, NDArray[np.int32]]]:
    """Leave out pieces that hardly stand out of a larger one of the same link."""
    planes = []
    for _, vertices, faces in pieces:
        corner = vertices[faces]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        planes.append((normal, (normal * corner[:, 0]).sum(axis=1)))
    kept = []
    for i, (link, vertices, faces) in enumerate(pieces):
        hidden = any(
            j != i and pieces[j][0] == link and len(planes[j][0]) > 0
            and np.all(vertices @ planes[j][0].T - planes[j][1] < _HIDDEN_M)
            and (np.ptp(pieces[j][1], axis=0).prod() > np.ptp(vertices, axis=0).prod())
            for j in range(len(pieces)))
        if not hidden:
            kept.append((link, vertices, faces))
    return kept
