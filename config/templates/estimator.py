"""An estimator of your own: answers each pair of images with a pose that has their stamp."""

from geometry_msgs.msg import PoseStamped
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import Image


class Estimator(Node):
    """Pairs images by their stamp; put your SLAM system where the pose is filled."""

    def __init__(self):
        super().__init__('estimator')
        self._left = {}
        self._publisher = self.create_publisher(PoseStamped, 'slam/pose', 10)
        self.create_subscription(Image, 'stereo/left/image_raw', self._left_callback, 10)
        self.create_subscription(Image, 'stereo/right/image_raw', self._right_callback, 10)

    def _left_callback(self, left):
        self._left[str(left.header.stamp)] = left

    def _right_callback(self, right):
        left = self._left.pop(str(right.header.stamp), None)
        if left is not None:
            pose = PoseStamped()
            pose.header.stamp = left.header.stamp        # tells which images this answers
            pose.header.frame_id = 'odom'
            pose.pose.position.x = 0.0      # of base_link in odom
            self._publisher.publish(pose)


def main():
    """Run until Ctrl-C."""
    rclpy.init()
    try:
        rclpy.spin(Estimator())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == '__main__':
    main()
