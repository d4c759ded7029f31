"""Shadows of rocks, from their silhouettes as the sun sees them.

A rock is convex, or of convex pieces, and the silhouette of a piece is a convex polygon in the
plane perpendicular to the sun rays. The signed distance to the edges of the polygon is the
distance at which a sun ray passes the piece. It is exact, whatever the pitch of the grid that
stores the result.
"""

from __future__ import annotations

from collections.abc import Iterator
import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled, read_only
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.rocks import Rocks, RockShape
from lunar_rover_sim.image.illumination.horizon import SunGeometry

F32 = NDArray[np.float32]

Near = tuple[NDArray[np.int64], NDArray[np.int64], F32, F32, F32]

_BATCH = 1_500_000
_MAX_REACH_M = 40.0
_FALL = 0.05        # slope of the ground away from the rock that its shadow may follow
_LIT_RAD = 0.014    # with the sun that far above the horizon ground is lit, that far below dark
_MARGIN_CELLS = 2
_OUTLINE_SHARE = 0.68       # of an outline in the rectangle around it: the mean of the library
_LEAST_WIDTH_CELLS = 0.4    # rocks narrower than this cast no shadow on a coarse grid


@dataclasses.dataclass(frozen=True)
class Silhouettes:
    """Convex outlines in the plane perpendicular to the sun rays [m]; see `axes`, rows 0 and 1.

    Attributes:
        owner: (m,) index of the rock of which it is the outline, or that of a piece.
        edges: (m, k, 3) unit outward normal and offset; unused ones repeat another.
        centre: (m, 3) in all three axes.
        half_width: (m,) of the whole rock in the first axis.
        top: (m,) its largest second coordinate.
        axes: (3, 3) rows: lateral, upward in the sun's plane, towards the sun.
    """

    owner: NDArray[np.int64]
    edges: F32
    centre: Array
    half_width: Array
    top: Array
    axes: Array

    @functools.cached_property
    def _by_edge(self) -> F32:
        """(k, 3, m) edges, one of all rocks after the other."""
        return np.ascontiguousarray(self.edges.transpose(1, 2, 0))

    def distance(self, index: NDArray[np.int64], a: F32, b: F32) -> F32:
        """Return the signed distance [m] of points (a, b) from outline `index`; < 0 inside."""
        result = np.full(len(a), -np.inf, np.float32)
        # Edge by edge: a table of all edges of all points is too large for the cache.
        for normal_a, normal_b, offset in self._by_edge:
            beyond = normal_a[index] * a
            beyond += normal_b[index] * b
            beyond -= offset[index]
            np.maximum(result, beyond, out=result)
        return result


def sun_axes(sun: SunGeometry) -> Array:
    """Return (3, 3) rows: lateral, upward across the ray, towards the sun."""
    ca, sa = np.cos(sun.azimuth_rad), np.sin(sun.azimuth_rad)
    ce, se = np.cos(sun.elevation_rad), np.sin(sun.elevation_rad)
    return np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])


def silhouettes(rocks: Rocks, shapes: tuple[RockShape, ...], sun: SunGeometry) -> Silhouettes:
    """Return the outlines of the pieces of all rocks towards the sun."""
    rocks, shapes, owner = rocks.in_pieces(shapes)
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
        turned = shape.vertices @ (axes @ rotation[members]).transpose(0, 2, 1)
        turned *= rocks.diameter_m[members, None, None]
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
    # Of all pieces of a rock.
    for values in (half_width, top):
        whole = np.full(owner[-1] + 1 if count else 0, -np.inf)
        np.maximum.at(whole, owner, values)
        values[:] = whole[owner]
    return Silhouettes(owner, result, centre, half_width, top, axes)


def outlines(vertices: Array, faces: NDArray[np.int32]) -> F32:
    """Return (m, k, 3) outline edges of (m, v, 3) convex meshes seen along their third axis."""
    x, y = np.ascontiguousarray(vertices[..., 0]), np.ascontiguousarray(vertices[..., 1])
    first, second, third = faces.T
    x0, y0 = x[:, first], y[:, first]
    front = (x[:, second] - x0) * (y[:, third] - y0) > (y[:, second] - y0) * (x[:, third] - x0)
    pairs, left, right = _edges(faces)
    outline = front[:, left] != front[:, right]
    owner, edge = np.nonzero(outline)
    count = outline.sum(axis=1)
    start = np.cumsum(count) - count
    order = np.repeat(edge[start][:, None], count.max(initial=1), axis=1)
    order[owner, np.arange(len(owner)) - start[owner]] = edge
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
    light = angle > -_LIT_RAD
    for near in _pairs(grid, rocks, sun, _near(grid, rocks, 0.0), _MARGIN_CELLS):
        _stamp(clearance_m.reshape(-1), occluder_m.reshape(-1), best, light, rocks.edges,
               np.float32(2.5 * grid.cell_m), *near)


