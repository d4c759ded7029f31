"""A controller of your own: answers odometry with velocities, 20 times per simulated second."""

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node


class Controller(Node):
    """Walks straight on and swings its head."""

    def __init__(self):
        super().__init__('controller')
        self._publisher = self.create_publisher(TwistStamped, 'cmd_vel', 10)
        self.create_subscription(Odometry, 'odom', self._odom_callback, 10)

    def _odom_callback(self, odom):
        stamp = odom.header.stamp
        if stamp.nanosec % 50_000_000 == 0:
            command = TwistStamped()
            command.header.stamp = stamp        # tells which odometry this answers
            command.header.frame_id = 'base_link'
            command.twist.linear.x = 0.1
            command.twist.angular.z = 0.2 if stamp.sec // 2 % 2 else -0.2
            self._publisher.publish(command)


def main():
    """Run until Ctrl-C."""
    rclpy.init()
    try:
        rclpy.spin(Controller())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == '__main__':
    main()
