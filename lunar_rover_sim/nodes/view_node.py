"""view_node: the topics of a graph to browsers, as `run/live_view.py` serves them."""

from __future__ import annotations

import math
import queue
import struct
import time
from typing import Any

from geometry_msgs.msg import Twist
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy
from rclpy.subscription import Subscription
from rosbags.typesys import get_typestore, Stores

from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.bag.stamps import StampTable
from lunar_rover_sim.base import topics
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.nodes import node_main, qos
from lunar_rover_sim.nodes.ground_listener import WindowListener
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.nodes.parameters import declare
from lunar_rover_sim.run.live_page import MapPages
from lunar_rover_sim.run.live_view import LiveView
from lunar_rover_sim.run.node_config import ViewNodeConfig

_POLL_S = 0.2
_HISTORY = 5
_EVER_NS = 2 ** 63
_TWIST = struct.Struct('<4x6d')


class ViewNode(node_main.GraphNode):
    """Subscribes to what a client watches, and then to the clock; and to windows of the site.

    It takes no part in lockstep: nobody waits for it, and a slow client loses messages. It
    publishes nothing but the velocities that a client sends.
    """

    def __init__(self) -> None:
        super().__init__('view_node')
        config = declare(self, ViewNodeConfig)
        self._begun: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._drivers: dict[str, Publisher] = {}
        self._others: list[str] = []        # nodes that drive
        world = load_world(config.world, verify=False) if config.world else None
        self._map = MapPages(world, lambda: self._others)
        self._windows = None if world is None else WindowListener(self, world, lockstep=False)
        self._view = LiveView(config.port, self._begun.put, self._on_drive, self._map.extra,
                              config.allow_origin)
        store = get_typestore(Stores.ROS2_JAZZY)
        self._stamps = StampTable(store)
        self._types: dict[str, str] = {}
        self._read: dict[str, Subscription] = {}
        self._clock_reader: Subscription | None = None
        self._now_ns: int | None = None         # the simulated time that was told last
        self.create_timer(_POLL_S, self._poll)
        self.report_ready(config, self._view.access.url)

    def close(self) -> None:
        """Stop to serve."""
        self._view.close()
        if self._windows is not None:
            self._windows.close()

    def _poll(self) -> None:
        """Offer new topics, read those that are watched, and show the window of the rover."""
        world = None if self._windows is None else self._windows.at(_EVER_NS)
        if world is not None:
            self._map.show(world)
        for topic, types in self.get_topic_names_and_types():
            if topic not in self._types and self._view.offer(topic, types[0]):
                self._types[topic] = types[0]
        self._others = sorted(
            info.node_name for topic in self._types if topic.endswith(f'/{topics.CMD_VEL.name}')
            for info in self.get_publishers_info_by_topic(topic)
            if info.node_name != self.get_name())
        begun = set()
        while not self._begun.empty():
            begun.add(self._begun.get())
        watched = self._view.watched()
        for topic in [t for t in self._read if t not in watched or t in begun]:
            # Once more for a new client: latched messages come to new subscriptions.
            self.destroy_subscription(self._read.pop(topic))
        if self._read_clock(bool(watched)):
            # What has no stamp gets the time of the clock, which has come by the next call.
            return
        for topic in sorted(watched.difference(self._read)):
            self._subscribe(topic)

    def _read_clock(self, wanted: bool) -> bool:
        """Tell clients the simulated time; where there is none, that of the wall.

        Return whether the node has just begun to listen to the clock.
        """
        clock = topics.CLOCK
        if not wanted and self._clock_reader is not None:
            self.destroy_subscription(self._clock_reader)
            self._clock_reader = None
        elif wanted and self._clock_reader is None and clock.graph_name in self._types:
            self._clock_reader = self.create_subscription(
                message_class(clock.type), clock.graph_name,
                self._clock_callback, qos.reliable(_HISTORY, False))
            return True
        if wanted and self._clock_reader is None:
            self._view.tell_time(time.time_ns())
        return False

    def _clock_callback(self, message: Any) -> None:
        self._now_ns = time_ns(message.clock)
        self._view.tell_time(self._now_ns)

    def _subscribe(self, topic: str) -> None:
        offers = self.get_publishers_info_by_topic(topic)
        durable = bool(offers) and all(
            info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for info in offers)
        msgtype = self._types[topic]

        def callback(raw: bytes) -> None:
            stamp_ns = self._stamps.stamp_ns(msgtype, raw)
            if stamp_ns is None:
                stamp_ns = time.time_ns() if self._now_ns is None else self._now_ns
            self._view.send(topic, stamp_ns, raw)

        self._read[topic] = self.create_subscription(
            message_class(msgtype), topic, callback, qos.reliable(_HISTORY, durable), raw=True)

    def _on_drive(self, topic: str, data: bytes) -> None:
        """Publish a velocity of a client; called in a thread of the server."""
        scope, _, name = topic.rpartition('/')
        known = any(other.startswith(f'{scope}/') for other in list(self._types))
        if name == topics.CMD_VEL.name and known and self.executor is not None:
            self.executor.create_task(self._drive, topic, data)

    def _drive(self, topic: str, data: bytes) -> None:
        if len(data) < _TWIST.size or not all(map(math.isfinite, _TWIST.unpack_from(data))):
            return
        if topic not in self._drivers:
            self._drivers[topic] = self.create_publisher(Twist, topic, 1)
        message = Twist()
        message.linear.x, *_, message.angular.z = _TWIST.unpack_from(data)
        self._drivers[topic].publish(message)
