"""Recorders beside a plain rclpy program; both types of cmd_vel; nodes in namespaces."""

from contextlib import ExitStack
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

from geometry_msgs.msg import PoseStamped, Twist, TwistStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from nav_msgs.msg import Path as PathMsg  # noqa: E402
from peer import LEGS, Peer, running  # noqa: E402  (needs rclpy)
from rcl_interfaces.srv import GetParameters  # noqa: E402
import rclpy  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.duration import Duration  # noqa: E402
from sensor_msgs.msg import CompressedImage, Imu, JointState  # noqa: E402
from waiting import wait_until  # noqa: E402

from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.base.files.paths import find_file  # noqa: E402
from lunar_rover_sim.judge.evaluation.trajectory_files import read_tum  # noqa: E402
from lunar_rover_sim.nodes.drive_node import DriveNode  # noqa: E402
from lunar_rover_sim.nodes.reader_discovery import UNKNOWN_NAME  # noqa: E402
from lunar_rover_sim.products.inspection.check import check  # noqa: E402
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


def test_velocities_of_another_type_are_named_at_once(peer: Peer, tmp_path: Path) -> None:
    """Even if their publisher lives for half a second only."""
    context = Context()         # a DDS participant knows one type per topic
    rclpy.init(context=context)
    other = rclpy.create_node('other', context=context)
    publisher = peer.node.create_publisher(Twist, 'cmd_vel', 10)
    try:
        with running('recorder_node', '-p', f'output:={tmp_path / "bag"}') as node:
            peer.spin_until(lambda: publisher.get_subscription_count() > 0)
            stamped = other.create_publisher(TwistStamped, 'cmd_vel', 10)
            time.sleep(0.5)
            other.destroy_publisher(stamped)
            told = next((line for line in node.stdout if 'is not recorded' in line), '')
        assert '/cmd_vel: geometry_msgs/msg/TwistStamped is not recorded: the bag has ' \
            'geometry_msgs/msg/Twist on this topic' in told
    finally:
        other.destroy_node()
        context.try_shutdown()


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


def test_cmd_vel_of_both_types_moves_the_legs(peer: Peer) -> None:
    """Twist as teleop_twist_keyboard sends it; then, with both offered, of each in turn."""
    commands = peer.listen(JointState, 'joint_commands')
    states = peer.node.create_publisher(JointState, 'joint_states', 10)
    ticks = [0]
    # A DDS participant knows one type per topic.
    context = Context()
    rclpy.init(context=context)
    teleop = rclpy.create_node('teleop', context=context)
    publishers = {Twist: teleop.create_publisher(Twist, 'cmd_vel', 10)}
    sending: list[Any] = [Twist]

    def tick() -> None:
        ticks[0] += 1
        state = JointState(name=LEGS, position=[0.0] * 4, velocity=[0.0] * 4)
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(5_000_000 * ticks[0], 10**9)
        states.publish(state)
        twist = Twist()
        twist.linear.x = 0.1
        for kind in sending:
            publishers[kind].publish(
                twist if kind is Twist else TwistStamped(header=state.header, twist=twist))

    def is_fast(wanted: bool) -> bool:
        return bool(commands) and (max(map(abs, commands[-1].velocity)) > 0.5) == wanted

    try:
        with running('gait_controller_node', '-p', 'cmd_timeout_s:=0.02') as node:
            peer.spin_until(lambda: is_fast(True), meanwhile=tick)
            publishers[TwistStamped] = peer.node.create_publisher(TwistStamped, 'cmd_vel', 10)
            for kind in (TwistStamped, Twist):
                sending.clear()
                peer.spin_until(lambda: is_fast(False), meanwhile=tick)
                sending.append(kind)
                peer.spin_until(lambda: is_fast(True), meanwhile=tick)
            node.send_signal(signal.SIGINT)
            log = node.stdout.read()
        assert 'publishers offer geometry_msgs/msg/Twist, which is read too' in log
        assert 'no message gets through' not in log
    finally:
        teleop.destroy_node()
        context.try_shutdown()


def test_another_type_is_named_with_ours(domain: int,
                                         capfd: pytest.CaptureFixture[str]) -> None:
    """DDS does not connect them, and says nothing.

    The gait controller is not named: it reads a Twist in a hidden node.
    """
    context = Context()
    rclpy.init(context=context)
    other = rclpy.create_node('other', context=context)
    other.create_subscription(Imu, 'cmd_vel', print, 10)
    rclpy.init(args=['--ros-args', '-p', 'enable_stamped_cmd_vel:=false'])
    drive = DriveNode()

    def readers() -> set[str]:
        return {info.node_name for info in drive.get_subscriptions_info_by_topic('/cmd_vel')}

    try:
        with running('gait_controller_node'):
            wait_until(lambda: len(readers() - {UNKNOWN_NAME}) == 3)
            for _ in range(2):      # it warns of what it sees in two looks
                for timer in drive.timers:
                    timer.callback()
    finally:
        drive.destroy_node()
        rclpy.try_shutdown()
        other.destroy_node()
        context.try_shutdown()
    told = [line for line in capfd.readouterr().err.splitlines()
            if 'no message gets through' in line]
    assert len(told) == 1, told
    assert 'geometry_msgs/msg/Twist, but sensor_msgs/msg/Imu is read by other' in told[0]
    assert 'WARN' in told[0]


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
                    assert process.wait(60) == 0
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
