"""The parameters `qos_overrides.TOPIC.publisher|subscription.POLICY`, as ROS 2 defines them.

rclpy declares and applies them. Here they are checked: it would raise errors of several kinds for
a wrong value, and say nothing of a topic that does not exist.
"""

from __future__ import annotations

from typing import cast

from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSPolicyKind
from rclpy.qos_overriding_options import QoSOverridingOptions

from lunar_rover_sim.arguments import brief
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.parameters import nearest

PREFIX = 'qos_overrides.'
# Offered by every publisher and subscription of our nodes.
OPTIONS = QoSOverridingOptions((QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH,
                                QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY))
_WORDS = {'history': ('keep_last', 'keep_all'), 'reliability': ('reliable', 'best_effort'),
          'durability': ('volatile', 'transient_local')}
_POLICIES = ('depth', *_WORDS)
_KINDS = ('publisher', 'subscription')


def check_values(node: Node) -> None:
    """Raise ConfigError for an override that has no meaning; before anything is created."""
    # rclpy's annotation of the result is wrong.
    given = cast('dict[str, Parameter]', node.get_parameters_by_prefix(''))
    for name, parameter in given.items():
        if not name.startswith(PREFIX):
            continue
        _, kind, policy = _parts(name)
        value = parameter.value
        if kind not in _KINDS or policy not in _POLICIES:
            raise ConfigError(f'{name}: no such parameter; valid is {PREFIX}TOPIC.publisher.POLICY'
                              f' or .subscription., POLICY one of {", ".join(_POLICIES)}')
        if policy == 'depth':
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise ConfigError(f'{name}: {brief(value)} is not valid; valid is >= 1')
        elif value not in _WORDS[policy]:
            raise ConfigError(f'{name}: {brief(value)} is not valid; valid is '
                              + ' or '.join(_WORDS[policy]))


def check_topics(node: Node) -> None:
    """Raise ConfigError for an override of a publisher that the node does not have.

    Subscriptions come and go with the publishers of others; they are not checked.
    """
    published = {publisher.topic_name for publisher in node.publishers}
    for name in node.get_parameters_by_prefix(''):
        if not name.startswith(PREFIX):
            continue
        topic, kind, _ = _parts(name)
        if kind == 'publisher' and topic not in published:
            raise ConfigError(f'{name}: {node.get_name()} does not publish {topic}; '
                              f'{nearest(topic, sorted(published))}')


def _parts(name: str) -> tuple[str, str, str]:
    """Return topic, 'publisher' or 'subscription', and policy; '' for what is missing."""
    rest, _, policy = name.removeprefix(PREFIX).rpartition('.')
    topic, _, kind = rest.rpartition('.')
    return topic, kind, policy
