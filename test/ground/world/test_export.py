"""Meshes and pictures of worlds, and the command line."""

import dataclasses
import errno
import os

from matplotlib.figure import Figure
import numpy as np
from PIL import Image
import pytest
import trimesh
import worlds

from lunar_rover_sim.base.errors import ConfigError, WorldError
from lunar_rover_sim.cli.main import execute
from lunar_rover_sim.ground.world import export, map_sheet, shade, world_folder
from lunar_rover_sim.ground.world.grid import HeightGrid


@pytest.mark.parametrize('suffix', ['glb', 'obj', 'ply'])
def test_export_is_read_by_others(tmp_path, suffix):
    world = worlds.small()
    path = export.write(world, tmp_path / f'world.{suffix}', stride=4)
    loaded = trimesh.load(path, process=False)
    # Rocks are geometry of their own.
    if suffix == 'glb':
        assert len(loaded.geometry) == 1 + len(set(world.rocks.shape.tolist()))
        mesh = loaded.to_mesh()
    else:
        mesh = loaded
    if suffix == 'obj':
        names = [line[2:] for line in path.read_text().splitlines() if line.startswith('o ')]
        assert len(names) == 1 + len(world.rocks) and names[0] == 'ground'
    vertices = mesh.vertices
    if suffix == 'glb':  # y up
        vertices = np.column_stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]])
    size = world.config.size_m
    assert np.allclose(np.ptp(vertices[:, :2], axis=0), size, atol=0.5)
    n = (world.ground.n - 1) // 4 + 1
    assert len(vertices) >= n * n
    # The ground's vertices lie on the ground.
    at = world.height_at(vertices[:, :2])
    on_ground = np.abs(vertices[:, 2] - at) < 1e-4
    assert on_ground.sum() >= 0.95 * n * n
    assert len(list(tmp_path.iterdir())) == 1  # no temporary file, no material beside it


def test_the_ground_has_the_grey_of_its_albedo():
    """128 stands for 1; of samples that are left out, the colours are too."""
    world = worlds.small()
    albedo = np.random.default_rng(0).uniform(0.0, 2.5, world.albedo.shape).astype(np.float32)
    scene = export.to_scene(dataclasses.replace(world, albedo=albedo), 8, rocks=False)
    ground = scene.geometry['ground']
    colours = ground.visual.vertex_colors
    i, j = np.round((ground.vertices[:, 1::-1] / world.ground.cell_m
                     + 0.5 * (world.ground.n - 1))).astype(int).T
    expected = np.minimum(128.0 * albedo[i, j], 255.0)
    for channel in range(3):
        assert np.abs(colours[:, channel] - expected).max() <= 1.0
    assert np.all(colours[:, 3] == 255)


def test_a_fine_part_takes_the_place_of_the_ground_below_it():
    """Off the middle, wider than high: faces with all corners within it are left out."""
    world = worlds.small()
    cell = world.ground.cell_m
    x, y = cell * np.arange(-40.0, 91.0, 0.5), cell * np.arange(-120.0, -59.0, 0.5)
    height = world.ground.height_at(np.stack(np.meshgrid(x, y), axis=-1)) - 0.01
    scene = export.to_scene(world, 4, rocks=False, fine=export.FinePart(x, y, height))
    whole = export.to_scene(world, 4, rocks=False).geometry['ground']
    ground, fine = scene.geometry['ground'], scene.geometry['fine']
    assert set(scene.geometry) == {'ground', 'fine'}
    np.testing.assert_array_equal(ground.vertices, whole.vertices)
    gone = {tuple(f) for f in whole.faces.tolist()} - {tuple(f) for f in ground.faces.tolist()}
    assert len(ground.faces) + len(gone) == len(whole.faces)
    for face in whole.faces.tolist():
        corners = whole.vertices[face][:, :2]
        within = ((corners >= [x[0] - 1e-9, y[0] - 1e-9])
                  & (corners <= [x[-1] + 1e-9, y[-1] + 1e-9])).all()
        assert (tuple(face) in gone) == within
    # 128 by 60 cells of the ground lie within, that is 32 by 15 of its every fourth.
    assert len(gone) == 2 * 32 * 15
    assert len(fine.vertices) == height.size and len(fine.faces) == 2 * 261 * 121
    np.testing.assert_allclose(fine.bounds[:, :2], [[x[0], y[0]], [x[-1], y[-1]]])
    assert (fine.face_normals[:, 2] > 0.0).all()
    assert (fine.visual.vertex_colors == [128, 128, 128, 255]).all()


