"""Poses of a SLAM program, whose messages come on several topics in any order."""

import numpy as np
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402  (needs rclpy)
from geometry_msgs.msg import PoseStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from peer import at_rest_odometry  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402

from lunar_rover_sim.autonomy.navigation.config import SLAM  # noqa: E402
from lunar_rover_sim.base import frames  # noqa: E402
from lunar_rover_sim.nodes.conversions import time_msg  # noqa: E402
from lunar_rover_sim.nodes.pose_source import PoseSource  # noqa: E402
from lunar_rover_sim.rover.description import load_rover  # noqa: E402
from lunar_rover_sim.rover.mounts import optical_poses  # noqa: E402
from lunar_rover_sim.run.node_config import MappingNodeConfig  # noqa: E402

FRAME_NS = 100_000_000


class Topics:
    """Stands for a node: keeps the callbacks of its subscriptions, by topic."""

    def __init__(self):
        self.callbacks = {}

    def create_subscription(self, _kind, name, callback, _qos, raw=False, light=False):
        self.callbacks[name] = callback

    def get_logger(self):
        return None

    def tell(self, topic, message, frame, **values):
        for name, value in values.items():
            setattr(message, name, value)
        message.header.stamp = time_msg(frame * FRAME_NS)
        self.callbacks[topic](serialize_message(message) if topic == 'odom' else message)

    def tell_wheels(self, frame, x_m=0.0):
        """The wheels, and what comes with them."""
        imu = Imu()
        imu.linear_acceleration.z = 1.6
        self.tell('odom', at_rest_odometry(), frame)
        self.tell('imu/data_raw', imu, frame)
        wheels = Odometry()
        wheels.pose.pose.position.x = x_m
        self.tell('wheel/odometry', wheels, frame)

    def tell_pose(self, frame, T=np.eye(4), frame_id='slam_map'):
        pose = PoseStamped()
        pose.header.frame_id = frame_id
        pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = T[:3, 3].tolist()
        q = pose.pose.orientation
        q.w, q.x, q.y, q.z = frames.wxyz_from_matrix(T[:3, :3]).tolist()
        self.tell('slam/pose', pose, frame)

    def tell_status(self, frame, message):
        self.tell('slam/status', DiagnosticArray(), frame,
                  status=[DiagnosticStatus(message=message)])


@pytest.fixture
def source():
    node, answers = Topics(), []
    poses = PoseSource(node, MappingNodeConfig(), SLAM, load_rover(None),
                       lambda: answers.append(poses.answered_ns // FRAME_NS), lambda: None)
    return node, poses, answers


def test_a_loss_is_answered_after_the_pose_before_it(source):
    """The pose of frame 1 waits for its wheels while frame 2 is lost already."""
    node, poses, answers = source
    node.tell_pose(1)
    node.tell_status(1, 'tracking')
    node.tell_status(2, 'lost')
    assert answers == []
    node.tell_wheels(1)
    assert answers == [1, 2]
    np.testing.assert_allclose(poses.at(FRAME_NS)[:3, 3], (0.0, 0.0, 0.1), atol=1e-12)
    assert poses.at(2 * FRAME_NS) is None


def test_a_status_waits_for_its_pose_but_not_for_one_from_before_it_has_joined(source):
    node, poses, answers = source
    node.tell_status(1, 'initialising')
    assert answers == [1]
    node.tell_wheels(3)
    node.tell_pose(2)
    node.tell_status(2, 'tracking')
    node.tell_status(3, 'tracking')
    assert answers == [1, 2] and poses.at(2 * FRAME_NS) is None
    node.tell_pose(3)
    assert answers == [1, 2, 3] and poses.at(3 * FRAME_NS) is not None


def test_poses_in_the_site_are_taken_as_they_are_and_carried_on(source):
    """In `odom` they are of an estimator with a map from orbit; a place that is found jumps."""
    node, poses, answers = source
    R = frames.matrix_from_wxyz(frames.wxyz_from_rpy(0.0, 0.0, 0.5 * np.pi))
    T_base_camera = optical_poses(load_rover(None))[0]

    def tell(frame, position):
        T = frames.se3(R, position)
        node.tell_pose(frame, T @ T_base_camera, 'odom')
        node.tell_status(frame, 'tracking')
        return T

    node.tell_wheels(1)
    told = tell(1, (40.0, -7.0, 2.0))
    np.testing.assert_allclose(poses.at(FRAME_NS), told, atol=1e-9)
    assert answers[-1] == 1 and not poses.has_jumped(FRAME_NS)
    # Half a metre ahead by the wheels is half a metre along y, where it looks to.
    assert not poses.is_carried_to(3 * FRAME_NS)
    node.tell_wheels(2, 0.3)
    node.tell_wheels(3, 0.5)
    assert poses.is_carried_to(3 * FRAME_NS)
    stamp, T = poses.newest(FRAME_NS, 3 * FRAME_NS)
    assert stamp == 3 * FRAME_NS
    np.testing.assert_allclose(T, frames.se3(R, (40.0, -6.5, 2.0)), atol=1e-3)
    assert poses.newest(3 * FRAME_NS)[0] == FRAME_NS
    tell(3, (40.1, -6.4, 2.0))
    assert not poses.has_jumped(3 * FRAME_NS)
    node.tell_wheels(4, 0.6)
    tell(4, (60.0, 10.0, 2.0))
    assert poses.has_jumped(4 * FRAME_NS) and not poses.has_jumped(3 * FRAME_NS)
