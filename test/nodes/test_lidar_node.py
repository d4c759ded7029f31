"""lidar_node in runs: its messages, and a run that goes on without it."""

import contextlib
import re

import numpy as np
import pytest
from waiting import wait_until

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from nav_msgs.msg import Odometry  # noqa: E402  (needs rclpy)
from peer import at_rest_odometry, running  # noqa: E402
from sensor_msgs.msg import PointCloud2  # noqa: E402

from lunar_rover_sim.bag.messages import header_ns, pose_matrix  # noqa: E402
from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.base.errors import GraphError  # noqa: E402
from lunar_rover_sim.image.lidar.motion import ScanMotion  # noqa: E402
from lunar_rover_sim.image.lidar.scan import POINT  # noqa: E402
from lunar_rover_sim.nodes.conversions import time_msg  # noqa: E402
from lunar_rover_sim.products.inspection.check import check  # noqa: E402
from lunar_rover_sim.run.node_processes import NodeProcesses  # noqa: E402
from lunar_rover_sim.run.plan import NodePlan, SCENARIO_FILE  # noqa: E402
from lunar_rover_sim.run.recording import record  # noqa: E402
from lunar_rover_sim.run.scenario import Scenario  # noqa: E402

SMALL = {'world.size_m': 12.8, 'world.surroundings.samples': 257, 'seed': 3,
         'recorder_node.topics': ['all', 'lidar/points', 'lidar/scan'],
         'run.nodes': ['physics_node', 'gait_controller_node', 'recorder_node', 'lidar_node']}


def test_scans_in_a_bag(tmp_path):
    """The clouds are those of the same motion in Python, number by number."""
    scenario = Scenario.load('flat', {**SMALL, 'lidar_node.part': 'espros_tofcam635',
                                      'rover.lidar.rpy_deg': [0.0, 10.0, 90.0],
                                      'rover.lidar.position_m': [0.0, -0.35, 0.05],
                                      'lidar_node.own_body': 'end'}, duration_s=0.45)
    result = record(scenario, tmp_path / 'run')
    # Rounded up to whole scans and frames: 0.5 s. The first scan is that of the second period.
    assert result.counts['/lidar/points'] == result.counts['/lidar/scan'] == 4
    assert '/lidar/points_deskewed' not in result.counts
    report = check(result.bag)
    assert not report.failed and 'scans' in {finding.check for finding in report.findings}
    lidar = result.scenario.lidar()
    with open_bag(result.bag) as bag:
        states = {ns: pose_matrix(odom) for _, ns, odom in bag.messages(['/odom'])}
        angles = {ns: legs.position[:4] for _, ns, legs in bag.messages(['/joint_states'])}
        clouds = [(ns, cloud) for _, ns, cloud in bag.messages(['/lidar/points'])]
        planar = [scan for _, _, scan in bag.messages(['/lidar/scan'])]
    for start, cloud in clouds:
        stamps = range(start, start + 100_000_001, 5_000_000)
        scan = lidar.scan(ScanMotion([1e-9 * (s - start) for s in stamps],
                                     [states[s] for s in stamps], [angles[s] for s in stamps]),
                          start // 100_000_000)
        points = np.frombuffer(cloud.data.tobytes(), POINT)
        assert np.array_equal(points, scan.cloud())
        assert cloud.is_dense and cloud.width == len(points) > 1000
        assert [f.name for f in cloud.fields] == list(POINT.names)
    assert planar[0].header.frame_id == 'lidar_link'
    assert len(planar[0].ranges) == 160 and planar[0].range_max == 7.5


def test_states_that_were_missed(peer, world_folder):
    """Time does not wait for a node that may fail: its first scan is the first one seen whole."""
    clouds = peer.listen(PointCloud2, 'lidar/points')
    poses = peer.node.create_publisher(Odometry, 'odom', 10)
    odometry, sent = at_rest_odometry(), []

    def send():
        if poses.get_subscription_count():
            sent.append(1_730_000_000 + 50_000_000 * len(sent))
            odometry.header.stamp = time_msg(sent[-1])
            poses.publish(odometry)

    with running('lidar_node', '-p', f'world:={world_folder}', '-p', 'time_mode:=lockstep',
                 '-p', 'part:=espros_tofcam635'):
        peer.spin_until(lambda: len(clouds) > 2, meanwhile=send)
    stamps = np.array([header_ns(cloud) for cloud in clouds])
    assert sent[0] < stamps[0] < sent[-1] and not (stamps % 100_000_000).any()
    assert (np.diff(stamps) == 100_000_000).all()


@pytest.mark.parametrize('may_fail', [['lidar_node'], []])
def test_a_node_that_dies(tmp_path, may_fail):
    """It is named with its reason; the others go on, or not, as the scenario says."""
    (tmp_path / SCENARIO_FILE).write_text('{}')
    with contextlib.ExitStack() as stack:
        if not may_fail:
            stack.enter_context(pytest.raises(GraphError, match="lidar_node .*: world: '' is not"))
        nodes = stack.enter_context(NodeProcesses([NodePlan('lidar_node', {})], tmp_path, 77,
                                                  may_fail))
        wait_until(lambda: nodes.lost, meanwhile=nodes.has_finished)
        assert re.search("lidar_node ended with status 1: world: '' is .*; the run goes on",
                         nodes.lost['lidar_node'])


def test_an_unread_node_traces_no_scan_and_does_not_listen(peer, world_folder):
    """It has no reader, then one, then none again."""
    poses = peer.node.create_publisher(Odometry, 'odom', 10)
    odometry, sent = at_rest_odometry(), []

    def send():
        sent.append(50_000_000 * (len(sent) + 1))
        odometry.header.stamp = time_msg(sent[-1])
        poses.publish(odometry)

    with running('lidar_node', '-p', f'world:={world_folder}', '-p',
                 'part:=espros_tofcam635'):
        peer.spin_until(lambda: peer.node.count_publishers('lidar/points') == 1)
        peer.spin_until(lambda: len(sent) >= 20, meanwhile=send)
        assert poses.get_subscription_count() == 0      # no scan without states
        clouds = peer.listen(PointCloud2, 'lidar/points')
        peer.spin_until(lambda: poses.get_subscription_count() == 1)
        peer.spin_until(lambda: len(clouds) > 2, meanwhile=send)
        first = header_ns(clouds[0])
        # What was driven before is no scan that was left out.
        assert first > 20 * 50_000_000 and first % 100_000_000 == 0
        peer.node.destroy_subscription(list(peer.node.subscriptions)[-1])
        peer.spin_until(lambda: poses.get_subscription_count() == 0)
