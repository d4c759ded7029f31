"""Nodes in namespaces and under other names: their parameters, and two rovers in one graph."""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys

import pytest

pytestmark = pytest.mark.ros
rclpy = pytest.importorskip('rclpy')

from peer import Peer, running  # noqa: E402  (needs rclpy)
from rcl_interfaces.srv import GetParameters  # noqa: E402

from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.files.paths import find_file  # noqa: E402
from lunar_rover_sim.inspection.check import check  # noqa: E402
from lunar_rover_sim.run.plan import prepare, resolve, SCENARIO_FILE  # noqa: E402
from lunar_rover_sim.run.plan import rover_overrides  # noqa: E402
from lunar_rover_sim.run.scenario import Scenario  # noqa: E402


def test_a_scenario_holds_under_another_name(peer: Peer) -> None:
    """In a namespace and under __node:= the section of the program counts; -p wins over it."""
    with running('drive_node', '--params-file', str(find_file('scenario', 'baseline')), '-r',
                 '__ns:=/rover1', '-r', '__node:=path', '-p', 'speed_mps:=0.05'):
        answer = peer.call(GetParameters, '/rover1/path/get_parameters', GetParameters.Request(
            names=['mode', 'shape', 'speed_mps', 'seed']))
    mode, shape, speed, seed = answer.values
    assert (mode.string_value, shape.string_value) == ('spline', 'figure_eight')
    assert (speed.double_value, seed.integer_value) == (0.05, 1)


def test_two_rovers_share_one_time(tmp_path: Path, world_folder: Path, domain: int) -> None:
    """Each has its bag; all stamps are there, and one clock."""
    rovers = ['rover1', 'rover2']
    processes = []
    try:
        for k, rover in enumerate(rovers):
            scenario = resolve(Scenario.load('flat', [
                *rover_overrides(rovers, rover), f'physics_node.start.y_m={k}',
                'run.nodes=[physics_node, gait_controller_node, recorder_node]'],
                duration_s=0.5))
            folder = tmp_path / rover
            for plan in prepare(scenario, folder, world_folder):
                arguments = plan.ros_arguments(folder / SCENARIO_FILE)
                processes.append((plan.name, subprocess.Popen(
                    [sys.executable, '-m', 'lunar_rover_sim.nodes.entry_points', plan.name,
                     *arguments, '-r', f'__ns:=/{rover}'])))
        for wanted in ('physics_node', 'gait_controller_node', 'recorder_node'):
            for name, process in processes:
                if name == wanted:
                    if name != 'physics_node':
                        process.terminate()
                    assert process.wait(60) == 0
    finally:
        for _, process in processes:
            process.kill()
            process.wait()
    for k, rover in enumerate(rovers):
        assert check(tmp_path / rover / 'bag').ok
        with open_bag(tmp_path / rover / 'bag') as bag:
            assert set(bag.types) - {'/clock'} == {
                topic for topic in bag.types if topic.startswith(f'/{rover}/')}
            assert bag.counts['/clock'] == bag.counts[f'/{rover}/odom'] == 100
            assert abs(bag.first('odom').pose.pose.position.y - k) < 0.05
