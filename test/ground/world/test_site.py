"""A site: windows with the same ground where they overlap, from every side, made once."""

import dataclasses
import os
import pathlib
import subprocess
import sys

from ground.world.elevation_models import bumps, hills, write_tiff
import numpy as np
import pytest
from waiting import LIMIT_S

from lunar_rover_sim.autonomy.navigation.global_plan import GroundCosts
from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.parameters import merge
from lunar_rover_sim.ground.world import cache
from lunar_rover_sim.ground.world.build import build_world, Builder, drop_m
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.levels import axis_m
from lunar_rover_sim.ground.world.orbital_making import orbital_map
from lunar_rover_sim.ground.world.orbital_map import OrbitalConfig
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.ground.world.world_folder import content_hash, load_world

WINDOW = {'size_m': 25.6, 'cell_m': 0.05, 'surroundings': {'samples': 257}}
TINY = {'size_m': 25.6, 'cell_m': 0.1, 'surroundings': {'samples': 65, 'extent_m': 60.0}}
SIDES = ((12.8, 0.0), (-12.8, 0.0), (0.0, 12.8), (-12.8, -12.8))


def made_up(tmp_path):
    return WINDOW


def measured(tmp_path):
    path = write_tiff(tmp_path / 'hills.tif', hills(160))
    return merge(WINDOW, {'source': 'dem', 'path': str(path), 'dem': {'center': [3.0, -7.7]}})


@pytest.fixture(params=[made_up, measured])
def site(request, tmp_path, monkeypatch):
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path / 'cache'))
    site = Site(WorldConfig.from_mapping(request.param(tmp_path)), 3)
    yield site
    site.close()


def shared(one, other, k=0):
    """Return the samples that two windows share of a level, without the outermost ones."""
    a, b = one.levels[k], other.levels[k]
    parts = []
    for grid, beside in ((a, b), (b, a)):
        ranges = []
        for axis in (1, 0):
            offset = round((beside.middle_m[axis] - grid.middle_m[axis]) / grid.cell_m)
            ranges.append(slice(max(offset, 0) + 1, grid.n + min(offset, 0) - 1))
        parts.append(tuple(ranges))
    return parts


def test_the_ground_is_the_same_from_every_side(site):
    """Heights and rocks bit by bit, albedo but for the border; craters by their keys."""
    middle = site.window((0.0, 0.0))
    for side in SIDES:
        beside = site.window(side)
        assert beside.ground.middle_m == side and content_hash(beside) == beside.hash
        here, there = shared(middle, beside)
        assert middle.ground.heights_m[here].size > 100_000 // 2
        np.testing.assert_array_equal(middle.ground.heights_m[here],
                                      beside.ground.heights_m[there])
        inner = np.s_[60:-60, 60:-60]
        np.testing.assert_array_equal(middle.albedo[here][inner], beside.albedo[there][inner])
        keys, i, j = np.intersect1d(middle.rocks.key, beside.rocks.key, return_indices=True)
        assert len(keys) > 20
        for name in ('position_m', 'orientation_wxyz', 'shape', 'size', 'albedo'):
            np.testing.assert_array_equal(getattr(middle.rocks, name)[i],
                                          getattr(beside.rocks, name)[j])
        _, i, j = np.intersect1d(middle.craters.key, beside.craters.key, return_indices=True)
        assert len(i) > 100
        np.testing.assert_array_equal(middle.craters.position_m[i], beside.craters.position_m[j])


def test_coarse_levels_agree_but_for_the_sphere_and_what_lies_within():
    config = WorldConfig.from_mapping(WINDOW)
    site = Site(config, 3)
    one, other = site.window((0.0, 0.0)), site.window((12.8, 0.0))
    heights, coarse = [], []
    for world in (one, other):
        grid = world.levels[1]
        x = axis_m(grid.n, grid.cell_m)
        heights.append(grid.heights_m + drop_m(x**2 + x[:, None]**2, 0.5**0.5 * config.size_m))
        coarse.append(np.maximum(np.abs(x), np.abs(x)[:, None]) > world.ground.half_extent_m)
    here, there = shared(one, other, 1)
    # Where neither window shows its fine ground, nor fades into the next level.
    alike = (coarse[0][here] & coarse[1][there])[60:-60, 60:-60]
    off = np.abs(heights[0][here] - heights[1][there])[60:-60, 60:-60][alike]
    assert off.size > 1000 and np.mean(off < 1e-4) > 0.99
    site.close()


