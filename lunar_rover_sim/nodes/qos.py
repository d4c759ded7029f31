"""Quality of service of every topic, in one place.

All is RELIABLE. Latched topics are TRANSIENT_LOCAL. All others are VOLATILE: a late reader gets
what is sent from then on, nothing of the past. In lockstep nodes hold their first message until
the readers are matched (`matching`). The parameters `qos_overrides` change single profiles.
`publisher` and `subscription` take type and name from the contract, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

from rclpy.event_handler import EventHandler, QoSSubscriptionEventType, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from lunar_rover_sim.base.errors import brief, ConfigError
from lunar_rover_sim.base.parameters import nearest
from lunar_rover_sim.base.topics import CHANGING, DEPTH_FRAME, EVENT, FRAME, LATCHED, SCAN, Topic
from lunar_rover_sim.nodes.message_types import message_class

STATE_DEPTH = 4000      # 20 s of states: those who wait for rare images lag by some of them
FRAME_DEPTH = 10
COMMAND_DEPTH = 10


def reliable(depth: int, durable: bool = False) -> QoSProfile:
    """Return a profile that keeps so many messages, for late readers too if it is durable."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if durable else DurabilityPolicy.VOLATILE)


def depth(topic: Topic | None) -> int:
    """Return the history depth of a topic of the contract; unknown topics count as state."""
    if topic in CHANGING:
        return FRAME_DEPTH
    if topic is not None and topic.rate == LATCHED:
        return 1
    if topic is not None and topic.rate in (FRAME, DEPTH_FRAME, SCAN):
        return FRAME_DEPTH
    return STATE_DEPTH


def offered(topic: Topic) -> QoSProfile:
    """Return the profile of a publisher of this package."""
    return reliable(depth(topic), durable=topic.rate == LATCHED)


def requested(topic: Topic, lockstep: bool) -> QoSProfile:
    """Return the profile of a subscription of this package; in real time the history is short."""
    if topic.rate == LATCHED:
        return reliable(1, durable=True)
    return reliable(depth(topic) if lockstep else COMMAND_DEPTH)


def publisher(node: Node, topic: Topic, **options: Any) -> Publisher:
    """Return a publisher with the type, name and profile of a topic of the contract.

    Args:
        options: More arguments of `create_publisher`.
    """
    return node.create_publisher(message_class(topic.type), topic.graph_name, offered(topic),
                                 **options)


def subscription(node: Node, topic: Topic, callback: Callable[[Any], None], lockstep: bool,
                 **options: Any) -> Subscription:
    """Return a subscription with the type, name and profile of a topic of the contract.

    Args:
        lockstep: As of `requested`.
        options: More arguments of `create_subscription`.
    """
    return node.create_subscription(message_class(topic.type), topic.graph_name, callback,
                                    requested(topic, lockstep), **options)


def adapted(publishers: Sequence[TopicEndpointInfo], history: int) -> QoSProfile:
    """Return a profile for discovered publishers: their reliability and durability.

    Where one of them, such as a sensor driver, offers best effort, or there is none yet, best
    effort is asked for, which matches all.

    Args:
        history: Depth [messages].
    """
    profiles = [publisher.qos_profile for publisher in publishers]
    if profiles and all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles):
        return reliable(history, all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL
                                     for p in profiles))
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=history,
                      reliability=ReliabilityPolicy.BEST_EFFORT,
                      durability=DurabilityPolicy.VOLATILE)


def loss_events(topic: Topic | None,
                on_loss: Callable[[Any], None]) -> SubscriptionEventCallbacks | None:
    """Return the events that tell of lost messages; None where they are not safe, or mean nothing.

    A latched message is meant to be replaced by the next one. Others that have no period come as
    fast as their publisher likes, and rmw_fastrtps (Jazzy) locks up where messages are lost while
    an event of earlier ones is taken: its locks are in another order than those of the reader.
    """
    if topic is None or topic.rate in (EVENT, LATCHED):
        return None
    return SubscriptionEventCallbacks(message_lost=on_loss)


class FirstLoss(SubscriptionEventCallbacks):
    """The event that a message is lost, for those who end at the first one.

    It is not taken, so nothing locks up (see `loss_events`), and nobody learns how many are lost.

    Args:
        on_loss: Called without an argument; the node must end, or it is called again and again.
    """

    def __init__(self, on_loss: Callable[[], None]) -> None:
        super().__init__()
        self._on_loss = on_loss

    def create_event_handlers(self, callback_group: Any, subscription: Any,
                              topic_name: str) -> list[EventHandler]:
        """Return the handlers of a new subscription; rclpy calls this."""
        return [*super().create_event_handlers(callback_group, subscription, topic_name),
                _UntakenEvent(callback_group=callback_group,
                              callback=lambda _: self._on_loss(),
                              event_type=QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST,
                              parent_impl=subscription)]


class _UntakenEvent(EventHandler):

    def take_data(self) -> bool:
        return True


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
