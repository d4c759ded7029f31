"""gait_controller_node: cmd_vel to leg phases to joint commands."""

from __future__ import annotations

import collections

from geometry_msgs.msg import Twist, TwistStamped
from sensor_msgs.msg import JointState

from lunar_rover_sim import topics
from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.errors import GaitError
from lunar_rover_sim.gait.calibration import GaitCalibration
from lunar_rover_sim.gait.conditions import differences, rover_conditions
from lunar_rover_sim.gait.controller import GaitController, MAX_COMMAND
from lunar_rover_sim.nodes import conversions, node_main, qos
from lunar_rover_sim.nodes.lockstep_listener import LockstepListener
from lunar_rover_sim.nodes.parameters import declare, on_change
from lunar_rover_sim.nodes.reader_discovery import ReaderDiscovery
from lunar_rover_sim.nodes.time_jump import TimeJump
from lunar_rover_sim.nodes.velocity_subscription import VelocitySubscription
from lunar_rover_sim.rover.rover_file import load_rover
from lunar_rover_sim.run.node_config import GaitNodeConfig


class GaitControllerNode(node_main.GraphNode):
    """Answers every joint state with a joint command that bears its stamp.

    Where it waits for a stamped cmd_vel in lockstep, it uses the newest one whose stamp is not
    later than that of the state. So the answer depends on stamps, not on the time of arrival.
    """

    def __init__(self) -> None:
        super().__init__('gait_controller_node')
        config = declare(self, GaitNodeConfig)
        rover = load_rover(config.rover or None)
        self._legs = rover.legs
        self._config = config = config.for_rover(rover)
        calibration = GaitCalibration.of(config, rover=rover.name)
        for difference in differences(calibration.conditions, rover_conditions(rover)):
            self.get_logger().warning(f'calibration: measured with {difference}')
        self._controller = GaitController(config, calibration, rover.legs)
        self._waits = config.lockstep and topics.CMD_VEL.name in config.wait.topics
        self._states: collections.deque[JointState] = collections.deque()
        self._velocities: collections.deque[TwistStamped] = collections.deque()
        self._now_ns = 0
        self._jump = TimeJump(self)

        self._message = JointState()    # refilled for every answer
        self._publisher = self.create_publisher(JointState, topics.JOINT_COMMANDS.name,
                                                qos.offered(topics.JOINT_COMMANDS))
        # In lockstep the first answer is held until everybody reads it.
        self._matching = ReaderDiscovery(
            self, [self._publisher],
            tuple(dict.fromkeys([*config.wait.topics, *config.participants]))
            if config.lockstep else ())
        self._listener = LockstepListener(self, config.wait, config.lockstep, self._newest_ns,
                                          self._answer_while_open,
                                          {topics.CMD_VEL: self._velocities.append}
                                          if self._waits else None)
        self._velocity = None if self._waits else VelocitySubscription(self, self._set_velocity)
        self.create_subscription(JointState, topics.JOINT_STATES.name, self._state_callback,
                                 qos.requested(topics.JOINT_STATES, config.lockstep))
        on_change(self, config, self._controller.configure)
        self.create_timer(0.5, self._watch)
        self.report_ready(config, waits=(topics.JOINT_STATES.name, *config.wait.topics))

    def destroy_node(self) -> None:
        """Leave the graph, as the reader of Twist too."""
        if self._velocity is not None:
            self._velocity.close()
        super().destroy_node()

    def _state_callback(self, msg: JointState) -> None:
        if self._jump.has_occurred(time_ns(msg.header.stamp)):
            self._states.clear()
            self._velocities.clear()
            self._listener.restart()
            self._controller.reset()
        if not self._states:
            # Nobody had to answer before. At the start that may have been minutes.
            self._listener.note_progress()
        self._states.append(msg)
        self._listener.judge_early()
        self._answer_while_open()

    def _newest_ns(self) -> int | None:
        if not self._states:
            return self._now_ns or None
        return time_ns(self._states[-1].header.stamp)

    def _answer_while_open(self) -> None:
        while self._states and self._matching.is_complete:
            state = self._states[0]
            now_ns = time_ns(state.header.stamp)
            if self._waits:
                if not self._listener.gate.is_open(now_ns):
                    return
                self._use_velocities(now_ns)
            self._states.popleft()
            self._now_ns = now_ns
            self._answer(state)
            self._listener.note_progress()

    def _answer(self, state: JointState) -> None:
        command = self._controller.update(
            self._now_ns, conversions.legs_of(state, self._legs, 'position'),
            conversions.legs_of(state, self._legs, 'velocity'))
        self._publisher.publish(conversions.fill_joint_state(
            self._message, self._legs, command.angle_rad, command.velocity_radps, None,
            state.header.stamp))

    def _use_velocities(self, now_ns: int) -> None:
        """Hand the controller the velocity commands with stamps up to `now_ns`."""
        while self._velocities:
            stamp_ns = time_ns(self._velocities[0].header.stamp)
            if stamp_ns > now_ns:
                return
            self._set_velocity(self._velocities.popleft().twist, stamp_ns)

    def _set_velocity(self, twist: Twist, command_ns: int | None = None) -> None:
        # Outside lockstep a command counts from the newest state.
        command_ns = self._now_ns if command_ns is None else command_ns
        forward_mps, yaw_rate_radps = conversions.velocity_of(twist)
        try:
            self._controller.set_velocity(forward_mps, yaw_rate_radps, command_ns)
        except GaitError:
            self.warnings.add('velocity', f'cmd_vel: linear.x = {forward_mps}, angular.z = '
                              f'{yaw_rate_radps} refused',
                              f'; valid is -{MAX_COMMAND:g} to {MAX_COMMAND:g}')
        for report in self._controller.take_reports():
            self.get_logger().warning(report)

    def work(self) -> None:
        """Answer the states that were held until all readers were matched."""
        self._answer_while_open()

    def _watch(self) -> None:
        if self._waits and self._states:
            self._listener.check_silence(time_ns(self._states[0].header.stamp))


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return node_main.run(GaitControllerNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
