"""The part that leg-driving nodes share: joint states in, joint commands out, in step."""

from __future__ import annotations

import abc
import collections
from collections.abc import Callable
from contextlib import suppress
import time
from typing import Any, Protocol

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist, TwistStamped
from sensor_msgs.msg import JointState

from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import GaitError, GraphError
from lunar_rover_sim.nodes import conversions, node_main, qos
from lunar_rover_sim.nodes.lockstep_listener import LockstepListener
from lunar_rover_sim.nodes.message_types import name_of
from lunar_rover_sim.nodes.node_main import GraphNode, TimeJump
from lunar_rover_sim.nodes.parameters import declare
from lunar_rover_sim.nodes.reader_discovery import ReaderDiscovery
from lunar_rover_sim.rover.description import load_rover, RoverDescription
from lunar_rover_sim.rover.gait.controller import LegCommand, MAX_COMMAND
from lunar_rover_sim.run.checkpoint import Checkpoint
from lunar_rover_sim.run.node_config import GaitNodeConfig, PolicyNodeConfig

VELOCITIES = name_of(Twist), name_of(TwistStamped)


class Controller(Protocol):
    """What turns velocities and states into leg commands."""

    def reset(self) -> None:
        """Forget time, phases and command."""

    def set_velocity(self, forward_mps: float, yaw_rate_radps: float,
                     stamp_ns: int | None = None) -> None:
        """Command a velocity; raise GaitError for one that is not valid."""

    def take_reports(self) -> list[str]:
        """Return the reports since the last call."""


class LegControllerNode(node_main.GraphNode, abc.ABC):
    """Answers every joint state with a joint command that bears its stamp.

    Where it waits for a stamped cmd_vel in lockstep, it uses the newest one whose stamp is not
    later than that of the state. So the answer depends on stamps, not on the time of arrival.

    Attributes:
        needs: Topics without which there is nothing to answer.
        fields: What it reads of joint states; a state that lacks a value is refused.
        legs: Of the rover.
        config: The parameters.
        states: Joint states that are not answered yet.
    """

    needs: tuple[str, ...] = (topics.JOINT_STATES.name,)
    fields: tuple[str, ...] = ('position', 'velocity')

    def __init__(self, name: str, kind: type[GaitNodeConfig] | type[PolicyNodeConfig]) -> None:
        super().__init__(name)
        config = declare(self, kind)
        rover = load_rover(config.rover or None)
        self.legs = rover.legs
        self._controller = self.make_controller(config, rover)
        self.config = config
        self._waits = config.lockstep and topics.CMD_VEL.name in config.wait.topics
        self.states: collections.deque[JointState] = collections.deque()
        self._velocities: collections.deque[TwistStamped] = collections.deque()
        self._now_ns = 0
        self._jump = TimeJump(self)

        self._message = JointState()    # refilled for every answer
        self._listener = LockstepListener(self, config.wait, config.lockstep, self._newest_ns,
                                          self._answer_while_open,
                                          {topics.CMD_VEL: self._velocities.append}
                                          if self._waits else None)
        if not self._waits:
            self._velocity = VelocitySubscription(self, self._set_velocity)
        qos.subscription(self, topics.JOINT_STATES, self._state_callback, config.lockstep)
        self.prepare(config)
        # After all that it reads: who sees it may send the first state.
        self._publisher = qos.publisher(self, topics.JOINT_COMMANDS)
        # In lockstep the first answer is held until everybody reads it.
        self._matching = ReaderDiscovery(
            self, [self._publisher],
            tuple(dict.fromkeys([*config.wait.topics, *config.participants]))
            if config.lockstep else ())
        self.create_timer(0.5, self._watch)
        self.report_ready(config, waits=(*self.needs, *config.wait.topics))

    @abc.abstractmethod
    def make_controller(self, config: Any, rover: RoverDescription) -> Controller:
        """Return what drives the legs."""

    @abc.abstractmethod
    def command_for(self, state: JointState) -> LegCommand:
        """Return the command for a state."""

    def prepare(self, config: Any) -> None:
        """Prepare what else the node needs, before it advertises its answers."""

    def next_state(self) -> JointState | None:
        """Return the state to be answered next, of `states`; None where something is missing."""
        return self.states[0] if self.states else None

    def forget(self) -> None:
        """Drop what belongs to a time before the present one."""

    def _state_callback(self, msg: JointState) -> None:
        try:
            for field in self.fields:
                conversions.legs_of(msg, self.legs, field)
        except GraphError as error:
            self.warnings.add('state', f'joint_states: {error}')
            return
        if self._jump.has_occurred(time_ns(msg.header.stamp)):
            self.states.clear()
            self._velocities.clear()
            self._listener.restart()
            self._controller.reset()
            self.forget()
        if not self.states:
            # Nobody had to answer before. At the start that may have been minutes.
            self._listener.note_progress()
        self.states.append(msg)
        self._listener.judge_early()
        self._answer_while_open()

    def _newest_ns(self) -> int | None:
        if not self.states:
            return self._now_ns or None
        return time_ns(self.states[-1].header.stamp)

    def _answer_while_open(self) -> None:
        while self._matching.is_complete and (state := self.next_state()) is not None:
            now_ns = time_ns(state.header.stamp)
            if self._waits:
                if not self._listener.gate.is_open(now_ns):
                    return
                self._use_velocities(now_ns)
            self.states.popleft()
            self._now_ns = now_ns
            self.publish(self.command_for(state), state.header.stamp)
            self._listener.note_progress()

    def publish(self, command: LegCommand, stamp: Time) -> None:
        """Publish a command."""
        self._publisher.publish(conversions.fill_joint_state(
            self._message, self.legs, command.angle_rad, command.velocity_radps, None, stamp))

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
        forward_mps, yaw_rate_radps = twist.linear.x, twist.angular.z
        try:
            self._controller.set_velocity(forward_mps, yaw_rate_radps, command_ns)
        except GaitError:
            self.warnings.add('velocity', f'cmd_vel: linear.x = {forward_mps}, angular.z = '
                              f'{yaw_rate_radps} refused',
                              f'; valid is -{MAX_COMMAND:g} to {MAX_COMMAND:g}')
        for report in self._controller.take_reports():
            self.get_logger().warning(report)

    def is_at_rest(self, begun: Checkpoint) -> bool:
        """See `GraphNode`."""
        return not (self.states or self._velocities) and self._now_ns >= begun.time_ns

    def resume(self, time_ns: int, state: Any) -> None:
        """See `GraphNode`."""
        self._now_ns = time_ns
        self._jump.resume(time_ns)
        self._listener.resume(time_ns)

    def work(self) -> None:
        """Answer the states that were held until all readers were matched."""
        self._answer_while_open()

    def _watch(self) -> None:
        if self._waits and self.states:
            self._listener.check_silence(time_ns(self.states[0].header.stamp))


