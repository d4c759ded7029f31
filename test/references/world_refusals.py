"""World: what is refused at which bound, folders that are damaged, what is kept."""

from __future__ import annotations

import dataclasses
from pathlib import Path
import shutil
from typing import Any

import numpy as np
import pytest
from references.cases import reference
from references.scenes import hills, stony_world
from references.words import said
import trimesh
import yaml

from lunar_rover_sim.world import export
from lunar_rover_sim.world.cache import cache_folder, cached
from lunar_rover_sim.world.config import preset, WorldConfig
from lunar_rover_sim.world.crater_population import populate
from lunar_rover_sim.world.dem import open_dem
from lunar_rover_sim.world.kept_arrays import kept
from lunar_rover_sim.world.mesh import MeshSource
from lunar_rover_sim.world.site import reported_site
from lunar_rover_sim.world.world_folder import load_world, save_world


@reference
def recipes() -> dict[str, Any]:
    """Parameters that do not go together, and those that just do."""
    tried = [
        {'size_m': 6.4}, {'size_m': 6.5}, {'size_m': 0.3}, {'size_m': 0.4}, {'size_m': 204.8},
        {'size_m': 205.2}, {'size_m': 6.4000001}, {'size_m': 6.40001}, {'size_m': 500.0},
        {'craters': {'min_diameter_m': 200.0}}, {'craters': {'min_diameter_m': 200.1}},
        {'rocks': {'min_diameter_m': 0.5, 'max_diameter_m': 0.5}},
        {'rocks': {'min_diameter_m': 0.5, 'max_diameter_m': 0.4}},
        {'craters': {'oldest_depth': 0.2}},
        {'craters': {'oldest_depth': 0.15, 'fresh_depth': 0.1}},
        {'craters': {'fresh_depth': 0.05, 'fresh_rim': 0.05}},
        {'craters': {'fresh_depth': 0.0501, 'fresh_rim': 0.05}},
        {'source': 'dem'}, {'source': 'mesh', 'path': 'x'}, {'dem': {'height_scale': 0.0}},
        {'dem': {'height_scale': -1.0}}]
    rng = np.random.default_rng(1)
    dense = WorldConfig.from_mapping({'craters': {'density': 0.5, 'min_diameter_m': 0.01}})
    return {'said': [said(WorldConfig.from_mapping, one) for one in tried],
            'preset': said(preset, 'flt'),
            'seeds': [said(WorldConfig().with_seed, seed) for seed in (0, -1, 1.5)],
            'own seed': WorldConfig(seed=0).with_seed(5).seed,
            'dense': said(populate, dense.craters, 60.0, 0.0, 10.0, 0, rng),
            'samples': [WorldConfig.from_mapping(one).samples for one in tried[:1] + tried[4:5]],
            'places': [said(reported_site, {'lon_deg': lon, 'lat_deg': lat, 'grid_north_deg': 0.0})
                       for lon, lat in ((360.0, 90.0), (360.1, 0.0), (0.0, -90.1), ('a', 0.0))]}


@reference
def strides_of_exports() -> dict[str, Any]:
    """Strides that divide the ground or do not."""
    world = stony_world((hills(49, 0.1), hills(33, 0.8)), 3)
    return {'said': [said(export.to_scene, world, stride) for stride in (1, 5, -1, 48, 49)],
            'chosen': len(export.to_scene(world, 48).geometry['ground'].vertices),
            'format': said(export.write, world, Path('a.stl'))}


