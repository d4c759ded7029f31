"""pose_bridge_node: the walk of this simulation in the picture of another simulator."""

from __future__ import annotations

import collections
from collections.abc import Callable
import importlib
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.nodes import conversions, node_main, qos
from lunar_rover_sim.nodes.diagnostics import Diagnostics, Drops
from lunar_rover_sim.nodes.node_main import GraphNode, TimeJump
from lunar_rover_sim.nodes.parameters import declare
from lunar_rover_sim.nodes.pose_stream import BridgedState, LossLog, PoseStream, PoseTarget
from lunar_rover_sim.nodes.reader_discovery import ReaderDiscovery
from lunar_rover_sim.rover.rover_file import load_rover
from lunar_rover_sim.rover.visual import link_poses
from lunar_rover_sim.run.companion_config import PoseBridgeNodeConfig, SET_ENTITY_STATE, TELEPORT

SERVICE = 'set_entity_state'
WORLD_FRAME = 'world'       # the global frame of simulation_interfaces


def make_target(node: GraphNode, config: PoseBridgeNodeConfig) -> PoseTarget:
    """Return the interface that the parameters name.

    Raises:
        GraphError: Where it needs simulation_interfaces, and that is not installed.
    """
    if config.interface == TELEPORT:
        publisher = node.create_publisher(PoseStamped, topics.TELEPORT.name,
                                          qos.offered(topics.TELEPORT))
        return Teleports(publisher, config.frame_id or config.entity)
    try:
        msg = importlib.import_module('simulation_interfaces.msg')
        srv = importlib.import_module('simulation_interfaces.srv')
    except ImportError:
        raise GraphError(f'interface: {config.interface} needs the package simulation_interfaces '
                         '(apt install ros-jazzy-simulation-interfaces); valid without it is '
                         f'{TELEPORT}') from None
    return EntityStates(node.create_client(srv.SetEntityState, SERVICE), srv.SetEntityState,
                        msg.Result.RESULT_OK, config.frame_id or WORLD_FRAME, config.send_twist,
                        node.guarded)


class EntityStates:
    """Sets the entities of a state one by one: a call follows the answer to the one before.

    Args:
        client: Of the service.
        kind: Its type, version 1 or 2.
        ok: The code of success.
        frame_id: Of the poses.
        send_twist: Whether velocities are sent, too.
        guarded: Wraps what the executor calls.
    """

    def __init__(self, client: Any, kind: Any, ok: int, frame_id: str, send_twist: bool,
                 guarded: Callable[[Callable[..., None]], Callable[..., None]]) -> None:
        self._client, self._kind, self._ok = client, kind, ok
        self._frame_id, self._send_twist = frame_id, send_twist
        self._answered = guarded(self._answer_callback)
        self._state: BridgedState | None = None
        self._rest: list[str] = []
        self._future: Any = None
        self._done: Callable[[str], None] = lambda problem: None

    @property
    def is_ready(self) -> bool:
        """Whether the service is there."""
        return self._client.service_is_ready()

    def send(self, state: BridgedState, done: Callable[[str], None]) -> None:
        """Set all entities; stop at the first that is refused."""
        self._state, self._done = state, done
        self._rest = list(state.poses)
        self._call()

    def give_up(self) -> None:
        """Forget the call that is under way."""
        if self._future is not None:
            self._client.remove_pending_request(self._future)
            self._future = None

    def _call(self) -> None:
        assert self._state is not None
        entity = self._rest[0]
        request = self._kind.Request()
        request.entity = entity
        is_base = entity == next(iter(self._state.poses))
        twist = (self._state.linear_mps, self._state.angular_radps) \
            if self._send_twist and is_base else (np.zeros(3), np.zeros(3))
        conversions.fill_entity_pose(request.state, self._state.poses[entity], *twist,
                                     conversions.time_msg(self._state.stamp_ns), self._frame_id)
        # Version 1 has no flags: it sets pose and twist.
        if hasattr(request, 'set_pose'):
            request.set_pose, request.set_twist = True, self._send_twist
        future = self._future = self._client.call_async(request)
        future.add_done_callback(self._answered)

    def _answer_callback(self, future: Any) -> None:
        if future is not self._future:
            return      # given up
        self._future = None
        entity, result = self._rest.pop(0), future.result().result
        if result.result != self._ok:
            self._done(f'{entity}: {result.error_message or f"result {result.result}"}')
        elif self._rest:
            self._call()
        else:
            self._done('')


class Teleports:
    """Publishes the pose of base_link. Nobody answers: what is sent counts as taken."""

    def __init__(self, publisher: Publisher, frame_id: str) -> None:
        self._publisher = publisher
        self._frame_id = frame_id

    @property
    def is_ready(self) -> bool:
        """Whether somebody reads."""
        return self._publisher.get_subscription_count() > 0

    def send(self, state: BridgedState, done: Callable[[str], None]) -> None:
        """Publish the pose of the first entity."""
        self._publisher.publish(conversions.pose_stamped(
            next(iter(state.poses.values())), self._frame_id,
            conversions.time_msg(state.stamp_ns)))
        done('')

    def give_up(self) -> None:
        """Do nothing: a message is never under way for long."""


