"""Pace of time: the wall clock, or steps that a service grants while time is paused.

rclpy's events executor awaits no coroutine: a callback that waited in the node's thread would wait
for ever. So the service has a thread, and a ROS node for it.
"""

from __future__ import annotations

from collections.abc import Callable
import threading
import time
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node


class Stepping:
    """Steps granted while time is paused.

    Args:
        wake: Makes the node look for granted steps; it may be called in any thread.
    """

    def __init__(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        self._changed = threading.Condition()
        self._left = 0
        self._problem: str | None = None

    def run(self, count: int) -> str | None:
        """Grant steps and wait until they are made; return why they were not, or None."""
        with self._changed:
            self._left, self._problem = count, None
            self._wake()
            self._changed.wait_for(lambda: not self._left)
            return self._problem

    @property
    def pending(self) -> bool:
        """Whether a step is granted."""
        return self._left > 0

    def made(self) -> None:
        """Note that the node has made a step."""
        with self._changed:
            self._left = max(self._left - 1, 0)
            self._changed.notify_all()

    def cancel(self, problem: str) -> None:
        """Withdraw what is left."""
        with self._changed:
            if self._left:
                self._left, self._problem = 0, problem
            self._changed.notify_all()


class ServiceThread:
    """A thread beside a node that answers `~/NAME`, where callbacks may wait.

    Args:
        node: Whose services these are.
        name: Of the thread's own node, after that of `node`.
        offer: Makes services and actions on the thread's node; called with it and with what
            returns the full name of `NAME`. One callback runs at a time.
    """

    def __init__(self, node: Node, name: str,
                 offer: Callable[[Node, Callable[[str], str]], None]) -> None:
        # Remaps of the process, its __node above all, are for the node itself.
        self._node = rclpy.create_node(
            f'{node.get_name()}_{name}', namespace=node.get_namespace(),
            use_global_arguments=False, enable_rosout=False, start_parameter_services=False)
        offer(self._node, lambda own: node.resolve_service_name(f'~/{own}'))
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass        # the context has ended: so does the thread

    def close(self) -> None:
        """End the thread; nobody may be waiting in the callback."""
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()


# Wall times: the first report comes early, for short runs.
_FIRST_REPORT_S, _REPORT_S = 5.0, 60.0


class WallPace:
    """How much simulated time is due by the wall clock at a real-time factor.

    Args:
        factor: Simulated time per wall time.
        period_ns: Simulated time of a period [ns].
        most_periods: Largest delay that is made up for, in periods. The rest is given up, and
            reported once a minute with the mean factor since the last report.
        logger: Gets the reports.
    """

    def __init__(self, factor: float, period_ns: int, most_periods: int, logger: Any) -> None:
        self._factor = factor
        self._period_ns = period_ns
        self._most = most_periods
        self._logger = logger
        self._given_up_s = 0.0
        self._report_due_s = _FIRST_REPORT_S
        self.restart(0)

    def restart(self, now_ns: int) -> None:
        """Count from simulated time `now_ns` [ns] and the present wall time on."""
        self._wall_s, self._start_ns = time.monotonic(), now_ns
        self._report_wall_s, self._report_ns = self._wall_s, now_ns

    def due_periods(self, now_ns: int) -> int:
        """Return how many periods are due at simulated time `now_ns` [ns]."""
        wall_s = time.monotonic()
        due_ns = self._start_ns + round((wall_s - self._wall_s) * 1e9 * self._factor)
        behind = (due_ns - now_ns) // self._period_ns
        if behind <= self._most:
            return behind
        self._given_up_s += behind * self._period_ns / 1e9
        self._wall_s, self._start_ns = wall_s, now_ns
        elapsed_s = wall_s - self._report_wall_s
        if elapsed_s >= self._report_due_s:
            reached = (now_ns - self._report_ns) / 1e9 / elapsed_s
            self._logger.warning(
                f'real_time_factor {self._factor:g} is not reached: {reached:.2f} in the mean of '
                f'{elapsed_s:.0f} s, {self._given_up_s:.1f} s given up so far')
            self._report_wall_s, self._report_ns = wall_s, now_ns
            self._report_due_s = _REPORT_S
        return 1
