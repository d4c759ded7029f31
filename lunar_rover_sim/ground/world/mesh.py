"""Triangle meshes as terrain: a height field from exact vertical ray casting."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import logging
import pathlib
from typing import Any

import numpy as np
from numpy.typing import NDArray
import trimesh

from lunar_rover_sim.base.errors import one_line, WorldError
from lunar_rover_sim.base.files.paths import check_regular, user_path
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.fill import harmonic_fill
from lunar_rover_sim.ground.world.grid import Box, box_around, widened
from lunar_rover_sim.ground.world.missing_data import max_step_m
from lunar_rover_sim.ground.world.raster import MAX_HEIGHT_M
from lunar_rover_sim.ground.world.tile import PAD_PIXELS, Tile

logger = logging.getLogger(__name__)

FORMATS = ('.obj', '.stl', '.ply', '.glb', '.gltf', '.off')
_CANDIDATES = 1_000_000  # points tested against triangles at once
_LARGEST_M = 1e8         # of a coordinate: 60 radii of the Moon
_RAYS = 4                # along the side of a sample that is looked at for holes
_ROWS_AT_ONCE = 64       # of such samples


@dataclasses.dataclass(frozen=True)
class MeshHits:
    """Where vertical rays met a mesh.

    Attributes:
        top_m: (ny, nx) highest hit, NaN where there is none.
        layers: (ny, nx) number of separate upward faces on the ray, 0 if they were not counted;
            more than one means an overhang.
    """

    top_m: NDArray[np.float64]
    layers: NDArray[np.int32]


def cast(triangles_m: NDArray[np.float64], x_m: NDArray[np.float64], y_m: NDArray[np.float64],
         count_layers: bool = True) -> MeshHits:
    """Return where vertical rays at the grid of x and y (evenly spaced) meet (f, 3, 3) triangles.

    Each triangle is tested against the rays in its bounding box only, exactly, by its edges.
    """
    nx, ny = len(x_m), len(y_m)
    step_x, step_y = x_m[1] - x_m[0], y_m[1] - y_m[0]
    low, high = triangles_m.min(axis=1), triangles_m.max(axis=1)
    slack = 1e-9
    i0 = np.maximum(np.ceil((low[:, 0] - x_m[0]) / step_x - slack), 0).astype(int)
    i1 = np.minimum(np.floor((high[:, 0] - x_m[0]) / step_x + slack), nx - 1).astype(int)
    j0 = np.maximum(np.ceil((low[:, 1] - y_m[0]) / step_y - slack), 0).astype(int)
    j1 = np.minimum(np.floor((high[:, 1] - y_m[0]) / step_y + slack), ny - 1).astype(int)
    edge_a, edge_b = triangles_m[:, 1] - triangles_m[:, 0], triangles_m[:, 2] - triangles_m[:, 0]
    twice_area = edge_a[:, 0] * edge_b[:, 1] - edge_a[:, 1] * edge_b[:, 0]
    scale = np.abs(edge_a[:, :2]).max(axis=1) * np.abs(edge_b[:, :2]).max(axis=1)
    use = (i0 <= i1) & (j0 <= j1) & (np.abs(twice_area) > 1e-12 * np.maximum(scale, 1e-300))
    index = np.flatnonzero(use)
    wide = (i1 - i0 + 1)[index]
    count = wide * (j1 - j0 + 1)[index]
    top = np.full(nx * ny, -np.inf)
    upward: list[tuple[NDArray, NDArray]] = []
    ends = np.cumsum(count)
    start = 0
    while start < len(index):
        base = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, base + _CANDIDATES, side='right')), start + 1)
        which = np.repeat(np.arange(start, stop), count[start:stop])
        serial = np.arange(len(which)) - (ends[which] - count[which] - base)
        t = index[which]
        i = i0[t] + serial % wide[which]
        j = j0[t] + serial // wide[which]
        px, py = x_m[i] - triangles_m[t, 0, 0], y_m[j] - triangles_m[t, 0, 1]
        inverse = 1.0 / twice_area[t]
        u = (px * edge_b[t, 1] - py * edge_b[t, 0]) * inverse
        v = (py * edge_a[t, 0] - px * edge_a[t, 1]) * inverse
        hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9)
        t = t[hit]
        place = j[hit] * nx + i[hit]
        z = triangles_m[t, 0, 2] + u[hit] * edge_a[t, 2] + v[hit] * edge_b[t, 2]
        np.maximum.at(top, place, z)
        if count_layers:
            up = twice_area[t] > 0.0
            upward.append((place[up].astype(np.int32), z[up]))
        start = stop
    layers = np.zeros(nx * ny, np.int32)
    if upward:
        # A ray through a common edge hits both triangles: count separate heights.
        place = np.concatenate([p for p, _ in upward])
        z = np.concatenate([h for _, h in upward])
        order = np.lexsort((z, place))
        place, z = place[order], z[order]
        separate = np.ones(len(place), bool)
        separate[1:] = (place[1:] != place[:-1]) | (z[1:] - z[:-1] > 1e-6)
        np.add.at(layers, place[separate], 1)
    top[np.isneginf(top)] = np.nan
    return MeshHits(top.reshape(ny, nx), layers.reshape(ny, nx))


class MeshSource:
    """A mesh file as a `tile.Source`."""

    def __init__(self, config: WorldConfig) -> None:
        self.config = config
        self.path = user_path(config.path, 'world.path')
        triangles = _triangles(self.path, config)
        low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
        middle = 0.5 * (low + high)[:2] + np.asarray(config.mesh.center)
        self.reference_m = 0.5 * float(low[2] + high[2])
        self._triangles = triangles - [*middle, self.reference_m]
        self.area_m = (float(low[0] - middle[0]), float(high[0] - middle[0]),
                       float(low[1] - middle[1]), float(high[1] - middle[1]))
        self.pixel_m = max(config.mesh.resolution_m, config.cell_m)
        self.report: dict[str, Any] = {'file': str(self.path), 'triangles': len(triangles)}
        self._extent_m = float(high[0] - low[0]), float(high[1] - low[1])
        self.check_window((0.0, 0.0))

    def check_window(self, middle_m: tuple[float, float]) -> None:
        """Check the fine ground around a place.

        Raises:
            WorldError: If it is not within the mesh, or has holes.
        """
        half, (x, y) = 0.5 * self.config.size_m, middle_m
        where = '' if middle_m == (0.0, 0.0) else f' around x {x:g}, y {y:g} m'
        area = self.area_m
        least = min(x - area[0], area[1] - x, y - area[2], area[3] - y)
        if least < half - 1e-6:
            raise WorldError(
                f'{self.path}: the window of {self.config.size_m:g} m{where} reaches '
                f'{half - least:.4g} m beyond the mesh ({self._extent_m[0]:.5g} x '
                f'{self._extent_m[1]:.5g} m); move world.mesh.center, set world.mesh.scale, or '
                'make world.size_m smaller')
        _, _, hits = self._cast(box_around(middle_m, half), self.config.cell_m, True)
        holes, overhangs = int(np.isnan(hits.top_m).sum()), int((hits.layers > 1).sum())
        rays = hits.top_m.size
        self.report.update(rays=rays, holes=holes, overhangs=overhangs)
        if holes == rays:
            raise WorldError(f'{self.path}: no vertical ray meets the mesh in the window{where}; '
                             'move world.mesh.center or choose another world.mesh.up_axis')
        if holes and self.config.mesh.holes == 'refuse':
            raise WorldError(f'{self.path}: {holes} of {rays} vertical rays in the window{where} '
                             'meet no face; mend the mesh or set world.mesh.holes to fill')
        if holes:
            logger.warning('%s: %d of %d rays met no face%s; the holes are filled', self.path,
                           holes, rays, where)
        if overhangs:
            logger.warning('%s: %d of %d rays met several surfaces%s; the highest is taken',
                           self.path, overhangs, rays, where)

    def tile(self, box_m: Box, cell_m: float) -> Tile | None:
        """Return the heights in a box and around it, sampled at `resolution_m` or the cell."""
        spacing = max(self.pixel_m, cell_m)
        first, _, hits = self._cast(widened(box_m, PAD_PIXELS * spacing), spacing)
        known = np.isfinite(hits.top_m)
        if not known.any():
            return None
        top = np.where(known, hits.top_m, 0.0).astype(np.float32)
        return Tile(harmonic_fill(top, known), first, (0.0, 0.0), (spacing, spacing),
                    not known.all())

    def has_data(self, x_m: NDArray[np.float64],
                 y_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return where the mesh has no hole at and around samples, as `Raster.has_data`.

        A hole between the rays, `_RAYS` along the side of a sample, is not seen.
        """
        places = (np.arange(_RAYS) + 0.5) / _RAYS - 0.5
        x, y = ((at[:, None] + (at[1] - at[0]) * places).ravel() for at in (x_m, y_m))
        found = np.empty((len(y_m), len(x_m)), bool)
        for row in range(0, len(y_m), _ROWS_AT_ONCE):
            rows = y[row * _RAYS:(row + _ROWS_AT_ONCE) * _RAYS]
            hits = np.isfinite(cast(self._triangles, x, rows, False).top_m)
            hits |= np.logical_or.outer(_beyond(rows, self.area_m[2:]),
                                        _beyond(x, self.area_m[:2]))
            found[row:row + _ROWS_AT_ONCE] = hits.reshape(-1, _RAYS, len(x_m), _RAYS).all((1, 3))
        return found

    def close(self) -> None:
        """Release the mesh."""
        self._triangles = np.empty((0, 3, 3))

    def _cast(self, box_m: Box, spacing_m: float, count_layers: bool = False
              ) -> tuple[tuple[int, int], list[NDArray[np.float64]], MeshHits]:
        """Cast rays at the multiples of the spacing that lie on the mesh and in a box.

        Returns:
            The first multiple along x and y, the places, and what was hit: nothing if there are
            fewer than two along a side.
        """
        first, axes = [], []
        for low, high, least, most in zip(self.area_m[::2], self.area_m[1::2], box_m[::2],
                                          box_m[1::2]):
            first.append(int(np.ceil(max(low, least) / spacing_m - 1e-6)))
            last = int(np.floor(min(high, most) / spacing_m + 1e-6))
            axes.append(np.arange(first[-1], last + 1, dtype=np.float64) * spacing_m)
        begin = first[0], first[1]
        if min(len(axes[0]), len(axes[1])) < 2:
            return begin, axes, MeshHits(np.empty((0, 0)), np.empty((0, 0), np.int32))
        return begin, axes, cast(self._triangles, axes[0], axes[1], count_layers)