@compiled
def _stamp(clearance_m: F32, occluder_m: F32, best: F32, light: NDArray[np.bool_], edges: F32,
           close_m: np.float32, cells: NDArray[np.int64], owner: NDArray[np.int64], along: F32,
           a: F32, b: F32) -> None:
    """Do the work of `stamp` for cells near shadows; best: least angle of each cell; changed."""
    for p in range(len(cells)):
        cell, rock = cells[p], owner[p]
        if not light[cell]:
            continue
        distance = np.float32(-np.inf)      # as `Silhouettes.distance`
        for e in range(edges.shape[1]):
            distance = max(distance, edges[rock, e, 0] * a[p] + edges[rock, e, 1] * b[p]
                           - edges[rock, e, 2])
            if distance >= close_m:
                break
        away = max(along[p], np.float32(0.01))
        if distance < close_m and distance / away <= best[cell]:
            best[cell] = distance / away
            clearance_m[cell], occluder_m[cell] = distance, away


def share(grid: HeightGrid, rocks: Silhouettes, sun: SunGeometry,
          inner_half_m: float) -> NDArray[np.uint8]:
    """Return (n, n) shares of the grid's cells that lie in the shadow of rocks, 255 for all of it.

    Coarse cells are as large as the shadows, which have no edges to keep there: what counts is how
    much of a cell is dark. An outline counts as a rectangle of about its area. Penumbrae are
    narrower than a cell and left out.

    Args:
        inner_half_m: Half extent of the finer grid within, where the share does not matter.
    """
    dark = np.zeros(grid.heights_m.size, np.float32)
    cells_of, shares = [], []
    near = _near(grid, rocks, inner_half_m)
    near[1:] &= rocks.owner[1:] != rocks.owner[:-1]     # a rectangle is that of the whole rock
    if sun.elevation_rad > 0.0 and np.any(near):
        width = np.float32(grid.cell_m)
        height = np.float32(grid.cell_m * max(np.sin(sun.elevation_rad), 0.02))
        half = (_OUTLINE_SHARE * rocks.half_width).astype(np.float32)
        top = rocks.top.astype(np.float32)
        middle = rocks.centre[:, 0].astype(np.float32)
        for cells, owner, _, a, b in _pairs(grid, rocks, sun, near, 1):
            side = np.abs(a - middle[owner])
            across = np.minimum(half[owner] - side + 0.5 * width, 2.0 * half[owner])
            upward = np.clip((top[owner] - b) / height + np.float32(0.5), 0.0, 1.0)
            cells_of.append(cells)
            shares.append(np.clip(across / width, 0.0, 1.0) * upward)
        np.add.at(dark, np.concatenate(cells_of), np.concatenate(shares))
    np.minimum(dark, np.float32(1.0), out=dark)
    dark *= np.float32(255.0)
    return np.rint(dark, out=dark).astype(np.uint8).reshape(grid.heights_m.shape)


def _near(grid: HeightGrid, rocks: Silhouettes, inner_half_m: float) -> NDArray[np.bool_]:
    """Return the rocks whose shadows may fall on a grid, outside the finer one within it."""
    away = np.abs((rocks.centre @ rocks.axes)[:, :2]).max(axis=1, initial=0.0)
    inner = inner_half_m - _MAX_REACH_M - 2.0 * rocks.half_width
    return (away < grid.half_extent_m + _MAX_REACH_M) & (away > inner) \
        & (2.0 * rocks.half_width > _LEAST_WIDTH_CELLS * grid.cell_m * (inner_half_m > 0.0))


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
    keep = (along > 0.0) & (along < _MAX_REACH_M) & (rocks.owner[caster] != point) \
        & (seen[point, 1] < rocks.top[caster])
    caster, point, along = caster[keep], point[keep], along[keep].astype(np.float32)
    distance = rocks.distance(caster, *seen[point, :2].T.astype(np.float32))
    angle = clearance / occluder
    np.minimum.at(angle, point, distance / along)
    wins = angle[point] == distance / along
    clearance[point[wins]], occluder[point[wins]] = distance[wins], along[wins]
    return clearance, occluder


