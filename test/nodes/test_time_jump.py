"""Time that goes back, and frames that fall on their period in real time."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
import signal

import pytest

pytestmark = pytest.mark.ros
rclpy = pytest.importorskip('rclpy')

from geometry_msgs.msg import PoseStamped, TwistStamped  # noqa: E402  (needs rclpy)
from peer import Peer, running, SMALL_CAMERA  # noqa: E402
from sensor_msgs.msg import CameraInfo, JointState  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from lunar_rover_sim.bag.messages import header_ns  # noqa: E402
from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.evaluation.trajectory_files import read_tum  # noqa: E402


@pytest.mark.alone
def test_every_node_goes_on_when_time_restarts(peer: Peer, world_folder: Path,
                                               tmp_path: Path) -> None:
    """Physics restarts: commands and frames come for the new time, one log line a node.

    All frames, the first one too, have stamps on the period.
    """
    world = '-p', f'world:={world_folder}'
    answers = {topic: peer.listen(kind, topic) for topic, kind in (
        ('cmd_vel', TwistStamped), ('joint_commands', JointState),
        ('stereo/left/camera_info', CameraInfo))}

    def answered(low_s: float, high_s: float, since: dict[str, int]) -> bool:
        return all(any(low_s < header_ns(m) / 1e9 < high_s for m in messages[since[topic]:])
                   for topic, messages in answers.items())

    with ExitStack() as stack:
        nodes = {name: stack.enter_context(running(name, *arguments)) for name, arguments in (
            ('drive_node', ('-p', 'mode:=spline', '-p', 'shape:=circle')),
            ('gait_controller_node', ()),
            ('render_node', (*world, *SMALL_CAMERA)),
            ('recorder_node', ('-p', f'output:={tmp_path / "bag"}', '-p',
                               'topics:=[odom, clock]')))}
        peer.spin_until(lambda: peer.node.count_publishers('stereo/left/camera_info') > 0)
        stack.enter_context(running('physics_node', *world))
        peer.spin_until(lambda: answered(2.0, 1e9, dict.fromkeys(answers, 0)))
        response = peer.call(Trigger, 'physics_node/restart', Trigger.Request())
        assert response.success and 'time begins at 0' in response.message
        since = {topic: len(messages) for topic, messages in answers.items()}
        peer.spin_until(lambda: answered(0.0, 1.5, since))
        # The recorder answers nobody: it is given the time that the others took, and more.
        peer.spin_until(lambda: answered(1.0, 3.0, since))
        for name, node in nodes.items():
            node.send_signal(signal.SIGINT)
            lines = [line for line in node.stdout if 'time has gone back' in line]
            assert len(lines) == 1, name
    stamps = [header_ns(info) for info in answers['stereo/left/camera_info']]
    assert all(stamp % 100_000_000 == 0 for stamp in stamps)
    with open_bag(tmp_path / 'bag') as bag:
        odometry = [bag.stamp_ns(message) for message in bag.raw(['/odom'])]
    assert min(odometry[len(odometry) // 2:]) < 1_500_000_000 or odometry[-1] < odometry[0]


def test_lockstep_goes_on_after_reset_and_restart(peer: Peer, world_folder: Path) -> None:
    """~/reset: every stamp once. ~/restart: time begins at one period, nobody stalls."""
    states = peer.listen(JointState, 'joint_states', 50_000)
    lockstep = ('-p', 'time_mode:=lockstep', '-p', 'participants:=[joint_commands, cmd_vel]')

    def reached(second: float) -> bool:
        return bool(states) and header_ns(states[-1]) / 1e9 > second

    def jumps() -> list[int]:
        return [k for k, (a, b) in enumerate(zip(states, states[1:]), 1)
                if header_ns(b) < header_ns(a)]

    with ExitStack() as stack:
        for name, arguments in (
                ('drive_node', ('-p', 'mode:=spline', '-p', 'shape:=circle')),
                ('gait_controller_node', ('-p', 'wait.topics:=[cmd_vel]', '-p',
                                          'wait.lags_s:=[0.05]')),
                ('physics_node', ('-p', f'world:={world_folder}', '-p',
                                  'wait.topics:=[joint_commands]', '-p', 'wait.lags_s:=[0.0]'))):
            stack.enter_context(running(name, *lockstep, *arguments))
        peer.spin_until(lambda: reached(0.5))
        assert peer.call(Trigger, 'physics_node/reset', Trigger.Request()).success
        later_s = header_ns(states[-1]) / 1e9 + 0.5
        peer.spin_until(lambda: reached(later_s))
        assert peer.call(Trigger, 'physics_node/restart', Trigger.Request()).success
        # States of the time before are still on their way.
        peer.spin_until(lambda: bool(jumps()))
        peer.spin_until(lambda: len(states) > jumps()[0] + 100)
    stamps = [header_ns(state) for state in states]
    first, = jumps()
    # Who takes no part may join late.
    assert stamps[:first] == [stamps[0] + 5_000_000 * k for k in range(first)]
    assert stamps[first:] == [5_000_000 * (k + 1) for k in range(len(stamps) - first)]


def test_poses_after_a_restart_go_to_a_file_of_their_own(peer: Peer, tmp_path: Path) -> None:
    """A trajectory file has increasing stamps."""
    file = tmp_path / 'estimate.txt'
    publisher = peer.node.create_publisher(PoseStamped, 'pose', 10)
    with running('trajectory_recorder_node', '-p', f'output:={file}'):
        peer.spin_until(lambda: publisher.get_subscription_count() > 0)
        for seconds in (5, 6, 7, 1, 2):
            pose = PoseStamped()
            pose.header.stamp.sec = seconds
            pose.pose.orientation.w = 1.0
            publisher.publish(pose)
        second = tmp_path / 'estimate_2.txt'
        peer.spin_until(lambda: second.exists() and len(second.read_text().splitlines()) == 2)
    assert read_tum(file).stamps_ns.tolist() == [5 * 10**9, 6 * 10**9, 7 * 10**9]
    assert read_tum(second).stamps_ns.tolist() == [10**9, 2 * 10**9]
