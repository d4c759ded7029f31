"""Nodes alone, beside a plain rclpy program, as in somebody else's stack."""

from pathlib import Path
import signal
import time
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402  (needs rclpy)
from geometry_msgs.msg import Twist  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from peer import fails, LEGS, Peer, running  # noqa: E402
from rcl_interfaces.srv import DescribeParameters, SetParameters  # noqa: E402
import rclpy  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402

from lunar_rover_sim.bag.messages import time_ns  # noqa: E402
from lunar_rover_sim.base.errors import LunarRoverSimError  # noqa: E402
from lunar_rover_sim.nodes.conversions import time_msg  # noqa: E402
from lunar_rover_sim.nodes.physics_node import PhysicsNode  # noqa: E402
from lunar_rover_sim.nodes.recorder_node import RecorderNode  # noqa: E402
from lunar_rover_sim.nodes.render_node import RenderNode  # noqa: E402


def test_physics_node_walks_on_commands(peer: Peer, world_folder: Path) -> None:
    """Remapped commands from a script turn the legs; pause and step work; it says how it is."""
    told = peer.listen(DiagnosticArray, '/diagnostics')
    odometry = peer.listen(Odometry, 'odom')
    joints = peer.listen(JointState, 'joint_states')
    publisher = peer.node.create_publisher(JointState, 'my_commands', 10)

    def turn() -> None:
        publisher.publish(JointState(name=LEGS, velocity=[3.0] * 4))

    with running('physics_node', '-p', f'world:={world_folder}', '-r',
                 'joint_commands:=my_commands'):
        peer.spin_until(lambda: bool(joints) and min(joints[-1].position) > 2.0, meanwhile=turn)
        stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in odometry]
        assert all(b > a and (b - a) % 5_000_000 == 0 for a, b in zip(stamps, stamps[1:]))
        assert odometry[-1].header.frame_id == 'odom'

        assert peer.call(SetBool, 'physics_node/pause', SetBool.Request(data=True)).success
        peer.spin_until(lambda: True)
        before = odometry[-1].header.stamp
        assert peer.call(Trigger, 'physics_node/step', Trigger.Request()).success
        peer.spin_until(lambda: odometry[-1].header.stamp != before)
        assert peer.call(Trigger, 'physics_node/reset', Trigger.Request()).success
        assert peer.call(SetBool, 'physics_node/pause', SetBool.Request(data=False)).success
        count = len(odometry)
        peer.spin_until(lambda: len(odometry) > count + 5)
        peer.spin_until(lambda: bool(told))
        assert {status.name for status in told[-1].status} == {
            'physics_node: State rate', 'physics_node: Real-time factor',
            'physics_node: Participants', 'physics_node: Drops', 'physics_node: Attitude'}
        assert told[-1].header.stamp.sec > 0
        position = odometry[-1].pose.pose.position
        assert np.hypot(position.x, position.y) < 0.05


def test_gait_node_answers_a_hand_made_state(peer: Peer) -> None:
    """Each joint state gets the command that bears its stamp; cmd_vel moves it.

    NaN, Inf and a flood do not move the legs; the node goes on. Parameters change while it runs,
    as with `ros2 param set`: valid values are taken, others refused with the reason.
    """
    commands = peer.listen(JointState, 'joint_commands')
    states = peer.node.create_publisher(JointState, 'joint_states', 10)
    velocities = peer.node.create_publisher(Twist, 'cmd_vel', 10)
    ticks = [0]

    def tick(*speeds: float) -> None:
        for speed in speeds:
            twist = Twist()
            twist.linear.x = speed
            velocities.publish(twist)
        ticks[0] += 1
        state = JointState(name=LEGS, position=[0.0] * 4, velocity=[0.0] * 4)
        state.header.stamp = time_msg(5_000_000 * ticks[0])
        states.publish(state)

    def answer(name: str, value: Any) -> Any:
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()])
        return peer.call(SetParameters, 'gait_controller_node/set_parameters', request).results[0]

    with running('gait_controller_node'):
        nonsense = [float('nan'), float('inf'), -float('inf')] * 20
        peer.spin_until(lambda: len(commands) > 10, meanwhile=lambda: tick(*nonsense))
        assert all(np.isfinite(command.velocity).all() for command in commands)
        assert np.abs(commands[-1].velocity).max() < 1.0

        peer.spin_until(lambda: max(commands[-1].velocity) > 0.1,
                        meanwhile=lambda: tick(0.0, 0.1))
        assert all(time_ns(command.header.stamp) % 5_000_000 == 0 for command in commands)
        assert list(commands[-1].name) == LEGS
        assert len(commands[-1].position) == 4

        assert answer('duty_factor', 0.55).successful
        assert answer('gait', 'crawl').successful
        refused = answer('foot_width_deg', 150.0)
        assert not refused.successful
        assert 'foot_width' in refused.reason
        assert not answer('spokes', 4).successful
        described = peer.call(
            DescribeParameters, 'gait_controller_node/describe_parameters',
            DescribeParameters.Request(names=['duty_factor', 'spokes'])).descriptors
        assert 'stance' in described[0].description
        assert not described[0].read_only
        assert described[1].read_only
        assert described[1].integer_range[0].to_value == 12


