"""The true surface, and maps of a bag that are off it by what is known."""

import cv2
import map_bag
import numpy as np
import pytest
import synthetic_bag
import worlds

from lunar_rover_sim.autonomy.navigation.config import MapConfig
from lunar_rover_sim.autonomy.navigation.elevation_map import ElevationMap
from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.frames import matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.ground.world.world_folder import save_world
from lunar_rover_sim.image.stereo.seen_depth import SeenDepth
from lunar_rover_sim.judge.evaluation.map_evaluation import (CELL_M, DISTANCES_M, evaluate_maps,
                                                             NEAR_M, TrueSurface)
from lunar_rover_sim.run.scenario import Scenario


def rocky():
    return worlds.small(**{'rocks.abundance': 0.3, 'clear_radius_m': 0.5})


@pytest.fixture(scope='module', name='folder')
def _folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp('world') / 'world'
    save_world(rocky(), folder)
    return folder


def judged(folder, path, **values):
    return evaluate_maps(map_bag.write(path, rocky(), **values), folder)


def test_a_true_map_with_an_offset_has_that_error(folder, tmp_path):
    result = judged(folder, tmp_path / 'bag', error_m=0.02)
    assert result.maps == 1 and result.near.cells > 1000
    assert result.offset_m == pytest.approx(0.02, abs=0.001)
    assert result.near.median_m == pytest.approx(0.02, abs=0.002)
    # Samples of a cell differ at the edges of rocks.
    assert 0.0199 <= result.near.rms_m < 0.03
    assert result.near.cells == sum(one.cells for one in result.by_distance
                                    if one.high_m <= NEAR_M)


def test_each_band_has_the_errors_of_its_cells(tmp_path):
    """Those whose middles are as far from the rover, in the raster that maps are judged in."""
    world = worlds.small(1, **worlds.BARE)
    save_world(world, tmp_path / 'world')
    axis = (np.arange(round(map_bag.SIZE_M / map_bag.CELL_M)) + 0.5) * map_bag.CELL_M
    middle = (np.floor((axis - 0.5 * map_bag.SIZE_M) / CELL_M) + 0.5) * CELL_M
    away = np.hypot(*np.meshgrid(middle, middle))
    result = evaluate_maps(map_bag.write(tmp_path / 'bag', world,
                                         error_m=0.2 * (away < DISTANCES_M[1]).ravel()),
                           tmp_path / 'world')
    inner, outer, *_ = result.by_distance
    assert inner.rms_m == pytest.approx(0.2, abs=0.01) and outer.rms_m < 0.01
    # The map states 1 cm; its cells are smaller than those whose middles count.
    second, *others = (one.beyond_3_sigma for one in result.by_distance[1:] if one.cells)
    assert inner.beyond_3_sigma > 0.9 and second < 0.1 and not any(others)


def test_flags_are_right_or_missing_also_in_a_picture(folder, tmp_path):
    """At a height that is too low by 6 cm, which is as dark blue as the scale goes."""
    def of(name, **values):
        bag = map_bag.write(tmp_path / name, rocky(), error_m=-0.06, **values)
        result = evaluate_maps(bag, folder, output=tmp_path / f'{name}.png')
        image = cv2.imread(str(tmp_path / f'{name}.png'))[..., ::-1].astype(int)
        assert image.shape == (550, 1210, 3)
        # Below the blue end of `coolwarm`, on the left, nothing is as blue.
        assert (np.abs(image[:, :605] - (59, 76, 192)).sum(axis=2) < 30).sum() > 5000
        return result, [(np.abs(image[:, 605:] - colour).sum(axis=2) < 30).sum() for colour in (
            (44, 160, 44), (214, 39, 40), (255, 127, 14), (217, 217, 217))]

    right, (green, red, orange, grey) = of('found')
    assert right.near.precision > 0.98 and right.near.recall > 0.98
    # Cells of the flags are smaller than those of the picture: some reach beyond a rock.
    assert green > 2000 and grey > 5000 and red == 0 and orange < green / 4
    none, (green, red, orange, grey) = of('missed', flag_rocks=False)
    assert none.near.recall == 0.0 and none.near.precision != none.near.precision
    assert red > 2000 and grey > 5000 and green == orange == 0
    told = none.to_mapping()
    assert told['near'] == {**none.near._asdict(), 'precision': None}
    assert told['offset_m'] == none.offset_m and len(told['by_distance']) == len(none.by_distance)


def test_a_bag_without_a_map_and_a_world_that_is_another_are_refused(folder, tmp_path):
    bag = synthetic_bag.write(tmp_path / 'bag', synthetic_bag.latched_items())
    with pytest.raises(EvaluationError, match='holds no map/elevation.* mapping_node'):
        evaluate_maps(bag, folder)


