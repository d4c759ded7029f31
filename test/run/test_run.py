"""The real graph over real DDS: nodes that fail, signals, and what is refused."""

import os
from pathlib import Path
import re
import signal

from command_line import unfolded
from conftest import BLIND, processes_naming, simulate, start_run
import psutil
import pytest
from waiting import LIMIT_S, wait_until

from lunar_rover_sim.bag.content_hash import bag_hash
from lunar_rover_sim.bag.marker import why_incomplete
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.recovery import recover
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.run.node_processes import NodeProcesses
from lunar_rover_sim.run.plan import NodePlan, resolve
from lunar_rover_sim.run.recording import Limits
from lunar_rover_sim.run.scenario import Scenario

pytestmark = pytest.mark.ros


def without_progress(stderr: str) -> list[str]:
    """Return the lines of errors: a run of more than 10 s tells its progress between them."""
    return [line for line in stderr.strip().splitlines()
            if not line.startswith(('building the world: ', 'starting: ', 'simulating: '))]


def wait_for_recording(folder: Path) -> None:
    """Return when the graph runs: the bag holds two chunks, which have 0.3 MB without images."""
    wait_until(lambda: sum(file.stat().st_size for file in (folder / 'bag').glob('*.mcap'))
               > 600_000, 'nothing was recorded')


def process_of(folder: Path, node: str) -> int:
    """Return the process id of a node of the run in `folder`, as soon as it is there."""
    def found() -> list[int]:
        return processes_naming(f'entry_points {node}', str(folder))

    wait_until(found, f'{node} did not start')
    return found()[0]


def readable_bag(folder: Path) -> Path:
    """Return the bag of a run; it is recovered where the recorder was killed."""
    bag = folder / 'bag'
    if not (bag / 'metadata.yaml').exists():
        recover(bag)
    return bag


def test_a_killed_node_ends_the_run(tmp_path: Path) -> None:
    """At once, with one line that names it; the bag up to there can be read."""
    folder = tmp_path / 'run'
    run = start_run(folder, 60, *BLIND)
    wait_for_recording(folder)
    os.kill(process_of(folder, 'recorder_node'), signal.SIGKILL)
    stderr = unfolded(run.communicate(timeout=LIMIT_S)[1])
    assert run.returncode == 1
    assert 'recorder_node ended with SIGKILL' in stderr
    assert len(without_progress(stderr)) == 1
    assert 'recorder_node ended with SIGKILL' in str(why_incomplete(folder / 'bag'))
    with open_bag(readable_bag(folder)) as bag:
        assert bag.counts['/odom'] > 0


def test_a_suspended_recorder_finishes_its_bag(tmp_path: Path, domain: int) -> None:
    """It goes on when it is told to stop."""
    bag = tmp_path / 'bag'
    (tmp_path / 'scenario.yaml').write_text('/**: {ros__parameters: {seed: 1}}\n')
    plan = NodePlan('recorder_node', {'output': str(bag)})
    with NodeProcesses([plan], tmp_path, domain) as nodes:
        wait_until(lambda: not nodes.unstarted())
        os.kill(process_of(tmp_path, 'recorder_node'), signal.SIGSTOP)
        wait_until(nodes.suspended)
    assert (bag / 'metadata.yaml').exists()


def test_a_killed_run_takes_its_nodes_along(tmp_path: Path) -> None:
    """After SIGKILL of the run no process of it goes on, and the bag can be read."""
    folder = tmp_path / 'run'
    run = start_run(folder, 60, *BLIND)
    wait_for_recording(folder)
    nodes = [process_of(folder, name) for name in ('physics_node', 'drive_node',
                                                   'recorder_node')]
    monitors = [child.pid for child in psutil.Process(run.pid).children()]
    run.kill()
    run.communicate(timeout=LIMIT_S)
    for process in {*nodes, *monitors}:
        wait_until_gone(process)
    assert why_incomplete(folder / 'bag')
    with open_bag(readable_bag(folder)) as bag:
        assert bag.counts['/odom'] > 0


