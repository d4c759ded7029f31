"""Recorders beside a plain rclpy program; both types of cmd_vel; nodes in namespaces."""

from collections.abc import Iterator
from contextlib import ExitStack
import math
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time  # noqa: E402
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from nav_msgs.msg import Path as PathMsg  # noqa: E402
from peer import LEGS, Peer, running  # noqa: E402  (needs rclpy)
from rcl_interfaces.srv import GetParameters  # noqa: E402
import rclpy  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.duration import Duration  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import CompressedImage, JointState  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.base import topics  # noqa: E402
from lunar_rover_sim.base.files.paths import find_file  # noqa: E402
from lunar_rover_sim.judge.evaluation.trajectory_files import read_tum  # noqa: E402
from lunar_rover_sim.products.inspection.check import check  # noqa: E402
from lunar_rover_sim.run.ending import DONE  # noqa: E402
from lunar_rover_sim.run.node_processes import NodeProcesses  # noqa: E402
from lunar_rover_sim.run.plan import prepare, resolve, rover_overrides, SCENARIO_FILE  # noqa: E402
from lunar_rover_sim.run.scenario import Scenario  # noqa: E402


def test_recorder_node_records_what_it_finds(peer: Peer, tmp_path: Path) -> None:
    """A topic that nobody declared is recorded; those on request only where they are named."""
    publisher = peer.node.create_publisher(Twist, 'somebody/elses_topic', 20)
    named, other = (peer.node.create_publisher(
        CompressedImage, f'stereo/{side}/image_raw/compressed', 10) for side in ('left', 'right'))
    bag = tmp_path / 'bag'
    with running('recorder_node', '-p', f'output:={bag}', '-p',
                 'topics:=[all, stereo/left/image_raw/compressed]'):
        peer.spin_until(lambda: publisher.get_subscription_count() > 0
                        and named.get_subscription_count() > 0)
        named.publish(CompressedImage())
        assert not other.get_subscription_count()
        for _ in range(20):
            publisher.publish(Twist())
            time.sleep(0.01)
        assert publisher.wait_for_all_acked(Duration(seconds=30))
        time.sleep(1.0)
    with open_bag(bag) as recorded:
        assert not recorded.incomplete
        assert recorded.counts['/somebody/elses_topic'] == 20
        assert recorded.counts['/stereo/left/image_raw/compressed'] == 1


def test_a_flood_does_not_hold_up_the_end_of_a_recording(peer: Peer, tmp_path: Path) -> None:
    """Messages are lost, and the middleware must not lock up over it; the file is finished."""
    publisher = peer.node.create_publisher(Twist, 'cmd_vel', 10)
    with running('recorder_node', '-p', f'output:={tmp_path / "bag"}') as node:
        peer.spin_until(lambda: publisher.get_subscription_count() > 0)
        end_s = time.monotonic() + 4.0
        while time.monotonic() < end_s:
            publisher.publish(Twist())
        node.send_signal(signal.SIGINT)
        assert node.wait(60) in DONE
        assert 'messages a second' in node.stdout.read()
    with open_bag(tmp_path / 'bag') as bag:
        assert bag.incomplete is None
        assert bag.count('cmd_vel') == sum(1 for _ in bag.raw(['cmd_vel'])) > 1000


def test_a_clock_that_stops_is_told_and_marks_the_bag(peer: Peer, tmp_path: Path) -> None:
    """Without a run nobody else sees it; a publisher that leaves in order marks nothing."""
    for leaves in (True, False):
        path = tmp_path / str(leaves)
        clock = peer.node.create_publisher(Clock, '/clock', 10)
        with running('recorder_node', '-p', f'output:={path}') as node:
            peer.spin_until(lambda: clock.get_subscription_count() > 0)
            for second in range(1, 4):
                clock.publish(Clock(clock=Time(sec=second)))
            assert clock.wait_for_all_acked(Duration(seconds=30))
            if leaves:
                peer.node.destroy_publisher(clock)
            assert node.stdout is not None
            told = next(line for line in node.stdout if 'stands still at 3.000 s' in line)
            assert ('its publisher has left' in told) == leaves
        with open_bag(path) as bag:
            assert (bag.incomplete is None) == leaves
            assert leaves or 'the clock stopped at 3.000 s' in str(bag.incomplete)


