"""Shadows of rocks, from their silhouettes as the sun sees them.

A rock is convex, so that its silhouette is a convex polygon in the plane perpendicular to the sun
rays. The signed distance to the edges of the polygon is the distance at which a sun ray passes the
rock. It is exact, whatever the pitch of the grid that stores the result.
"""

from __future__ import annotations

from collections.abc import Iterator
import dataclasses

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array, matrix_from_wxyz
from lunar_rover_sim.illumination.horizon import SunGeometry
from lunar_rover_sim.world.grid import HeightGrid
from lunar_rover_sim.world.rocks import Rocks, RockShape

F32 = NDArray[np.float32]

_BATCH = 1_500_000
_MAX_REACH_M = 40.0
_FALL = 0.05        # slope of the ground away from the rock that its shadow may follow
_LIT_RAD = 0.014    # where the sun stands higher above the horizon the ground is fully lit
_MARGIN_CELLS = 2.0


@dataclasses.dataclass(frozen=True)
class Silhouettes:
    """Convex outlines in the plane perpendicular to the sun rays [m]; see `axes`, rows 0 and 1.

    edges: (m, k, 3) unit outward normal and offset; unused ones repeat another
    centre: (m, 3) in all three axes; half_width: (m,); top: (m,) largest second coordinate
    axes: (3, 3) rows: lateral, upward in the sun's plane, towards the sun
    """

    edges: F32
    centre: Array
    half_width: Array
    top: Array
    axes: Array

    def distance(self, index: NDArray[np.int64], a: F32, b: F32) -> F32:
        """Return the signed distance [m] of points (a, b) from outline `index`; < 0 inside."""
        edges = self.edges[index]
        return (edges[..., 0] * a[..., None] + edges[..., 1] * b[..., None]
                - edges[..., 2]).max(axis=-1)


def sun_axes(sun: SunGeometry) -> Array:
    """Return (3, 3) rows: lateral, upward across the ray, towards the sun."""
    ca, sa = np.cos(sun.azimuth_rad), np.sin(sun.azimuth_rad)
    ce, se = np.cos(sun.elevation_rad), np.sin(sun.elevation_rad)
    return np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])


def silhouettes(rocks: Rocks, shapes: tuple[RockShape, ...], sun: SunGeometry) -> Silhouettes:
    """Return the outlines of all rocks towards the sun."""
    axes = sun_axes(sun)
    count = len(rocks)
    rotation = matrix_from_wxyz(rocks.orientation_wxyz) if count else np.zeros((0, 3, 3))
    parts: list[tuple[NDArray[np.int64], F32]] = []
    half_width, top = np.zeros(count), np.zeros(count)
    centre = rocks.position_m @ axes.T
    for k, shape in enumerate(shapes):
        members = np.flatnonzero(rocks.shape == k)
        if len(members) == 0:
            continue
        turned = np.einsum('ij,mjk,vk->mvi', axes, rotation[members], shape.vertices)
        turned = turned * rocks.diameter_m[members, None, None]
        half_width[members] = np.abs(turned[..., 0]).max(axis=1)
        top[members] = centre[members, 1] + turned[..., 1].max(axis=1)
        edges = outlines(turned, shape.faces)
        edges[..., 2] += np.einsum('mkj,mj->mk', edges[..., :2], centre[members, :2])
        parts.append((members, edges))
    widest = max((edges.shape[1] for _, edges in parts), default=1)
    result = np.zeros((count, widest, 3), np.float32)
    for members, edges in parts:
        result[members, :edges.shape[1]] = edges
        result[members, edges.shape[1]:] = edges[:, :1]
    return Silhouettes(result, centre, half_width, top, axes)


