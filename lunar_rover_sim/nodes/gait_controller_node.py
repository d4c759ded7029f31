"""gait_controller_node: cmd_vel to leg phases to joint commands."""

from __future__ import annotations

import collections

from geometry_msgs.msg import Twist, TwistStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from lunar_rover_sim import topics
from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.files.resources import config_path
from lunar_rover_sim.gait.calibration import GaitCalibration
from lunar_rover_sim.gait.controller import GaitController
from lunar_rover_sim.nodes import node_main
from lunar_rover_sim.nodes import qos
from lunar_rover_sim.nodes.joint_messages import command_template, JointReader
from lunar_rover_sim.nodes.lockstep_listener import AnswerListener
from lunar_rover_sim.nodes.parameters import declare, on_change
from lunar_rover_sim.rover.rover_file import load_rover
from lunar_rover_sim.run.node_config import GaitNodeConfig


class GaitControllerNode(node_main.GraphNode):
    """Answers every joint state with a joint command that bears its stamp.

    In lockstep, where it waits for a stamped cmd_vel, it uses the newest one that is not younger
    than the state it answers, whenever that arrived: the answer depends on stamps alone.
    """

    def __init__(self) -> None:
        super().__init__('gait_controller_node')
        self._config = config = declare(self, GaitNodeConfig)
        config.check_spokes(load_rover(config.rover or None).legs.spokes)
        self._controller = GaitController(config, GaitCalibration.load(
            config.calibration or config_path('gait_calibration.yaml')))
        self._waits = config.lockstep and topics.CMD_VEL.name in config.wait.topics
        self._states: collections.deque[tuple[int, bytes]] = collections.deque()
        self._commands: collections.deque[tuple[int, Twist]] = collections.deque()
        self._refused = 0

        self._reader = JointReader()
        self._reply = command_template()
        self._publisher = self.create_publisher(JointState, topics.JOINT_COMMANDS.name,
                                                qos.offered(topics.JOINT_COMMANDS))
        self._listener = AnswerListener(
            self, config.wait, self._newest_ns, self._answer_while_open,
            {topics.CMD_VEL.name: lambda raw, ns: self._commands.append(
                (ns, deserialize_message(raw, TwistStamped).twist))})
        if not self._waits:
            stamped = config.enable_stamped_cmd_vel
            self.create_subscription(
                TwistStamped if stamped else Twist, topics.CMD_VEL.name,
                (lambda msg: self._command(msg.twist)) if stamped else self._command,
                qos.requested(topics.CMD_VEL, lockstep=False))
        self.create_subscription(JointState, topics.JOINT_STATES.name, self._state_callback,
                                 qos.requested(topics.JOINT_STATES, config.lockstep), raw=True)
        on_change(self, config, self._controller.configure)
        self.create_timer(0.5, self._watch)
        self._now_ns = 0

    def _state_callback(self, raw: bytes) -> None:
        stamp = stamp_ns(topics.JOINT_STATES.type, raw)
        if stamp is None:
            return
        self._states.append((stamp, raw))
        self._answer_while_open()

    def _newest_ns(self) -> int | None:
        if not self._states:
            return self._now_ns or None
        return self._states[-1][0]

    def _answer_while_open(self) -> None:
        while self._states:
            now_ns, raw = self._states[0]
            if self._waits:
                if not self._listener.gate.is_open(now_ns):
                    return
                while self._commands and self._commands[0][0] <= now_ns:
                    command_ns, twist = self._commands.popleft()
                    self._command(twist, command_ns)
            self._states.popleft()
            self._now_ns = now_ns
            self._answer(raw)
            self._listener.progress()

    def _answer(self, raw: bytes) -> None:
        command = self._controller.update(self._now_ns, self._reader.read(raw, 'position'),
                                          self._reader.read(raw, 'velocity'))
        numbers = self._reply.numbers
        numbers[:4], numbers[-4:] = command.angle_rad, command.velocity_radps
        self._publisher.publish(self._reply.stamped(self._now_ns))

    def _command(self, twist: Twist, command_ns: int | None = None) -> None:
        # An unstamped command is as new as the state that is answered next.
        command_ns = self._now_ns if command_ns is None else command_ns
        if not self._controller.set_velocity(twist.linear.x, twist.angular.z, command_ns):
            self._refused += 1
            self.get_logger().warning(
                f'cmd_vel: linear.x = {twist.linear.x}, angular.z = {twist.angular.z} refused '
                f'({self._refused} so far); valid is finite', throttle_duration_sec=1.0)
        for report in self._controller.take_reports():
            self.get_logger().warning(report)

    def _watch(self) -> None:
        if self._waits and self._states:
            self._listener.check_silence(self._states[0][0])


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return node_main.run(GaitControllerNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
