"""cmd_vel of both types without a parameter; other types on our topics are named."""

from __future__ import annotations

import signal

import pytest

pytestmark = pytest.mark.ros
rclpy = pytest.importorskip('rclpy')

from geometry_msgs.msg import Twist, TwistStamped  # noqa: E402  (needs rclpy)
from peer import LEGS, Peer, running  # noqa: E402
from sensor_msgs.msg import Imu, JointState  # noqa: E402


def test_cmd_vel_of_either_type_moves_the_legs(peer: Peer) -> None:
    """Twist first, as teleop_twist_keyboard sends it; then TwistStamped instead of it."""
    commands = peer.listen(JointState, 'joint_commands')
    states = peer.node.create_publisher(JointState, 'joint_states', 10)
    ticks = [0]

    def tick() -> None:
        ticks[0] += 1
        state = JointState(name=LEGS, position=[0.0] * 4, velocity=[0.0] * 4)
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(5_000_000 * ticks[0], 10**9)
        states.publish(state)
        if publisher.msg_type is Twist:
            twist = Twist()
            twist.linear.x = 0.1
            publisher.publish(twist)
        else:
            stamped = TwistStamped(header=state.header)
            stamped.twist.linear.x = 0.1
            publisher.publish(stamped)

    def fastest() -> float:
        return max(map(abs, commands[-1].velocity)) if commands else 0.0

    with running('gait_controller_node', '-p', 'cmd_timeout_s:=0.02'):
        publisher = peer.node.create_publisher(Twist, 'cmd_vel', 10)
        peer.spin_until(lambda: fastest() > 0.5, meanwhile=tick)
        peer.node.destroy_publisher(publisher)
        publisher = peer.node.create_publisher(TwistStamped, 'cmd_vel', 10)
        peer.spin_until(lambda: publisher.get_subscription_count() > 0)
        commands.clear()
        peer.spin_until(lambda: fastest() > 0.5, meanwhile=tick)


def test_another_type_is_named_with_ours(peer: Peer) -> None:
    """DDS does not connect them, and says nothing."""
    peer.listen(Imu, 'joint_commands')
    with running('gait_controller_node') as node:
        peer.spin_until(lambda: peer.node.count_publishers('joint_commands') > 0)
        told = ''
        while 'no message gets through' not in told:
            told = node.stdout.readline()
        node.send_signal(signal.SIGINT)
    assert 'sensor_msgs/msg/JointState' in told and 'sensor_msgs/msg/Imu' in told
    assert 'WARN' in told and 'peer' in told
