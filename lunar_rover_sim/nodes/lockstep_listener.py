"""Whose stamps time waits for: subscriptions of any type, found as they appear."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import time

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy

from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.errors import GraphError
from lunar_rover_sim.nodes import qos
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.run.lockstep import StampGate
from lunar_rover_sim.run.node_config import WaitConfig

# Whoever answers may have seen a state that is still on its way to this node, but no more.
_MOST_AHEAD_NS = 1_000_000_000


class AnswerListener:
    """A `StampGate` fed by subscriptions.

    A topic is subscribed as soon as somebody publishes it, with the publisher's type and
    durability, so that any message with a stamp takes part: joint commands, camera_info, a user's
    pose. `handlers` get the serialised message before the gate learns of it. `on_answer` is called
    after every answer. What is stamped more than a second after `now_ns()`, the newest time that
    the node knows of (None: none yet), is refused: it would hold the gate open until then.
    """

    def __init__(self, node: Node, wait: WaitConfig, now_ns: Callable[[], int | None],
                 on_answer: Callable[[], None],
                 handlers: Mapping[str, Callable[[bytes, int], None]] | None = None) -> None:
        self.gate = StampGate(wait.lag_ns_by_topic())
        self._node = node
        self._wait = wait
        self._now_ns = now_ns
        self._refused = 0
        self._on_answer = on_answer
        self._handlers = dict(handlers or {})
        self._pending = list(self.gate.topics)
        self._last_progress = time.monotonic()
        self._timer = node.create_timer(0.02, self._discover)

    @property
    def found(self) -> bool:
        """Whether every awaited topic has a publisher."""
        return not self._pending

    def check_found(self) -> None:
        """Raise GraphError, naming the topics, if publishers are overdue [wall time]."""
        if self._pending and time.monotonic() - self._last_progress > self._wait.start_s:
            raise GraphError(f'no publisher for {self._wait.start_s:g} s on '
                             + ', '.join(self._pending))

    def progress(self) -> None:
        """Take note that time went on, an answer came, or nothing is awaited at present."""
        self._last_progress = time.monotonic()

    def check_silence(self, now_ns: int) -> None:
        """Raise GraphError, naming topic and node, if an answer is overdue [wall time]."""
        missing = self.gate.missing(now_ns) or self.gate.behind(now_ns)
        if not missing:
            return
        started = all(self.gate.has_answered(topic) for topic in missing)
        limit_s = self._wait.silence_s if started else self._wait.start_s
        if time.monotonic() - self._last_progress < limit_s:
            return
        silent = '; '.join(f'{topic} (from {self._publishers(topic)}, last stamp {ns / 1e9:.3f} s)'
                           for topic, ns in missing.items())
        raise GraphError(f'no answer for {limit_s:g} s at {now_ns / 1e9:.3f} s of simulated time '
                         f'on {silent}')

    def _publishers(self, topic: str) -> str:
        infos = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))
        return ', '.join(sorted(info.node_name for info in infos)) or 'nobody: no publisher'

    def _discover(self) -> None:
        for topic in list(self._pending):
            infos = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))
            if infos:
                self._pending.remove(topic)
                durable = all(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                              for info in infos)
                self._subscribe(topic, infos[0].topic_type, durable)
        if not self._pending:
            self._timer.cancel()

    def _subscribe(self, topic: str, type_name: str, durable: bool) -> None:
        handler = self._handlers.get(topic)

        def callback(raw: bytes) -> None:
            stamp = stamp_ns(type_name, raw)
            if stamp is None:
                raise GraphError(f'{topic}: messages of type {type_name} have no stamp; time '
                                 'cannot wait for them')
            now_ns = self._now_ns()
            if now_ns is not None and stamp > now_ns + _MOST_AHEAD_NS:
                self._refuse(topic, stamp, now_ns)
                return
            if handler is not None:
                handler(raw, stamp)
            self.gate.answer(topic, stamp)
            # Slow is not silent: on a loaded machine a frame may take seconds.
            self.progress()
            self._on_answer()

        self._node.create_subscription(message_class(type_name), topic, callback,
                                       qos.adapted(qos.STATE_DEPTH, durable), raw=True)

    def _refuse(self, topic: str, stamp: int, now_ns: int) -> None:
        self._refused += 1
        self._node.get_logger().warning(
            f'{topic}: stamp {stamp / 1e9:.3f} s refused ({self._refused} so far); valid is at '
            f'most {_MOST_AHEAD_NS / 1e9:g} s after the simulated time, {now_ns / 1e9:.3f} s '
            '(does its publisher use /clock?)', throttle_duration_sec=1.0)