def test_drive_node_answers_odometry(peer: Peer) -> None:
    """A profile is driven on hand-made odometry."""
    velocities = peer.listen(Twist, 'cmd_vel')
    poses = peer.node.create_publisher(Odometry, 'odom', 10)
    odometry = Odometry()
    odometry.pose.pose.orientation.w = 1.0
    ticks = [0]

    def tick() -> None:
        ticks[0] += 1
        odometry.header.stamp.sec = ticks[0]
        odometry.pose.pose.position.x = 0.1 * ticks[0]
        poses.publish(odometry)

    with running('drive_node', '-p', 'mode:=profile', '-p', 'profile_forward_mps:=[0.08]', '-p',
                 'enable_stamped_cmd_vel:=false'):
        peer.spin_until(lambda: bool(velocities) and velocities[-1].linear.x > 0.07,
                        meanwhile=tick)


@pytest.mark.parametrize(('argument', 'said'), [
    ('mdoe:=spline', 'did you mean mode'), ('qos_overrides./cmd_vl.publisher.depth:=3',
                                            '/cmd_vl; did you mean /cmd_vel')])
def test_a_wrong_parameter_ends_a_node_with_one_line(argument: str, said: str,
                                                     domain: int) -> None:
    """And with 1."""
    line = fails('drive_node', '-p', argument)
    assert said in line and argument.split(':=')[0][:17] in line


@pytest.mark.parametrize(('node', 'argument', 'said'), [
    (PhysicsNode, 'seed:=2', "world: '' is not valid"),
    (PhysicsNode, 'qos_overrides./odom.publisher.depth:=0',
     'qos_overrides./odom.* 0 is not valid; valid is >= 1'),
    (RenderNode, 'sun.elevation_deg:=100.0', 'sun.elevation_deg: 100.0 is not valid'),
    (RecorderNode, 'output:=/tmp', 'exists already')])
def test_what_keeps_a_node_from_starting_is_named(node: Any, argument: str, said: str,
                                                  domain: int) -> None:
    rclpy.init(args=['--ros-args', '-p', argument])
    try:
        with pytest.raises(LunarRoverSimError, match=said):
            node()
    finally:
        rclpy.shutdown()


def test_an_answer_from_the_future_does_not_hold_the_gate_open(peer: Peer,
                                                               world_folder: Path) -> None:
    """Stamps of another clock are refused and named; time waits for those of its own."""
    clocks = peer.listen(Odometry, 'odom')
    publisher = peer.node.create_publisher(JointState, 'joint_commands', 10)

    def answer(seconds: int) -> None:
        command = JointState(name=LEGS, velocity=[0.0] * 4)
        command.header.stamp.sec = seconds
        publisher.publish(command)

    with running('physics_node', '-p', f'world:={world_folder}', '-p', 'time_mode:=lockstep',
                 '-p', 'wait.topics:=[joint_commands]', '-p', 'wait.lags_s:=[0.0]',
                 '-p', 'start_paused:=true') as process:
        # Who gets a response is known: the one state that comes at first is not lost.
        peer.spin_until(lambda: peer.node.count_publishers('odom') > 0)
        assert peer.call(SetBool, 'physics_node/pause', SetBool.Request(data=False)).success
        peer.spin_until(lambda: bool(clocks), meanwhile=lambda: answer(1_700_000_000))
        # The node may not have discovered us when it publishes its first state.
        enough = time.monotonic() + 1.0
        peer.spin_until(lambda: time.monotonic() > enough,
                        meanwhile=lambda: answer(1_700_000_000))
        assert len(clocks) == 1
        # By stamps: many more states come at once than our queue holds.
        peer.spin_until(lambda: time_ns(clocks[-1].header.stamp) > 500_000_000,
                        meanwhile=lambda: answer(1))
        process.send_signal(signal.SIGINT)
        assert 'joint_commands: stamp 1700000000.000 s refused' in process.stdout.read()
