"""Reports of physics_node on /diagnostics: state rate, pace, participants, drops, attitude."""

from __future__ import annotations

from collections.abc import Callable
import time

from lunar_rover_sim.nodes.diagnostics import (Diagnostics, Drops, ERROR, OK, Rate, SubjectStatus,
                                               TOLERANCE, WARN)
from lunar_rover_sim.nodes.node_main import GraphNode
from lunar_rover_sim.rover.physics.state import RoverState, TipOver
from lunar_rover_sim.run.lockstep import StampGate
from lunar_rover_sim.run.node_config import PhysicsNodeConfig

# A participant is late when it lags by more than it may, and by more than this [ns]. A lag of
# this many times as much is an error, as is this share of the real-time factor.
_LATE_NS, _ERROR_TIMES, _ERROR_SHARE = 100_000_000, 10, 0.5


class PhysicsDiagnostics:
    """Reports on a running simulation.

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