def test_a_recording_that_ends_before_its_run_stays_marked(tmp_path: Path) -> None:
    """As after Ctrl-C, or where the run was killed; without a run it is as long as it is."""
    scenario = tmp_path / 'scenario.yaml'
    scenario.write_text('physics_node: {ros__parameters: {duration_s: 30.0}}\n')
    for name, arguments, expected in (
            ('run', ('-p', f'scenario_file:={scenario}'),
             'the recording ended at 0.000 s of 30 s'), ('alone', (), None)):
        with running('recorder_node', '-p', f'output:={tmp_path / name}', *arguments) as node:
            assert any('ready' in line for line in node.stdout)
            time.sleep(0.5)
        with open_bag(tmp_path / name) as bag:
            assert bag.incomplete == expected


def test_a_drive_that_is_over_early_is_whole_whatever_is_recorded(peer: Peer,
                                                                  tmp_path: Path) -> None:
    """A navigator tells when its run ends; a list of other topics must not leave it out."""
    scenario = tmp_path / 'scenario.yaml'
    scenario.write_text('physics_node: {ros__parameters: {duration_s: 30.0}}\n')
    publisher = peer.node.create_publisher(Header, topics.NAVIGATED.name, 10)
    with running('recorder_node', '-p', f'output:={tmp_path / "bag"}', '-p',
                 f'scenario_file:={scenario}', '-p', 'topics:=[odom]'):
        peer.spin_until(lambda: publisher.get_subscription_count() > 0)
        publisher.publish(Header(stamp=Time(sec=2)))
        assert publisher.wait_for_all_acked(Duration(seconds=30))
        time.sleep(0.5)
    with open_bag(tmp_path / 'bag') as bag:
        assert bag.incomplete is None
        assert bag.counts[f'/{topics.NAVIGATED.name}'] == 1


def test_trajectory_recorder_node_writes_tum(peer: Peer, tmp_path: Path) -> None:
    """An estimator's poses become a file that `evaluate` reads; a Path repeats itself, once.

    Poses after a restart go to a file of their own: a trajectory has increasing stamps.
    """
    publishers = {kind: peer.node.create_publisher(kind, f'slam/{kind.__name__.lower()}', 10)
                  for kind in (Odometry, PoseStamped, PathMsg)}
    files = {kind: tmp_path / f'{kind.__name__}.txt' for kind in publishers}
    path = PathMsg()
    with ExitStack() as recorders:
        for kind, file in files.items():
            recorders.enter_context(running(
                'trajectory_recorder_node', '-p', f'output:={file}', '-r',
                f'pose:=slam/{kind.__name__.lower()}'))
        peer.spin_until(lambda: all(publisher.get_subscription_count()
                                    for publisher in publishers.values()))
        for k in range(1, 6):
            pose = PoseStamped()
            pose.header.stamp.sec, pose.header.stamp.nanosec = k, 5
            pose.pose.position.x = 0.1 * k
            pose.pose.orientation.w = 1.0
            path.poses.append(pose)
            odometry = Odometry(header=pose.header)
            odometry.pose.pose = pose.pose
            for kind, message in ((Odometry, odometry), (PoseStamped, pose), (PathMsg, path)):
                publishers[kind].publish(message)
            time.sleep(0.05)
        peer.spin_until(lambda: all(len(file.read_text().splitlines()) == 5
                                    for file in files.values()))
        for k in (1, 2):
            pose = PoseStamped()
            pose.header.stamp.sec, pose.pose.orientation.w = k, 1.0
            publishers[PoseStamped].publish(pose)
        second = tmp_path / 'PoseStamped_2.txt'
        peer.spin_until(lambda: second.exists() and len(second.read_text().splitlines()) == 2)
    assert read_tum(second).stamps_ns.tolist() == [10**9, 2 * 10**9]
    for file in files.values():
        trajectory = read_tum(file)
        assert trajectory.stamps_ns.tolist() == [k * 10**9 + 5 for k in range(1, 6)]
        assert np.allclose(trajectory.positions_m[:, 0], 0.1 * np.arange(1, 6))
        assert np.allclose(trajectory.orientations_wxyz, [1, 0, 0, 0])


