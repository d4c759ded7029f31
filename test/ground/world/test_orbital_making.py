"""Maps of a world from orbit: what they show is the ground, and their errors are as stated."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import rasterio

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.orbital_making import orbital_map
from lunar_rover_sim.ground.world.orbital_map import OrbitalConfig, OrbitalMap

TRUE = OrbitalConfig(extent_m=300.0, photo_pixel_m=0.0, smooth_m=0.0, height_stddev_m=0.0,
                     bias_stddev_m=0.0, tilt_stddev_deg=0.0, crater_place_m=0.0, crater_size=0.0)


@pytest.fixture(scope='module', name='world')
def _world() -> World:
    return build_world(WorldConfig.from_mapping({
        'size_m': 6.4, 'cell_m': 0.1, 'surroundings': {'samples': 513, 'extent_m': 200.0}}), 4)


def test_heights_are_means_of_the_ground(world: World) -> None:
    made = orbital_map(world, TRUE)
    rows, columns = np.array([5, 80, 120]), np.array([11, 70, 140])
    for row, column in zip(rows, columns):
        middle = np.array(made.first_m) + made.pixel_m * np.array([column, row])
        offsets = (np.arange(64) + 0.5) / 64 * made.pixel_m - 0.5 * made.pixel_m
        places = middle + np.stack(np.meshgrid(offsets, offsets), axis=-1)
        assert abs(made.heights_m[row, column] - world.height_at(places).mean()) < 0.02


def test_errors_have_the_covariance_that_is_stated(world: World) -> None:
    """Over 40 seeds, at two places 10 m apart; the spread of a variance of n is (2 / n)^0.5."""
    config = dataclasses.replace(TRUE, height_stddev_m=0.5, bias_stddev_m=1.0,
                                 tilt_stddev_deg=0.2)
    true, places = orbital_map(world, TRUE), np.array([[100.0, -60.0], [110.0, -60.0]])
    off = np.array([orbital_map(world, dataclasses.replace(config, error_seed=k)).height_at(places)
                    for k in range(40)]) - true.height_at(places)
    known = orbital_map(world, config)
    stated = known.covariance_m2(places[:, None], places[None])
    np.testing.assert_allclose(np.diag(stated), known.variance_m2(places))
    found = off.T @ off / len(off)
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    assert np.abs((found - stated) / scale).max() < 4.0 * np.sqrt(2.0 / len(off))


def test_progress_goes_up_to_all_of_it(world: World) -> None:
    told: list[tuple[str, float]] = []
    orbital_map(world, dataclasses.replace(TRUE, photo_pixel_m=1.0),
                lambda what, share: told.append((what, share)))
    photo = [share for what, share in told if what == 'photo']
    assert photo == sorted(photo) and len(photo) > 2
    assert 0.0 <= photo[0] and photo[-1] <= 1.0


def test_what_is_interrupted_leaves_nothing(world: World, tmp_path: Path,
                                            monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(_: object) -> None:
        raise KeyboardInterrupt

    made = orbital_map(world, TRUE)
    monkeypatch.setattr(OrbitalMap, '_features', interrupt)
    with pytest.raises(KeyboardInterrupt):
        made.save(tmp_path / 'maps')
    assert not list(tmp_path.iterdir())


def test_files_are_read_by_others(world: World, tmp_path: Path) -> None:
    made = orbital_map(world, dataclasses.replace(TRUE, photo_pixel_m=2.0))
    made.save(tmp_path)
    with rasterio.open(tmp_path / 'heights.tif') as file:
        x, y = file.xy(0, 0)            # row 0 is in the north
        assert file.read(1)[0, 0] == made.heights_m[-1, 0]
        assert (x, y) == (made.first_m[0], made.first_m[1] + made.pixel_m * (file.height - 1))
    assert (tmp_path / 'photo.tif').is_file() and (tmp_path / 'craters.geojson').is_file()


@pytest.mark.parametrize(('change', 'words'), [
    ({'extent_m': 1e4}, 'extent_m: 10000 is not valid'),
    ({'pixel_m': 90.0}, 'pixel_m: 90 is not valid')])
def test_what_cannot_be_mapped_is_refused(change: dict, words: str, world: World) -> None:
    with pytest.raises(WorldError, match=words):
        orbital_map(world, dataclasses.replace(TRUE, **change))
