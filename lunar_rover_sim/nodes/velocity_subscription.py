"""cmd_vel of either type: TwistStamped, or Twist as teleoperation and Nav2 on Jazzy send it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from rclpy.node import Node

from lunar_rover_sim import topics
from lunar_rover_sim.nodes import qos
from lunar_rover_sim.nodes.message_types import name_of

_FOLLOW_S = 0.2
_TYPES = {name_of(kind): kind for kind in (TwistStamped, Twist)}


class VelocitySubscription:
    """Subscribes `cmd_vel` with the type that its publishers offer; TwistStamped before the first.

    A DDS participant knows one type per topic name, so a node cannot subscribe to both. The type
    is changed when nobody publishes the present one and somebody the other.

    on_velocity: gets the Twist of each message
    """

    def __init__(self, node: Node, on_velocity: Callable[[Twist], None]) -> None:
        self._node = node
        self._on_velocity = on_velocity
        self._topic = node.resolve_topic_name(topics.CMD_VEL.name)
        self._type = name_of(TwistStamped)
        self._subscription: Any = self._subscribe()
        node.create_timer(_FOLLOW_S, self._follow)

    def _subscribe(self) -> Any:
        stamped = _TYPES[self._type] is TwistStamped
        return self._node.create_subscription(
            _TYPES[self._type], topics.CMD_VEL.name,
            (lambda msg: self._on_velocity(msg.twist)) if stamped else self._on_velocity,
            qos.requested(topics.CMD_VEL, lockstep=False))

    def _follow(self) -> None:
        if self._subscription is None:
            # The executor has let go of the old one since the last call.
            self._subscription = self._subscribe()
            return
        infos = self._node.get_publishers_info_by_topic(self._topic)
        offered = {info.topic_type for info in infos}
        others = [name for name in _TYPES if name in offered and name != self._type]
        if others and self._type not in offered:
            self._type = others[0]
            self._node.get_logger().info(f'{self._topic}: publishers offer {self._type}, which is '
                                         'read from now on')
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