def test_where_windows_are_and_when_the_next_one_comes():
    site = Site(WorldConfig.from_mapping({**WINDOW, 'site_km': 0.2}), 3)
    assert site.half_extent_m == pytest.approx(12.8 + 6 * 12.8)
    assert site.middle((0.0, 0.0)) == (0.0, 0.0)
    assert site.middle((9.0, -9.0), (0.0, 0.0)) == (0.0, 0.0)
    assert site.middle((9.7, -2.0), (0.0, 0.0)) == (12.8, 0.0)
    assert site.middle((7.0, 0.0)) == (12.8, 0.0)
    assert site.middle((500.0, -500.0)) == pytest.approx((76.8, -76.8))
    for wrong in ((1.0, 0.0), (89.6, 0.0)):
        with pytest.raises(WorldError, match='is not the middle of a window; valid are multiples'):
            site.window(wrong)


def test_a_world_made_by_hand_is_its_only_window():
    world = build_world(WorldConfig.from_mapping(TINY), 1)
    assert Site.of(world).window((12.8, 0.0)).config == world.config
    lifted = Site.of(dataclasses.replace(world, hash=''))
    assert lifted.middle((300.0, 2.0)) == (0.0, 0.0)
    assert lifted.half_extent_m == world.ground.half_extent_m
    with pytest.raises(WorldError, match='is not the middle of a window'):
        lifted.window((12.8, 0.0))


def test_a_measured_site_ends_with_its_file(tmp_path):
    site = Site(WorldConfig.from_mapping(measured(tmp_path)))
    # 320 m wide, with the origin 7.7 m off its middle, and pixels of 2 m.
    assert site.half_extent_m == pytest.approx(12.8 + 10 * 12.8)
    site.close()


def test_a_hole_on_the_way_is_refused_with_its_place(tmp_path):
    heights = hills(160)
    heights[80:83, 100:104] = np.nan
    path = write_tiff(tmp_path / 'hole.tif', heights)
    site = Site(WorldConfig.from_mapping({**WINDOW, 'source': 'dem', 'path': str(path)}))
    with pytest.raises(WorldError, match='in the window around x 38.4, y 0 m have no data'):
        site.window((3 * site.step_m, 0.0))
    site.close()


@pytest.mark.parametrize('pixel_m', [0.5, 2.0])
def test_maps_from_orbit_show_holes_and_far_plans_keep_off_them(tmp_path, pixel_m):
    """Wherever the rover may be sent, it is in no window that cannot be made."""
    n = round(320.0 / pixel_m)
    heights = hills(n, pixel_m)
    heights[n // 2, round(0.8 * n)] = np.nan        # one pixel, at x = 96 m, y = 0
    path = write_tiff(tmp_path / 'hole.tif', heights, pixel_m)
    config = WorldConfig.from_mapping({**TINY, 'source': 'dem', 'path': str(path)})
    site, source = Site(config), Builder(config).source
    maps = orbital_map(site, OrbitalConfig(photo_pixel_m=0.0))
    lost = np.argwhere(np.isnan(maps.heights_m))
    assert 1 <= len(lost) <= 4
    places = maps.first_m + maps.pixel_m * lost[:, ::-1]
    assert np.abs(places - [96.0, 0.0]).max() < 2.5
    keeps_off_the_hole(site, maps, source)
    site.close()


def keeps_off_the_hole(site, maps, source):
    """Check that a hole at (96, 0) is far from all that a far plan may cross."""
    costs = GroundCosts.of(maps, hole_margin_m=site.hole_margin_m)
    rows, columns = np.nonzero(~costs.known)
    holes = costs.centre_m(np.stack([rows, columns], axis=1))
    assert (np.abs(holes - [96.0, 0.0]).max(axis=1) < site.hole_margin_m + 10.0).all()
    for x in (-80.0, 45.0, 70.0):
        if costs.has_ground(x, 3.0):
            # The windows that a rover there may be in.
            for at in {site.middle((x + dx, 3.0)) for dx in (-9.7, 0.0, 9.7)}:
                source.check_window(at)
    assert costs.has_ground(45.0, 3.0) and not costs.has_ground(70.0, 3.0)


def test_a_hole_of_a_mesh_is_one_of_the_map_from_orbit(tmp_path):
    """It is smaller than a pixel of the map; the windows beside it can be made."""
    terrain, _ = bumps(n=321, cell=1.0)
    centres = terrain.triangles_center[:, :2]
    terrain.update_faces(np.abs(centres - [96.0, 0.0]).max(axis=1) > 0.7)
    terrain.export(tmp_path / 'holed.ply')
    config = WorldConfig.from_mapping({**TINY, 'source': 'mesh',
                                       'path': str(tmp_path / 'holed.ply')})
    site, source = Site(config), Builder(config).source
    with pytest.raises(WorldError, match='in the window around x 102.4, y 0 m meet no face'):
        source.check_window((102.4, 0.0))
    maps = orbital_map(site, OrbitalConfig(photo_pixel_m=0.0))
    assert 1 <= np.isnan(maps.heights_m).sum() <= 9
    keeps_off_the_hole(site, maps, source)
    site.close()


def test_a_damaged_window_is_made_again(tmp_path, monkeypatch):
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path))
    site = Site(WorldConfig.from_mapping(TINY), 5)
    folder = site.folder((12.8, 0.0))
    first = load_world(folder).hash
    (folder / 'height_0.npy').write_bytes(b'nothing')
    assert load_world(site.folder((12.8, 0.0))).hash == first
    assert folder.parent == cache.window_folder()
    site.close()


