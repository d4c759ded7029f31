"""lidar_node in runs: its messages, and a run that goes on without it."""

from __future__ import annotations

import contextlib
import re
import time

import numpy as np
import pytest

from lunar_rover_sim.bag.messages import pose_matrix
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.errors import GraphError
from lunar_rover_sim.inspection.check import check
from lunar_rover_sim.lidar.lidar import Lidar
from lunar_rover_sim.lidar.motion import Motion
from lunar_rover_sim.lidar.scan import POINT
from lunar_rover_sim.run.node_processes import NodeProcesses
from lunar_rover_sim.run.plan import NodePlan, SCENARIO_FILE
from lunar_rover_sim.run.recording import record
from lunar_rover_sim.run.scenario import Scenario

pytestmark = pytest.mark.ros

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
    lidar = Lidar.from_scenario(result.scenario)
    with open_bag(result.bag) as bag:
        states = {ns: pose_matrix(odom) for _, ns, odom in bag.messages(['/odom'])}
        angles = {ns: legs.position[:4] for _, ns, legs in bag.messages(['/joint_states'])}
        clouds = [(ns, cloud) for _, ns, cloud in bag.messages(['/lidar/points'])]
        planar = [scan for _, _, scan in bag.messages(['/lidar/scan'])]
    for start, cloud in clouds:
        stamps = range(start, start + 100_000_001, 5_000_000)
        scan = lidar.scan(Motion([1e-9 * (s - start) for s in stamps],
                                 [states[s] for s in stamps], [angles[s] for s in stamps]),
                          start // 100_000_000)
        points = np.frombuffer(cloud.data.tobytes(), POINT)
        assert np.array_equal(points, scan.cloud())
        assert cloud.is_dense and cloud.width == len(points) > 1000
        assert [f.name for f in cloud.fields] == list(POINT.names)
    assert planar[0].header.frame_id == 'lidar_link'
    assert len(planar[0].ranges) == 160 and planar[0].range_max == 7.5


@pytest.mark.parametrize('may_fail', [['lidar_node'], []])
def test_a_node_that_dies(tmp_path, may_fail):
    """It is named with its reason; the others go on, or not, as the scenario says."""
    (tmp_path / SCENARIO_FILE).write_text('{}')
    deadline = time.monotonic() + 60.0
    with contextlib.ExitStack() as stack:
        if not may_fail:
            stack.enter_context(pytest.raises(GraphError, match="lidar_node .*: world: '' is not"))
        nodes = stack.enter_context(NodeProcesses([NodePlan('lidar_node', {})], tmp_path, 77,
                                                  may_fail))
        while not nodes.lost and time.monotonic() < deadline:
            assert not nodes.has_finished()
            time.sleep(0.05)
        assert re.search("lidar_node ended with status 1: world: '' is .*; the run goes on",
                         nodes.lost['lidar_node'])