class Legs:
    """Feeds a gait controller with states, and with velocities of one type at a time."""

    def __init__(self, peer: Peer, teleop: Any) -> None:
        self.peer = peer
        self._commands = peer.listen(JointState, 'joint_commands')
        self._states = peer.node.create_publisher(JointState, 'joint_states', 10)
        # A DDS participant knows one type per topic.
        self._makers = {Twist: teleop, TwistStamped: peer.node}
        self._publishers: dict[Any, Any] = {}
        self._ticks = 0
        self.sent = {Twist: 0, TwistStamped: 0}

    def offer(self, kind: Any) -> None:
        self._publishers[kind] = self._makers[kind].create_publisher(kind, 'cmd_vel', 10)

    def leave(self, kind: Any) -> None:
        self._makers[kind].destroy_publisher(self._publishers.pop(kind))

    def tick(self, kind: Any = None) -> None:
        self._ticks += 1
        state = JointState(name=LEGS, position=[0.0] * 4, velocity=[0.0] * 4)
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(5_000_000 * self._ticks,
                                                                    10**9)
        self._states.publish(state)
        if kind is not None:
            twist = Twist()
            twist.linear.x = 0.1
            self._publishers[kind].publish(
                twist if kind is Twist else TwistStamped(header=state.header, twist=twist))
            self.sent[kind] += 1

    @property
    def are_fast(self) -> bool:
        return bool(self._commands) and max(map(abs, self._commands[-1].velocity)) > 0.5


@pytest.fixture()
def legs(peer: Peer) -> Iterator[Legs]:
    context = Context()
    rclpy.init(context=context)
    teleop = rclpy.create_node('teleop', context=context)
    yield Legs(peer, teleop)
    teleop.destroy_node()
    context.try_shutdown()


def test_the_type_of_cmd_vel_may_change(legs: Legs) -> None:
    """Twist, TwistStamped, Twist: each moves the legs while it alone has a publisher."""
    with running('gait_controller_node', '-p', 'cmd_timeout_s:=0.02'):
        for kind in (Twist, TwistStamped, Twist):
            legs.offer(kind)
            legs.peer.spin_until(lambda: legs.are_fast, meanwhile=lambda: legs.tick(kind))
            legs.leave(kind)
            legs.peer.spin_until(lambda: not legs.are_fast, meanwhile=legs.tick)


def test_what_moves_the_rover_is_in_the_bag(legs: Legs, tmp_path: Path) -> None:
    """A second type is neither recorded nor driven, even after the first has left."""
    with running('recorder_node', '-p', f'output:={tmp_path / "bag"}') as recorder, \
            running('gait_controller_node', '-p', 'cmd_timeout_s:=0.02') as gait:
        legs.offer(Twist)
        legs.peer.spin_until(lambda: legs.are_fast, meanwhile=lambda: legs.tick(Twist))
        legs.offer(TwistStamped)
        legs.peer.spin_until(lambda: not legs.are_fast, meanwhile=legs.tick)
        for leaves in (False, True):
            if leaves:
                legs.leave(Twist)
            for _ in range(20):
                legs.peer.spin_until(lambda: True)
                legs.tick(TwistStamped)
                rclpy.spin_once(legs.peer.node, timeout_sec=0.05)
                assert not legs.are_fast
        for node, said in ((gait, 'TwistStamped of peer is refused: geometry_msgs/msg/Twist is '
                                  'recorded on this topic'),
                           (recorder, 'is neither recorded nor driven')):
            node.send_signal(signal.SIGINT)
            assert said in node.stdout.read()
    with open_bag(tmp_path / 'bag') as bag:
        assert bag.types['/cmd_vel'] == 'geometry_msgs/msg/Twist'
        assert 0 < bag.count('cmd_vel') <= legs.sent[Twist]


