"""recorder_node and trajectory_recorder_node alone, beside a plain rclpy program."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
import time

import numpy as np
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from geometry_msgs.msg import PoseStamped, Twist, TwistStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from peer import Peer, running  # noqa: E402
import rclpy  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.duration import Duration  # noqa: E402
from sensor_msgs.msg import CompressedImage  # noqa: E402


def test_recorder_node_records_what_it_finds(peer: Peer, tmp_path: Path) -> None:
    """A topic that nobody declared is recorded; those on request only where they are named."""
    from lunar_rover_sim.bag.reader import open_bag
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
    from lunar_rover_sim.bag.reader import open_bag
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
    """An estimator's poses become a file that `evaluate` reads; a Path repeats itself, once."""
    from nav_msgs.msg import Path as PathMsg

    from lunar_rover_sim.evaluation.trajectory_files import read_tum
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
    for file in files.values():
        trajectory = read_tum(file)
        assert trajectory.stamps_ns.tolist() == [k * 10**9 + 5 for k in range(1, 6)]
        assert np.allclose(trajectory.positions_m[:, 0], 0.1 * np.arange(1, 6))
        assert np.allclose(trajectory.orientations_wxyz, [1, 0, 0, 0])
