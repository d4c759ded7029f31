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
        self._waiting = {}      # images whose other one is still to come, by stamp
        self._publisher = self.create_publisher(PoseStamped, 'slam/pose', 10)
        for side in ('left', 'right'):
            self.create_subscription(Image, f'stereo/{side}/image_raw',
                                     lambda image, side=side: self._receive(image, side), 10)

    def _receive(self, image, side):
        pair = self._waiting.setdefault(str(image.header.stamp), {})
        pair[side] = image
        if len(pair) == 2:      # either may be the first
            del self._waiting[str(image.header.stamp)]
            pose = PoseStamped()
            pose.header.stamp = pair['left'].header.stamp       # tells which images this answers
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
