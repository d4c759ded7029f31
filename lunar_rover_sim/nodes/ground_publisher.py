"""Topics of changed ground: changes at frame rate, and all of it at once.

A reader that joins late takes the snapshot, and over it the changes with later stamps. Values are
absolute, so it then has the ground exactly.
"""

from __future__ import annotations

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.publisher import Publisher
from sensor_msgs.msg import PointCloud2

from lunar_rover_sim import topics
from lunar_rover_sim.bag.ground_points import points_of
from lunar_rover_sim.nodes import conversions, image_conversions, qos
from lunar_rover_sim.nodes.node_main import GraphNode
from lunar_rover_sim.regolith.overlay import GroundChanges, Overlay
from lunar_rover_sim.world.grid import HeightGrid


class GroundPublisher:
    """Publishes changes whenever a period [ns] is over, and a snapshot for each new reader.

    Attributes:
        changes: The publisher of the changes.
    """

    def __init__(self, node: GraphNode, overlay: Overlay, ground: HeightGrid,
                 period_ns: int, frame_id: str) -> None:
        """Publish the first snapshot: the ground at the start.

        Args:
            ground: The untouched one.
            frame_id: Of the clouds.
        """
        self._overlay, self._ground, self._period_ns = overlay, ground, period_ns
        self._now_ns, self._frame_id = 0, frame_id
        self.changes: Publisher = node.create_publisher(
            PointCloud2, topics.GROUND_CHANGES.name, qos.offered(topics.GROUND_CHANGES))
        events = PublisherEventCallbacks(matched=self._on_match)
        self._snapshot: Publisher = node.create_publisher(
            PointCloud2, topics.GROUND_SNAPSHOT.name, qos.offered(topics.GROUND_SNAPSHOT),
            event_callbacks=events)
        self._send(self._snapshot, overlay.snapshot())

    def publish(self, now_ns: int) -> None:
        """Publish what has changed, if a period ends at this time [ns]."""
        self._now_ns = now_ns
        if now_ns % self._period_ns == 0:
            self._send(self.changes, self._overlay.take_changes())

    def restart(self) -> None:
        """Begin again at time 0, with the ground at the start."""
        self._now_ns = 0
        self._send(self._snapshot, self._overlay.snapshot())

    def _on_match(self, event: object) -> None:
        if getattr(event, 'current_count_change') > 0:
            self._send(self._snapshot, self._overlay.snapshot())

    def _send(self, publisher: Publisher, changes: GroundChanges) -> None:
        publisher.publish(image_conversions.ground_cloud(
            points_of(changes, self._ground), conversions.time_msg(self._now_ns),
            self._frame_id))
