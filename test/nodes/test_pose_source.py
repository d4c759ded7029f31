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
from lunar_rover_sim.nodes.conversions import time_msg  # noqa: E402
from lunar_rover_sim.nodes.pose_source import PoseSource  # noqa: E402
from lunar_rover_sim.rover.description import load_rover  # noqa: E402
from lunar_rover_sim.run.node_config import MappingNodeConfig  # noqa: E402

FRAME_NS = 100_000_000


class Topics:
    """Stands for a node: keeps the callbacks of its subscriptions, by topic."""

    def __init__(self):
        self.callbacks = {}

    def create_subscription(self, _kind, name, callback, _qos, raw=False):
        self.callbacks[name] = callback

    def get_logger(self):
        return None

    def tell(self, topic, message, frame, **values):
        for name, value in values.items():
            setattr(message, name, value)
        message.header.stamp = time_msg(frame * FRAME_NS)
        self.callbacks[topic](serialize_message(message) if topic == 'odom' else message)

    def tell_wheels(self, frame):
        """The wheels, and what comes with them."""
        imu = Imu()
        imu.linear_acceleration.z = 1.6
        self.tell('odom', at_rest_odometry(), frame)
        self.tell('imu/data_raw', imu, frame)
        self.tell('wheel/odometry', Odometry(), frame)

    def tell_pose(self, frame):
        pose = PoseStamped()
        pose.pose.orientation.w = 1.0
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
