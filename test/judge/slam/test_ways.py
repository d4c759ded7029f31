"""Ways that are driven again: found in recordings, kept in seals, followed by drive_node."""

from collections.abc import Callable
import functools
import json
from pathlib import Path

from judge.slam.test_benchmark import Recorder
from judge.slam.test_seal import NEEDED
from judge.slam.test_traverse import run
import numpy as np
import pytest
from scipy.spatial import cKDTree
import synthetic_bag as synthetic

from lunar_rover_sim.base.errors import ConfigError, SlamError
from lunar_rover_sim.cli.main import execute
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.judge.slam import benchmark, traverse
from lunar_rover_sim.judge.slam.drives import Drive
from lunar_rover_sim.judge.slam.seal import read_seal
from lunar_rover_sim.judge.slam.ways import ALONG, planned, sealed_ways, settings_of
from lunar_rover_sim.run.scenario import Scenario

pytest.importorskip('gtsam')


def test_a_planned_way_keeps_clear_of_rocks_and_of_steep_ground(tmp_path):
    """Looked at are the rocks and heights of the windows themselves."""
    way = traverse.way_of(20.0, 1002, tmp_path)
    np.testing.assert_array_equal(traverse.way_of(20.0, 1002, tmp_path), way)
    np.testing.assert_array_equal(way[-1], [16.0, 12.0])
    corners = np.vstack([[0.0, 0.0], way])
    along = np.hypot(*np.diff(corners, axis=0).T).cumsum()
    s = np.arange(0.3, along[-1], 0.05)
    points = np.stack([np.interp(s, np.r_[0.0, along], axis) for axis in corners.T], axis=-1)
    scenario = Drive(traverse.SCENARIO, 1002, 10.0).load_scenario()
    site = Site(scenario.world, 1002)
    for middle in {site.middle(point) for point in points}:
        world = site.window(middle)
        here = points[np.abs(points - middle).max(axis=1) < 0.6 * site.step_m]
        rocks = world.rocks
        high = rocks.position_m[:, 2] + 0.4 * rocks.diameter_m - world.ground.height_at(
            rocks.position_m[:, :2]) > 0.1
        off_m, _ = cKDTree(here).query(rocks.position_m[high, :2])
        assert (off_m > 0.3 * rocks.diameter_m[high] + 0.2).all()
        ahead, aside = (world.ground.height_at(here + step) - world.ground.height_at(here - step)
                        for step in np.array([[0.15, 0.0], [0.0, 0.15]]))
        assert np.degrees(np.arctan(np.hypot(ahead, aside) / 0.3)).max() < 25.0
    site.close()


def test_a_goal_that_no_way_leads_to_is_named(tmp_path):
    """The rover stands on the only ground that it can cross."""
    scenario = Scenario.load(traverse.SCENARIO, ['mapping_node.limits.max_slope_deg=1'], seed=5)
    with pytest.raises(SlamError, match=r'along: no way from \(0, 0\) to \(9, 0\) m was found '
                       'with seed 5'):
        planned(scenario, (9.0, 0.0))


def test_drives_along_a_way_follow_it_and_end_there():
    """The settings are those of drive_node, in place of mapping and navigator."""
    way = np.array([[1.0, 0.5], [2.25, -1.0]])
    scenario = Drive(traverse.SCENARIO, 7, 900.0,
                     overrides=ALONG + settings_of(way)).load_scenario()
    drive = scenario.drive_node
    assert (drive.waypoints_x_m, drive.waypoints_y_m) == ((1.0, 2.25), (0.5, -1.0))
    assert 'drive_node' in scenario.run.nodes and drive.end_after_s >= 0.0
    assert not {'navigator_node', 'mapping_node'}.intersection(scenario.run.nodes)


@pytest.fixture
def sealed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch
           ) -> tuple[Path, Callable[..., Recorder]]:
    """Return a seal of two drives along ways, and what runs a traverse of two sites."""
    bag = synthetic.write(tmp_path / 'bag', synthetic.drive(1.2, state_hz=50, only=NEEDED))
    monkeypatch.setattr(traverse, 'anchor_of', lambda *_: None)
    go = functools.partial(run, bag, monkeypatch)
    go(tmp_path / 'along')
    assert execute(['slam', 'seal', str(tmp_path / 'along' / '3m_1hz_6deg'), '-o',
                    str(tmp_path / 'seal.yaml')]) == 0
    return tmp_path / 'seal.yaml', go


def overrides(folder: Path, seed: int) -> list[str]:
    path = next(folder.glob(f'**/expedition-seed{seed}/drive.json'))
    return list(json.loads(path.read_text())['overrides'])


def test_a_seal_keeps_the_ways(sealed, tmp_path, monkeypatch):
    """An entry, and a traverse under any sun, are driven along them."""
    path, go = sealed
    seal = read_seal(path)
    expected = overrides(tmp_path / 'along', 1002)
    way = [text for text in expected if text.startswith('drive_node.waypoints_')]
    assert len(way) == 2 and not set(way).intersection(seal.settings)
    assert seal.drive('expedition', 1002).overrides == tuple(expected)

    monkeypatch.setattr('lunar_rover_sim.cli.benchmark.run_cells', functools.partial(
        benchmark.run, recorder=Recorder(tmp_path / 'bag')))
    execute(['benchmark', '-o', str(tmp_path / 'entry'), '--sealed', str(path), '--sensors',
             'stereo', '--system', 'wheels'])
    assert json.loads((tmp_path / 'entry/score.json').read_text())['is_sealed']
    assert overrides(tmp_path / 'entry', 1002) == expected

    go(tmp_path / 'low', '--along', str(path), '--set', 'render_node.sun.azimuth_deg=10')
    assert set(way) <= set(overrides(tmp_path / 'low', 1002))


def test_without_a_way_nothing_is_driven(sealed, tmp_path):
    path, _ = sealed
    with pytest.raises(SlamError, match='holds no way of expedition-seed1003'):
        sealed_ways(path, [1002, 1003], 'expedition')
    with pytest.raises(SlamError, match='distances: 30 is not valid with this way of seed 1001'):
        execute(['benchmark', 'traverse', '-o', str(tmp_path / 'x'), '--along', str(path),
                 '--distances', '30', '--sites', '1'])
    with pytest.raises(ConfigError, match='nowhere'):
        execute(['benchmark', 'traverse', '-o', str(tmp_path / 'x'), '--along', 'nowhere'])
    assert not (tmp_path / 'x').exists()
