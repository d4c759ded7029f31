"""A run that was killed goes on at its last checkpoint; the bag is that of one that was not."""

import dataclasses
from pathlib import Path
import shutil

from command_line import unfolded
from conftest import PLAIN, SMALL, TINY
import pytest

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.content_hash import bag_hash
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.totals import resumed_ns
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.rover.description import save_rover
from lunar_rover_sim.run import checkpoint
from lunar_rover_sim.run.plan import resolve, why_no_checkpoints
from lunar_rover_sim.run.recording import unfinished_run
from lunar_rover_sim.run.scenario import Scenario

SETTINGS = (*SMALL, *TINY, *PLAIN, 'render_node.frame_rate_hz=5', 'render_node.depth_every=1',
            'render_node.sensor.exposure_mode=auto', 'physics_node.ground.model=regolith',
            'physics_node.checkpoint_period_s=0.4', 'navigator_node.start_delay_s=0.2')


def kill(folder: Path) -> None:
    """Make a run what one is that was killed in the third file of its bag."""
    bag = folder / 'bag'
    *_, newest = sorted((folder / 'checkpoints').iterdir())
    shutil.rmtree(newest)
    (bag / marker.METADATA_NAME).unlink()
    last = bag / 'bag_2.mcap'
    last.write_bytes(last.read_bytes()[:-1000])
    marker.mark(bag)


@pytest.mark.ros
def test_a_killed_run_goes_on_as_if_it_had_not_been(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With navigation by what the cameras see, on soft ground, with automatic exposure."""
    whole, killed = tmp_path / 'whole', tmp_path / 'killed'
    assert main(['run', 'baseline', '-o', str(whole), '--duration', '1.0', '--goal', '3,0.5', *(
        word for setting in SETTINGS for word in ('--set', setting))]) == 0
    assert [one.name for one in sorted((whole / 'checkpoints').iterdir())] == [
        '000000000400000000', '000000000800000000']
    with pytest.raises(ConfigError, match='whole: the run is finished'):
        unfinished_run(whole)
    shutil.copytree(whole, killed, symlinks=True)
    kill(killed)
    capsys.readouterr()
    assert main(['run', '--resume', str(killed)]) == 0
    assert 'resumed at 0.400 s' in capsys.readouterr().out
    with open_bag(whole / 'bag') as one, open_bag(killed / 'bag') as other:
        assert other.counts == one.counts and one.counts['/map/traversability'] == 5
        assert resumed_ns(one) == () and resumed_ns(other) == (400_000_000,)
    assert bag_hash(killed / 'bag') == bag_hash(whole / 'bag')
    report = check(killed / 'bag')
    assert report.ok and 'resumed at 0.400 s' in str(report)


@pytest.mark.parametrize('settings, why', [
    (['time_mode=real_time'], 'in time_mode real_time'),
    (['run.nodes=[physics_node, slam_node, recorder_node]'],
     'with slam_node, whose state is not kept'),
    (['run.may_fail=[lidar_node]'], 'with run.may_fail: lidar_node'),
    (['physics_node.wait.topics=[mine]', 'physics_node.wait.lags_s=[0]'],
     'where time waits for programs that the run does not start')])
def test_runs_that_cannot_go_on_have_no_checkpoints(settings: list[str], why: str) -> None:
    scenario = resolve(Scenario.load('baseline', ['physics_node.checkpoint_period_s=60',
                                                  *settings]))
    assert scenario.physics_node.checkpoint_period_s == 0.0
    assert why_no_checkpoints(scenario) == why


def test_a_period_ends_where_all_is_due() -> None:
    scenario = resolve(Scenario.load('baseline', [
        'physics_node.checkpoint_period_s=0.5', 'render_node.frame_rate_hz=0.5',
        'render_node.depth_every=2']))
    assert scenario.physics_node.checkpoint_period_s == 4.0
    assert resolve(scenario) == scenario


def test_only_whole_checkpoints_count(tmp_path: Path) -> None:
    assert checkpoint.newest(tmp_path) is None
    for time_ns in (10**9, 2 * 10**9, 3 * 10**9):
        begun = checkpoint.begin(tmp_path, time_ns)
        assert checkpoint.under_way(tmp_path) == begun and begun.missing(['a', 'b']) == ['a', 'b']
        begun.part('a').write_bytes(b'state')
        assert begun.missing(['a', 'b']) == ['b'] and not begun.is_whole()
        checkpoint.seal(begun)
    assert checkpoint.under_way(tmp_path) is None
    newest = checkpoint.newest(tmp_path)
    assert newest is not None and newest.time_ns == 3 * 10**9
    assert len(list(tmp_path.iterdir())) == 2       # older ones are removed
    newest.part('a').write_bytes(b'other')
    before = checkpoint.newest(tmp_path)
    assert before is not None and before.time_ns == 2 * 10**9
    for told in ('{}', '[' * 100_000):
        (before.folder / 'manifest.json').write_text(told)
        assert checkpoint.newest(tmp_path) is None
    checkpoint.begin(tmp_path, 4 * 10**9)
    checkpoint.clear(tmp_path, 2 * 10**9)
    assert [path.name for path in tmp_path.iterdir()] == ['000000002000000000']


def test_what_cannot_go_on_is_refused(tmp_path: Path,
                                      capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['run', '--resume', str(tmp_path), '--seed', '3']) == 2
    assert '--resume: --seed 3 is not valid beside it' in unfolded(capsys.readouterr().err)
    assert main(['run', '--resume', str(tmp_path)]) == 1
    assert 'holds no run; valid is the folder of a run' in unfolded(capsys.readouterr().err)
    (tmp_path / 'scenario.yaml').write_text(Scenario.load('baseline').to_yaml())
    assert main(['run', '--resume', str(tmp_path)]) == 1
    assert 'holds no whole checkpoint; valid is a run with' in unfolded(capsys.readouterr().err)
    (tmp_path / 'bag').mkdir()
    marker.mark(tmp_path / 'bag')
    with marker.lock(tmp_path / 'bag'):
        assert main(['run', '--resume', str(tmp_path)]) == 1
    assert 'the run goes on at this moment' in unfolded(capsys.readouterr().err)


def test_a_run_whose_rover_was_changed_does_not_go_on(tmp_path: Path) -> None:
    scenario = Scenario.load('baseline', rover='hexapod')
    (tmp_path / 'scenario.yaml').write_text(scenario.to_yaml())
    begun = checkpoint.begin(tmp_path / 'checkpoints', 10**9)
    begun.part('physics_node').write_bytes(b'state')
    checkpoint.seal(begun)
    save_rover(scenario.rover, tmp_path / 'rover.yaml')
    assert unfinished_run(tmp_path) == Scenario.load(tmp_path / 'scenario.yaml')
    heavier = dataclasses.replace(scenario.rover.chassis, mass_kg=9.0)
    save_rover(dataclasses.replace(scenario.rover, chassis=heavier), tmp_path / 'rover.yaml')
    with pytest.raises(ConfigError, match='rover.yaml is another rover than that of scenario'):
        unfinished_run(tmp_path)
