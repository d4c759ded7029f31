"""The recipe: what is refused."""

import math
import re

import numpy as np
import pytest
import rasterio
from rasterio.crs import CRS
from rasterio.transform import from_origin

from lunar_rover_sim.base.errors import ConfigError, WorldError
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.cache import cached
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.dem import dem_site
from lunar_rover_sim.ground.world.moon_place import reported_site
from lunar_rover_sim.image.illumination.sky import sky
from lunar_rover_sim.run.scenario import Scenario

FLAT = Scenario.load('flat').world


@pytest.mark.parametrize('mapping, message', [
    ({'size_m': 50.1}, r'size_m: 50.1 is not a multiple of 16 cells .* nearest is 50$'),
    ({'size_m': 51.3}, r'size_m: 51.3 .* nearest is 51.2$'),
    ({'rocks': {'min_diameter_m': 2.0, 'max_diameter_m': 1.0}},
     r'^world\.rocks\.min_diameter_m: 2 is not valid; valid is <= max_diameter_m = 1 \[m\]$'),
    ({'source': 'dem'}, 'world.path: empty; source dem needs a file'),
    ({'source': 'dme', 'path': 'x'}, "'dme' is not valid; did you mean dem"),
])
def test_mistakes_are_named(mapping, message):
    with pytest.raises(ConfigError, match=message):
        WorldConfig.from_mapping(mapping, 'world')


@pytest.mark.parametrize('size_m, cell_m', [(0.05, 0.025), (0.59, 0.025), (12.9, 0.05),
                                            (3.3, 0.1), (900.0, 0.025)])
def test_the_size_that_is_offered_is_valid_and_none_is_nearer(size_m, cell_m):
    with pytest.raises(ConfigError, match='the nearest is') as raised:
        WorldConfig(size_m=size_m, cell_m=cell_m)
    offered = float(str(raised.value).rpartition(' ')[2])
    assert WorldConfig(size_m=offered, cell_m=cell_m).size_m == offered
    step = int(re.findall(r'multiple of (\d+) cells', str(raised.value))[0]) * cell_m
    for other in (offered - step, offered + step):
        if abs(other - size_m) < abs(offered - size_m) - 1e-9:
            with pytest.raises(ConfigError):
                WorldConfig(size_m=other, cell_m=cell_m)


def test_mapping_round_trip():
    config = WorldConfig.from_mapping({'rocks.abundance': 0.01, 'seed': 5})
    assert WorldConfig.from_mapping(config.to_mapping()) == config
    assert config.samples == 2049


@pytest.mark.parametrize('seed, message', [
    (-1, r'^seed: -1 is not valid; valid is >= 0$'),
    (1.5, r'^seed: 1\.5 is not a whole number$'),
    ('one', r"^seed: 'one' is not a whole number$"),
])
def test_a_seed_is_a_whole_number_from_0_on(seed, message):
    with pytest.raises(ConfigError, match=message):
        build_world(FLAT, seed)
    with pytest.raises(ConfigError, match=message):
        cached(FLAT, seed)


@pytest.mark.parametrize('seed', [-2, -7, 0.5, 'one'])
def test_the_seed_of_a_recipe_is_a_whole_number_or_that_of_the_scenario(seed):
    assert WorldConfig.from_mapping({'seed': -1}).with_seed(4).seed == 4
    with pytest.raises(ConfigError, match='seed: .* is not'):
        WorldConfig.from_mapping({'seed': seed})


def test_the_seed_of_the_recipe_wins():
    assert FLAT.with_seed(7).seed == 7
    assert FLAT.with_seed(0).seed == 0
    assert WorldConfig(seed=3).with_seed(7).seed == 3


RADIUS_M = 1737400.0
SOUTH, NORTH = (f'+proj=stere +lat_0={lat} +lon_0=0 +R=1737400 +units=m' for lat in (-90, 90))