def test_bad_joint_states_and_commands_are_refused_and_counted(
        domain: int, tmp_path: Path, peer: Peer, world_folder: Path) -> None:
    """Without joints, without values, not finite, on both topics of a run: it goes on."""
    bad = [JointState(), JointState(name=LEGS), JointState(name=LEGS, velocity=[1.0]),
           JointState(name=LEGS, position=[math.nan] * 4, velocity=[math.nan] * 4)]
    scenario = resolve(Scenario.load('flat', [
        'time_mode=real_time', 'physics_node.ground.model=rigid',
        'run.nodes=[physics_node, gait_controller_node, recorder_node]'], duration_s=3.0))
    folder = tmp_path / 'run'
    publishers = [peer.node.create_publisher(JointState, name, 10)
                  for name in ('joint_states', 'joint_commands')]
    with NodeProcesses(prepare(scenario, folder, world_folder), folder, domain) as graph:
        peer.spin_until(graph.has_finished, meanwhile=lambda: [
            publisher.publish(message) for publisher in publishers for message in bad])
    for node, words in (('physics_node', 'joint_commands: velocity'),
                        ('gait_controller_node', 'joint_states: position')):
        log = (folder / f'logs/{node}.log').read_text()
        assert words in log and 'so far)' in log
    with open_bag(folder / 'bag') as bag:
        assert bag.incomplete is None and bag.count('tf') > 100


def test_a_scenario_holds_under_another_name(peer: Peer) -> None:
    """In a namespace and under __node:= the section of the program counts; -p wins over it."""
    with running('drive_node', '--params-file', str(find_file('scenario', 'baseline')), '-r',
                 '__ns:=/rover1', '-r', '__node:=path', '-p', 'speed_mps:=0.05'):
        answer = peer.call(GetParameters, '/rover1/path/get_parameters', GetParameters.Request(
            names=['mode', 'shape', 'speed_mps', 'seed']))
    mode, shape, speed, seed = answer.values
    assert (mode.string_value, shape.string_value) == ('spline', 'figure_eight')
    assert (speed.double_value, seed.integer_value) == (0.05, 1)


def test_two_rovers_share_one_time(tmp_path: Path, world_folder: Path, peer: Peer) -> None:
    """Each has its bag; all stamps are there, and one clock, though a recorder comes late."""
    rovers = ['rover1', 'rover2']
    commands, processes = [], []
    for k, rover in enumerate(rovers):
        scenario = resolve(Scenario.load('flat', [
            *rover_overrides(rovers, rover, recorded=True), f'physics_node.start.y_m={k}',
            'run.nodes=[physics_node, gait_controller_node, recorder_node]',
            'physics_node.ground.model=rigid'], duration_s=0.5))
        folder = tmp_path / rover
        for plan in prepare(scenario, folder, world_folder):
            commands.append((plan.name, [
                sys.executable, '-m', 'lunar_rover_sim.nodes.entry_points', plan.name,
                *plan.ros_arguments(folder / SCENARIO_FILE), '-r', f'__ns:=/{rover}']))
    try:
        for name, command in commands[:-1]:
            processes.append((name, subprocess.Popen(command)))
        peer.spin_until(lambda: bool(peer.node.count_publishers('/rover1/recorder/written')))
        processes.append((commands[-1][0], subprocess.Popen(commands[-1][1])))
        for wanted in ('physics_node', 'gait_controller_node', 'recorder_node'):
            for name, process in processes:
                if name == wanted:
                    if name != 'physics_node':
                        process.terminate()
                    assert process.wait(60) in DONE
    finally:
        for _, process in processes:
            process.kill()
            process.wait()
    for k, rover in enumerate(rovers):
        assert check(tmp_path / rover / 'bag').ok
        with open_bag(tmp_path / rover / 'bag') as bag:
            assert set(bag.types) - {'/clock'} == {
                topic for topic in bag.types if topic.startswith(f'/{rover}/')}
            assert bag.counts['/clock'] == bag.counts[f'/{rover}/odom'] == 100
            assert abs(bag.first('odom').pose.pose.position.y - k) < 0.05