def test_export_without_rocks_and_with_surroundings(tmp_path):
    world = worlds.small()
    scene = export.to_scene(world, 8, rocks=False, surroundings=True)
    assert set(scene.geometry) == {'ground'} | {f'surroundings_{i}'
                                                for i in range(1, len(world.levels))}
    assert scene.extents[0] == pytest.approx(2 * world.levels[-1].half_extent_m)
    everything = export.to_scene(world, 8)
    rocks = [name for name in everything.graph.nodes_geometry if name.startswith('rock_')]
    assert len(rocks) == len(world.rocks)
    transform, _ = everything.graph['rock_0']
    assert np.allclose(transform[:3, 3], world.rocks.position_m[0])
    scale = np.cbrt(np.linalg.det(transform[:3, :3]))
    assert scale == pytest.approx(world.rocks.diameter_m[0])


def test_export_refusals(tmp_path):
    world = worlds.small()
    with pytest.raises(WorldError, match=r'\.stl format is not one that is written; valid are'):
        export.write(world, tmp_path / 'world.stl')
    with pytest.raises(WorldError, match='--stride: 7 does not divide the 512 cells'):
        export.write(world, tmp_path / 'world.glb', stride=7)
    with pytest.raises(WorldError, match='cannot be written'):
        export.write(world, tmp_path / 'nowhere' / 'world.ply')


