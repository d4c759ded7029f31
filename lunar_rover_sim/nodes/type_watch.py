"""Warns where somebody uses another type on one of a node's topics: DDS is silent about it."""

from __future__ import annotations

from rclpy.node import Node

from lunar_rover_sim.nodes.message_types import name_of

_PERIOD_S = 3.0


class TypeWatch:
    """Compares the types of a node's topics with those of others every 3 s; warns once of each."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._told: set[tuple[str, str, str]] = set()
        self._ignored: set[tuple[str, str]] = set()
        node.create_timer(_PERIOD_S, self._look)

    def ignore(self, topic: str, type_name: str) -> None:
        """Let others use a type on a topic, given by its full name."""
        self._ignored.add((topic, type_name))

    def _look(self) -> None:
        several = {name for name, types in self._node.get_topic_names_and_types()
                   if len(types) > 1}
        if not several:
            return
        own = [(p.topic_name, name_of(p.msg_type), 'publishes', 'read')
               for p in self._node.publishers if p.topic_name in several]
        own += [(s.topic_name, name_of(s.msg_type), 'reads', 'published')
                for s in self._node.subscriptions if s.topic_name in several]
        for topic, type_name, does, is_done in own:
            infos = self._node.get_subscriptions_info_by_topic(topic) if does == 'publishes' \
                else self._node.get_publishers_info_by_topic(topic)
            for info in infos:
                key = topic, info.node_name, info.topic_type
                # Hidden nodes are part of others, which may read two types.
                if (info.topic_type == type_name or key in self._told
                        or (topic, info.topic_type) in self._ignored
                        or info.node_name.startswith('_')):
                    continue
                self._told.add(key)
                self._node.get_logger().warning(
                    f'{topic}: {self._node.get_name()} {does} {type_name}, but {info.topic_type} '
                    f'is {is_done} by {info.node_name}: no message gets through')
