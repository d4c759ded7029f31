"""cmd_vel of both types without a parameter; other types on our topics are named."""

from __future__ import annotations

import signal
import time
from typing import Any

import pytest

pytestmark = pytest.mark.ros
rclpy = pytest.importorskip('rclpy')

from geometry_msgs.msg import Twist, TwistStamped  # noqa: E402  (needs rclpy)
from peer import LEGS, Peer, running  # noqa: E402
from rclpy.context import Context  # noqa: E402
from sensor_msgs.msg import Imu, JointState  # noqa: E402


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


def test_drive_node_may_publish_twist(peer: Peer) -> None:
    """The gait controller reads it in a hidden node: no warning that it reads TwistStamped."""
    with running('gait_controller_node'), \
            running('drive_node', '-p', 'enable_stamped_cmd_vel:=false') as drive:
        peer.spin_until(lambda: peer.node.count_subscribers('cmd_vel') == 2)
        time.sleep(4.5)     # two looks
        drive.send_signal(signal.SIGINT)
        log = drive.stdout.read()
    assert 'ready' in log
    assert 'no message gets through' not in log


def test_another_type_is_named_with_ours(peer: Peer) -> None:
    """DDS does not connect them, and says nothing."""
    peer.listen(Imu, 'joint_commands')
    with running('gait_controller_node') as node:
        peer.spin_until(lambda: peer.node.count_publishers('joint_commands') > 0)
        # To the end of its output: a node that has ended says no more.
        told = next((line for line in node.stdout if 'no message gets through' in line), '')
        node.send_signal(signal.SIGINT)
    assert 'sensor_msgs/msg/JointState' in told and 'sensor_msgs/msg/Imu' in told
    assert 'WARN' in told and 'peer' in told
