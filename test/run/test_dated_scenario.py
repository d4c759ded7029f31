"""The sun of a date in a scenario: with its world, in overrides, and recorded."""

import dataclasses
from pathlib import Path

from command_line import unfolded
import numpy as np
import pytest
import rasterio
from rasterio.crs import CRS
from rasterio.transform import from_origin
import synthetic_bag as synthetic
import worlds

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError, WorldError
from lunar_rover_sim.base.parameters import merge
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.map_projection import site_in_world
from lunar_rover_sim.ground.world.moon_place import reported_site
from lunar_rover_sim.ground.world.world_folder import load_world, save_world
from lunar_rover_sim.run import recording
from lunar_rover_sim.run.plan import resolve
from lunar_rover_sim.run.scenario import Scenario

DATE = 'render_node.sun.date=2026-11-22T00:00:00Z'
GIVEN = ['render_node.sun.site.source=given', 'render_node.sun.site.lat_deg=-89.9']


def _write(path: Path) -> Path:
    """Write flat ground 20 km from the south pole at longitude 90."""
    crs = CRS.from_user_input('+proj=stere +lat_0=-90 +lon_0=0 +R=1737400 +units=m')
    with rasterio.open(path, 'w', driver='GTiff', width=20, height=20, count=1, dtype='float32',
                       crs=crs, transform=from_origin(1e4, 1e4, 1e3, 1e3)) as file:
        file.write(np.zeros((20, 20), np.float32), 1)
    return path


@pytest.fixture(scope='module', name='of_pole')
def _of_pole(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return overrides for a world of this ground."""
    path = _write(tmp_path_factory.mktemp('dem') / 'pole.tif')
    return ['world.source=dem', f'world.path={path}']


@pytest.fixture(scope='module', name='folder')
def _folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a world of this ground, whose elevation model is gone."""
    path = _write(tmp_path_factory.mktemp('dem') / 'pole.tif')
    config = merge(worlds.SMALL, {'source': 'dem', 'path': str(path)})
    folder = tmp_path_factory.mktemp('worlds') / 'pole'
    save_world(build_world(WorldConfig.from_mapping(config), 1), folder)
    path.unlink()
    return folder


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


@pytest.mark.parametrize('name', ['dem', 'baseline'])
def test_the_site_of_a_world_folder(folder: Path, name: str) -> None:
    """Whatever world the scenario has of its own, a file that is not there or a generated one."""
    scenario = Scenario.load(name, [DATE], world=folder)
    site = reported_site(load_world(folder).report)
    assert site is not None and site.lon_deg == pytest.approx(90.0, abs=1e-6)
    found = scenario.render_node.sun
    assert found.site.to_mapping() == {'source': 'given', **site.to_report()}
    assert found.azimuth_deg == pytest.approx(60.69, abs=0.1)
    assert scenario.world == Scenario.load(name).world
    # What was dated by a folder is right for it.
    assert Scenario.load(name, [DATE, *(f'render_node.sun.site.{key}={value}' for key, value
                                        in found.site.to_mapping().items())],
                         world=folder) == scenario


OFF = [GIVEN[0], 'render_node.sun.site.lon_deg=100', 'render_node.sun.site.lat_deg=-88.8']
TURNED = [GIVEN[0], 'render_node.sun.site.lon_deg=90', 'render_node.sun.site.lat_deg=-89.34045',
          'render_node.sun.site.grid_north_deg=10']
OFF_TEXT = 'render_node.sun.site: longitude 100, latitude -88.8 (x 1583'
TURNED_TEXT = ('render_node.sun.site.grid_north_deg: 10 is not valid; valid is -90.0000, which '
               'the projection of the world says')


@pytest.mark.parametrize('given, text', [(OFF, OFF_TEXT), (TURNED, TURNED_TEXT)])
@pytest.mark.parametrize('command', ['run', 'render', 'view'])
def test_a_site_that_is_not_that_of_the_world_folder(
        folder: Path, given: list[str], text: str, command: str, tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr('lunar_rover_sim.cli.run.require_ros', lambda: None)
    output = [] if command == 'view' else ['-o', str(tmp_path / 'out')]
    settings = [word for setting in (DATE, *given) for word in ('--set', setting)]
    assert main([command, 'dem', '--world', str(folder), *output, *settings]) == 1
    error = unfolded(capsys.readouterr().err)
    assert text in error and error.count('\n') == 1
    assert text is not OFF_TEXT or 'is outside the world; valid is x and y within' in error
    assert not (tmp_path / 'out').exists()


def test_the_world_beside_a_bag_is_that_of_its_pictures(
        folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / 'world').symlink_to(folder)
    synthetic.write(tmp_path / 'bag', [synthetic.text(topics.WORLD_HASH, load_world(folder).hash)])
    settings = [word for setting in (DATE, *OFF) for word in ('--set', setting)]
    assert main(['render', 'baseline', '--at', str(tmp_path / 'bag'), '-o',
                 str(tmp_path / 'out'), *settings]) == 1
    assert OFF_TEXT in unfolded(capsys.readouterr().err)


def test_record_refuses_a_site_that_is_not_that_of_its_world(
        folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scenario was loaded without the folder."""
    monkeypatch.setattr(recording, 'require_ros', lambda: None)
    scenario = Scenario.load('baseline', [DATE, *OFF])
    with pytest.raises(ConfigError, match='longitude 100, .* is outside the world'):
        recording.record(scenario, tmp_path / 'run', world=folder)
    assert not (tmp_path / 'run').exists()


def test_a_world_folder_that_says_nothing_of_the_moon(tmp_path: Path) -> None:
    """A generated world has no site of its own, and any may be given."""
    save_world(worlds.small(), tmp_path / 'world')
    with pytest.raises(ConfigError, match='the world does not say where on the Moon it is'):
        Scenario.load('baseline', [DATE], world=tmp_path / 'world')
    assert Scenario.load('baseline', [DATE, *GIVEN], world=tmp_path / 'world') == Scenario.load(
        'baseline', [DATE, *GIVEN])


@pytest.mark.parametrize('crs', ['/etc/passwd', 'http://127.0.0.1:1/x', 'IAU:none', 'EPSG:4326',
                                 '+proj=eqc', '', 3, None])
def test_a_report_without_a_projection(folder: Path, crs: object,
                                       capfd: pytest.CaptureFixture[str]) -> None:
    world = load_world(folder)
    world = dataclasses.replace(world, report={**world.report, 'crs': crs})
    with pytest.raises(WorldError, match='report.crs: .* is not valid; valid is a projected CRS'):
        site_in_world(world, 90.0, -89.34)
    assert capfd.readouterr() == ('', '')
