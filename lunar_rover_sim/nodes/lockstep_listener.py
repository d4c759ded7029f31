"""The topics whose stamps time waits for: subscriptions of any type, made when they appear."""

from __future__ import annotations

import collections
from collections.abc import Callable, Collection, Mapping, Sequence
import math
import time
from typing import Any

from rclpy.topic_endpoint_info import TopicEndpointInfo

from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.base.topics import Topic
from lunar_rover_sim.nodes import qos
from lunar_rover_sim.nodes.diagnostics import Drops
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.nodes.node_main import GraphNode
from lunar_rover_sim.run.lockstep import machine_slowness, StampGate
from lunar_rover_sim.run.node_state import (ANSWERS, is_supervised, NodeState, PUBLISHERS, tell,
                                            WAITING)
from lunar_rover_sim.run.shared_config import WaitConfig

# An answer may refer to a state that has not reached this node yet, but not to a later one.
_MAX_AHEAD_NS = NS_PER_S
_DISCOVERY_S = 0.02
_NOTICE_S = 3.0     # without an answer, after which a warning tells who is awaited


class LockstepListener:
    """A `StampGate` that is fed by subscriptions.

    A topic without a handler is subscribed as soon as it has a publisher, with its type. So any
    message with a stamp takes part: joint commands, camera_info, a user's pose.

    Attributes:
        drops: Answers that were lost or refused.

    Args:
        node: Subscribes.
        wait: The awaited topics, their lags, and how long they may take.
        lockstep: Whether time waits; then an answer with stamp 0 and a lost one end the node.
        now_ns: Returns the newest simulated time [ns] that the node knows of, None before the
            first. A stamp more than a second after it is refused, because it would hold the gate
            open until then. Answers that come before the first time are kept until `judge_early`.
        on_answer: Called after every answer.
        handlers: Topic → callback that gets each message before the gate learns its stamp; the
            type of these topics has a header.
        relays: Topics whose publishers wait for somebody else's first answer in turn; in the first
            simulated second they may take as long as a first answer.
    """

    def __init__(self, node: GraphNode, wait: WaitConfig, lockstep: bool,
                 now_ns: Callable[[], int | None], on_answer: Callable[[], None],
                 handlers: Mapping[Topic, Callable[[Any], None]] | None = None,
                 relays: Collection[str] = ()) -> None:
        self.gate = StampGate(wait.lag_ns_by_topic())
        self._node = node
        self._wait = wait
        self._lockstep = lockstep
        self._now_ns = now_ns
        self._on_answer = on_answer
        self._types = {topic.name: topic.type for topic in handlers or {}}
        self._handlers = {topic.name: handler for topic, handler in (handlers or {}).items()}
        self._without_publisher = list(self.gate.topics)
        self._lag_ns = wait.lag_ns_by_topic()
        self._before_restart: set[str] = set()
        self._early: collections.deque[tuple[str, int, Any]] = collections.deque(
            maxlen=qos.STATE_DEPTH)     # topic, stamp [ns], message
        self.drops = Drops()
        self._relays = frozenset(relays)
        self._refused: dict[str, int] = {}      # topic → stamps refused so far
        self._last_progress_s = time.monotonic()
        self._told = False      # of this wait
        self._has_warned = False
        for topic in self._types:
            if topic in self._without_publisher:
                self._subscribe(topic, self._types[topic])
        # A timer: rclpy reports new publishers only to a subscription, whose type must be known.
        self._timer = node.create_timer(_DISCOVERY_S, self._discover)

    def resume(self, time_ns: int) -> None:
        """Begin at a time [ns], up to which all have answered."""
        self.gate.restart(time_ns)
        self.note_progress()

    def restart(self) -> None:
        """Begin again: time has gone back to zero.

        Answers that are still under way to the time before, later than the new time by more than
        the lag of their topic, are dropped until the topic has answered the new time.
        """
        self.gate.restart()
        self._before_restart = set(self.gate.topics)
        self.note_progress()

    @property
    def has_all_publishers(self) -> bool:
        """Whether every awaited topic has been subscribed."""
        return not self._without_publisher

    def check_publishers(self) -> None:
        """Raise GraphError, naming the topics, if publishers are overdue [wall time]."""
        # A recorder begins once all others publish.
        missing = [topic for topic in self._without_publisher
                   if topic != topics.RECORDED.name] or self._without_publisher
        if missing:
            self._check(self._limit_s(self._wait.start_s), 0, dict.fromkeys(missing, 0),
                        PUBLISHERS, is_late=False)

    def note_progress(self) -> None:
        """Restart the wait: time advanced, an answer came, or no answer is due."""
        self._last_progress_s = time.monotonic()
        self._told = False

    def check_silence(self, now_ns: int) -> None:
        """Raise GraphError, naming topic and node, if an answer is overdue [wall time].

        Warns of the first long wait, and logs the others.
        """
        missing = self.gate.missing(now_ns) or self.gate.behind(now_ns)
        if not missing:
            return
        # A node that answers with wrong stamps has started, too.
        started = all(self.gate.has_answered(topic) or topic in self._refused
                      for topic in missing)
        if self.gate.is_starting(now_ns) and not self._relays.isdisjoint(missing):
            started = False
        self._check(self._limit_s(self._wait.silence_s if started else self._wait.start_s),
                    now_ns, missing, ANSWERS, is_late=started)

    def _limit_s(self, limit_s: float) -> float:
        """Return how long it waits itself: in a run in lockstep the run decides.

        The run sees who loads, works or has died, and ends in time.
        """
        if not is_supervised():
            return limit_s
        return math.inf if self._lockstep else limit_s * machine_slowness()

    def _check(self, limit_s: float, now_ns: int, missing: Mapping[str, int], awaits: str,
               is_late: bool) -> None:
        """Raise GraphError if a wait is overdue; tell a long one, and log it where `is_late`."""
        waited_s = time.monotonic() - self._last_progress_s
        is_over = waited_s >= limit_s
        if not is_over and (self._told or waited_s < _NOTICE_S):
            return
        self._told = True
        text = self._describe_silence(now_ns, missing)
        tell(NodeState(WAITING, text, awaits, now_ns))
        if is_over:
            raise GraphError(f'{text}, {limit_s:.3g} s so far')
        if is_late:
            self._log_wait(f'{text}, {_NOTICE_S:g} s so far', limit_s)

    def _log_wait(self, text: str, limit_s: float) -> None:
        logger = self._node.get_logger()
        if is_supervised():     # a run shows the state told, and decides by whether nodes work
            logger.info(text)
            return
        text += f'; waits for up to {limit_s:g} s'
        # A slow machine would repeat it at every frame.
        if self._has_warned:
            logger.info(text)
        else:
            logger.warning(text)
        self._has_warned = True

    def _describe_silence(self, now_ns: int, missing: Mapping[str, int]) -> str:
        silent = ', '.join(
            f'{topic} (from {self._publishers(topic)}) since {ns / 1e9:.3f} s'
            + (f' ({self._refused[topic]} stamps refused)' if topic in self._refused else '')
            for topic, ns in missing.items())
        return (f'nothing on {silent}; {self._node.get_name()} waits for '
                f'{"it" if len(missing) == 1 else "them"} at {now_ns / 1e9:.3f} s of simulated '
                'time')

    def _publishers(self, topic: str) -> str:
        infos = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))
        return ', '.join(sorted(info.node_name for info in infos)) or 'nobody, no publisher'

    def _discover(self) -> None:
        for topic in list(self._without_publisher):
            infos = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))
            if infos:
                self._without_publisher.remove(topic)
                if topic in self._types:
                    self._check_types(topic, infos)
                else:
                    self._subscribe(topic, infos[0].topic_type)
        if not self._without_publisher:
            self._timer.cancel()

    def _check_types(self, topic: str, infos: Sequence[TopicEndpointInfo]) -> None:
        """Raise GraphError for a publisher of another type: a recorder might take that one."""
        for info in infos:
            if info.topic_type != self._types[topic]:
                raise GraphError(f'{topic}: type {info.topic_type} of {info.node_name} is not '
                                 f'valid; time waits for {self._types[topic]}')

    def _subscribe(self, topic: str, type_name: str) -> None:
        def handled(msg: Any) -> None:
            self._take_answer(topic, time_ns(msg.header.stamp), msg)

        def stamp_only(raw: bytes) -> None:
            stamp = stamp_ns(type_name, raw)
            if stamp is None:
                raise GraphError(f'{topic}: messages of type {type_name} have no stamp; time '
                                 'cannot wait for them')
            self._take_answer(topic, stamp)

        events = (qos.FirstLoss(self._node.guarded(lambda: self._fail_by_loss(topic)))
                  if self._lockstep else
                  qos.loss_events(topics.topic_of(topic.lstrip('/')), self._node.guarded(
                      lambda event: self._on_loss(topic, event))))
        # Messages without a handler may be large: they are not deserialised.
        raw = topic not in self._handlers
        self._node.create_subscription(message_class(type_name), topic,
                                       stamp_only if raw else handled,
                                       qos.reliable(qos.STATE_DEPTH), raw=raw,
                                       event_callbacks=events)

    def _fail_by_loss(self, topic: str) -> None:
        raise GraphError(f'{topic}: messages of {self._publishers(topic)} are lost; give its '
                         'publisher a depth of at least its lag')

    def _on_loss(self, topic: str, event: Any) -> None:
        self.drops.add(f'Messages of {topic}', event.total_count_change)
        self._node.get_logger().warning(
            f'{topic}: {event.total_count} messages of {self._publishers(topic)} are lost',
            throttle_duration_sec=1.0)

    def _take_answer(self, topic: str, stamp: int, msg: Any = None) -> None:
        now_ns = self._now_ns()
        if self._lockstep and stamp == 0:
            if not now_ns:
                return      # sent before there was a state to answer
            raise GraphError(f'{topic}: stamp 0 (from {self._publishers(topic)}) is no answer; '
                             'valid is the stamp of the message that it answers')
        if now_ns is None:
            # It may be stamped with another clock: only the first state can tell.
            self._early.append((topic, stamp, msg))
        elif self._is_accepted(topic, stamp, msg, now_ns):
            self._on_answer()

    def judge_early(self) -> None:
        """Take or refuse the answers that came before the node knew the time; it knows it now."""
        now_ns = self._now_ns()
        if now_ns is None or not self._early:
            return
        early = list(self._early)
        self._early.clear()
        # All of them first: `on_answer` uses the newest one.
        if any([self._is_accepted(*answer, now_ns) for answer in early]):
            self._on_answer()

    def _is_accepted(self, topic: str, stamp: int, msg: Any, now_ns: int) -> bool:
        """Hand an answer on to its handler and the gate, unless its stamp is not valid."""
        if topic in self._before_restart:
            if stamp > now_ns + self._lag_ns[topic]:
                return False
            self._before_restart.discard(topic)
        if stamp > now_ns + _MAX_AHEAD_NS:
            self._refuse(topic, stamp, now_ns)
            return False
        if topic in self._handlers:
            self._handlers[topic](msg)
        self.gate.answer(topic, stamp)
        # A slow participant is not a silent one: on a loaded machine a frame may take seconds.
        self.note_progress()
        return True

    def _refuse(self, topic: str, stamp: int, now_ns: int) -> None:
        self._refused[topic] = self._refused.get(topic, 0) + 1
        self.drops.add(f'Refused stamps of {topic}')
        self._node.warnings.add(
            f'stamp of {topic}', f'{topic}: stamp {stamp / 1e9:.3f} s refused',
            f'; valid is at most {_MAX_AHEAD_NS / 1e9:g} s after the simulated time, '
            f'{now_ns / 1e9:.3f} s (does its publisher use /clock?)')
