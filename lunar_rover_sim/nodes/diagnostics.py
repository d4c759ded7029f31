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
from lunar_rover_sim.rover.physics.state import RoverState, TipOver
from lunar_rover_sim.run.lockstep import StampGate
from lunar_rover_sim.run.node_config import PhysicsNodeConfig

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
        self._publisher = qos.publisher(node, topics.DIAGNOSTICS)
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


# A participant is late when it lags by more than it may, and by more than this [ns]. A lag of
# this many times as much is an error, as is this share of the real-time factor.
_LATE_NS, _ERROR_TIMES, _ERROR_SHARE = 100_000_000, 10, 0.5


class PhysicsDiagnostics:
    """Reports on a running simulation: state rate, pace, participants, drops, attitude.

    Args:
        node: physics_node.
        config: Its parameters.
        gate: Knows by how much participants lag.
        drops: Messages that were lost.
        now_ns: Returns the simulated time [ns].
        is_paused: Returns whether time stands still on purpose.
    """

    def __init__(self, node: GraphNode, config: PhysicsNodeConfig, gate: StampGate, drops: Drops,
                 now_ns: Callable[[], int], is_paused: Callable[[], bool]) -> None:
        self._factor = 0.0 if config.lockstep else config.real_time_factor
        self._rate = Rate(config.state_rate_hz * self._factor)
        self._gate = gate
        self._lags_ns = config.wait.lag_ns_by_topic()
        self._now_ns, self._is_paused = now_ns, is_paused
        self._last_s, self._last_ns = time.monotonic(), now_ns()
        Diagnostics(node, {'State rate': self._state_rate, 'Real-time factor': self._speed,
                           'Participants': self._participants, 'Drops': drops.status,
                           'Attitude': self._attitude})
        self._warnings, self._tip_over = node.warnings, TipOver()

    def tick(self, state: RoverState) -> None:
        """Count one state, and warn where the rover tips over with it."""
        self._rate.tick()
        if self._tip_over.has_begun(state.orientation_wxyz):
            x, y, _ = state.position_m
            self._warnings.add('tip-over', f'tipped over at {self._now_ns() / 1e9:.2f} s, x '
                               f'{x:.2f} m, y {y:.2f} m')

    def _state_rate(self) -> SubjectStatus:
        return self._rate.status('Paused' if self._is_paused() else '')

    def _speed(self) -> SubjectStatus:
        """Compare the pace of the last second with the one that is wanted."""
        now_s, now_ns = time.monotonic(), self._now_ns()
        # Time may have begun at 0 again.
        advanced_ns = max(now_ns - self._last_ns, 0)
        actual = advanced_ns / 1e9 / max(now_s - self._last_s, 1e-9)
        self._last_s, self._last_ns = now_s, now_ns
        level, message = OK, 'Real-time factor met'
        if self._is_paused():
            message = 'Paused'
        elif not self._factor:
            message = 'Lockstep: as fast as the participants'
        elif actual < _ERROR_SHARE * self._factor:
            level, message = ERROR, 'Far slower than asked for'
        elif actual < (1.0 - TOLERANCE) * self._factor:
            level, message = WARN, 'Slower than asked for'
        values = {'Actual real-time factor': f'{actual:.3f}',
                  'Simulated time (s)': f'{now_ns / 1e9:.3f}'}
        if self._factor:
            values['Target real-time factor'] = f'{self._factor:g}'
        return SubjectStatus(level, message, values)

    def _attitude(self) -> SubjectStatus:
        values = {'Tilt (deg)': f'{self._tip_over.tilt_deg:.1f}'}
        if self._tip_over.lies:
            return SubjectStatus(ERROR, 'Tipped over', values)
        return SubjectStatus(OK, 'Upright', values)

    def _participants(self) -> SubjectStatus:
        """Return by how much each awaited topic is behind the simulated time."""
        now_ns, values, level = self._now_ns(), {}, OK
        behind, late = self._gate.behind(now_ns), []
        for topic, allowed_ns in self._lags_ns.items():
            lag_ns = now_ns - behind.get(topic, now_ns)
            values[f'Lag of {topic} (s)'] = f'{lag_ns / 1e9:.3f}'
            values[f'Allowed lag of {topic} (s)'] = f'{allowed_ns / 1e9:.3f}'
            limit_ns = max(allowed_ns, _LATE_NS)
            if lag_ns > limit_ns:
                late.append(topic)
                level = max(level, ERROR if lag_ns > _ERROR_TIMES * limit_ns else WARN)
        if late:
            return SubjectStatus(level, 'Late: ' + ', '.join(late), values)
        return SubjectStatus(level, 'All are in time' if values else 'Nobody is awaited', values)
