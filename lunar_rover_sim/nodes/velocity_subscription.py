"""cmd_vel of both types: TwistStamped, and Twist as teleoperation and Nav2 on Jazzy send it."""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import Twist, TwistStamped
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from lunar_rover_sim import topics
from lunar_rover_sim.nodes import qos
from lunar_rover_sim.nodes.message_types import name_of
from lunar_rover_sim.nodes.node_main import GraphNode

_FOLLOW_S = 0.2
_POLL_S = 0.02


class VelocitySubscription:
    """Subscribes `cmd_vel` as TwistStamped and, while somebody publishes it, as Twist.

    Of both types at once the newest message counts.

    on_velocity: gets the Twist of each message
    """

    def __init__(self, node: GraphNode, on_velocity: Callable[[Twist], None]) -> None:
        self._node = node
        self._on_velocity = on_velocity
        self._topic = node.resolve_topic_name(topics.CMD_VEL.name)
        self._plain: _PlainTwist | None = None
        node.create_subscription(TwistStamped, topics.CMD_VEL.name,
                                 lambda msg: on_velocity(msg.twist),
                                 qos.requested(topics.CMD_VEL, lockstep=False))
        node.type_watch.ignore(self._topic, name_of(Twist))
        node.create_timer(_FOLLOW_S, self._follow)
        node.create_timer(_POLL_S, self._poll)

    def close(self) -> None:
        """Stop reading Twist."""
        if self._plain is not None:
            self._plain.close()
            self._plain = None

    def _follow(self) -> None:
        offered = any(info.topic_type == name_of(Twist)
                      for info in self._node.get_publishers_info_by_topic(self._topic))
        if offered and self._plain is None:
            self._node.get_logger().info(f'{self._topic}: publishers offer {name_of(Twist)}, '
                                         'which is read too')
            self._plain = _PlainTwist(self._node, self._topic, self._on_velocity)
        elif not offered:
            self.close()

    def _poll(self) -> None:
        if self._plain is not None:
            self._plain.poll()


class _PlainTwist:
    """Reads Twist on a topic in a DDS participant of its own: one knows one type per topic."""

    def __init__(self, node: GraphNode, topic: str,
                 on_velocity: Callable[[Twist], None]) -> None:
        self._context = Context()
        rclpy.init(args=[], context=self._context, domain_id=node.context.get_domain_id(),
                   signal_handler_options=SignalHandlerOptions.NO)
        # Hidden from `ros2 node list` by its first letter.
        self._node = rclpy.create_node(
            f'_{node.get_name()}_twist', namespace=node.get_namespace(), context=self._context,
            use_global_arguments=False, start_parameter_services=False, enable_rosout=False)
        self._node.create_subscription(Twist, topic, on_velocity, qos.newest())
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)

    def poll(self) -> None:
        """Hand on the newest message, if there is one."""
        self._executor.spin_once(timeout_sec=0.0)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()
