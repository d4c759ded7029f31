"""Prints how far simulated time has come, ten times a second [ns].

    python -m lunar_rover_sim.nodes.clock_monitor

The supervisor of a run reads it, and thereby needs no ROS in its own process. The queue holds one
message, and the monitor takes it when it prints: the messages in between cost nothing. It ends at
the end of its input, which comes also when the supervisor is killed.
"""

from __future__ import annotations

import select
import sys

import rclpy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.closing import Closing
from lunar_rover_sim.nodes import qos
from lunar_rover_sim.nodes.node_main import bound_leaving

_PERIOD_S = 0.1


class ClockMonitor(Closing):
    """Takes the newest clock message on request; context manager."""

    def __init__(self) -> None:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node('lunar_rover_sim_run', start_parameter_services=False,
                                       enable_rosout=False)
        self._now_ns = 0
        self._node.create_subscription(Clock, topics.CLOCK.graph_name, self._clock_callback,
                                       qos.reliable(1))

    def _clock_callback(self, message: Clock) -> None:
        self._now_ns = time_ns(message.clock)

    def now_ns(self) -> int:
        """Return the newest simulated time [ns]; 0 before the first clock message."""
        rclpy.spin_once(self._node, timeout_sec=0.0)
        return self._now_ns

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        rclpy.try_shutdown()


def main() -> None:
    """Print until the input ends."""
    with ClockMonitor() as clock:
        while not select.select([sys.stdin], [], [], _PERIOD_S)[0]:
            print(clock.now_ns(), flush=True)
        bound_leaving()


if __name__ == '__main__':
    main()