@reference
def measured_grounds(folder: Path) -> dict[str, Any]:
    """Folders of heights that are incomplete, too small, steep or without data."""
    found: dict[str, Any] = {}
    good = 100.0 + hills(31, 1.0, 0.5).heights_m.astype(float)
    step, gap, little = good.copy(), good.copy(), good.copy()
    step[:, 15:] += 29.0
    gap[14:17, 15], little[2, 3] = np.nan, np.nan
    deep = np.where(np.isfinite(gap), np.nan, gap)
    for name, heights, text, options in (
            ('good', good, 'pixel_size: [1.0, -1.0]', {}),
            ('step', step, 'pixel_size: [1.0, -1.0]', {}),
            ('cliff', step + np.where(np.arange(31) > 14, 3.0, 0.0), 'pixel_size: [1.0, -1.0]',
             {}),
            ('wide step', step * 2.0, 'pixel_size: [5.0, -5.0]', {}),
            ('gap', gap, 'pixel_size: [1.0, -1.0]', {}),
            ('filled', gap, 'pixel_size: [1.0, -1.0]', {'nodata': 'fill'}),
            ('nothing', deep, 'pixel_size: [1.0, -1.0]', {'nodata': 'fill'}),
            ('edge', good, 'pixel_size: [1.0, -1.0]', {'center': [12.3, 0.0]}),
            ('just', good, 'pixel_size: [1.0, -1.0]', {'center': [12.3 - 0.0001, 0.0]}),
            ('south', good, 'pixel_size: [1.0, 1.0]', {'center': [0.0, -14.0]}),
            ('far gap', little, 'pixel_size: [1.0, -1.0]', {}),
            ('flat', np.full((31, 31), 5.0), 'pixel_size: [1.0, -1.0]', {}),
            ('size', good, 'pixel_size: [1.0, -1.0]\nsize: [30, 31]', {}),
            ('no pixel', good, 'a: 1', {}), ('own pixel', good, 'a: 1', {'pixel_m': 2.0}),
            ('zero', good, 'pixel_size: [0.0, 1.0]', {}),
            ('huge', good, 'pixel_size: [1e7, 1]', {}),
            ('crs', good, 'pixel_size: [1.0, -1.0]', {'center_mode': 'crs'}),
            ('high', good + 1e5, 'pixel_size: [1.0, -1.0]', {})):
        place = folder / name
        place.mkdir()
        np.save(place / 'dem.npy', heights)
        (place / 'dem.yaml').write_text(text + '\n')
        config = WorldConfig.from_mapping({
            'source': 'dem', 'path': str(place), 'size_m': 6.4, 'cell_m': 0.1, 'dem': options})
        words = said(open_dem, config, without=folder)
        found[name] = words
        if not words:
            found[f'reference {name}'] = open_dem(config).reference_m
    return found


@reference
def odd_meshes(folder: Path) -> dict[str, Any]:
    """Meshes that are no ground, or not enough of it."""
    found: dict[str, Any] = {}
    vertices, faces = export.surface(hills(13, 0.7, 0.3))
    for name, points, triangles, options in (
            ('good', vertices, faces, {}), ('hole', vertices, faces[1:], {}),
            ('filled', vertices, faces[1:], {'holes': 'fill'}),
            ('moved', vertices, faces, {'center': [1.1, 0.0]}),
            ('just', vertices, faces, {'center': [1.0, 0.0]}),
            ('small', vertices, faces, {'scale': 0.7}),
            ('upright', vertices, faces, {'up_axis': 'x'}),
            ('turned', vertices, faces[:, ::-1], {}), ('wall', vertices[:, [0, 2, 2]], faces, {}),
            ('huge', vertices * 1e9, faces, {}), ('no faces', vertices, faces[:0], {})):
        path = folder / f'{name}.ply'
        trimesh.Trimesh(points, triangles, process=False).export(path)
        config = WorldConfig.from_mapping({
            'source': 'mesh', 'path': str(path), 'size_m': 6.4, 'cell_m': 0.1, 'mesh': options})
        words = said(MeshSource, config, without=folder)
        found[name] = words
        if not words:
            found[f'report {name}'] = {key: value for key, value in MeshSource(
                config).report.items() if key != 'file'}
    return found


