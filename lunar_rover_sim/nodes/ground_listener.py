"""Follows the ground of physics: a snapshot, then its changes, applied up to a stamp."""

from __future__ import annotations

import bisect
from collections.abc import Callable

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2

from lunar_rover_sim.bag.ground_points import changes_of
from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.ground.regolith.overlay import GroundChanges, Overlay
from lunar_rover_sim.nodes import qos
from lunar_rover_sim.nodes.node_main import GraphNode

# Messages of two topics may arrive a little out of order; stamps further back are of a restart.
_JUMP_NS = 500_000_000


class GroundListener:
    """The ground as far as it is known; `overlay` is that of the stamp last asked for.

    Nothing counts before the first snapshot. Later ones, for other readers, change nothing.
    Without a publisher nothing arrives, and the overlay stays empty.
    """

    def __init__(self, node: GraphNode, on_change: Callable[[], None]) -> None:
        """Subscribe; on_change: called when more of the ground is known."""
        self.overlay = Overlay()
        self._on_change = on_change
        self._known_ns: int | None = None       # stamp up to which changes have arrived
        # Stamp, whether it is a snapshot, and its values; in the order of stamps.
        self._waiting: list[tuple[int, bool, GroundChanges]] = []
        node.create_subscription(PointCloud2, topics.GROUND_SNAPSHOT.name,
                                 lambda raw: self._take(raw, True),
                                 qos.requested(topics.GROUND_SNAPSHOT, lockstep=True), raw=True)
        node.create_subscription(PointCloud2, topics.GROUND_CHANGES.name,
                                 lambda raw: self._take(raw, False),
                                 qos.reliable(qos.STATE_DEPTH), raw=True)

    @property
    def is_known(self) -> bool:
        """Whether there is ground that gives."""
        return self._known_ns is not None

    def knows(self, at_ns: int) -> bool:
        """Return whether all changes up to a stamp [ns] have arrived."""
        return self._known_ns is not None and self._known_ns >= at_ns

    def advance(self, to_ns: int) -> None:
        """Apply the changes up to a stamp [ns] to the overlay."""
        if self._known_ns is None:
            return
        while self._waiting and self._waiting[0][0] <= to_ns:
            _, whole, changes = self._waiting.pop(0)
            if whole:
                known = Overlay()
                known.apply(changes)
                self.overlay.restore(known)
            else:
                self.overlay.apply(changes)

    def _take(self, raw: bytes, whole: bool) -> None:
        at_ns = stamp_ns(topics.GROUND_CHANGES.type, raw) or 0
        if self._known_ns is not None and at_ns < self._known_ns - _JUMP_NS:
            self._waiting.clear()
            self._known_ns = at_ns
        item = at_ns, whole, changes_of(deserialize_message(raw, PointCloud2))
        bisect.insort(self._waiting, item, key=lambda entry: entry[0])
        if self._known_ns is None and whole:
            self._known_ns = self._waiting[-1][0]
        elif self._known_ns is not None and not whole:
            self._known_ns = max(self._known_ns, at_ns)
        self._on_change()
