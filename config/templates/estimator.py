"""An estimator of your own: answers each pair of images with a pose that has their stamp."""

from geometry_msgs.msg import PoseStamped
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import Image


class Estimator(Node):
    """Pairs left and right images by their stamp; put your SLAM system into `estimate`."""

    def __init__(self):
        super().__init__('estimator')
        self._left = {}
        self._publisher = self.create_publisher(PoseStamped, 'slam/pose', 10)
        self.create_subscription(Image, 'stereo/left/image_raw', self._left_callback, 10)
        self.create_subscription(Image, 'stereo/right/image_raw', self._right_callback, 10)

    def _left_callback(self, image):
        self._left[image.header.stamp.sec, image.header.stamp.nanosec] = image

    def _right_callback(self, right):
        left = self._left.pop((right.header.stamp.sec, right.header.stamp.nanosec), None)
        if left is None:
            return
        pose = PoseStamped()
        pose.header.stamp = left.header.stamp        # tells which images this answers
        pose.header.frame_id = 'odom'
        pose.pose = self.estimate(left, right, pose.pose)
        self._publisher.publish(pose)

    def estimate(self, left, right, pose):
        """Return the pose of base_link in odom; here it stays at the origin."""
        return pose


def main():
    """Run until Ctrl-C."""
    rclpy.init()
    try:
        rclpy.spin(Estimator())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
