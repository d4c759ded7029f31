"""mapping_node on clouds of a LiDAR; goals that navigator_node refuses; a rover gone blind."""

import signal
import threading

import numpy as np
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402  (needs rclpy)
from geometry_msgs.msg import PoseStamped, TwistStamped  # noqa: E402
from nav_msgs.msg import OccupancyGrid, Odometry  # noqa: E402
from peer import at_rest_odometry, running  # noqa: E402
from sensor_msgs.msg import Image, PointCloud2  # noqa: E402

from lunar_rover_sim.bag.messages import header_ns  # noqa: E402
from lunar_rover_sim.base.frames import inverse, se3, wxyz_from_rpy  # noqa: E402
from lunar_rover_sim.image.camera.config import CameraConfig  # noqa: E402
from lunar_rover_sim.image.camera.rig import StereoRig  # noqa: E402
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


class Plain:
    """In the place of physics and cameras: level ground, and legs that do what they are told."""

    PERIOD_S = 0.1
    CAMERA = CameraConfig(width=160, height=120)

    def __init__(self, peer):
        self.peer, self.now_ns = peer, 10**9
        self.x = self.y = self.yaw = 0.0
        self.odometry = peer.node.create_publisher(Odometry, 'odom', 10)
        self.images = peer.node.create_publisher(Image, 'ground_truth/depth/image', 10)
        self.maps = peer.listen(OccupancyGrid, 'map/traversability')
        self.velocities = peer.listen(TwistStamped, 'cmd_vel')
        self.statuses = peer.listen(DiagnosticArray, 'navigator/status')
        rig = StereoRig(load_rover(None), self.CAMERA)
        T = se3(np.eye(3), (0.0, 0.0, 0.1)) @ rig.T_base_left
        v, u = np.mgrid[0:120, 0:160]
        down = np.stack([u, v, np.ones(u.shape)], -1) @ np.linalg.inv(rig.K).T @ T[2, :3]
        self.seen = np.where(down < -0.01, -T[2, 3] / np.minimum(down, -0.01), np.nan)

    def send(self, depth):
        """Send where the rover is, and what it sees; None: nothing."""
        self.now_ns += round(self.PERIOD_S * 1e9)
        pose = at_rest_odometry()
        pose.header.stamp = time_msg(self.now_ns)
        pose.pose.pose.position.x, pose.pose.pose.position.y = self.x, self.y
        q = pose.pose.pose.orientation
        q.w, q.x, q.y, q.z = wxyz_from_rpy(0.0, 0.0, self.yaw)
        self.odometry.publish(pose)
        if depth is not None:
            image = Image(height=120, width=160, encoding='32FC1', step=640)
            image.header.stamp, image.data = pose.header.stamp, depth.astype('<f4').tobytes()
            self.images.publish(image)

    def step(self, depth):
        """Send, wait for all answers, and move; return velocity [m/s] and yaw rate [rad/s]."""
        self.send(depth)
        self.peer.spin_until(lambda: all(
            answers and header_ns(answers[-1]) == self.now_ns
            for answers in (self.velocities, *([] if depth is None else [self.maps]))))
        twist = self.velocities[-1].twist
        self.yaw += self.PERIOD_S * twist.angular.z
        self.x += self.PERIOD_S * twist.linear.x * np.cos(self.yaw)
        self.y += self.PERIOD_S * twist.linear.x * np.sin(self.yaw)
        return twist.linear.x, twist.angular.z


@pytest.mark.parametrize('blind', [np.full((120, 160), np.nan), None],
                         ids=['a covered lens', 'a dead camera'])
def test_a_rover_gone_blind_stands_looks_around_and_gives_up(peer, blind):
    """It stands `map_age_s` after the last depth; what it knew is no ground to drive on."""
    turn_radps, age_s, lost_s = 1.0, 1.5, 2.0
    goal = ('-p', 'has_goal:=true', '-p', 'goal_x_m:=9.0', '-p', 'rate_hz:=10', '-p',
            f'map_age_s:={age_s}', '-p', f'lost_s:={lost_s}', '-p',
            f'max_yaw_rate_radps:={turn_radps}')
    with running('mapping_node', '-p', 'depth:=true_depth', '-p', 'camera.width:=160', '-p',
                 'camera.height:=120'), running('navigator_node', *goal):
        plain = Plain(peer)
        peer.spin_until(lambda: plain.maps and plain.velocities and plain.statuses,
                        meanwhile=lambda: plain.send(plain.seen))
        drive = [plain.step(plain.seen) for _ in range(60)]
        assert plain.x > 0.3 and drive[-1][0] > 0.1
        # It looks around once, and gives up; then for a second more.
        left_s = age_s + lost_s + 1.5 * 2.0 * np.pi / turn_radps + age_s + 1.0
        after = np.array([plain.step(blind) for _ in range(round(left_s / plain.PERIOD_S))])
    late = round(age_s / plain.PERIOD_S) + 1    # of commands, by the period of maps
    assert (after[:late - 2, 0] > 0.0).all() and not after[late:, 0].any()
    assert 6.0 < np.abs(after[late:, 1]).sum() * plain.PERIOD_S < 7.0
    assert not after[-10:].any()
    assert plain.statuses[-1].status[0].message == 'failed'