def test_the_strides_that_are_offered_are_those_that_are_taken():
    world = worlds.small()
    with pytest.raises(WorldError, match='the 512 cells of the ground; valid are') as refused:
        export.to_scene(world, 7, rocks=False)
    offered = [int(word) for word in str(refused.value).rpartition('are ')[2].split(', ')]
    for stride in range(1, 65):
        if stride in offered:
            ground = export.to_scene(world, stride, rocks=False).geometry['ground']
            assert len(ground.vertices) == (512 // stride + 1)**2
        else:
            with pytest.raises(WorldError):
                export.to_scene(world, stride, rocks=False)


def test_exported_ground_comes_back_as_a_world(tmp_path):
    # Out as GLB and in again as a mesh: the same surface.
    from lunar_rover_sim.base.parameters import merge
    from lunar_rover_sim.ground.world.build import build_world
    from lunar_rover_sim.ground.world.config import WorldConfig
    world = worlds.small()
    path = export.write(world, tmp_path / 'world.glb', stride=2, rocks=False)
    mapping = merge(worlds.BARE, {'source': 'mesh', 'path': str(path), 'size_m': 6.4,
                                  'surroundings': {'samples': 257}})
    again = build_world(WorldConfig.from_mapping(mapping), 1)
    xy = np.random.default_rng(0).integers(-32, 33, (500, 2)) * 0.05  # samples of both
    expected = world.height_at(xy) - world.height_at((0.0, 0.0))
    assert np.abs(again.height_at(xy) - expected).max() < 1e-4


def test_a_full_disk_leaves_no_file(tmp_path, monkeypatch):
    def full(*args):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr(os, 'replace', full)
    with pytest.raises(WorldError, match='cannot be written: No space left on device'):
        export.write(worlds.small(), tmp_path / 'world.ply', stride=16)
    assert list(tmp_path.iterdir()) == []


def test_shadow_ends_where_it_should():
    # A wall 1 m high at x = 0, sun in the east at 10 degrees: shadow from 0 to -1 / tan 10.
    n, cell = 401, 0.05
    axis = (np.arange(n) - 200) * cell
    heights = np.where(np.abs(axis) < 0.2, 1.0, 0.0)[None].repeat(n, 0).astype(np.float32)
    dark = shade.shadow(heights, cell, 0.0, 10.0)[200]
    length = -axis[dark].min() - 0.2
    assert length == pytest.approx(1.0 / np.tan(np.radians(10.0)), abs=2 * cell)
    assert not dark[axis > 0.25].any()


def test_slope_and_horizon_of_a_plane():
    world = worlds.small(**worlds.BARE)
    assert np.allclose(shade.horizon_deg(world, [0.0, 90.0], 0.3), 0.0, atol=0.05)
    axis = np.arange(65.0) - 32.0
    tilted = HeightGrid((0.1 * axis)[None].repeat(65, 0).astype(np.float32), 1.0)
    assert np.allclose(shade.slope_deg(tilted.heights_m, 1.0), np.degrees(np.arctan(0.1)))
    # Along x and y together: half the squared slope.
    assert shade.rms_slope_deg(tilted, 4.0) == pytest.approx(
        np.degrees(np.arctan(0.1 / np.sqrt(2.0))))


@pytest.mark.parametrize('samples,kept', [(257, 257), (513, 513), (769, 385), (1025, 513)])
def test_ground_is_thinned_out_to_513_samples_along_a_side(samples, kept):
    """Around it too, where nothing lies below the ground."""
    grid, around = (HeightGrid(np.zeros((samples, samples), np.float32), cell_m)
                    for cell_m in (0.1, 0.4))
    flat = dataclasses.replace(worlds.small(**worlds.BARE), levels=(grid, around),
                               albedo=np.ones((samples, samples), np.float32))
    scene = export.to_scene(flat, rocks=False, surroundings=True)
    mesh = scene.geometry['surroundings_1']
    assert len(scene.geometry['ground'].vertices) == len(mesh.vertices) == kept**2
    assert mesh.area == pytest.approx((16.0 - 1.0) * (2.0 * grid.half_extent_m)**2, rel=1e-3)


def test_a_preview_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(map_sheet, 'sheet', lambda *_: Figure())
    (tmp_path / 'file').touch()
    with pytest.raises(WorldError, match='cannot be written'):
        map_sheet.write(worlds.small(), tmp_path / 'file' / 'sheet.png')


def call(*argv):
    """Run a world command; return its exit status."""
    return execute(['world', *argv])


SMALL = ['--set', 'world.surroundings.samples=129', '--set', 'world.surroundings.extent_m=60']


def test_command_line(tmp_path, capsys):
    folder = str(tmp_path / 'w')
    assert call('build', '--scenario', 'feature_sparse', '--size', '6.4', '--seed', '9', *SMALL,
                '-o', folder) == 0
    world = world_folder.load_world(folder)
    assert world.config.size_m == 6.4 and world.config.seed == 9
    assert world.config.rocks.abundance == 0.0015
    assert world.hash in capsys.readouterr().out
    assert call('info', folder) == 0
    out = capsys.readouterr().out
    assert world.hash in out and '6.4 m at 0.025 m' in out
    assert call('preview', folder, '--no-views') == 0
    with Image.open(tmp_path / 'w.png') as image:
        pixels = np.asarray(image.convert('L'), float)
    assert pixels.shape[0] > 600 and pixels.std() > 20.0
    assert call('export', folder, '-o', str(tmp_path / 'w.ply')) == 0
    for again in (('build', '-o', folder), ('preview', folder),
                  ('export', folder, '-o', str(tmp_path / 'w.ply'))):
        with pytest.raises(ConfigError, match='exists already'):
            call(*again)


def test_command_line_sources(tmp_path):
    mesh, _ = tmp_path / 'plane.obj', trimesh.creation.box((20.0, 20.0, 1.0)).export(
        tmp_path / 'plane.obj')
    call('build', '--mesh', str(mesh), '--window', '1.5', '-2', '--size', '3.2', *SMALL, '-o',
         str(tmp_path / 'm'))
    config = world_folder.load_world(tmp_path / 'm').config
    assert config.source == 'mesh' and config.mesh.center == (1.5, -2.0)
    with pytest.raises(WorldError, match='absent.tif: no such file'):
        call('build', '--dem', str(tmp_path / 'absent.tif'), '-o', str(tmp_path / 'd'))
    assert not (tmp_path / 'd').exists()


@pytest.mark.parametrize('argv, message', [
    (['build', '--scenario', 'baselin', '-o', 'x'], 'no such scenario; did you mean baseline'),
    (['build', '--set', 'world.rocks.abundanc=1', '-o', 'x'], 'did you mean abundance'),
    (['build', '--set', 'rocks.abundance=1', '-o', 'x'], 'valid is world.PARAM=VALUE'),
    (['build', '--seed', '-3', '-o', 'x'], '--seed: -3 is not valid'),
    (['build', '--mesh', 'a.obj', '--window', '1', '1', '--window-in', 'crs', '-o', 'x'],
     'not valid for a mesh'),
    (['preview', 'x', '--sun', '0', '200'], '--sun: 0 200 is not valid'),
])
def test_command_line_mistakes(tmp_path, monkeypatch, argv, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=message):
        call(*argv)
    assert list(tmp_path.iterdir()) == []