def test_a_second_signal_leaves_nothing_behind(tmp_path: Path) -> None:
    """A run that gets a second signal while it stops its nodes ends with all of them."""
    folder = tmp_path / 'run'
    run = start_run(folder, 60, *BLIND)
    wait_for_recording(folder)
    first, *nodes = (process_of(folder, name) for name in (
        'drive_node', 'physics_node', 'recorder_node'))
    run.terminate()
    wait_until_gone(first)
    run.terminate()
    run.communicate(timeout=LIMIT_S)
    for node in nodes:
        wait_until_gone(node)
    with open_bag(readable_bag(folder)) as bag:
        assert bag.counts['/odom'] > 0


def wait_until_gone(process: int) -> None:
    """Return when there is no such process any more."""
    wait_until(lambda: not psutil.pid_exists(process), f'{process} is left')


def test_a_stopped_node_is_named(tmp_path: Path) -> None:
    """A node that stays silent ends the run with its name."""
    folder = tmp_path / 'run'
    run = start_run(folder, 60, *BLIND, '--set', 'physics_node.wait.silence_s=3.0')
    wait_for_recording(folder)
    os.kill(process_of(folder, 'gait_controller_node'), signal.SIGSTOP)
    stderr = unfolded(run.communicate(timeout=LIMIT_S)[1])
    assert run.returncode == 1
    # Physics notices the silence; where it runs late, `run` notices the stopped process.
    assert ('joint_commands (from gait_controller_node' in stderr
            or 'gait_controller_node is stopped' in stderr)


def test_an_awaited_topic_that_nobody_publishes_is_named(tmp_path: Path) -> None:
    """Not physics, which waits for it."""
    finished = simulate(tmp_path / 'run', *BLIND, '--set', 'physics_node.wait.topics=[my/pose]',
                        '--set', 'physics_node.wait.lags_s=[0.1]',
                        '--set', 'physics_node.wait.start_s=0.2')
    assert finished.returncode == 1
    assert re.search(r'^lunar_rover_sim: nothing on [^;]*my/pose \(from nobody, no publisher\) '
                     'since 0.000 s[^;]*; physics_node waits for', unfolded(finished.stderr),
                     re.MULTILINE)
    # Physics counts from its own start, which takes seconds on a busy machine, `run` from before.
    scenario = resolve(Scenario.load('baseline', BLIND[1::2]))
    start_s = Limits.of(scenario).start_s
    assert start_s is not None and start_s > scenario.physics_node.wait.start_s + 15.0


def test_nodes_that_load_for_longer_than_the_limit_of_a_start_take_part(tmp_path: Path) -> None:
    """Physics, which is there first, does not give them up: all import for longer than that."""
    finished = simulate(tmp_path / 'run', '--duration', '0.5', '--set',
                        'physics_node.wait.start_s=0.1')
    assert finished.returncode == 0, finished.stderr
    with open_bag(tmp_path / 'run/bag') as bag:
        assert bag.counts['/stereo/left/image_raw'] > 0


def test_physics_stopped_while_the_nodes_start(tmp_path: Path) -> None:
    """It is not given the time that a slow start is given."""
    folder = tmp_path / 'run'
    run = start_run(folder, 60, *BLIND, '--set', 'physics_node.wait.silence_s=3.0')
    os.kill(process_of(folder, 'physics_node'), signal.SIGSTOP)
    stderr = unfolded(run.communicate(timeout=LIMIT_S)[1])
    assert run.returncode == 1
    assert 'physics_node is stopped (SIGSTOP)' in stderr


