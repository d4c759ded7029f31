"""A world as a mesh file for other tools: GLB, OBJ, PLY."""

from __future__ import annotations

import dataclasses
import pathlib
from typing import Any

import numpy as np
from numpy.typing import NDArray
import trimesh

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.frames import matrix_from_wxyz
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World

FORMATS = ('.glb', '.obj', '.ply')
_MAX_SAMPLES = 513  # along a side, unless a stride is asked for

# glTF: y up, x right, z towards the viewer; OBJ and PLY are written z up, as the world is.
_Y_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0],
                  [0.0, 0.0, 0.0, 1.0]])


@dataclasses.dataclass(frozen=True)
class FinePart:
    """A part of the ground on a finer grid, which takes the place of the ground there.

    Attributes:
        x_m: (nx,) positions, in equal steps.
        y_m: (ny,) positions, in equal steps.
        height_m: (ny, nx) [m].
    """

    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    height_m: NDArray[np.float64]


def write(world: World, path: str | pathlib.Path, stride: int = 0, rocks: bool = True,
          surroundings: bool = False, fine: FinePart | None = None) -> pathlib.Path:
    """Write the ground and, as geometry of their own, rocks and surroundings to a mesh file.

    Args:
        fine: A part of the ground that is geometry of its own, `fine`, such as tracks.
        stride: Keep every `stride`-th sample of the ground; 0 chooses one that keeps at most 513
            along a side. Vertices have the albedo as a grey colour. A PLY file holds only one
            mesh, in which all parts are joined.

    Raises:
        WorldError: On an unknown format, a stride that does not divide the ground, or a file that
            cannot be written.
    """
    path = pathlib.Path(path)
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise WorldError(f'{path}: {suffix or "no"} format is not one that is written; valid are '
                         + ', '.join(FORMATS))
    scene = to_scene(world, stride, rocks, surroundings, fine)
    if suffix == '.glb':
        scene.apply_transform(_Y_UP)
        content: Any = scene.export(file_type='glb')
    elif suffix == '.obj':
        content = scene.export(file_type='obj', include_texture=False)
    else:
        content = scene.to_mesh().export(file_type='ply')
    if isinstance(content, str):
        content = content.encode()
    atomic_write(path, content, WorldError)
    return path


def to_scene(world: World, stride: int = 0, rocks: bool = True, surroundings: bool = False,
             fine: FinePart | None = None) -> Any:
    """Return the world as a `trimesh.Scene`, z up, in metres; arguments as for `write`."""
    cells = world.ground.n - 1
    if stride == 0:
        stride = next(s for s in range(1, cells + 1)
                      if cells % s == 0 and (cells // s < _MAX_SAMPLES or s == cells))
    if stride < 1 or cells % stride:
        valid = ', '.join(str(s) for s in range(1, 65) if cells % s == 0)
        raise WorldError(f'--stride: {stride} does not divide the {cells} cells of the ground; '
                         f'valid are {valid}')
    scene = trimesh.Scene()
    vertices, faces = surface(world.ground, stride)
    grey = np.clip(128.0 * world.albedo[::stride, ::stride].ravel(), 0, 255).astype(np.uint8)
    if fine is not None:
        x, y = vertices[:, 0], vertices[:, 1]
        covered = ((x >= fine.x_m[0]) & (x <= fine.x_m[-1])
                   & (y >= fine.y_m[0]) & (y <= fine.y_m[-1]))
        faces = faces[~covered[faces].all(axis=1)]
        points, triangles = _fine_surface(fine)
        scene.add_geometry(_mesh(points, triangles, np.full(len(points), 128, np.uint8)),
                           node_name='fine', geom_name='fine')
    scene.add_geometry(_mesh(vertices, faces, grey), node_name='ground', geom_name='ground')
    if surroundings:
        for index, level in enumerate(world.levels[1:], 1):
            step = next(s for s in range(1, level.n) if (level.n - 1) % s == 0
                        and (level.n - 1) // s < _MAX_SAMPLES)
            vertices, faces = surface(level, step)
            # The inner level has its own mesh.
            hole = world.levels[index - 1].half_extent_m
            faces = faces[np.abs(vertices[faces][:, :, :2]).max(axis=(1, 2)) > hole + 1e-6]
            grey = np.full(len(vertices), 128, np.uint8)
            name = f'surroundings_{index}'
            scene.add_geometry(_mesh(vertices, faces, grey), node_name=name, geom_name=name)
    if rocks:
        _add_rocks(scene, world)
    return scene


def surface(grid: HeightGrid, stride: int = 1) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return vertices (v, 3) [m] and faces (f, 3) of every `stride`-th sample, seen from above.

    The diagonals run as in the grid.
    """
    heights = grid.heights_m[::stride, ::stride]
    n = heights.shape[0]
    axis = (np.arange(n) - 0.5 * (n - 1)) * grid.cell_m * stride
    return _fine_surface(FinePart(axis, axis, heights.astype(np.float64)))


def _fine_surface(part: FinePart) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    rows, n = part.height_m.shape
    x, y = np.meshgrid(part.x_m, part.y_m)
    vertices = np.column_stack([x.ravel(), y.ravel(), part.height_m.ravel()])
    corner = (np.arange(rows - 1)[:, None] * n + np.arange(n - 1)).ravel()
    east, north, both = corner + 1, corner + n, corner + n + 1
    faces = np.concatenate([np.column_stack([corner, east, both]),
                            np.column_stack([corner, both, north])])
    return vertices, faces


def _mesh(vertices: NDArray, faces: NDArray, grey: NDArray) -> Any:
    colours = np.column_stack([grey, grey, grey, np.full_like(grey, 255)])
    return trimesh.Trimesh(vertices, faces, vertex_colors=colours, process=False)


def _add_rocks(scene: Any, world: World) -> None:
    """Add each rock as a node; rocks of one shape share their geometry."""
    rotation = matrix_from_wxyz(world.rocks.orientation_wxyz)
    for index, shape in enumerate(world.rock_shapes):
        instances = np.flatnonzero(world.rocks.shape == index)
        if not len(instances):
            continue
        scene.geometry[shape.name] = _mesh(shape.vertices, shape.faces,
                                           np.full(len(shape.vertices), 150, np.uint8))
        for i in instances:
            pose = np.eye(4)
            pose[:3, :3] = rotation[i] * world.rocks.diameter_m[i]
            pose[:3, 3] = world.rocks.position_m[i]
            scene.graph.update(frame_to=f'rock_{i}', matrix=pose, geometry=shape.name)