def outlines(vertices: Array, faces: NDArray[np.int32]) -> F32:
    """Return (m, k, 3) outline edges of (m, v, 3) convex meshes seen along their third axis."""
    corners = vertices[:, faces]
    cross = ((corners[:, :, 1, 0] - corners[:, :, 0, 0])
             * (corners[:, :, 2, 1] - corners[:, :, 0, 1])
             - (corners[:, :, 1, 1] - corners[:, :, 0, 1])
             * (corners[:, :, 2, 0] - corners[:, :, 0, 0]))
    front = cross > 0.0
    pairs, left, right = _edges(faces)
    outline = front[:, left] != front[:, right]
    widest = max(int(outline.sum(axis=1).max(initial=1)), 1)
    order = np.argsort(~outline, axis=1, kind='stable')[:, :widest]
    used = np.take_along_axis(outline, order, axis=1)
    order = np.where(used, order, order[:, :1])
    rows = np.arange(len(vertices))[:, None]
    p = vertices[rows, pairs[order, 0]][..., :2]
    q = vertices[rows, pairs[order, 1]][..., :2]
    direction = q - p
    length = np.maximum(np.linalg.norm(direction, axis=-1, keepdims=True), 1e-12)
    normal = np.stack([direction[..., 1], -direction[..., 0]], axis=-1) / length
    offset = (normal * p).sum(axis=-1)
    middle = vertices[..., :2].mean(axis=1)[:, None]
    inward = (normal * middle).sum(axis=-1) > offset
    sign = np.where(inward, -1.0, 1.0)
    return np.concatenate([normal * sign[..., None], (offset * sign)[..., None]],
                          axis=-1).astype(np.float32)


def _edges(faces: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64],
                                              NDArray[np.int64]]:
    """Return (e, 2) vertex pairs of a closed mesh and the two faces beside each."""
    half = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    owner = np.tile(np.arange(len(faces)), 3)
    key = np.sort(half, axis=1)
    order = np.lexsort((key[:, 1], key[:, 0]))
    key, owner = key[order], owner[order]
    return key[::2].astype(int), owner[::2], owner[1::2]


def stamp(clearance_m: F32, occluder_m: F32, grid: HeightGrid, rocks: Silhouettes,
          sun: SunGeometry) -> None:
    """Merge the shadows of rocks into clearance and occluder distance of a grid, in place [m]."""
    if len(rocks.edges) == 0 or sun.elevation_rad <= -0.02:
        return
    angle = (clearance_m / occluder_m).ravel()
    best = np.where(angle > _LIT_RAD, np.float32(np.inf), angle)
    flat_c, flat_t = clearance_m.reshape(-1), occluder_m.reshape(-1)
    pieces = []
    for cells, distance, along in _pairs(grid, rocks, sun):
        value = distance / along
        np.minimum.at(best, cells, value)
        pieces.append((cells, distance, along, value))
    for cells, distance, along, value in pieces:
        wins = value == best[cells]
        flat_c[cells[wins]] = distance[wins]
        flat_t[cells[wins]] = along[wins]


def darken(clearance_m: F32, occluder_m: F32, points_m: Array,
           rocks: Silhouettes) -> tuple[F32, F32]:
    """Return clearance and occluder distance of one point per rock, other rocks included."""
    clearance, occluder = clearance_m.copy(), occluder_m.copy()
    seen = points_m @ rocks.axes.T
    order = np.argsort(seen[:, 0], kind='stable')
    first = np.searchsorted(seen[order, 0], rocks.centre[:, 0] - rocks.half_width)
    count = np.searchsorted(seen[order, 0], rocks.centre[:, 0] + rocks.half_width) - first
    caster = np.repeat(np.arange(len(rocks.top)), count)
    offset = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    point = order[first[caster] + offset]
    along = rocks.centre[caster, 2] - seen[point, 2]
    keep = (along > 0.0) & (along < _MAX_REACH_M) & (caster != point) \
        & (seen[point, 1] < rocks.top[caster])
    caster, point, along = caster[keep], point[keep], along[keep].astype(np.float32)
    distance = rocks.distance(caster, *seen[point, :2].T.astype(np.float32))
    angle = clearance / occluder
    np.minimum.at(angle, point, distance / along)
    wins = angle[point] == distance / along
    clearance[point[wins]], occluder[point[wins]] = distance[wins], along[wins]
    return clearance, occluder


