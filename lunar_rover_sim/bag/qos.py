"""Offered QoS as bags record it, so that `ros2 bag play` publishes as the graph did."""

from __future__ import annotations

from typing import Any

from rosbags.interfaces import (Qos, QosDurability, QosHistory, QosLiveliness, QosReliability,
                                QosTime)
from rosbags.rosbag2.metadata import parse_qos
import yaml

from lunar_rover_sim.base.errors import BagError, one_line
from lunar_rover_sim.base.files.yaml_text import FAST_LOADER
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.base.topics import CONTRACT, LATCHED

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

    Discovery does not transmit history and depth. Where they are unknown, those of the contract
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


def qos_of_text(text: str) -> list[Qos]:
    """Return the profiles in the YAML text that a storage file holds for a topic.

    Both layouts are read: names, as bags of version 9 have them, and the numbers of older
    versions.

    Raises:
        BagError: Where they cannot be read.
    """
    try:
        return parse_qos(yaml.load(text, FAST_LOADER) or [])  # noqa: S506
    except (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError, OverflowError,
            RecursionError) as error:
        raise BagError('offered QoS profiles cannot be read: '
                       + one_line(error)) from None


def _member(kind: Any, value: Any, otherwise: Any) -> Any:
    """Return the member of an enumeration by its number."""
    try:
        return kind(int(value))
    except ValueError:
        return otherwise


def _time(nanoseconds: int) -> QosTime:
    return QosTime(int(nanoseconds) // NS_PER_S, int(nanoseconds) % NS_PER_S)
