"""The ground as meshes: tiles of the fine grid in three resolutions, and the surroundings.

The finest tiles have the very vertices and triangles of `HeightGrid`, which MuJoCo collides with.
A tile's points are relative to its middle in x and y, so that single precision holds them to
0.1 um; heights are those of the grid, which has single precision itself.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.files.images import write_png
from lunar_rover_sim.ground.world.fine_relief import slopes
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.levels import axis_m
from lunar_rover_sim.ground.world.rocks import Rocks, RockShape
from lunar_rover_sim.products.usd.material import bind, bind_contact
from lunar_rover_sim.products.usd.stage import (add_mesh, integers, label, place, points, Sdf,
                                                set_faces, set_texels, single_quaternion, Usd,
                                                UsdGeom, UsdPhysics, UsdShade, Vt)

F32 = NDArray[np.float32]

# Name of the variant → cells of the grid per cell of the mesh.
RESOLUTIONS = {'full': 1, 'quarter': 4, 'sixteenth': 16}
TEXTURE_SCALE = 2.0         # albedo factor of the brightest texel
_TILE_CELLS = 128           # at most, along a side
_SURROUNDING_SAMPLES = 1025     # at most, along a side


def write_relief(path: Path, tiles: list[tuple[float, F32]]) -> float:
    """Write the relief below the grid as a normal map that repeats; return its period [m].

    Args:
        tiles: Period [m] and periodic (n, n) heights [m], the coarsest first; finer ones are
            averaged to its texels. Tangents are along x and y, as the texture coordinates of the
            ground are.
    """
    period, heights = tiles[0]
    n = len(heights)
    slope = slopes(heights, period / n)
    for finer_period, finer in tiles[1:]:
        copies = round(period / finer_period)
        texels = n // copies
        part = cv2.resize(slopes(finer, finer_period / len(finer)), (texels, texels),
                          interpolation=cv2.INTER_AREA)
        slope += np.tile(part, (copies, copies, 1))
    normal = np.concatenate([-slope, np.ones((n, n, 1), np.float32)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    write_png(path, np.rint(127.5 * (normal[::-1] + 1.0)).astype(np.uint8))
    return period


def write_texture(path: Path, albedo: F32) -> None:
    """Write (n, n) albedo factors as a PNG of 8 bits; its first row is in the north."""
    texels = np.clip(np.rint(albedo[::-1] * (255.0 / TEXTURE_SCALE)), 0, 255).astype(np.uint8)
    write_png(path, texels)


def tile_cells(cells: int) -> int:
    """Return the cells along a side of a tile: a divisor of `cells`, at most _TILE_CELLS.

    It is the largest one that is a multiple of 16 if possible, else of 8, 4 or 2.
    """
    step = next(s for s in (16, 8, 4, 2, 1) if cells % s == 0)
    return max(c for c in range(step, min(_TILE_CELLS, cells) + 1, step) if cells % c == 0)


def write_ground(path: Path, grid: HeightGrid) -> None:
    """Write the tiles in all resolutions that their cells allow, below `/full`, `/quarter` …"""
    stage = Usd.Stage.CreateNew(str(path))
    surface = _Surface(grid)
    side = tile_cells(grid.n - 1)
    for name, stride in RESOLUTIONS.items():
        if side % stride:
            continue
        group = UsdGeom.Scope.Define(stage, f'/{name}').GetPrim()
        faces = triangles(side // stride + 1)
        for row in range(0, grid.n - 1, side):
            for column in range(0, grid.n - 1, side):
                tile = group.GetPath().AppendChild(f'tile_{row // side:02d}_{column // side:02d}')
                rows, columns = slice(row, row + side + 1), slice(column, column + side + 1)
                middle = np.array([surface.axis[column] + surface.axis[column + side],
                                   surface.axis[row] + surface.axis[row + side]]) / 2
                mesh = surface.mesh(stage, tile, rows, columns, stride, middle)
                set_faces(mesh, faces)
                place(mesh.GetPrim(), [*middle, 0.0])
                UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
                UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(
                    UsdPhysics.Tokens.none)
                label(mesh.GetPrim(), 'ground')
    stage.Save()


def write_surroundings(path: Path, levels: tuple[HeightGrid, ...]) -> list[str]:
    """Write the coarse levels without what is within the finer ones; return their prims' names."""
    stage = Usd.Stage.CreateNew(str(path))
    names = []
    for k, (inner, grid) in enumerate(zip(levels[:-1], levels[1:]), 1):
        stride = next(s for s in range(1, grid.n) if (grid.n - 1) % s == 0
                      and (grid.n - 1) // s < _SURROUNDING_SAMPLES)
        names.append(f'level_{k}')
        every = slice(0, grid.n)
        mesh = _Surface(grid).mesh(stage, Sdf.Path(f'/{names[-1]}'), every, every, stride,
                                   np.zeros(2))
        _cut_hole(mesh, inner.half_extent_m, stride * grid.cell_m)
        label(mesh.GetPrim(), 'ground')
    stage.Save()
    return names


class _Surface:
    """Samples of a grid with normals, of which meshes take parts."""

    def __init__(self, grid: HeightGrid) -> None:
        self.grid = grid
        self.axis = axis_m(grid.n, grid.cell_m)
        slope_y, slope_x = np.gradient(grid.heights_m, np.float32(grid.cell_m))
        length = np.sqrt(np.float32(1.0) + slope_x ** 2 + slope_y ** 2)
        self._normal_x, self._normal_y = -slope_x / length, -slope_y / length

    def mesh(self, stage: Usd.Stage, path: Sdf.Path, rows: slice, columns: slice, stride: int,
             middle_m: NDArray[np.float64]) -> UsdGeom.Mesh:
        """Define a mesh without faces of every `stride`-th sample in rows and columns."""
        rows = slice(rows.start, rows.stop, stride)
        columns = slice(columns.start, columns.stop, stride)
        z = self.grid.heights_m[rows, columns]
        x, y = np.meshgrid(self.axis[columns] - middle_m[0], self.axis[rows] - middle_m[1])
        vertices = np.stack([x, y, z], axis=-1, dtype=np.float32).reshape(-1, 3)
        nx, ny = self._normal_x[rows, columns], self._normal_y[rows, columns]
        nz = np.sqrt(np.maximum(1.0 - nx ** 2 - ny ** 2, 0.0))
        # The middle of a texel is where its sample lies.
        texel = (np.arange(self.grid.n) + 0.5) / self.grid.n
        s, t = np.meshgrid(texel[columns], texel[rows])
        mesh = UsdGeom.Mesh.Define(stage, path)
        mesh.CreatePointsAttr(points(vertices))
        mesh.CreateExtentAttr(points([vertices.min(axis=0), vertices.max(axis=0)]))
        mesh.CreateNormalsAttr(points(np.stack([nx, ny, nz], axis=-1).reshape(-1, 3)))
        mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        set_texels(mesh, np.stack([s, t], axis=-1).reshape(-1, 2))
        return mesh


def triangles(n: int) -> NDArray[np.int64]:
    """Return the (f, 3) triangles of n x n samples, two a cell, as `HeightGrid` divides it."""
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    east, north, both = corner + 1, corner + n, corner + n + 1
    return np.stack([corner, east, both, corner, both, north], axis=-1).reshape(-1, 3)


def _cut_hole(mesh: UsdGeom.Mesh, half_m: float, cell_m: float) -> None:
    """Give a coarse level its faces, without those within the finer level of [-h, h]^2.

    The finer level has more vertices along its border than this one. One row of cells reaches
    below it, lowered by a cell, so that no sky is seen between them.
    """
    vertices = np.array(mesh.GetPointsAttr().Get())
    n = round(len(vertices) ** 0.5)
    faces = triangles(n)
    away = np.abs(vertices[:, :2]).max(axis=1)
    faces = faces[(away[faces] >= half_m - 1e-3).any(axis=1)]
    vertices[away < half_m - 1e-3, 2] -= cell_m
    used = np.unique(faces)
    set_faces(mesh, np.searchsorted(used, faces))
    normals = np.array(mesh.GetNormalsAttr().Get())
    set_texels(mesh, np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar('st').Get())[used])
    kept = vertices[used]
    mesh.GetPointsAttr().Set(points(kept))
    mesh.GetNormalsAttr().Set(points(normals[used]))
    mesh.GetExtentAttr().Set(points([kept.min(axis=0), kept.max(axis=0)]))