def _pairs(grid: HeightGrid, rocks: Silhouettes,
           sun: SunGeometry) -> Iterator[tuple[NDArray[np.int64], F32, F32]]:
    """Yield (cell, signed distance, distance along the ray) of cells near each shadow."""
    n, cell = grid.n, grid.cell_m
    heading = sun.direction_xy
    swap = abs(heading[0]) > abs(heading[1])
    major, minor = (0, 1) if swap else (1, 0)
    lean = heading[minor] / heading[major]
    position = rocks.centre @ rocks.axes
    ground = np.nan_to_num(grid.height_at(position[:, :2]), nan=-1e3)
    height = (rocks.top - rocks.axes[1, :2] @ position[:, :2].T) / rocks.axes[1, 2] - ground
    fall = max(np.tan(sun.elevation_rad - 0.005) - _FALL, 0.02)
    reach = np.clip(height / fall, 0.0, _MAX_REACH_M) + rocks.half_width + 2 * cell
    wide = rocks.half_width / abs(heading[major]) + _MARGIN_CELLS * cell
    inside = grid.contains(position[:, :2]) & (height > 0.0)
    steps = np.ceil(reach * abs(heading[major]) / cell).astype(int) + 1
    columns = np.ceil(2 * wide / cell).astype(int) + 2
    # Rocks with windows of nearly the same size are processed together.
    step_class = np.ceil(np.log2(steps) * 2).astype(int)
    column_class = np.ceil(np.log2(columns) * 2).astype(int)
    key = np.where(inside, step_class * 64 + column_class, -1)
    middle = 0.5 * (n - 1)
    origin = position[:, :2] / cell + middle
    for k in np.unique(key[inside]):
        group = np.flatnonzero(key == k)
        rows_n, columns_n = int(steps[group].max()), int(columns[group].max())
        batch = max(_BATCH // (rows_n * columns_n), 1)
        for start in range(0, len(group), batch):
            member = group[start:start + batch]
            sign = -1 if heading[major] > 0 else 1
            first = np.round(origin[member, major]).astype(int) - sign \
                * (np.ceil(rocks.half_width[member] / cell).astype(int) + 1)
            major_index = first[:, None] + sign * np.arange(rows_n)
            centre = origin[member, minor][:, None] \
                + lean * (major_index - origin[member, major][:, None])
            minor_index = np.round(centre).astype(int)[..., None] \
                + np.arange(columns_n) - columns_n // 2
            major_index = np.broadcast_to(major_index[..., None], minor_index.shape)
            ok = (major_index >= 0) & (major_index < n) & (minor_index >= 0) & (minor_index < n)
            owner = np.broadcast_to(member[:, None, None], ok.shape)[ok]
            mi, ni = major_index[ok], minor_index[ok]
            ix, iy = (mi, ni) if swap else (ni, mi)
            x = ((ix - middle) * cell).astype(np.float32)
            y = ((iy - middle) * cell).astype(np.float32)
            z = grid.heights_m[iy, ix]
            axes = rocks.axes.astype(np.float32)
            along = rocks.centre[owner, 2].astype(np.float32) \
                - (axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z)
            a = axes[0, 0] * x + axes[0, 1] * y
            b = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
            near = (along > 0.0) & (b < rocks.top[owner] + 2 * cell)
            owner, along, a, b = owner[near], along[near], a[near], b[near]
            cells = (iy[near] * n + ix[near])
            distance = rocks.distance(owner, a, b)
            close = distance < 2.5 * cell
            yield cells[close], distance[close], np.maximum(along[close], np.float32(0.01))
