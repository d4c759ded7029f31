"""How far simulated time has come, read without taking part in the graph's traffic."""

from __future__ import annotations

from types import TracebackType

import rclpy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from lunar_rover_sim import topics
from lunar_rover_sim.nodes import conversions, qos


class ClockMonitor:
    """Takes the newest clock message when asked; context manager."""

    def __init__(self) -> None:
        # The runner that owns this handles its signals itself.
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node('lunar_rover_sim_run', start_parameter_services=False,
                                       enable_rosout=False)
        self._subscription = self._node.create_subscription(
            Clock, topics.CLOCK.name, lambda _: None, qos.newest())
        self._now_ns = 0

    def now_ns(self) -> int:
        """Return the newest simulated time [ns]; 0 before the first clock message."""
        with self._subscription.handle:
            taken = self._subscription.handle.take_message(Clock, False)
        if taken is not None:
            self._now_ns = conversions.time_ns(taken[0].clock)
        return self._now_ns

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        rclpy.try_shutdown()

    def __enter__(self) -> ClockMonitor:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 traceback: TracebackType | None) -> None:
        self.close()