def far(cloud, _grid):
    points = cloud.data.view('<f4').copy()
    points[0] = 1e30
    cloud.data = points.view(np.uint8)


@pytest.mark.parametrize('edit, why', [
    (lambda cloud, grid: setattr(cloud, 'point_step', 32), 'map/elevation: points of 32 bytes'),
    (lambda cloud, grid: setattr(cloud, 'data', cloud.data[:-16]), 'map/elevation: data holds'),
    (lambda cloud, grid: setattr(cloud, 'data', cloud.data | 255), 'a cell is not finite'),
    (lambda cloud, grid: setattr(cloud.fields[3], 'name', 'variance'), 'valid are .* stddev'),
    (far, 'map/elevation: cells are 1e[+]30 m apart'),
    (lambda cloud, grid: setattr(grid, 'data', grid.data[1:]), 'map/traversability: data holds')])
def test_maps_of_other_programs_that_are_none_are_refused(folder, tmp_path, edit, why):
    with pytest.raises(EvaluationError, match=why):
        judged(folder, tmp_path / 'bag', edit=edit)


def test_it_is_the_ground_or_a_rock_above_it():
    world = worlds.small(3)
    surface = TrueSurface(world)
    rng = np.random.default_rng(1)
    xy = rng.uniform(-6.0, 6.0, (2000, 2))
    height, rise = surface.heights(xy)
    ground = world.ground.height_at(xy)
    bare = rise == 0.0
    assert 0.9 < bare.mean() < 1.0
    np.testing.assert_allclose(height[bare], ground[bare], atol=1e-5)
    np.testing.assert_allclose(height, ground + rise, atol=1e-5)
    k = int(np.argmax(world.rocks.diameter_m))
    _, top = surface.heights(world.rocks.position_m[k, :2])
    assert top > 0.1 * world.rocks.diameter_m[k]
    assert np.isnan(surface.heights((100.0, 0.0))[0])


def test_of_a_window_elsewhere_on_a_site_it_is_that_of_any_other_window():
    site = Site.of(worlds.world(size_m=25.6, cell_m=0.05))
    xy = np.random.default_rng(2).uniform(2.0, 11.0, (2000, 2))
    (here, rise), (there, other) = (TrueSurface(site.window(middle)).heights(xy)
                                    for middle in ((0.0, 0.0), (12.8, 12.8)))
    assert np.isfinite(here).all() and (rise > 0.0).any()
    np.testing.assert_allclose(there, here, atol=1e-6)
    np.testing.assert_allclose(other, rise, atol=1e-6)


def test_a_map_of_it_has_means_of_its_cells():
    surface = TrueSurface(worlds.small(3))
    found = surface.elevation((1.0, -1.0), 4.0, 0.1)
    assert found.height_m.shape == (40, 40)
    x, y = np.meshgrid(*found.centres_m)
    height = [surface.heights(np.stack([x + dx, y + dy], axis=-1))[0]
              for dx in (-0.025, 0.025) for dy in (-0.025, 0.025)]
    np.testing.assert_allclose(found.height_m, np.mean(height, axis=0), atol=1e-6)


def test_the_stated_deviation_holds_also_at_rocks():
    """Eyes with errors of a matcher pass rocks; of a normal law 0.3 % would be beyond."""
    scenario, world = Scenario.load('baseline'), rocky()
    eyes = SeenDepth(world, scenario.rover, scenario.render_node.camera,
                     scenario.render_node.sun, 1)
    mapped = ElevationMap(MapConfig().by_pose('truth'))
    for k in range(20):
        place = np.array([0.05 * k - 1.5, 0.0])
        T = se3(matrix_from_wxyz(wxyz_from_rpy(0.0, 0.02 * (-1) ** k, 0.2 * np.sin(k))),
                (*place, world.height_at(place[None])[0] + 0.1))
        mapped.add_depth(k * 3 * 10**8, eyes.look(T, 5.0), eyes.K, eyes.real_baseline_m,
                         T @ eyes.T_base_camera, T[:3, 3])
    found = mapped.elevation()
    size = len(found.height_m) * found.cell_m
    true = TrueSurface(world).elevation(found.origin_m + 0.5 * size, size, found.cell_m, 3)
    surprise = np.abs(found.height_m - true.height_m) / found.stddev_m()
    surprise = surprise[np.isfinite(surprise)]
    assert len(surprise) > 1000
    # Faces of blocks are steep: what a cell beside one holds depends on millimetres.
    assert (surprise > 3.0).mean() < 0.05
    # Nor is it stated too large: without the relief, 5 to 15 % are beyond at rocks.
    steep = true.height_m[:-1] - true.height_m[1:] > 0.05
    assert steep.any() and 0.002 < np.nanmedian(found.stddev_m()) < 0.015
