"""Large messages from process to process, through the profile of Fast DDS in config/."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from peer import Peer  # noqa: E402  (needs rclpy)
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

COUNT = 3
SENDER = f"""
import array, sys, time, rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image
rclpy.init()
node = rclpy.create_node('sender')
images = node.create_publisher(Image, 'large', qos_profile_sensor_data)
message = Image(data=array.array('B', bytes(640 * 480 * 4)))
while images.get_subscription_count() == 0:
    time.sleep(0.02)
sys.stdin.readline()
for k in range({COUNT}):
    message.width = k
    images.publish(message)
print('sent', flush=True)
sys.stdin.readline()
"""


def test_a_burst_waits_in_shared_memory(peer: Peer) -> None:
    """Best effort, a reader without time for a second: 3.7 MB arrive, more than a default frame.

    The default segment of half a megabyte holds less than one image of 1.2 MB.
    """
    with subprocess.Popen([sys.executable, '-c', SENDER], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE, text=True, env=os.environ) as sender:
        try:
            assert sender.stdin is not None and sender.stdout is not None
            received = peer.listen(Image, 'large', qos_profile_sensor_data)
            peer.spin_until(lambda: peer.node.count_publishers('large') > 0)
            time.sleep(1.0)
            sender.stdin.write('\n')
            sender.stdin.flush()
            assert sender.stdout.readline() == 'sent\n'
            time.sleep(1.0)
            peer.spin_until(lambda: len(received) == COUNT)
            assert [image.width for image in received] == list(range(COUNT))
        finally:
            sender.kill()
