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
import synthetic_bag as synthetic

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base.errors import ConfigError, SlamError
from lunar_rover_sim.cli.main import execute
from lunar_rover_sim.judge.slam import benchmark, traverse
from lunar_rover_sim.judge.slam.drives import Drive
from lunar_rover_sim.judge.slam.seal import read_seal
from lunar_rover_sim.judge.slam.ways import ALONG, settings_of, way_of, ways_of

pytest.importorskip('gtsam')
S = np.linspace(0.0, 1.0, 400)[:, None]


def off_m(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Return the distance of each point from a polyline."""
    a, step = line[:-1], np.diff(line, axis=0)
    share = np.clip(((points[:, None] - a) * step).sum(2) / (step ** 2).sum(1), 0.0, 1.0)
    return np.linalg.norm(a + share[..., None] * step - points[:, None], axis=2).min(1)


def test_a_way_keeps_to_where_the_rover_was():
    """A winding way, standing for a while: few waypoints, and never off by more than 5 cm."""
    x = 12.0 * S[:, 0]
    places = np.column_stack([x, np.sin(x), 0.1 * x])
    way = way_of(np.vstack([places, np.repeat(places[-1:], 500, axis=0)]))
    line = np.vstack([places[0, :2], way])
    assert len(way) < 60
    assert off_m(places[:, :2], line).max() < 0.06
    assert np.linalg.norm(line[-1] - places[-1, :2]) < 0.06


def test_what_led_back_is_left_out():
    """Into a dead end of 2 m, back, and around a rock of 1 m: neither is driven again."""
    to, end, aside = np.array([4.0, 0.0]), np.array([6.0, 0.0]), np.array([4.0, 5.0])
    angle = 2.0 * np.pi * S
    circle = aside + [0.5, 0.0] - 0.5 * np.hstack([np.cos(angle), np.sin(angle)])
    way = way_of(np.vstack([S * to, to + S * (end - to), end + S * (to - end),
                            to + S * (aside - to), circle, aside + S * [-3.0, 0.0]]))
    line = np.vstack([[0.0, 0.0], way])
    assert np.hypot(*np.diff(line, axis=0).T).sum() == pytest.approx(12.0, abs=0.3)
    assert way[:, 0].max() < 4.2


def test_a_rover_that_stood_has_no_way():
    with pytest.raises(SlamError, match='has moved by 0.05 m only'):
        way_of(0.05 * np.hstack([S, S * 0, S * 0]))


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
    go(tmp_path / 'navigated')
    go(tmp_path / 'along', '--along', str(tmp_path / 'navigated'))
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
    # Where the rover was.
    points = np.column_stack([json.loads(text.partition('=')[2]) for text in way])
    with open_bag(tmp_path / 'bag') as bag:
        states = [bag.decode(message.data, message.msgtype).pose.pose.position
                  for message in bag.raw(['odom'])]
    assert off_m(points, np.array([(p.x, p.y) for p in states])).max() < 0.05
    assert np.hypot(*(points[-1] - (states[-1].x, states[-1].y))) < 0.06


def test_without_a_way_nothing_is_driven(sealed, tmp_path):
    path, _ = sealed
    with pytest.raises(SlamError, match='holds no way of expedition-seed1003'):
        ways_of(path, [1002, 1003], 'expedition')
    with pytest.raises(SlamError, match='holds no recording of expedition-seed5'):
        ways_of(tmp_path / 'navigated', [5], 'expedition')
    with pytest.raises(SlamError, match='distances: 30 is not valid with this way of seed 1001'):
        execute(['benchmark', 'traverse', '-o', str(tmp_path / 'x'), '--along', str(path),
                 '--distances', '30', '--sites', '1'])
    with pytest.raises(ConfigError, match='nowhere'):
        execute(['benchmark', 'traverse', '-o', str(tmp_path / 'x'), '--along', 'nowhere'])
    assert not (tmp_path / 'x').exists()