@reference
def damaged_folders(folder: Path) -> dict[str, Any]:
    """A world that is saved and read, and what is said of one that was changed."""
    world = dataclasses.replace(stony_world((hills(9, 0.1), hills(17, 0.8)), 4),
                                report={'a': np.float64(0.5), 'b': (1, 2)})
    good = save_world(world, folder / 'good')
    again = load_world(good, verify=False)
    found: dict[str, Any] = {
        'document': {key: value for key, value in yaml.safe_load(
            (good / 'world.yaml').read_text()).items() if key != 'world'},
        'read': [again.rocks, again.craters, again.albedo, *(g.heights_m for g in again.levels)],
        'names': [shape.name for shape in again.rock_shapes][:3], 'report': dict(again.report),
        'files': sorted(path.name for path in good.iterdir()),
        'again': said(save_world, world, good, without=folder),
        'over': said(save_world, world, good, True, without=folder),
        'changed': said(load_world, good, without=folder)}
    (folder / 'other').mkdir()
    found['other'] = said(save_world, world, folder / 'other', True, without=folder)

    def damaged(name: str, change: Any) -> None:
        place = folder / name
        shutil.copytree(good, place)
        change(place)
        found[name] = said(load_world, place, False, without=folder)

    def document(**values: Any) -> Any:
        def change(place: Path) -> None:
            old = yaml.safe_load((place / 'world.yaml').read_text())
            (place / 'world.yaml').write_text(yaml.safe_dump({**old, **values}))
        return change

    def archive(file: str, **values: Any) -> Any:
        def change(place: Path) -> None:
            old = dict(np.load(place / file))
            np.savez(place / file, **{key: values.get(key, old[key]) for key in old
                                      if values.get(key, 0) is not None})
        return change

    rocks, faces = world.rocks, world.rock_shapes[0].faces
    for name, change in (
            ('cells', document(cells_m=[])), ('cell', document(cells_m=[0.1, 0.0])),
            ('nine', document(cells_m=[0.1] * 9)), ('whole', document(cells_m=[1, 2])),
            ('format', document(format=2)), ('recipe', document(world={'size_m': 6.5})),
            ('one level', document(cells_m=[0.1])),
            ('albedo', lambda place: np.save(place / 'albedo.npy', np.ones((5, 5), np.float32))),
            ('double', lambda place: np.save(place / 'height_0.npy', np.ones((9, 9)))),
            ('tiny', lambda place: np.save(place / 'height_1.npy', np.ones((2, 2), np.float32))),
            ('least', lambda place: np.save(place / 'height_1.npy', np.ones((3, 3), np.float32))),
            ('oblong', lambda place: np.save(place / 'height_1.npy', np.ones((3, 4), np.float32))),
            ('shape', archive('rocks.npz', shape=rocks.shape + 99)),
            ('size', archive('rocks.npz', size=rocks.size - 1)),
            ('last', archive('rocks.npz', size=rocks.size * 0 + 3)),
            ('short', archive('rocks.npz', albedo=rocks.albedo[:2])),
            ('flat', archive('rocks.npz', position_m=rocks.position_m[:, :2])),
            ('none', archive('craters.npz', age=None)),
            ('scalar', archive('craters.npz', age=np.array(3.0))),
            ('corner', archive('shapes.npz', faces_0=faces + 99)),
            ('negative', archive('shapes.npz', faces_0=faces - 1)),
            ('three faces', archive('shapes.npz', faces_0=faces[:3])),
            ('four faces', archive('shapes.npz', faces_0=faces[:4])),
            ('words', archive('shapes.npz', names=np.array([1, 2]))),
            ('no file', lambda place: (place / 'world.yaml').unlink())):
        damaged(name, change)
    return found


@reference
def kept_results(folder: Path) -> dict[str, Any]:
    """Worlds and arrays that are kept, built once, and built again where they are damaged."""
    made: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('LUNAR_ROVER_SIM_CACHE', str(folder))
        config = WorldConfig.from_mapping({'size_m': 1.6, 'surroundings': {
            'samples': 65, 'extent_m': 0.0}})
        for _ in range(2):
            path = cached(config, 3, lambda what, share: made.append(what))
        made.append('again')
        (path / 'height_0.npy').write_bytes(b'no')
        cached(config, 3, lambda what, share: made.append(what))
        arrays = [kept('a', recipe, lambda: np.arange(5.0) * len(made))
                  for recipe in ([1], [1], [2])]
        for file in (folder / 'arrays').iterdir():
            file.write_bytes(b'no')
        arrays.append(kept('a', [1], lambda: np.arange(3.0)))
        names = [cache_folder() == folder / 'worlds', len(list((folder / 'worlds').iterdir())),
                 len(list((folder / 'arrays').iterdir())), len(path.name)]
    return {'made': made, 'arrays': arrays, 'names': names}
