"""Lockstep: simulated time waits until each awaited topic has answered.

There is no protocol of its own: participants answer by the stamps of ordinary messages.
`joint_commands` has the stamp of the state that it answers, `camera_info` that of the odometry
that it shows.
"""

from __future__ import annotations

from collections.abc import Mapping
import os

from lunar_rover_sim.base.seconds import NS_PER_S

# Longer than the lag of any participant: after this simulated time all have answered.
STARTED_NS = NS_PER_S


def machine_slowness() -> float:
    """Return how many times longer work takes now than on an idle machine, by its load; >= 1.

    The load is the mean number of threads, over a minute, that run, want a core or wait for a
    disk.
    """
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


class StampGate:
    """The newest stamp of each awaited topic, and the lag that each may have.

    Args:
        lag_ns_by_topic: Topic → lag [ns]. Time may advance from `now` when every topic has
            answered `now` itself or a stamp later than `now - lag`. So lag 0 awaits the answer to
            every state; a topic of period T and lag T is awaited once a period, and with lag 2 T
            it may be one message behind. Before its first message a topic counts as having
            answered time 0: time waits for a slow starter as soon as its lag is used up.
    """

    def __init__(self, lag_ns_by_topic: Mapping[str, int]) -> None:
        self._lag_ns = dict(lag_ns_by_topic)
        self.restart()

    def restart(self, start_ns: int = 0) -> None:
        """Begin again at a time [ns], up to which all have answered."""
        self._start_ns = start_ns
        self._stamp_ns = dict.fromkeys(self._lag_ns, start_ns)

    @property
    def topics(self) -> tuple[str, ...]:
        """The awaited topics."""
        return tuple(self._lag_ns)

    def answer(self, topic: str, stamp_ns: int) -> None:
        """Record that `topic` has answered up to `stamp_ns`; older stamps change nothing."""
        self._stamp_ns[topic] = max(self._stamp_ns[topic], stamp_ns)

    def has_answered(self, topic: str) -> bool:
        """Return whether `topic` has answered any stamp after the start."""
        return self._stamp_ns[topic] > self._start_ns

    def is_starting(self, now_ns: int) -> bool:
        """Return whether others may still begin at a time [ns]."""
        return now_ns <= self._start_ns + STARTED_NS

    def is_open(self, now_ns: int) -> bool:
        """Return whether time may advance from `now_ns`."""
        for topic, lag_ns in self._lag_ns.items():
            stamp_ns = self._stamp_ns[topic]
            if stamp_ns < now_ns and stamp_ns <= now_ns - lag_ns:
                return False
        return True

    def missing(self, now_ns: int) -> dict[str, int]:
        """Return topic → newest stamp [ns] of the topics that time waits for at `now_ns`."""
        return {t: s for t, s in self._stamp_ns.items()
                if s < now_ns and s <= now_ns - self._lag_ns[t]}

    def behind(self, now_ns: int) -> dict[str, int]:
        """Return topic → newest stamp [ns] of the topics that have not answered `now_ns`."""
        return {t: s for t, s in self._stamp_ns.items() if s < now_ns}


class WrittenStamps:
    """The stamp up to which everything is written of topics that come at their own periods.

    Args:
        period_ns_by_topic: Topic → period [ns], 0 where it is not known. Messages are due at whole
            multiples of the period. A topic whose newest message has the stamp s is complete up to
            the state before its next message, s + period - tick, where tick is the shortest
            period. Otherwise a slow topic would hold back time at an end that it does not fall on.
    """

    def __init__(self, period_ns_by_topic: Mapping[str, int]) -> None:
        tick_ns = min((p for p in period_ns_by_topic.values() if p), default=0)
        self._complete_ns = {t: max(0, p - tick_ns) for t, p in period_ns_by_topic.items()}
        self._stamp_ns = dict.fromkeys(period_ns_by_topic, 0)
        self._up_to_ns = 0

    def restart(self, start_ns: int = 0) -> None:
        """Begin again at a time [ns], up to which everything is written."""
        self._stamp_ns = dict.fromkeys(self._stamp_ns, start_ns)
        self._up_to_ns = start_ns

    @property
    def up_to_ns(self) -> int:
        """The stamp [ns] up to which every topic is written; it never goes back."""
        return self._up_to_ns

    def write(self, topic: str, stamp_ns: int) -> bool:
        """Note that a message is written; return whether `topic` is one of them.

        An older stamp than before, as others may put on tf, changes nothing.
        """
        if topic not in self._stamp_ns:
            return False
        self._stamp_ns[topic] = max(self._stamp_ns[topic], stamp_ns)
        self._up_to_ns = max(self._up_to_ns, min(
            stamp + self._complete_ns[t] for t, stamp in self._stamp_ns.items()))
        return True
