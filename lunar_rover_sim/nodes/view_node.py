"""view_node: the topics of a graph to browsers, as `run/live_view.py` serves them."""

from __future__ import annotations

import queue
import time

from rclpy.qos import DurabilityPolicy
from rclpy.subscription import Subscription
from rosbags.typesys import get_typestore, Stores

from lunar_rover_sim.bag.stamps import StampTable
from lunar_rover_sim.nodes import node_main, qos
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.nodes.parameters import declare
from lunar_rover_sim.run.companion_config import ViewNodeConfig
from lunar_rover_sim.run.live_view import HOST, LiveView

_POLL_S = 0.2
_HISTORY = 5


class ViewNode(node_main.GraphNode):
    """Subscribes to what a client watches, and to nothing else.

    It takes no part in lockstep: nobody waits for it, and a slow client loses messages.
    """

    def __init__(self) -> None:
        super().__init__('view_node')
        config = declare(self, ViewNodeConfig)
        self._begun: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._view = LiveView(config.port, self._begun.put)
        self._stamps = StampTable(get_typestore(Stores.ROS2_JAZZY))
        self._types: dict[str, str] = {}
        self._read: dict[str, Subscription] = {}
        self.create_timer(_POLL_S, self._poll)
        self.report_ready(config, f'ws://{HOST}:{config.port}')

    def destroy_node(self) -> None:
        """Stop to serve."""
        self._view.close()
        super().destroy_node()

    def _poll(self) -> None:
        """Offer new topics, and read those that are watched."""
        for topic, types in self.get_topic_names_and_types():
            if topic not in self._types and self._view.offer(topic, types[0]):
                self._types[topic] = types[0]
        begun = set()
        while not self._begun.empty():
            begun.add(self._begun.get())
        watched = self._view.watched()
        for topic in [t for t in self._read if t not in watched or t in begun]:
            # Once more for a new client: latched messages come to new subscriptions.
            self.destroy_subscription(self._read.pop(topic))
        for topic in sorted(watched.difference(self._read)):
            self._subscribe(topic)

    def _subscribe(self, topic: str) -> None:
        offers = self.get_publishers_info_by_topic(topic)
        durable = bool(offers) and all(
            info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for info in offers)
        msgtype = self._types[topic]

        def callback(raw: bytes) -> None:
            stamp_ns = self._stamps.stamp_ns(msgtype, raw)
            self._view.send(topic, time.time_ns() if stamp_ns is None else stamp_ns, raw)

        self._read[topic] = self.create_subscription(
            message_class(msgtype), topic, callback, qos.adapted(_HISTORY, durable), raw=True)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return node_main.run(ViewNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