def config(folder, crs=SOUTH, center=(0.0, 0.0), mode='crs'):
    """Return a world of an elevation model of a pole, 400 km wide."""
    path = folder / 'pole.tif'
    with rasterio.open(path, 'w', driver='GTiff', width=40, height=40, count=1, dtype='float32',
                       crs=CRS.from_user_input(crs) if crs else None,
                       transform=from_origin(-2e5, 2e5, 1e4, 1e4)) as file:
        file.write(np.zeros((40, 40), np.float32), 1)
    return WorldConfig.from_mapping({'source': 'dem', 'path': str(path), 'dem': {
        'center_mode': mode, 'center': list(center)}})


@pytest.mark.parametrize('lon_deg', [0.0, 35.0, 90.0, -135.0])
@pytest.mark.parametrize(('crs', 'sign'), [(SOUTH, -1.0), (NORTH, 1.0)])
def test_polar_stereographic(tmp_path, crs, sign, lon_deg):
    """From the projection's own formulas: at the south pole y turns by minus the longitude."""
    rho, lon = 1e5, math.radians(lon_deg)
    site = dem_site(config(tmp_path, crs, (rho * math.sin(lon), -sign * rho * math.cos(lon))))
    assert site.lon_deg == pytest.approx(lon_deg, abs=1e-6)
    colatitude = math.degrees(2.0 * math.atan(rho / (2.0 * RADIUS_M)))
    assert site.lat_deg == pytest.approx(sign * (90.0 - colatitude), abs=1e-6)
    assert site.grid_north_deg == pytest.approx(sign * lon_deg, abs=1e-3)
    again = dem_site(config(tmp_path, crs), (site.lon_deg, site.lat_deg))
    assert again.grid_north_deg == pytest.approx(site.grid_north_deg, abs=1e-6)


def test_the_sun_does_not_jump_around_the_pole(tmp_path):
    """Places on all sides of the pole, and the pole itself, see the sun in one direction."""
    date = np.asarray('2026-11-22T00:00', 'datetime64[us]')
    azimuths = [float(sky(dem_site(config(tmp_path, SOUTH, xy)), date).sun.azimuth_deg)
                for xy in ((0.0, 0.0), (30.0, 0.0), (-30.0, 0.0), (0.0, 30.0), (20.0, -30.0))]
    assert azimuths == pytest.approx([azimuths[0]] * 5, abs=0.01)


def test_lon_lat_of_the_window(tmp_path):
    site = dem_site(config(tmp_path, SOUTH, (44.0, -88.5), 'lonlat'))
    assert (site.lon_deg, site.lat_deg) == pytest.approx((44.0, -88.5), abs=1e-6)
    assert site.grid_north_deg == pytest.approx(-44.0, abs=1e-3)
    assert reported_site(site.to_report()) == site


def test_a_place_beyond_the_file(tmp_path):
    with pytest.raises(WorldError, match=r'latitude -80 \(x 0, y 3[0-9.e+]*\) is not on .* '
                       'valid is x -200000 to'):
        dem_site(config(tmp_path), (0.0, -80.0))


def test_a_file_without_a_crs_says_nothing_of_its_place(tmp_path):
    assert dem_site(config(tmp_path, None, mode='offset')) is None


def test_a_damaged_report():
    assert reported_site({}) is None
    with pytest.raises(WorldError, match='report.lat_deg: 91.0 is not valid; valid is -90 to 90'):
        reported_site({'lon_deg': 0.0, 'lat_deg': 91.0, 'grid_north_deg': 0.0})

    for name, most in (('lon_deg', 360.0), ('lat_deg', 90.0), ('grid_north_deg', 360.0)):
        given = {'lon_deg': 1.0, 'lat_deg': 2.0, 'grid_north_deg': 3.0}
        for value in (-most, most):
            assert getattr(reported_site({**given, name: value}), name) == value
            with pytest.raises(WorldError, match=f'report.{name}: .* is not valid'):
                reported_site({**given, name: 1.001 * value})
        assert reported_site({**given, name: None}) is None
