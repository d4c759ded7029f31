"""What the numbers of the label image mean, latched: made when somebody first asks for it."""

from __future__ import annotations

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from std_msgs.msg import String

from lunar_rover_sim import topics
from lunar_rover_sim.nodes import qos
from lunar_rover_sim.rendering.labels import vocabulary
from lunar_rover_sim.world.craters import Craters
from lunar_rover_sim.world.rocks import Rocks


class LabelPublisher:
    """Publishes the vocabulary once; a bag of it is as large as the catalogues of the world."""

    def __init__(self, node: Node, rocks: Rocks, craters: Craters, world_hash: str) -> None:
        """Wait for a reader; rocks: near and far ones, in the order of their labels."""
        self._catalogue = rocks, craters, world_hash
        self._is_sent = False
        self._publisher = node.create_publisher(
            String, topics.LABEL_INFO.name, qos.offered(topics.LABEL_INFO),
            event_callbacks=PublisherEventCallbacks(matched=self._on_match))

    def _on_match(self, event: object) -> None:
        if not self._is_sent and getattr(event, 'current_count') > 0:
            self._is_sent = True
            self._publisher.publish(String(data=vocabulary(*self._catalogue)))
