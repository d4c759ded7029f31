"""What the numbers of the label image mean, latched: made when somebody first asks for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from std_msgs.msg import Header, String

from lunar_rover_sim import topics
from lunar_rover_sim.nodes import qos
from lunar_rover_sim.nodes.vision_conversions import label_info, vision_info, vision_messages
from lunar_rover_sim.rendering.labels import class_names, vocabulary
from lunar_rover_sim.world.craters import Craters
from lunar_rover_sim.world.rocks import Rocks


class LabelPublisher:
    """Publishes the vocabulary once; a bag of it is as large as the catalogues of the world.

    Where vision_msgs is installed, its LabelInfo and VisionInfo as well.
    """

    def __init__(self, node: Node, rocks: Rocks, craters: Craters, world_hash: str,
                 legs: Sequence[str]) -> None:
        """Wait for readers; rocks: near and far ones, in the order of their labels.

        legs: names of those of the rover
        """
        self._node = node
        self._publishers: dict[str, Any] = {}
        self._offer(topics.LABEL_INFO, String,
                    lambda: String(data=vocabulary(rocks, craters, world_hash, legs)))
        msg = vision_messages()
        if msg is not None:
            header = Header(frame_id=topics.LABEL_CLASSES.frame_id)
            self._offer(topics.LABEL_CLASSES, msg.LabelInfo,
                        lambda: label_info(msg, class_names(len(rocks), legs), header))
            self._offer(topics.VISION_INFO, msg.VisionInfo,
                        lambda: vision_info(msg, world_hash, header))

    def _offer(self, topic: topics.Topic, message_type: type, make: Callable[[], Any]) -> None:
        """Publish what `make` returns when a topic is first read."""
        sent: list[bool] = []

        def on_match(event: object) -> None:
            if not sent and getattr(event, 'current_count') > 0:
                sent.append(True)
                self._publishers[topic.name].publish(make())

        self._publishers[topic.name] = self._node.create_publisher(
            message_type, topic.name, qos.offered(topic),
            event_callbacks=PublisherEventCallbacks(matched=on_match))