_FOLLOW_S, _RELEASE_S = 0.1, 0.5


class VelocitySubscription:
    """Subscribes `cmd_vel` as TwistStamped or Twist; a DDS participant knows one type per topic.

    It reads the type that a recorder records, so that the rover moves on nothing that its bag
    lacks. Without a recorder it stays with a type for as long as that has a publisher.

    Args:
        node: Subscribes.
        on_velocity: Called with the Twist of each message.
    """

    def __init__(self, node: GraphNode, on_velocity: Callable[[Twist], None]) -> None:
        self._node = node
        self._on_velocity = on_velocity
        self._topic = node.resolve_topic_name(topics.CMD_VEL.name)
        self._recorder = node.resolve_topic_name(topics.RECORDED.name)
        self._told: set[tuple[str, str]] = set()
        self._subscription: Any = None
        self._free_s = 0.0      # wall time from which another one can be made
        self._subscribe(name_of(TwistStamped))
        for name in VELOCITIES:
            node.type_watch.ignore(self._topic, name)
        node.create_timer(_FOLLOW_S, self._follow)

    def _subscribe(self, type_name: str) -> None:
        self._type = type_name
        is_plain = type_name == name_of(Twist)
        self._subscription = self._node.create_subscription(
            Twist if is_plain else TwistStamped, topics.CMD_VEL.name,
            self._on_velocity if is_plain else lambda msg: self._on_velocity(msg.twist),
            qos.requested(topics.CMD_VEL, lockstep=False))

    def _follow(self) -> None:
        publishers = self._node.get_publishers_info_by_topic(self._topic)
        offered = {info.topic_type for info in publishers}
        recorders = {(info.node_namespace, info.node_name) for info
                     in self._node.get_publishers_info_by_topic(self._recorder)}
        recorded = {info.topic_type
                    for info in self._node.get_subscriptions_info_by_topic(self._topic)
                    if (info.node_namespace, info.node_name) in recorders}
        wanted = sorted((recorded or offered).intersection(VELOCITIES))
        if self._subscription is None and time.monotonic() > self._free_s:
            # Where the executor still holds the one before, a later look can.
            with suppress(RuntimeError):
                self._subscribe(wanted[0] if wanted else self._type)
                self._node.get_logger().info(f'{self._topic}: {self._type} is read from now on')
        elif self._subscription is not None and wanted and self._type not in wanted:
            self._node.destroy_subscription(self._subscription)
            self._subscription, self._free_s = None, time.monotonic() + _RELEASE_S
        if self._subscription is None:
            return
        for info in publishers:
            key = info.node_name, info.topic_type
            if info.topic_type != self._type and key not in self._told:
                self._told.add(key)
                self._node.get_logger().warning(
                    f'{self._topic}: {info.topic_type} of {info.node_name} is refused: '
                    f'{self._type} is {"recorded" if recorded else "read"} on this topic; publish '
                    'one type only')
