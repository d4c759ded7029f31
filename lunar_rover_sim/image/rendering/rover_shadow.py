"""The shadow of the rover: its silhouette as the sun sees it.

All parts of the rover are built of convex pieces. Their outlines towards the sun make one map,
the silhouette as a signed distance. How far the ground lies behind the piece gives the penumbra,
sharp at the feet and wide far away.
"""

from __future__ import annotations

from collections.abc import Callable
import functools
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.rendering.canvas import FRAMES_UNDER_WAY
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.visual import link_poses, visual_parts, VisualPart

F32 = NDArray[np.float32]

MAP = 320               # pixels along a side of the silhouette map
_MARGIN_M = 0.06        # around the rover
_HIDDEN_M = 0.004       # pieces that protrude from others by less are left out of the shadow
_BLUR = 0.02            # of the distance: more than the sun's radius and half a pixel
_SUB = 4                # fractional bits of outline corners
_BAND = np.float32(4.0)     # pixels to either side of outlines to which distances are exact
_FAR, _SHORTEST = np.float32(1e9), np.float32(1e-9)


class _Piece(NamedTuple):
    """A convex piece: index of its link, (v, 3) corners in the link's frame [m], (f, 3) faces."""

    link: int
    vertices: Array
    faces: NDArray[np.int32]


class CastShadow(NamedTuple):
    """The shadow in one pose.

    Attributes:
        silhouette: Returns (MAP, MAP, 2) as `RoverShadow.silhouette` does.
        axes: Two of that map, over its half extent.
        centre: World position of the rover [m].
        bounds: (6,) of the rover in these axes, least and greatest; how far ahead it reaches [m];
            how much wider the shadow is behind it, over the distance.
    """

    silhouette: Callable[[], F32]
    axes: Array
    centre: Array
    bounds: F32

    def seen_from(self, camera: Array) -> F32:
        """Return (9,) axes of the map, and x and y of the rover and its height over a camera."""
        return np.array([*self.axes.ravel(), *self.centre[:2], self.centre[2] - camera[2]],
                        np.float32)


class RoverShadow:
    """The silhouettes of a rover."""

    def __init__(self, rover: RoverDescription) -> None:
        rest = link_poses(rover)
        links = list(rest)
        pieces = _pieces(rover)
        # Corners of all pieces, of each link; where each piece begins.
        corners = [np.concatenate([np.zeros((0, 3)), *(piece.vertices for piece in pieces
                                                       if piece.link == link)])
                   for link in range(len(links))]
        self._corners, self._starts = corners, np.cumsum([0, *(len(piece.vertices)
                                                               for piece in pieces)])
        reach = float(np.linalg.norm(np.concatenate(corners), axis=1).max()) + max(
            float(np.linalg.norm(pose[:3, 3])) for pose in rest.values())
        self.radius_m = reach
        self._half_m = reach + _MARGIN_M    # half extent of the silhouette map
        self._latest = functools.lru_cache(maxsize=FRAMES_UNDER_WAY)(self._silhouette_of)

    def cast(self, T_world_links: Array, sun_axes: Array) -> CastShadow:
        """Return the shadow.

        Args:
            T_world_links: (links, 4, 4).
            sun_axes: (3, 3) as `rock_shadow.sun_axes`.
        """
        # Further cameras, and all faces of a fisheye, show the rover in the same pose.
        wanted = T_world_links.tobytes(), sun_axes.tobytes()
        corners = self._seen_corners(T_world_links, sun_axes)
        low, high = corners.min(axis=0), corners.max(axis=0)
        across = np.stack([low - _MARGIN_M, high + _MARGIN_M], axis=1)[:2] / self._half_m
        bounds = np.array([*across.ravel(), high[2], _BLUR / self._half_m], np.float32)
        return CastShadow(functools.partial(self._latest, *wanted), sun_axes[:2] / self._half_m,
                          T_world_links[0, :3, 3], bounds)

    def _silhouette_of(self, links: bytes, axes: bytes) -> F32:
        return self.silhouette(np.frombuffer(links).reshape(-1, 4, 4),
                               np.frombuffer(axes).reshape(3, 3))

    def _seen_corners(self, T_world_links: Array, sun_axes: Array) -> Array:
        """Return (v, 3) corners of all pieces in axes of the sun, relative to the rover [m]."""
        offsets = (T_world_links[:, :3, 3] - T_world_links[0, :3, 3]) @ sun_axes.T
        turns = sun_axes @ T_world_links[:, :3, :3]
        return np.concatenate([offset + corners @ turn.T for offset, corners, turn in
                               zip(offsets, self._corners, turns)])

    def silhouette(self, T_world_links: Array, sun_axes: Array) -> F32:
        """Return the (MAP, MAP, 2) silhouette of the rover as the sun sees it.

        Its two values are the signed distance to the outline, < 0 inside [m], and the position of
        the piece along the sun ray, relative to the rover [m].
        """
        half = self._half_m
        scale = 0.5 * MAP / half
        seen = self._seen_corners(T_world_links, sun_axes)
        flat = (seen[:, :2] * scale + (0.5 * MAP - 0.5)).astype(np.float32)
        outlines = [cv2.convexHull(flat[first:end])[:, 0]
                    for first, end in zip(self._starts[:-1], self._starts[1:])]
        shapes = [(float(seen[first:end, 2].mean()),
                   np.rint(outline * (1 << _SUB)).astype(np.int32))
                  for first, end, outline in zip(self._starts[:-1], self._starts[1:], outlines)]
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
        distance = outside - inside
        # The transform measures to the centre of the nearest pixel of the other kind.
        distance -= np.copysign(np.float32(0.5), distance)
        _straighten(distance, np.concatenate(outlines),
                    np.cumsum([0, *(len(outline) for outline in outlines)]))
        distance *= np.float32(1.0 / scale)
        np.copyto(depth, cv2.dilate(depth, np.ones((25, 25), np.uint8)), where=free > 0)
        return np.asarray(cv2.merge([distance, depth]), np.float32)


