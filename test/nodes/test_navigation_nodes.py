"""mapping_node on clouds of a LiDAR; goals that navigator_node refuses."""

import signal
import threading

import numpy as np
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402  (needs rclpy)
from geometry_msgs.msg import PoseStamped  # noqa: E402
from nav_msgs.msg import OccupancyGrid, Odometry  # noqa: E402
from peer import at_rest_odometry, running  # noqa: E402
from sensor_msgs.msg import PointCloud2  # noqa: E402

from lunar_rover_sim.base.frames import inverse, se3  # noqa: E402
from lunar_rover_sim.nodes.conversions import time_msg  # noqa: E402
from lunar_rover_sim.nodes.map_conversions import traversability_of  # noqa: E402
from lunar_rover_sim.nodes.qos import reliable  # noqa: E402
from lunar_rover_sim.rover.description import load_rover  # noqa: E402
from lunar_rover_sim.rover.mounts import lidar_pose  # noqa: E402


def test_clouds_of_a_lidar_become_a_map(peer):
    """A plain, and a block of 0.15 m on it: as high as no spoke can climb."""
    x, y = np.meshgrid(np.arange(0.4, 3.0, 0.03), np.arange(-1.0, 1.0, 0.03))
    z = np.where((np.abs(x - 2.0) < 0.1) & (np.abs(y) < 0.1), 0.15, 0.0)
    T = inverse(se3(np.eye(3), (0.0, 0.0, 0.1)) @ lidar_pose(load_rover(None)))
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]
    cloud = PointCloud2(height=1, width=len(points), point_step=12, row_step=12 * len(points))
    cloud.data = points.astype('<f4').tobytes()
    grids, heights = peer.listen(OccupancyGrid, 'map/traversability'), peer.listen(
        PointCloud2, 'map/elevation')
    clouds = peer.node.create_publisher(PointCloud2, 'lidar/points_deskewed', 10)
    poses = peer.node.create_publisher(Odometry, 'odom', 10)
    odometry, stamps = at_rest_odometry(), iter(range(10**9, 10**12, 10**8))

    def send():
        if poses.get_subscription_count() and clouds.get_subscription_count():
            cloud.header.stamp = odometry.header.stamp = time_msg(next(stamps))
            poses.publish(odometry)
            clouds.publish(cloud)

    with running('mapping_node', '-p', 'depth:=lidar'):
        peer.spin_until(lambda: heights and heights[-1].width
                        and any(100 in grid.data for grid in grids),
                        meanwhile=send)
    found = traversability_of(next(grid for grid in reversed(grids) if 100 in grid.data))
    rows, columns = np.nonzero(found.cost == 100)
    block = found.origin_m + (np.column_stack([columns, rows]) + 0.5) * found.cell_m
    assert np.abs(block - (2.0, 0.0)).max() < 0.2
    cell = np.floor(((1.0, 0.0) - found.origin_m) / found.cell_m).astype(int)
    assert 0 <= found.cost[cell[1], cell[0]] < 10
    seen = np.frombuffer(heights[-1].data.tobytes(), '<f4').reshape(-1, 4)
    plain = np.abs(seen[:, 0] - 1.0) < 0.3
    assert plain.any() and np.abs(seen[plain, 2]).max() < 1e-3


def test_a_goal_in_an_unknown_frame_is_refused(peer):
    goals = peer.node.create_publisher(PoseStamped, 'goal_pose', 10)
    told = peer.listen(PoseStamped, 'goal')
    poses = peer.node.create_publisher(Odometry, 'odom', 10)
    odometry, stamps = at_rest_odometry(), iter(range(10**9, 10**12, 10**8))
    frame = ['nowhere']

    def send():
        if goals.get_subscription_count() and poses.get_subscription_count():
            goal = PoseStamped()
            goal.header.frame_id = frame[0]
            goal.pose.position.x = 2.0
            goals.publish(goal)
            odometry.header.stamp = time_msg(next(stamps))
            poses.publish(odometry)

    lines: list[str] = []
    with running('navigator_node') as node:
        reader = threading.Thread(target=lambda: [lines.append(line) for line in node.stdout])
        reader.start()
        peer.spin_until(lambda: any('refused' in line for line in lines), meanwhile=send)
        assert not told
        frame[0] = 'odom'
        peer.spin_until(lambda: told, meanwhile=send)
        # Who comes late is told what it is doing.
        late = []
        peer.node.create_subscription(DiagnosticArray, 'navigator/status', late.append,
                                      reliable(1, durable=True))
        peer.spin_until(lambda: late)
        assert late[-1].status[0].message == 'waiting'
        node.send_signal(signal.SIGINT)
        reader.join()
    assert told[0].pose.position.x == 2.0
    refused = next(line for line in lines if 'refused' in line)
    assert "goal: frame 'nowhere' has no transform here; valid are odom, base_link" in refused