def _beyond(at: NDArray[np.float64], ends: Sequence[float]) -> NDArray[np.bool_]:
    """Return which places lie beyond the ends of the mesh along an axis, or at one."""
    return (at < ends[0] + 1e-6) | (at > ends[1] - 1e-6)


def _triangles(path: pathlib.Path, config: WorldConfig) -> NDArray[np.float64]:
    """Return the (f, 3, 3) corners [m] of a mesh file, z up; raise WorldError."""
    check_regular(path, WorldError)
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise WorldError(f'world.path: {path}: not a mesh format that is read; valid are '
                         + ', '.join(FORMATS))
    try:
        with np.errstate(all='ignore'):     # numbers beyond all bounds are refused below
            loaded: Any = trimesh.load(path, process=False)
            if isinstance(loaded, trimesh.Scene):
                loaded = loaded.to_mesh()
    except Exception as error:  # the parsers raise errors of any class on a damaged file
        text = one_line(error)
        raise WorldError(f'{path}: cannot be read as a mesh: {text}') from None
    faces = getattr(loaded, 'faces', None)
    if faces is None or len(faces) == 0:
        raise WorldError(f'{path}: has no faces; a height field needs a surface')
    indices, count = np.asarray(faces), len(loaded.vertices)
    if indices.min() < 0 or indices.max() >= count:
        raise WorldError(f'{path}: a face names vertex {int(indices.max())}, counted from 0; the '
                         f'file has {count} vertices')
    with np.errstate(all='ignore'):
        triangles = np.asarray(loaded.triangles, np.float64) * config.mesh.scale
    if not np.all(np.abs(triangles) <= _LARGEST_M):
        raise WorldError(f'{path}: has vertices that are not finite numbers up to '
                         f'{_LARGEST_M:g} m')
    if triangles.shape[1:] != (3, 3):
        raise WorldError(f'{path}: cannot be read as a mesh: its vertices have '
                         f'{triangles.shape[-1]} coordinates, not 3')
    up = config.mesh.up_axis
    if up == 'auto':
        up = 'y' if suffix in ('.glb', '.gltf') else 'z'
    # glTF: y up, z towards the viewer, x right; so east = x, north = -z.
    turn = {'x': [[0, 1, 0], [0, 0, 1], [1, 0, 0]], 'y': [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
            'z': np.eye(3)}[up]
    triangles = triangles @ np.asarray(turn, float).T
    height_m = float(np.ptp(triangles[..., 2]))
    if height_m > 2.0 * MAX_HEIGHT_M:
        raise WorldError(f'{path}: its heights differ by {height_m:g} m, more than any on the '
                         f'Moon; valid is up to {2.0 * MAX_HEIGHT_M:g} m; mend its vertices, or '
                         'set world.mesh.scale')
    _refuse_spikes(path, triangles)
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    flat = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    total = np.linalg.norm(np.cross(a, b), axis=1).sum()
    if total == 0.0 or np.abs(flat).sum() < 1e-6 * total:
        raise WorldError(f'{path}: seen from above it has no area; choose another '
                         'world.mesh.up_axis')
    if flat.sum() < -1e-6 * np.abs(flat).sum():
        # The faces of an open surface are wound the other way round: turn them to look up.
        triangles = triangles[:, ::-1]
    return triangles


def _refuse_spikes(path: pathlib.Path, triangles: NDArray[np.float64]) -> None:
    """Raise WorldError if a vertex stands off all of its neighbours as no ground does.

    A wall is none: its vertices have neighbours beside them.
    """
    edges = triangles - np.roll(triangles, -1, axis=1)
    steep = np.abs(edges[..., 2]) > max_step_m(np.hypot(edges[..., 0], edges[..., 1]))
    tips = steep & np.roll(steep, 1, axis=1)        # both edges of a corner are
    if not tips.any():
        return
    _, vertex = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    vertex = vertex.reshape(tips.shape)
    spikes = np.setdiff1d(vertex[tips], vertex[~tips])
    if len(spikes):
        x, y, z = triangles[vertex == spikes[0]][0]
        raise WorldError(f'{path}: the vertex at x {x:.6g}, y {y:.6g}, z {z:.6g} m stands off all '
                         'of its neighbours as no ground does; mend the mesh, or set '
                         'world.mesh.scale')
