"""The sun of a date in a scenario: with its world, in overrides, and recorded."""

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.crs import CRS
from rasterio.transform import from_origin

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.run.plan import resolve
from lunar_rover_sim.run.scenario import Scenario

DATE = 'render_node.sun.date=2026-11-22T00:00:00Z'
GIVEN = ['render_node.sun.site.source=given', 'render_node.sun.site.lat_deg=-89.9']


@pytest.fixture(scope='module', name='of_pole')
def _of_pole(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return overrides for a world 20 km from the south pole at longitude 90."""
    path = tmp_path_factory.mktemp('dem') / 'pole.tif'
    crs = CRS.from_user_input('+proj=stere +lat_0=-90 +lon_0=0 +R=1737400 +units=m')
    with rasterio.open(path, 'w', driver='GTiff', width=20, height=20, count=1, dtype='float32',
                       crs=crs, transform=from_origin(1e4, 1e4, 1e3, 1e3)) as file:
        file.write(np.zeros((20, 20), np.float32), 1)
    return ['world.source=dem', f'world.path={path}']


def test_a_given_site() -> None:
    """Azimuth and elevation follow from the date, and nothing else changes."""
    sun = Scenario.load('baseline', [DATE, *GIVEN]).render_node.sun
    # As at the pole itself the elevation is minus the latitude below the sun, within 0.1 deg.
    assert sun.elevation_deg == pytest.approx(1.6, abs=0.1)
    assert sun.azimuth_deg == pytest.approx(60.69, abs=0.01)
    assert Scenario.load('baseline').render_node.sun.azimuth_deg == 60.0


def test_the_site_of_an_elevation_model(of_pole: list[str], tmp_path: Path) -> None:
    """Its projection turns the grid; the recorded scenario states all and gives the same again."""
    scenario = resolve(Scenario.load('dem', [*of_pole, DATE]))
    site = scenario.render_node.sun.site
    assert (site.source, site.lon_deg) == ('given', pytest.approx(90.0, abs=1e-6))
    assert site.lat_deg == pytest.approx(-89.34, abs=0.01)
    assert site.grid_north_deg == pytest.approx(-90.0, abs=1e-3)
    # In the grid of a polar map the sun is where it is seen from any place around the pole.
    assert scenario.render_node.sun.azimuth_deg == pytest.approx(60.69, abs=0.1)
    path = tmp_path / 'dem.yaml'
    path.write_text(scenario.to_yaml())
    assert resolve(Scenario.load(str(path))) == scenario
    later = Scenario.load(str(path), {'render_node.sun.date': '2026-11-29'}).render_node.sun
    assert later.azimuth_deg == pytest.approx(145.7, abs=0.3)


@pytest.mark.parametrize(('overrides', 'match'), [
    ([DATE], 'render_node.sun.site.source: world is not valid: the world does not say where'),
    ([DATE, *GIVEN, 'render_node.sun.azimuth_deg=30'],
     'sun.azimuth_deg: 30 is not valid with render_node.sun.date .2026-11-22'),
    ([DATE, 'render_node.sun.site.lat_deg=5'], 'site.lat_deg: 5 is not valid with source world'),
    (['render_node.sun.date=2200-01-01', *GIVEN],
     'render_node.sun.date: 2200-01-01T00:00:00Z is not valid; valid is 1972-01-01'),
    (['render_node.sun.date=noon'], "render_node.sun.date: 'noon' is not a date"),
    (['render_node.sun.date=2026-06-01', *GIVEN], 'elevation_deg: -1.* is not valid; valid is'),
])
def test_bad_input(overrides: list[str], match: str) -> None:
    with pytest.raises(ConfigError, match=match) as error:
        Scenario.load('baseline', overrides)
    assert '\n' not in str(error.value)


@pytest.mark.parametrize(('more', 'match'), [
    (['render_node.sun.site.lat_deg=-80'], 'sun.site: longitude 0, latitude -80 .* is not on'),
    (['render_node.sun.site.lat_deg=-89.5', 'render_node.sun.site.lon_deg=90'],
     'grid_north_deg: 0 is not valid; valid is -90.0000, which the projection of'),
])
def test_a_site_that_is_not_that_of_the_map(of_pole: list[str], more: list[str],
                                            match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        Scenario.load('dem', [*of_pole, DATE, GIVEN[0], *more])
