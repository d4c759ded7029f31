"""Quality of service of every topic, in one place.

All is RELIABLE. Latched topics are TRANSIENT_LOCAL. All others are VOLATILE: a late reader gets
what is sent from then on, nothing of the past. In lockstep nodes hold their first message until
the readers are matched (`matching`). The parameters `qos_overrides` change single profiles.
"""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from lunar_rover_sim.topics import DEPTH_FRAME, FRAME, LATCHED, SCAN, SUN, Topic

STATE_DEPTH = 1000
FRAME_DEPTH = 10
COMMAND_DEPTH = 10


def _profile(depth: int, durable: bool) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if durable else DurabilityPolicy.VOLATILE)


def depth(topic: Topic | None) -> int:
    """Return the history depth of a topic of the contract; unknown topics count as state."""
    if topic is SUN:    # it may move, and none of its directions is to be lost
        return FRAME_DEPTH
    if topic is not None and topic.rate == LATCHED:
        return 1
    if topic is not None and topic.rate in (FRAME, DEPTH_FRAME, SCAN):
        return FRAME_DEPTH
    return STATE_DEPTH


def offered(topic: Topic) -> QoSProfile:
    """Return the profile of a publisher of this package."""
    return _profile(depth(topic), durable=topic.rate == LATCHED)


def requested(topic: Topic, lockstep: bool) -> QoSProfile:
    """Return the profile of a subscription of this package; in real time the history is short."""
    if topic.rate == LATCHED:
        return _profile(1, durable=True)
    return _profile(depth(topic) if lockstep else COMMAND_DEPTH, durable=False)


def newest(durable: bool = False) -> QoSProfile:
    """Return a profile that keeps the newest message only."""
    return _profile(1, durable)


def adapted(history: int, durable: bool) -> QoSProfile:
    """Return a profile for a discovered publisher: its durability, and a depth [messages]."""
    return _profile(history, durable)


def best_effort(history: int) -> QoSProfile:
    """Return a profile that also matches best-effort publishers, such as sensor drivers."""
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=history,
                      reliability=ReliabilityPolicy.BEST_EFFORT,
                      durability=DurabilityPolicy.VOLATILE)