def test_divergence_in_the_drive_ends_the_run(tmp_path: Path) -> None:
    """Motors too strong for an explicit integrator: named, and the drive up to there is kept."""
    folder = tmp_path / 'run'
    motors = ('rover.motor.velocity_gain_nms=5.0', 'rover.motor.current_limit_a=1.0e3',
              'rover.motor.stall_torque_nm=1000.0', 'physics_node.integrator=euler',
              'drive_node.start_delay_s=1.0')
    run = start_run(folder, 60, *BLIND,
                    *(word for setting in motors for word in ('--set', setting)))
    stderr = unfolded(run.communicate(timeout=LIMIT_S)[1])
    assert run.returncode == 1
    assert len(without_progress(stderr)) == 1
    said = re.search(r'physics_node ended with status 1: the simulation diverged at ([\d.]+) s in '
                     r'body \w+', stderr)
    assert said and float(said[1]) > 1.0
    complete = next(finding for finding in check(folder / 'bag').failed
                    if finding.check == 'complete')
    assert complete.detail.startswith('the run failed: physics_node ended with status 1: the sim')
    with open_bag(folder / 'bag') as bag:
        assert bag.counts['/odom'] > 180


@pytest.mark.parametrize(('settings', 'end_s'), [
    (['drive_node.waypoints_x_m=[0.0]', 'drive_node.waypoints_y_m=[0.0]',
      'drive_node.goal_tolerance_m=5.0'], 2.0),
    (['drive_node.waypoints_x_m=[3.0]', 'drive_node.waypoints_y_m=[3.0]',
      'drive_node.tilt_limit_deg=0.01'], 2.0)])
def test_a_drive_that_is_done_ends_the_run(tmp_path: Path, settings: list[str], end_s: float
                                           ) -> None:
    """At the end of its route, or where it stops, and the recording counts as whole."""
    folder = tmp_path / 'run'
    words = ['drive_node.mode=waypoints', 'drive_node.shape=none', 'drive_node.end_after_s=1.0',
             'drive_node.start_delay_s=0.0', *settings]
    run = start_run(folder, 60, *(word for setting in words for word in ('--set', setting)))
    stderr = unfolded(run.communicate(timeout=LIMIT_S)[1])
    assert run.returncode == 0, stderr
    assert not check(folder / 'bag').failed
    with open_bag(folder / 'bag') as bag:
        assert bag.end_ns / 1e9 == pytest.approx(end_s, abs=0.1)


def test_interrupt_finishes_the_bag(tmp_path: Path) -> None:
    """Ctrl-C: the nodes stop in order, the bag is whole up to there and marked as short."""
    folder = tmp_path / 'run'
    run = start_run(folder, 60)
    wait_for_recording(folder)
    run.send_signal(signal.SIGINT)
    stdout, stderr = run.communicate(timeout=LIMIT_S)
    assert run.returncode == 130, stderr
    with open_bag(folder / 'bag') as bag:
        assert str(bag.incomplete).startswith('the recording ended at ')
        assert bag.counts['/odom'] > 0 and bag.counts['/stereo/left/image_raw'] > 0
    assert f'hash {bag_hash(folder / "bag")}' in stdout


def test_existing_output_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is overwritten."""
    assert main(['run', 'baseline', '-o', str(tmp_path)]) == 1
    said = unfolded(capsys.readouterr().err)
    assert said.startswith('lunar_rover_sim: ') and 'exists; name a new folder' in said
    assert not list(tmp_path.iterdir())


def test_a_topic_that_nobody_publishes_is_named(tmp_path: Path) -> None:
    """An empty bag is an error."""
    run = start_run(tmp_path / 'run', 60, '--duration', '0.2', '--set',
                    'run.nodes=[physics_node, recorder_node]', '--set',
                    'recorder_node.topics=[odomm]')
    stderr = unfolded(run.communicate(timeout=LIMIT_S)[1])
    assert run.returncode == 1
    assert 'recorder_node.topics: odomm: nobody published, did you mean odom?: the bag is empty' \
        in stderr


def test_a_run_places_its_bag_itself() -> None:
    """A place in the scenario is refused."""
    with pytest.raises(ConfigError, match="recorder_node.output: 'here' is not valid in a run"):
        resolve(Scenario.load('flat', ['recorder_node.output=here']))