def _pairs(grid: HeightGrid, rocks: Silhouettes, sun: SunGeometry, chosen: NDArray[np.bool_],
           margin_cells: int) -> Iterator[Near]:
    """Yield cells near each shadow: (cell, rock, distance along the ray, a, b), see Silhouettes.

    Args:
        chosen: The rocks that count.
        margin_cells: Beside a shadow, how many cells count as near.
    """
    cell, heights = grid.cell_m, read_only(grid.heights_m, np.float32)
    heading = sun.direction_xy
    swap = abs(heading[0]) > abs(heading[1])
    major, minor = (0, 1) if swap else (1, 0)
    lean = heading[minor] / heading[major]
    position = rocks.centre @ rocks.axes
    within = np.clip(position[:, :2], -grid.half_extent_m, grid.half_extent_m)
    ground = grid.height_at(within)
    height = (rocks.top - rocks.axes[1, :2] @ position[:, :2].T) / rocks.axes[1, 2] - ground
    fall = max(np.tan(sun.elevation_rad - 0.005) - _FALL, 0.02)
    reach = np.clip(height / fall, 0.0, _MAX_REACH_M) + rocks.half_width + margin_cells * cell
    wide = rocks.half_width / abs(heading[major]) + margin_cells * cell
    inside = chosen & (height > 0.0) \
        & (np.abs(position[:, :2]).max(axis=1) < grid.half_extent_m + reach)
    # Windows begin before the rock, on the side of the sun.
    before = np.ceil(rocks.half_width / cell).astype(int) + 1
    steps = np.ceil((reach - rocks.half_width) * abs(heading[major]) / cell).astype(int) + before
    steps += 1
    columns = np.ceil(2 * wide / cell).astype(int) + margin_cells
    # Rocks with windows of nearly the same size are processed together.
    step_class = np.ceil(np.log2(steps) * 2).astype(int)
    column_class = np.ceil(np.log2(columns) * 2).astype(int)
    key = np.where(inside, step_class * 64 + column_class, -1)
    origin = position[:, :2] / cell + 0.5 * (grid.n - 1)
    sign = -1 if heading[major] > 0 else 1
    first = np.round(origin[:, major]).astype(int) - sign * before
    for k in np.unique(key[inside]):
        group = np.flatnonzero(key == k)
        window = int(steps[group].max()), int(columns[group].max())
        batch = max(_BATCH // (window[0] * window[1]), 1)
        for start in range(0, len(group), batch):
            member = group[start:start + batch]
            yield _near_cells(
                heights, cell, member, first[member], sign, window, swap,
                origin[member, major], origin[member, minor], lean,
                rocks.centre[member, 2].astype(np.float32), rocks.top[member],
                rocks.axes.astype(np.float32))


@compiled
def _near_cells(heights: F32, cell_m: float, rocks: NDArray[np.int64],
                first: NDArray[np.int64], sign: int, window: tuple[int, int], swap: bool,
                major: Array, minor: Array, lean: float, depth_m: F32, top_m: Array,
                axes: F32) -> Near:
    """Return what `_pairs` yields for rocks with windows of one size.

    Args:
        rocks: (m,) their indices; first: of their windows, along the major axis.
        window: Steps away from the sun along that axis, and cells across.
        major, minor: (m,) where they stand, in cells; lean: of the shadows from the major axis.
        depth_m, top_m: (m,) distance towards the sun, and upper end of the outline.
    """
    n, middle, (steps, width) = len(heights), 0.5 * (len(heights) - 1), window
    room, count = len(rocks) * steps * width, 0
    cells, owner = np.empty(room, np.int64), np.empty(room, np.int64)
    found = np.empty((3, room), np.float32)
    for m in range(len(rocks)):
        for step in range(steps):
            i = first[m] + sign * step
            left = int(np.rint(minor[m] + lean * (i - major[m]))) - width // 2
            for j in range(max(left, 0), min(left + width, n) if 0 <= i < n else 0):
                ix, iy = (i, j) if swap else (j, i)
                x, y = np.float32((ix - middle) * cell_m), np.float32((iy - middle) * cell_m)
                z = heights[iy, ix]
                along = depth_m[m] - (axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z)
                b = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
                if along > 0.0 and b < top_m[m] + 2 * cell_m:
                    cells[count], owner[count] = iy * n + ix, rocks[m]
                    found[0, count], found[2, count] = along, b
                    found[1, count] = axes[0, 0] * x + axes[0, 1] * y
                    count += 1
    return cells[:count], owner[:count], found[0, :count], found[1, :count], found[2, :count]