# Joint states may come a little before the odometry of their stamp, or after.
_KEPT_JOINTS = 100


class PoseBridgeNode(node_main.GraphNode):
    """Sends the first state of every period, and says which one the other simulator has taken.

    It takes part in lockstep where physics waits for `pose_bridge/shown`; by default nobody waits,
    so that a slow or silent picture never stops a recording.
    """

    def __init__(self) -> None:
        super().__init__('pose_bridge_node')
        self._config = config = declare(self, PoseBridgeNodeConfig)
        self._rover = load_rover(config.rover or None)
        self._leg_entities = config.entities_of(self._rover.legs.names)
        offset = config.offset
        self._T_other_odom = frames.se3(
            frames.matrix_from_wxyz(frames.wxyz_from_rpy(*np.radians(
                [offset.roll_deg, offset.pitch_deg, offset.yaw_deg]))),
            [offset.x_m, offset.y_m, offset.z_m])
        self._moves_legs = config.interface == SET_ENTITY_STATE and config.send_legs
        self._period_ns = NS_PER_S // config.rate_hz
        self._no_period = self._last_period = 0 if config.lockstep else -1
        self._jump = TimeJump(self)
        self._odometry: tuple[int, bytes] | None = None
        self._joints: collections.OrderedDict[int, bytes] = collections.OrderedDict()
        self._taken_count = self._lost_count = 0

        self._drops = Drops()
        self._log = LossLog(self.get_logger().warning)
        self._stream = PoseStream(make_target(self, config), config.answer_s, self._taken,
                                  self._lost)
        self._joint_publisher = self.create_publisher(
            JointState, topics.BRIDGED_JOINTS.name, qos.offered(topics.BRIDGED_JOINTS))
        self._shown_publisher = self.create_publisher(Header, topics.SHOWN.name,
                                                      qos.offered(topics.SHOWN))
        self._matching = ReaderDiscovery(self, [self._joint_publisher, self._shown_publisher],
                                         config.participants if config.lockstep else ())
        truth = config.truth.name
        self.create_subscription(Odometry, truth, self._odom_callback,
                                 qos.requested(topics.ODOM, config.lockstep), raw=True)
        self.create_subscription(JointState, topics.JOINT_STATES.name, self._joints_callback,
                                 qos.requested(topics.JOINT_STATES, config.lockstep), raw=True)
        Diagnostics(self, {'Drops': self._drops.status})
        self.report_ready(config, waits=(truth, topics.JOINT_STATES.name))

    def close(self) -> None:
        """Say how it went."""
        self.get_logger().info(f'{self._taken_count} states sent, {self._lost_count} lost')

    # Raw: one message in twenty is used, and deserialising odometry takes 50 us.
    def _odom_callback(self, raw: bytes) -> None:
        now_ns = stamp_ns(topics.ODOM.type, raw)
        if now_ns is None:
            return
        if self._jump.has_occurred(now_ns):
            self._last_period, self._odometry = self._no_period, None
            self._joints.clear()
        if now_ns // self._period_ns <= self._last_period:
            return
        self._last_period = now_ns // self._period_ns
        self._odometry = now_ns, raw
        self._pair()

    def _joints_callback(self, raw: bytes) -> None:
        now_ns = stamp_ns(topics.JOINT_STATES.type, raw)
        if now_ns is not None:
            self._joints[now_ns] = raw
            if len(self._joints) > _KEPT_JOINTS:
                self._joints.popitem(last=False)
            self._pair()

    def _pair(self) -> None:
        """Hand over the odometry that is due, with the joint states of its stamp."""
        if self._odometry is None or not self._matching.is_complete:
            return
        now_ns, raw = self._odometry
        needs_joints = self._moves_legs or self._joint_publisher.get_subscription_count() > 0
        if needs_joints and now_ns not in self._joints:
            return
        self._odometry = None
        angles = np.zeros(len(self._rover.legs.each))
        if needs_joints:
            joints = deserialize_message(self._joints[now_ns], JointState)
            angles = conversions.legs_of(joints, self._rover.legs, 'position')
            if self._joint_publisher.get_subscription_count():
                self._joint_publisher.publish(joints)
        self._stream.put(self._state(deserialize_message(raw, Odometry), angles))

    def _state(self, odom: Odometry, angles: frames.Array) -> BridgedState:
        T_other_base = self._T_other_odom @ conversions.pose_of(odom)
        poses = {self._config.entity: T_other_base}
        if self._moves_legs:
            links = link_poses(self._rover, angles)
            for entity, leg in zip(self._leg_entities, self._rover.legs.names):
                poses[entity] = T_other_base @ links[leg]
        linear, angular = conversions.twist_of(odom)
        return BridgedState(time_ns(odom.header.stamp), poses, T_other_base[:3, :3] @ linear,
                            T_other_base[:3, :3] @ angular)

    def _taken(self, stamp: int) -> None:
        self._taken_count += 1
        self._shown_publisher.publish(Header(stamp=conversions.time_msg(stamp)))

    def _lost(self, kind: str, reason: str) -> None:
        self._lost_count += 1
        self._drops.add(kind)
        self._log.add(kind, reason)

    def work(self) -> None:
        """Send what could not be sent yet."""
        self._pair()
        self._stream.advance()
        self._log.advance()
