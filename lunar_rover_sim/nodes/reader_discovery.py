"""Discovery of a node's readers, so that none misses its first message.

Topics are VOLATILE: a reader gets what is sent after its publisher has been matched with it. In
lockstep a node therefore holds its first message until all who take part are matched.
"""

from __future__ import annotations

from collections.abc import Sequence
import time

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.nodes.message_types import name_of
from lunar_rover_sim.run.node_state import is_supervised

# A node advertises its topics before it subscribes, or after: the graph must have been the same
# for this long.
_SETTLED_S = 0.2
# A reader that takes no part, and is never matched, delays time no longer than this.
_STRANGERS_S = 3.0
_POLL_S = 0.02
_SLOW_S = 10.0
# Discovery transmits the names of nodes a little later than their topics.
UNKNOWN_NAME = '_NODE_NAME_UNKNOWN_'
_NEEDED = 'valid in lockstep is RELIABLE, VOLATILE, as QoSProfile(depth=10) of rclpy is'


class ReaderDiscovery:
    """Finds out when every participant has been discovered and matched.

    It is complete as soon as each of the topics of participants has a publisher, all readers that
    the node knows of are matched with its own publishers, and nothing of this has changed for
    0.2 s.

    Args:
        node: Whose readers are awaited.
        publishers: Those of the node.
        participants: Topics by whose publishers participants are recognised; without any, nothing
            is awaited.
    """

    def __init__(self, node: Node, publishers: Sequence[Publisher],
                 participants: Sequence[str]) -> None:
        self._node = node
        self._publishers = list(publishers)
        self._topics = [node.resolve_topic_name(name) for name in participants]
        self._is_complete = not self._topics
        self._start_s = self._last_poll_s = time.monotonic()
        self._seen: tuple[int, ...] = ()
        self._seen_s = self._start_s
        self._all_there_s: float | None = None
        self._told = False

    @property
    def is_complete(self) -> bool:
        """Whether the first message may be sent.

        Raises:
            GraphError: If a participant has a QoS with which it would lose messages.
        """
        now_s = time.monotonic()
        if not self._is_complete and now_s - self._last_poll_s > _POLL_S:
            self._last_poll_s = now_s
            self._poll(now_s)
        return self._is_complete

    def missing(self) -> list[str]:
        """Return the participants' topics that have no publisher."""
        return [name for name in self._topics if not self._node.count_publishers(name)]

    def _poll(self, now_s: float) -> None:
        missing = self.missing()
        if missing:
            self._all_there_s = None
            if now_s - self._start_s > _SLOW_S and not self._told:
                self._told = True
                text = 'waiting for a publisher of ' + ', '.join(missing)
                if is_supervised():     # a run shows who still loads
                    self._node.get_logger().info(text)
                else:
                    self._node.get_logger().warning(text)
            return
        if self._all_there_s is None:
            self._all_there_s = now_s
        names = self._participants()
        if names is None:
            return
        matched, known = [], []
        for publisher in self._publishers:
            readers = self._readers(publisher, names)
            known.append(len(readers))
            matched.append(publisher.get_subscription_count())
        seen = (*matched, *known)
        if seen != self._seen:
            self._seen, self._seen_s = seen, now_s
        patient = now_s - self._all_there_s < _STRANGERS_S
        if patient and any(m < k for m, k in zip(matched, known)):
            return
        self._is_complete = now_s - self._seen_s > _SETTLED_S

    def _participants(self) -> set[tuple[str, str]] | None:
        """Return (namespace, name) of the participants; None where a name is not known yet.

        Raises:
            GraphError: For a QoS with which an answer may get lost.
        """
        names = set()
        for topic in self._topics:
            for info in self._node.get_publishers_info_by_topic(topic):
                if info.node_name == UNKNOWN_NAME:
                    return None
                names.add((info.node_namespace, info.node_name))
                check_offer(topic, info)
        return names

    def _readers(self, publisher: Publisher,
                 participants: set[tuple[str, str]]) -> list[TopicEndpointInfo]:
        """Return the readers that `publisher` can be matched with."""
        type_name = name_of(publisher.msg_type)
        result = []
        for info in self._node.get_subscriptions_info_by_topic(publisher.topic_name):
            if info.topic_type != type_name:
                continue
            reason = incompatible(publisher.qos_profile, info.qos_profile)
            if reason is None:
                result.append(info)
            elif (info.node_namespace, info.node_name) in participants:
                raise GraphError(f'{publisher.topic_name}: {info.node_name} cannot read it: '
                                 f'{reason}; {_NEEDED}')
        return result


def check_offer(topic: str, info: TopicEndpointInfo) -> None:
    """Raise GraphError if messages of an awaited topic could get lost on their way."""
    if info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT:
        raise GraphError(f'{topic}: {info.node_name} offers BEST_EFFORT, with which an answer may '
                         f'get lost; {_NEEDED}')


def incompatible(offered: QoSProfile, requested: QoSProfile) -> str | None:
    """Return why two profiles do not match; None if they do.

    Deadlines and leases are not looked at: discovery writes infinite ones as other numbers than
    profiles do, so that rclpy's own comparison refuses them.
    """
    if (requested.durability == DurabilityPolicy.TRANSIENT_LOCAL
            and offered.durability == DurabilityPolicy.VOLATILE):
        return 'it requests TRANSIENT_LOCAL, and VOLATILE is offered'
    if (requested.reliability == ReliabilityPolicy.RELIABLE
            and offered.reliability == ReliabilityPolicy.BEST_EFFORT):
        return 'it requests RELIABLE, and BEST_EFFORT is offered'
    return None
