"""Real time: a renderer that is slower than its rate shows the newest state, not the oldest."""

from __future__ import annotations

from pathlib import Path

import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from nav_msgs.msg import Odometry  # noqa: E402  (needs rclpy)
from peer import at_rest_odometry, Peer, running  # noqa: E402
from rclpy.qos import QoSProfile  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

PERIOD_NS = 100_000_000
STATE_NS = 5_000_000


def test_states_that_piled_up_are_not_drawn_one_by_one(peer: Peer, world_folder: Path) -> None:
    """Two seconds of states at once: a few frames, on their periods, and the last one among them.

    One by one they would be twenty frames, and the images of a drive would lag ever farther
    behind.
    """
    images = peer.listen(Image, 'stereo/left/image_raw', 50)
    poses = peer.node.create_publisher(Odometry, 'odom', QoSProfile(depth=1000))

    def publish(stamp_ns: int) -> None:
        odometry = at_rest_odometry()
        odometry.header.stamp.sec, odometry.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        poses.publish(odometry)

    def stamps_ns() -> list[int]:
        return [image.header.stamp.sec * 10**9 + image.header.stamp.nanosec for image in images]

    with running('render_node', '-p', f'world:={world_folder}', '-p', 'time_mode:=real_time',
                 '-p', 'frame_rate_hz:=10'):
        peer.spin_until(lambda: bool(images),
                        meanwhile=lambda: publish(3 * 10**9))
        images.clear()
        first, last = 4 * 10**9, 6 * 10**9
        for stamp in range(first, last + STATE_NS, STATE_NS):
            publish(stamp)
        peer.spin_until(lambda: bool(images) and stamps_ns()[-1] == last)
    assert len(images) <= 10
    assert all(stamp % PERIOD_NS == 0 for stamp in stamps_ns())
