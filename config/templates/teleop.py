"""A teleoperation of your own: sends the newest command ten times a second of wall time.

Twist has no stamp. In lockstep time does not wait for it, and the run is not repeatable.
"""

import sys
import threading

from geometry_msgs.msg import Twist
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node


class Teleop(Node):
    """Reads lines `FORWARD_MPS YAW_RATE_RADPS` from the standard input."""

    def __init__(self):
        super().__init__('teleop')
        self._command = Twist()
        self._publisher = self.create_publisher(Twist, 'cmd_vel', 10)
        # The clock of the wall: with use_sim_time the node's own would follow simulated time.
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.1, lambda: self._publisher.publish(self._command), clock=clock)
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in sys.stdin:
            self._command.linear.x, self._command.angular.z = map(float, line.split())


def main():
    """Run until Ctrl-C."""
    rclpy.init()
    try:
        rclpy.spin(Teleop())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == '__main__':
    main()
