"""A world as a folder: save, load, content hash.

    world.yaml     format, recipe, hash, parameters, report, and the levels' cells
    height_0.npy   (n, n) float32 heights of the ground [m]; height_1.npy ... the coarse levels
    albedo.npy     (n, n) float32
    rocks.npz      instances; shapes.npz the library of shapes; craters.npz the catalogue

Folders are untrusted: arrays are read without pickle, and their size is bounded.
"""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import hashlib
import json
import pathlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import brief, check_argument, check_path, ConfigError, WorldError
from lunar_rover_sim.base.files.arrays import map_array, npy_bytes, read_archive
from lunar_rover_sim.base.files.atomic import partial_folder
from lunar_rover_sim.base.files.yaml_text import read_yaml, yaml_of
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks, RockShape

FORMAT = 2
# Version of the way from parameters to a world: raised when the same parameters and seed give
# another one. It stands in the folder and in the name in the cache.
RECIPE = 9
_MAX_SAMPLES = 8193 ** 2
_MAX_BYTES_ARRAY = 64_000_000
_MAX_BYTES_YAML = 1_000_000
_MAX_MIDDLE_M = 1e6


def content_hash(world: World) -> str:
    """Return the hexadecimal hash of the whole world except its hash and its report."""
    digest = hashlib.blake2b(digest_size=16)
    text = json.dumps([FORMAT, world.config.to_mapping(), [g.cell_m for g in world.levels],
                       world.ground.middle_m,
                       [shape.name for shape in world.rock_shapes]], sort_keys=True)
    digest.update(text.encode())
    arrays: list[NDArray] = [level.heights_m for level in world.levels] + [world.albedo]
    for part in (world.rocks, world.craters):
        arrays += [getattr(part, field.name) for field in dataclasses.fields(part)]
    for shape in world.rock_shapes:
        arrays += [shape.vertices, shape.faces]
        arrays += [np.array(shape.pieces, np.int32)] if shape.pieces else []
    for array in arrays:
        digest.update(f'{array.dtype.str}{array.shape}'.encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _report_hash(report: Mapping[str, Any]) -> str:
    """Return the hash of a report, which is no part of that of the content."""
    text = json.dumps(_plain(report), sort_keys=True, default=str)
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def sealed(world: World) -> World:
    """Return the world with its hash."""
    return dataclasses.replace(world, hash=content_hash(world))


def save_world(world: World, folder: str | pathlib.Path, overwrite: bool = False) -> pathlib.Path:
    """Write the world to a folder, whole or not at all, and return the folder.

    Args:
        overwrite: Replace an existing world; any other folder stays as it is.

    Raises:
        WorldError: If the folder exists and is not replaced, or if it cannot be written.
    """
    check_argument('world', world, World, 'a World (build_world(...))')
    check_path('folder', folder)
    folder = pathlib.Path(folder)
    if folder.exists() or folder.is_symlink():
        if not overwrite:
            raise WorldError(f'{folder}: exists already; choose another folder or remove it')
        if not (folder / 'world.yaml').is_file():
            raise WorldError(f'{folder}: exists and is not a world; it is left as it is')
    with partial_folder(folder, WorldError) as partial:
        made = partial / folder.name
        made.mkdir()
        _write(world, made)
        if overwrite and folder.exists():
            folder.rename(partial / 'replaced')
        made.rename(folder)
    return folder


def _write(world: World, folder: pathlib.Path) -> None:
    for index, level in enumerate(world.levels):
        (folder / f'height_{index}.npy').write_bytes(npy_bytes(level.heights_m))
    (folder / 'albedo.npy').write_bytes(npy_bytes(world.albedo))
    np.savez(folder / 'rocks.npz', **_fields(world.rocks))  # type: ignore[arg-type]
    np.savez(folder / 'craters.npz', **_fields(world.craters))  # type: ignore[arg-type]
    meshes: dict[str, NDArray] = {'names': np.array([s.name for s in world.rock_shapes], 'U64')}
    for index, shape in enumerate(world.rock_shapes):
        meshes[f'vertices_{index}'], meshes[f'faces_{index}'] = shape.vertices, shape.faces
        if shape.pieces:
            meshes[f'pieces_{index}'] = np.array(shape.pieces, np.int32)
    np.savez(folder / 'shapes.npz', **meshes)  # type: ignore[arg-type]
    document = {'format': FORMAT, 'recipe': RECIPE, 'hash': world.hash,
                'cells_m': [g.cell_m for g in world.levels],
                'middle_m': list(world.ground.middle_m),
                'report_hash': _report_hash(world.report),
                'report': _plain(world.report), 'world': world.config.to_mapping()}
    text = ('# Made by lunar_rover_sim. Heights are float32 [m], row 0 south, column 0 west.\n'
            + yaml_of(document))
    (folder / 'world.yaml').write_text(text, encoding='utf-8')


def _fields(part: Any) -> dict[str, NDArray]:
    return {field.name: getattr(part, field.name) for field in dataclasses.fields(part)}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def load_world(folder: str | pathlib.Path, verify: bool = True) -> World:
    """Return the world in a folder; heights and albedo are mapped, not copied.

    Args:
        verify: Compare content and report with their hashes (0.1 s for the default world).

    Raises:
        WorldError: If the folder is not a world, is damaged, or of another format.
    """
    check_path('folder', folder)
    folder = pathlib.Path(folder)
    document = _document(folder)
    cells = document.get('cells_m')
    if (not isinstance(cells, list) or not 1 <= len(cells) <= 8
            or not all(isinstance(c, float) and c > 0.0 for c in cells)):
        raise WorldError(f'{folder}/world.yaml: cells_m: {cells!r} is not a list of 1 to 8 cells')
    middle = document.get('middle_m')
    if (not isinstance(middle, list) or len(middle) != 2
            or not all(isinstance(m, float) and abs(m) < _MAX_MIDDLE_M for m in middle)):
        raise WorldError(f'{folder}/world.yaml: middle_m: {brief(middle)} is not two places [m]')
    try:
        config = WorldConfig.from_mapping(document.get('world') or {}, 'world')
    except ConfigError as error:
        raise WorldError(f'{folder}/world.yaml: {error}') from None
    levels = tuple(HeightGrid(_grid(folder / f'height_{i}.npy'), cell, (middle[0], middle[1]))
                   for i, cell in enumerate(cells))
    albedo = _grid(folder / 'albedo.npy')
    if albedo.shape != levels[0].heights_m.shape:
        raise WorldError(f'{folder}/albedo.npy: {albedo.shape} samples; height_0.npy has '
                         f'{levels[0].heights_m.shape}')
    shapes = _shapes(folder / 'shapes.npz')
    rocks = Rocks(**_archive(folder / 'rocks.npz', {
        'shape': 'i4', 'size': 'i4', 'position_m': 'f8,3', 'orientation_wxyz': 'f8,4',
        'albedo': 'f4', 'size_classes_m': 'f8*', 'key': 'u8'}))
    for name, index, end in (('shape', rocks.shape, len(shapes)),
                             ('size', rocks.size, len(rocks.size_classes_m))):
        if len(index) and not (0 <= index.min() and index.max() < end):
            raise WorldError(f'{folder}/rocks.npz: {name}: indices beyond {end - 1}')
    craters = Craters(**_archive(folder / 'craters.npz', {
        'position_m': 'f8,2', 'diameter_m': 'f8', 'age': 'f8', 'level': 'i4', 'key': 'u8'}))
    world = World(levels, albedo, rocks, shapes, config, str(document.get('hash')), craters,
                  document.get('report') or {})
    if verify and content_hash(world) != world.hash:
        raise WorldError(f'{folder}: the content does not match its hash {world.hash}; it was '
                         'changed or damaged: build it again')
    if verify and document.get('report_hash') not in (None, _report_hash(world.report)):
        raise WorldError(f'{folder}/world.yaml: the report does not match its hash; it was '
                         'changed or damaged: build it again')
    return world


def _document(folder: pathlib.Path) -> dict[str, Any]:
    path = folder / 'world.yaml'
    if not path.is_file():
        raise WorldError(f'{folder}: not a world folder (it has no world.yaml); make one with '
                         '`lunar_rover_sim world build`')
    document = read_yaml(path, _MAX_BYTES_YAML, WorldError)
    if not isinstance(document, dict) or document.get('format') != FORMAT:
        found = document.get('format') if isinstance(document, dict) else document
        raise WorldError(f'{path}: format {brief(found)}; this version reads format {FORMAT}: '
                         'build the world again')
    return document


def _grid(path: pathlib.Path) -> NDArray[np.float32]:
    array = map_array(path, WorldError)
    if (array.dtype != np.float32 or array.ndim != 2 or array.shape[0] != array.shape[1]
            or not 9 <= array.size <= _MAX_SAMPLES):
        raise WorldError(f'{path}: not a square of 3 to 8193 samples of float32')
    return array


def _archive(path: pathlib.Path, members: dict[str, str]) -> dict[str, NDArray]:
    """Return the members of an npz file; each as 'type' or 'type,columns', all of one length.

    A star marks a member with its own length.
    """
    result = {}
    length: int | None = None
    archive = read_archive(path, WorldError, _MAX_BYTES_ARRAY)
    for name, kind in members.items():
        array = _member(path, archive, name)
        dtype, _, columns = kind.rstrip('*').partition(',')
        shape = array.shape[1:]
        if array.dtype != np.dtype(dtype) or shape != ((int(columns),) if columns else ()):
            raise WorldError(f'{path}: {name}: {array.dtype} {array.shape} is not {kind}')
        if not kind.endswith('*'):
            length = len(array) if length is None else length
            if len(array) != length:
                raise WorldError(f'{path}: {name}: {len(array)} items; others have {length}')
        result[name] = array
    return result


def _shapes(path: pathlib.Path) -> tuple[RockShape, ...]:
    shapes = []
    archive = read_archive(path, WorldError, _MAX_BYTES_ARRAY)
    names = _member(path, archive, 'names')
    if names.dtype.kind != 'U' or names.ndim != 1 or len(names) > 1024:
        raise WorldError(f'{path}: names: not up to 1024 names')
    for index, name in enumerate(names):
        vertices = _member(path, archive, f'vertices_{index}')
        faces = _member(path, archive, f'faces_{index}')
        if (vertices.dtype != np.float32 or vertices.shape[1:] != (3,)
                or faces.dtype != np.int32 or faces.shape[1:] != (3,) or len(faces) < 4
                or faces.min() < 0 or faces.max() >= len(vertices)):
            raise WorldError(f'{path}: {name}: not a triangle mesh')
        pieces = archive.get(f'pieces_{index}', np.zeros(0, np.int32))
        if len(pieces) and (pieces.dtype != np.int32 or pieces.ndim != 1 or pieces.min() < 4
                            or pieces.sum(dtype=np.int64) != len(faces)):
            raise WorldError(f'{path}: {name}: pieces are not those of the faces')
        shapes.append(RockShape(str(name), vertices, faces, tuple(pieces.tolist())))
    return tuple(shapes)


def _member(path: pathlib.Path, archive: Mapping[str, NDArray], name: str) -> NDArray:
    if name not in archive:
        raise WorldError(f'{path}: {name} is missing')
    if archive[name].ndim == 0:
        raise WorldError(f'{path}: {name}: not a list')
    return archive[name]