@compiled
def _straighten(distance, corners, starts):  # type: ignore[no-untyped-def]
    """Replace distances near the outlines, which have steps of pixels, by those to the polygons.

    Args:
        distance: (n, n) signed, in pixels.
        corners: (v, 2) of convex polygons, one after the other, in pixels.
        starts: Where each begins, and the end.
    """
    n = len(distance)
    nearest = np.full((n, n), _FAR, np.float32)
    for k in range(len(starts) - 1):
        own = corners[starts[k]:starts[k + 1]]
        left, right = _FAR, -_FAR
        low, high, area = _FAR, -_FAR, np.float32(0.0)
        for i in range(len(own)):
            a, b = own[i - 1], own[i]
            left, right = min(left, b[0]), max(right, b[0])
            low, high = min(low, b[1]), max(high, b[1])
            area += a[0] * b[1] - a[1] * b[0]
        if area == 0.0:
            continue
        sign = np.float32(1.0) if area > 0.0 else np.float32(-1.0)
        for r in range(max(int(low - _BAND), 0), min(int(high + _BAND) + 2, n)):
            for c in range(max(int(left - _BAND), 0), min(int(right + _BAND) + 2, n)):
                if abs(distance[r, c]) > _BAND:
                    continue
                inside, square = -_FAR, _FAR
                for i in range(len(own)):
                    a, b = own[i - 1], own[i]
                    u, v = b[0] - a[0], b[1] - a[1]
                    x, y = np.float32(c) - a[0], np.float32(r) - a[1]
                    length2 = max(u * u + v * v, _SHORTEST)
                    inside = max(inside, sign * (x * v - y * u) / np.sqrt(length2))
                    t = min(max((x * u + y * v) / length2, np.float32(0.0)), np.float32(1.0))
                    square = min(square, (x - t * u)**2 + (y - t * v)**2)
                own_distance = np.sqrt(square) if inside > 0.0 else inside
                nearest[r, c] = min(nearest[r, c], own_distance)
    for r in range(n):
        for c in range(n):
            if nearest[r, c] < _FAR:
                distance[r, c] = nearest[r, c]


@functools.lru_cache(maxsize=2)     # for the next renderer of the same rover
def _pieces(rover: RoverDescription) -> tuple[_Piece, ...]:
    """Return the pieces that cast the shadow, link by link."""
    links = list(link_poses(rover))
    pieces = _protruding([piece for part in visual_parts(rover)
                          for piece in _split(part, links.index(part.link))])
    return tuple(sorted(pieces, key=lambda piece: piece.link))


def _split(part: VisualPart, link: int) -> list[_Piece]:
    """Split a mesh into pieces whose faces hang together by their sides.

    Vertices at one place count as one. Spokes that meet in a point are pieces of their own.
    """
    places, index = np.unique(np.round(part.vertices.astype(float), 7), axis=0,
                              return_inverse=True)
    faces = index.reshape(-1)[part.faces]
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=-1).reshape(-1, 2)
    side = len(faces) + np.unique(sides, axis=0, return_inverse=True)[1].reshape(-1)
    ends = np.repeat(np.arange(len(faces)), 3), side
    # Here, because they take time to import, and the parts of a rover are found once.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    graph = coo_array((np.ones(len(side)), ends), shape=(side.max() + 1,) * 2)
    count, label = connected_components(graph, directed=False)
    result = []
    for k in range(count):
        own = faces[label[:len(faces)] == k]
        members = np.unique(own)
        result.append(_Piece(link, places[members],
                             np.searchsorted(members, own).astype(np.int32)))
    return result


def _protruding(pieces: list[_Piece]) -> list[_Piece]:
    """Return the pieces without those that hardly protrude from a larger one of the same link."""
    planes = []
    for piece in pieces:
        corner = piece.vertices[piece.faces]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        planes.append((normal, (normal * corner[:, 0]).sum(axis=1)))
    kept = []
    for i, piece in enumerate(pieces):
        hidden = any(
            j != i and other.link == piece.link and len(planes[j][0]) > 0
            and np.all(piece.vertices @ planes[j][0].T - planes[j][1] < _HIDDEN_M)
            and np.ptp(other.vertices, axis=0).prod() > np.ptp(piece.vertices, axis=0).prod()
            for j, other in enumerate(pieces))
        if not hidden:
            kept.append(piece)
    return kept
