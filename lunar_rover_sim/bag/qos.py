"""Offered QoS as bags record it, so that `ros2 bag play` publishes as the graph did."""

from __future__ import annotations

from typing import Any

from rosbags.interfaces import (Qos, QosDurability, QosHistory, QosLiveliness, QosReliability,
                                QosTime)

from lunar_rover_sim.topics import CONTRACT, LATCHED

_NS_PER_S = 1_000_000_000
_FOREVER_NS = 2**63 - 1


def reliable_qos(depth: int = 10, latched: bool = False) -> Qos:
    """Return a RELIABLE, KEEP_LAST profile; `latched` makes it TRANSIENT_LOCAL."""
    forever = _time(_FOREVER_NS)
    return Qos(QosHistory.KEEP_LAST, depth, QosReliability.RELIABLE,
               QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
               forever, forever, QosLiveliness.AUTOMATIC, forever, False)


def contract_qos(topic: str) -> Qos:
    """Return the profile of a topic of the contract, under any namespace; else 10 deep."""
    for known in CONTRACT:
        if known.rate == LATCHED and ('/' + topic).endswith('/' + known.name):
            return reliable_qos(1, latched=True)
    return reliable_qos()


def as_recorded(profile: Any, topic: str) -> Qos:
    """Return rosbags' profile for one of rclpy's (or one of rosbags' own, unchanged).

    History and depth are not told by discovery; where they are unknown, those of the contract
    are written.
    """
    if isinstance(profile, Qos):
        return profile
    known = contract_qos(topic)
    history = _member(QosHistory, profile.history, QosHistory.UNKNOWN)
    depth = int(profile.depth)
    if history not in (QosHistory.KEEP_LAST, QosHistory.KEEP_ALL) or depth == 0:
        history, depth = known.history, known.depth
    return Qos(history, depth,
               _member(QosReliability, profile.reliability, known.reliability),
               _member(QosDurability, profile.durability, known.durability),
               _time(profile.deadline.nanoseconds), _time(profile.lifespan.nanoseconds),
               _member(QosLiveliness, profile.liveliness, known.liveliness),
               _time(profile.liveliness_lease_duration.nanoseconds),
               bool(profile.avoid_ros_namespace_conventions))


def _member(kind: Any, value: Any, otherwise: Any) -> Any:
    try:
        return kind(int(value))
    except ValueError:
        return otherwise


def _time(nanoseconds: int) -> QosTime:
    return QosTime(int(nanoseconds) // _NS_PER_S, int(nanoseconds) % _NS_PER_S)
