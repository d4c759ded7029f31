"""Warns where somebody uses another type on one of a node's topics: DDS is silent about it."""

from __future__ import annotations

from rclpy.node import Node

from lunar_rover_sim.nodes.message_types import name_of

_PERIOD_S = 2.0


class TypeWatch:
    """Compares the types of a node's topics with those of others every 2 s; warns once of each.

    It warns of what it sees twice in a row: another node may still be about to subscribe.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._told: set[tuple[str, str, str]] = set()
        self._seen: set[tuple[str, str, str]] = set()
        self._ignored: set[tuple[str, str]] = set()
        node.create_timer(_PERIOD_S, self._look)

    def ignore(self, topic: str, type_name: str) -> None:
        """Let others use a type on a topic, given by its full name."""
        self._ignored.add((topic, type_name))

    def _look(self) -> None:
        several = {name for name, types in self._node.get_topic_names_and_types()
                   if len(types) > 1}
        own = [(p.topic_name, name_of(p.msg_type), 'publishes', 'read')
               for p in self._node.publishers if p.topic_name in several]
        own += [(s.topic_name, name_of(s.msg_type), 'reads', 'published')
                for s in self._node.subscriptions if s.topic_name in several]
        before, self._seen = self._seen, set()
        for topic, type_name, does, is_done in own:
            infos = self._node.get_subscriptions_info_by_topic(topic) if does == 'publishes' \
                else self._node.get_publishers_info_by_topic(topic)
            served = [info.node_name for info in infos if info.topic_type == type_name]
            for info in infos:
                key = topic, info.node_name, info.topic_type
                if (info.topic_type == type_name or key in self._told
                        or (topic, info.topic_type) in self._ignored
                        or _belongs_to(info.node_name, served)):
                    continue
                self._seen.add(key)
                if key not in before:
                    continue
                self._told.add(key)
                self._node.get_logger().warning(
                    f'{topic}: {self._node.get_name()} {does} {type_name}, but {info.topic_type} '
                    f'is {is_done} by {info.node_name}: no message gets through')


def _belongs_to(name: str, served: list[str]) -> bool:
    """Return whether a node, or a hidden part `_NAME_…` of it, is among those of the right type.

    A hidden node itself is part of another, which may read two types.
    """
    return name.startswith('_') or any(other == name or other.startswith(f'_{name}_')
                                       for other in served)
