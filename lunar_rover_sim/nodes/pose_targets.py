"""The two interfaces by which other simulators take poses.

`SetEntityState` of simulation_interfaces (github.com/ros-simulation/simulation_interfaces): Isaac
Sim's extension isaacsim.ros2.sim_control, Gazebo, O3DE, and physics_node. PoseStamped teleports:
OmniLRS, /OmniLRS/Robots/Teleport, whose frame_id is the name of the robot.
"""

from __future__ import annotations

from collections.abc import Callable
import importlib
from typing import Any

from geometry_msgs.msg import PoseStamped
import numpy as np
from rclpy.publisher import Publisher

from lunar_rover_sim import topics
from lunar_rover_sim.errors import GraphError
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.nodes.node_main import GraphNode
from lunar_rover_sim.nodes.pose_stream import BridgedState, PoseTarget
from lunar_rover_sim.run.companion_config import PoseBridgeNodeConfig, TELEPORT

SERVICE = 'set_entity_state'
WORLD_FRAME = 'world'       # the global frame of simulation_interfaces


def make_target(node: GraphNode, config: PoseBridgeNodeConfig) -> PoseTarget:
    """Return the interface that the parameters name.

    Raises GraphError where it needs simulation_interfaces, and that is not installed.
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

    client: of the service; kind: its type, version 1 or 2; ok: the code of success
    guarded: wraps what the executor calls
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
