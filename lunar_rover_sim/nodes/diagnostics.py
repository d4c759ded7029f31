"""Diagnostics of a node on /diagnostics, once per second of wall time, as diagnostic_updater does.

Names, keys and levels follow diagnostic_updater (github.com/ros/diagnostics), so that
diagnostic_aggregator, rqt_robot_monitor and Foxglove show them.
"""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from lunar_rover_sim.base import topics
from lunar_rover_sim.nodes import qos
from lunar_rover_sim.nodes.node_main import GraphNode

_PERIOD_S = 1.0
# diagnostic_updater's tolerance of a frequency, and the length of its window in periods.
TOLERANCE, WINDOW = 0.1, 5
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


@dataclasses.dataclass(frozen=True)
class SubjectStatus:
    """What is to be said of one subject.

    Attributes:
        level: OK, WARN or ERROR.
        values: Key → value as text.
    """

    level: bytes
    message: str
    values: dict[str, str]


class Diagnostics:
    """Publishes what functions report, under `NODE: SUBJECT`; the timer keeps it alive.

    Args:
        node: Whose state is reported.
        subjects: Subject → function that is called once a second, read or not, so that each call
            covers one second.
    """

    def __init__(self, node: GraphNode, subjects: dict[str, Callable[[], SubjectStatus]]) -> None:
        self._node = node
        self._subjects = subjects
        # Two rovers in one graph are told apart by their namespaces.
        self._name = node.get_fully_qualified_name().lstrip('/')
        self._hardware = node.get_namespace().strip('/') or 'lunar_rover'
        self._publisher = node.create_publisher(DiagnosticArray, topics.DIAGNOSTICS.graph_name,
                                                qos.offered(topics.DIAGNOSTICS))
        node.create_timer(_PERIOD_S, self._report)

    def _report(self) -> None:
        statuses = {subject: report() for subject, report in self._subjects.items()}
        if not self._publisher.get_subscription_count():
            return
        msg = DiagnosticArray(status=[
            DiagnosticStatus(
                level=status.level, name=f'{self._name}: {subject}', message=status.message,
                hardware_id=self._hardware,
                values=[KeyValue(key=key, value=value) for key, value in status.values.items()])
            for subject, status in statuses.items()])
        msg.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(msg)


class Rate:
    """The frequency of an event by the wall clock, over a window of five seconds.

    Args:
        target_hz: Expected frequency; one lower by more than a tenth is a warning; 0: none.
    """

    def __init__(self, target_hz: float) -> None:
        self._target_hz = target_hz
        self._count = 0
        self._marks = [(time.monotonic(), 0)] * WINDOW
        self._next = 0

    def tick(self) -> None:
        """Count one event."""
        self._count += 1

    def status(self, idle: str = '') -> SubjectStatus:
        """Return the status since the window began; idle: why no event is expected, if so."""
        now_s, (then_s, before) = time.monotonic(), self._marks[self._next]
        self._marks[self._next] = now_s, self._count
        self._next = (self._next + 1) % WINDOW
        events, window_s = self._count - before, max(now_s - then_s, 1e-9)
        actual_hz, least_hz = events / window_s, self._target_hz * (1.0 - TOLERANCE)
        if idle:
            level, message = OK, idle
        elif not events:
            level, message = ERROR, 'No events recorded.'
        elif actual_hz < least_hz:
            level, message = WARN, 'Frequency too low.'
        else:
            level, message = OK, 'Desired frequency met'
        values = {'Events in window': str(events), 'Events since startup': str(self._count),
                  'Duration of window (s)': f'{window_s:.3f}',
                  'Actual frequency (Hz)': f'{actual_hz:.3f}'}
        if self._target_hz:
            values |= {'Target frequency (Hz)': f'{self._target_hz:g}',
                       'Minimum acceptable frequency (Hz)': f'{least_hz:g}'}
        return SubjectStatus(level, message, values)


class Drops:
    """Counts what was lost; a loss since the last status is a warning."""

    def __init__(self) -> None:
        self._by_kind: dict[str, int] = {}
        self._told = 0

    def add(self, kind: str, count: int = 1) -> None:
        """Count losses of a kind."""
        self._by_kind[kind] = self._by_kind.get(kind, 0) + count

    @property
    def total(self) -> int:
        """All losses since the start."""
        return sum(self._by_kind.values())

    def status(self) -> SubjectStatus:
        """Return the status since the last one, with the counts since the start."""
        total = self.total
        new, self._told = total - self._told, total
        message = f'{new} lost lately' if new else 'Nothing lost lately'
        return SubjectStatus(WARN if new else OK, message,
                             {'Lost since startup': str(total),
                              **{kind: str(count) for kind, count in self._by_kind.items()}})