def test_two_processes_make_a_window_once(tmp_path):
    program = ('from lunar_rover_sim.ground.world.site import Site\n'
               'from lunar_rover_sim.ground.world.config import WorldConfig\n'
               f'site = Site(WorldConfig.from_mapping({TINY!r}), 5)\n'
               'print(site.folder((0.0, 12.8)), site.window((0.0, 12.8)).hash)\n')
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path),
                   'LUNAR_ROVER_SIM_CACHE': str(tmp_path)}
    both = [subprocess.Popen([sys.executable, '-c', program], env=environment, text=True,
                             stdout=subprocess.PIPE, stderr=subprocess.PIPE) for _ in range(2)]
    said = {process.communicate(timeout=LIMIT_S)[0] for process in both}
    assert len(said) == 1 and '' not in said
    assert len([p for p in pathlib.Path(tmp_path, 'windows').iterdir() if p.is_dir()]) == 1


def test_a_window_is_the_same_whatever_was_made_before(site):
    """One that goes on from its neighbours, and one that is made anew."""
    goes_on = Builder(site.config)
    for middle in ((0.0, 0.0), (12.8, 0.0), (25.6, -12.8)):
        last = goes_on.window(middle)
    anew = Builder(site.config)
    assert anew.window((25.6, -12.8)).hash == last.hash
    for builder in (goes_on, anew):
        builder.close()


def test_a_disk_that_is_full_in_the_middle_of_a_window_is_said_and_leaves_nothing(tmp_path):
    program = ('import resource\n'
               'from lunar_rover_sim.base.errors import WorldError\n'
               'from lunar_rover_sim.ground.world.site import Site\n'
               'from lunar_rover_sim.ground.world.config import WorldConfig\n'
               f'site = Site(WorldConfig.from_mapping({TINY!r}), 5)\n'
               'print(site.window((0.0, 0.0)).hash)\n'
               '_, most = resource.getrlimit(resource.RLIMIT_FSIZE)\n'
               'resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, most))\n'
               'try:\n'
               '    site.window((0.0, 12.8))\n'
               'except WorldError as error:\n'
               '    print(error)\n'
               'resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))\n'
               'print(site.window((0.0, 12.8)).ground.middle_m)\n')
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path),
                   'LUNAR_ROVER_SIM_CACHE': str(tmp_path)}
    done = subprocess.run([sys.executable, '-c', program], env=environment, text=True,
                          capture_output=True, timeout=LIMIT_S)
    first, error, again = done.stdout.splitlines()
    assert len(first) == 32 and again == '(0.0, 12.8)', done.stderr
    assert error.startswith(str(tmp_path / 'windows')) and error.endswith(
        'LUNAR_ROVER_SIM_CACHE names another folder for built worlds')
    assert 'cannot be written: ' in error
    folders = [path.name for path in (tmp_path / 'windows').iterdir() if path.is_dir()]
    assert len(folders) == 1 and not folders[0].startswith('.')