_SHAPES = '/shapes'


def brightness_classes(rocks: Rocks, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the class of each rock, and the mean albedo factor of the classes: quantiles."""
    if not len(rocks):
        return np.zeros(0, int), np.zeros(0)
    edges = np.quantile(rocks.albedo, np.linspace(0.0, 1.0, count + 1)[1:-1])
    found, member = np.unique(np.searchsorted(edges, rocks.albedo), return_inverse=True)
    return member, np.array([rocks.albedo[member == k].mean() for k in range(len(found))])


def write_rocks(path: Path, rocks: Rocks, shapes: tuple[RockShape, ...]) -> None:
    """Write rocks that can be touched, as instances `/rocks/rock_<index>`."""
    stage = Usd.Stage.CreateNew(str(path))
    group = UsdGeom.Scope.Define(stage, '/rocks').GetPath()
    known = set()
    for i in range(len(rocks)):
        shape = shapes[int(rocks.shape[i])]
        prototype = Sdf.Path(_SHAPES).AppendChild(shape.name)
        if shape.name not in known:
            known.add(shape.name)
            stage.CreateClassPrim(_SHAPES)
            UsdGeom.Xform.Define(stage, prototype)
            for k, piece in enumerate(shape.convex()):
                mesh = add_mesh(stage, prototype.AppendChild(f'hull_{k}' if k else 'hull'),
                                piece.vertices, piece.faces).GetPrim()
                UsdPhysics.CollisionAPI.Apply(mesh)
                UsdPhysics.MeshCollisionAPI.Apply(mesh).CreateApproximationAttr(
                    UsdPhysics.Tokens.convexHull)
        rock = UsdGeom.Xform.Define(stage, group.AppendChild(f'rock_{i}')).GetPrim()
        rock.GetReferences().AddInternalReference(prototype)
        rock.SetInstanceable(True)
        place(rock, rocks.position_m[i], rocks.orientation_wxyz[i], float(rocks.diameter_m[i]))
        label(rock, 'rock', f'rock_{i}')
    stage.Save()


def write_far_rocks(path: Path, rocks: Rocks, shapes: tuple[RockShape, ...]) -> None:
    """Write rocks that are only seen, as one instancer `/rocks`."""
    stage = Usd.Stage.CreateNew(str(path))
    instancer = UsdGeom.PointInstancer.Define(stage, '/rocks')
    group = UsdGeom.Scope.Define(stage, '/rocks/shapes').GetPath()
    targets = []
    for shape in shapes:
        targets.append(group.AppendChild(shape.name))
        add_mesh(stage, targets[-1], shape.vertices, shape.faces)
    instancer.CreatePrototypesRel().SetTargets(targets)
    instancer.CreateProtoIndicesAttr(integers(rocks.shape))
    instancer.CreatePositionsAttr(points(rocks.position_m))
    instancer.CreateOrientationsfAttr(Vt.QuatfArray(
        [single_quaternion(q) for q in rocks.orientation_wxyz]))
    instancer.CreateScalesAttr(points(np.repeat(rocks.diameter_m[:, None], 3, axis=1)))
    if len(rocks):
        reach = 0.75 * rocks.diameter_m[:, None]
        instancer.CreateExtentAttr(points([(rocks.position_m - reach).min(axis=0),
                                           (rocks.position_m + reach).max(axis=0)]))
    label(instancer.GetPrim(), 'rock')
    stage.Save()


def bind_rocks(stage: Usd.Stage, parent: Sdf.Path, member: np.ndarray,
               materials: list[UsdShade.Material], contact: UsdShade.Material) -> None:
    """Bind the material of its class to each rock below `parent`, by overs in the root layer."""
    for i, k in enumerate(member):
        bind(stage.OverridePrim(parent.AppendChild(f'rock_{i}')), materials[int(k)])
    bind_contact(stage.GetPrimAtPath(parent), contact)
