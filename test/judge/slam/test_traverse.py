"""The benchmark of traverses: conditions, systems and sites, done once, and its table."""

import functools

from judge.slam import closed_way, relief_walk
from judge.slam.test_benchmark import Recorder
import numpy as np
import pytest

from lunar_rover_sim.base.errors import ConfigError, SlamError
from lunar_rover_sim.cli.main import execute
from lunar_rover_sim.judge.slam import benchmark, traverse
from lunar_rover_sim.judge.slam.drives import Drive, Judged
from lunar_rover_sim.judge.slam.graph import pose_graph
from lunar_rover_sim.judge.slam.run_on_bag import SlamResult
from lunar_rover_sim.run.scenario import Scenario

SYSTEMS = ('wheels', 'reference', 'graph', 'anchored')


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    steps = closed_way.drive(laps=0.2, heading=True)
    return closed_way.write(tmp_path_factory.mktemp('traverse') / 'bag', steps)


def run(bag, monkeypatch, folder, *words):
    """Return the recorder of a small benchmark."""
    recorder = Recorder(bag)
    monkeypatch.setattr(traverse, 'planned', lambda scenario, goal_m: np.array(
        [[1.0, 0.1 * (scenario.physics_node.seed - 1001)], goal_m]))
    monkeypatch.setattr('lunar_rover_sim.cli.benchmark.run_cells',
                        functools.partial(benchmark.run, recorder=recorder))
    assert execute(['benchmark', 'traverse', '-o', str(folder), '--distances', '3', '--sites', '2',
                    '--rates', '1', '--suns', '6', *words]) == 0
    return recorder


@pytest.mark.skipif(not pose_graph.has_gtsam(), reason='gtsam is not installed')
def test_every_system_is_judged_on_every_site_once(bag, monkeypatch, tmp_path, capsys):
    """All but the wheels see a metre of flat ground well; on a map it says nothing."""
    made = []

    def orbital_map(site, config):
        made.append((site.config.seed, config.extent_m, config.error_seed))
        return relief_walk.orbital(0)

    monkeypatch.setattr(traverse, 'orbital_map', orbital_map)
    run(bag, monkeypatch, tmp_path)
    lines = (tmp_path / 'traverse.md').read_text().splitlines()
    cells = {line.split(' | ')[3]: line.split(' | ') for line in lines if line.startswith('| 3 |')}
    assert set(cells) == set(SYSTEMS)
    for system in SYSTEMS:
        assert cells[system][4].startswith('2/2 [0.34, 1.00]')
    assert float(cells['wheels'][6].split()[0]) > float(cells['graph'][6].split()[0])
    assert cells['anchored'][8].startswith('0/2') and cells['anchored'][9].startswith('0/2')
    assert cells['graph'][8] == '–'
    told = [line for line in lines if 'of 3 tests' in line]
    assert len(told) == 3 and all('not shown to differ' in line for line in told)
    own = tmp_path / '3m_1hz_6deg'
    assert len(list((own / 'cells').glob('*/result.json'))) == 8
    assert (own / 'cells' / 'expedition-seed1001-stereo-anchored' / 'live_covariance.txt').exists()
    assert made == [(1001, 246.0, 1001), (1002, 246.0, 1002)]
    again = run(bag, monkeypatch, tmp_path)
    assert not again.drives
    assert (tmp_path / 'traverse.md').read_text().splitlines() == lines


def test_conditions_are_settings_of_the_scenario():
    near, dark = traverse.conditions([300.0], [0.5], ['3', 'dark'])
    assert (near.name, dark.name) == ('300m_0.5hz_3deg', '300m_0.5hz_dark')
    scenario = Drive(traverse.SCENARIO, 7, 10.0, overrides=dark.settings()).load_scenario()
    render, lit = scenario.render_node, Scenario.load('permanent_shadow').render_node
    assert (render.lamp, render.sensor, render.sun.irradiance) == (lit.lamp, lit.sensor, 0.0)
    assert render.sensor.exposure_mode == 'auto'    # one exposure does not suit what moves along
    assert {t.name for t in benchmark.AIDED} == set(scenario.recorder_node.topics)


def test_a_difference_is_shown_by_all_tests_together():
    """Eight sites, on all of which the graph is better."""
    condition, = traverse.conditions([300.0], [0.5], ['6'])
    judged = [(condition, Judged(Drive('expedition', seed, 10.0), SlamResult(
        system, 'stereo', tracked_share=1.0, ate_m=error * seed, ate_percent=error,
        distance_m=300.0)))
        for system, error in (('reference', 2.0), ('graph', 1.0)) for seed in range(1, 9)]
    text = traverse.table(judged)
    assert '300m_0.5hz_6deg, graph: its error is smaller than that of the reference' in text
    assert 'of 1 tests' in text


@pytest.mark.parametrize(('words', 'error', 'said'), [
    (['--suns', 'twilight'], SlamError, "suns: 'twilight' is not valid"),
    (['--suns', '6', '6.0'], SlamError, 'name each distance, rate and sun once'),
    (['--distances', '3', '4'], ConfigError, '--sites: 1 numbers are not valid with 2'),
    (['--executable', '/nowhere/stereo_euroc'], SlamError, 'needs --vocabulary')])
def test_what_cannot_be_is_one_line(tmp_path, words, error, said):
    sites = ['--sites', '1'] if '--distances' in words else []
    with pytest.raises(error, match=said):
        execute(['benchmark', 'traverse', '-o', str(tmp_path / 'out'), *sites, *words])
    assert not (tmp_path / 'out').exists()
