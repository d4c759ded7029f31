"""The last message of each topic at or before the stamp of an image."""

from __future__ import annotations

from collections import defaultdict, deque
from typing import Generic, TypeVar

from lunar_rover_sim.seconds import NS_PER_S

KEPT_NS = NS_PER_S  # so long before its last message a topic is remembered
# Bags of other recorders hold messages by the time of their arrival, up to so much out of order.
LATE_NS = KEPT_NS // 2

V = TypeVar('V')


class RecentMessages(Generic[V]):
    """Keeps the last messages of each topic, and the one before them.

    kept_ns: for so long
    """

    def __init__(self, kept_ns: int = KEPT_NS) -> None:
        self._kept_ns = kept_ns
        self._kept: dict[str, deque[tuple[int, V]]] = defaultdict(deque)

    def add(self, topic: str, stamp_ns: int, value: V) -> None:
        """Take a message; those of a topic come in the order of their stamps."""
        kept = self._kept[topic]
        kept.append((stamp_ns, value))
        while len(kept) > 1 and kept[1][0] <= stamp_ns - self._kept_ns:
            kept.popleft()

    def at(self, topic: str, stamp_ns: int) -> tuple[int, V] | None:
        """Return stamp and value of the last message at or before a stamp; None if none was."""
        return next((each for each in reversed(self._kept.get(topic, ()))
                     if each[0] <= stamp_ns), None)
