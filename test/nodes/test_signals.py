"""SIGINT and SIGTERM end every node quietly, at any moment of its life."""

from __future__ import annotations

from pathlib import Path
import re
import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

# After the entry point has been reached. Before it Python itself starts, for 0.1 s or so.
DELAYS_S = (0.0, 0.2, 0.5, 1.0)


def wait_for_entry_point(process: int, limit_s: float = 20.0) -> None:
    """Return when the process catches SIGTERM."""
    deadline = time.monotonic() + limit_s
    while time.monotonic() < deadline:
        caught = re.search(r'SigCgt:\s*(\w+)', Path(f'/proc/{process}/status').read_text())
        if caught and int(caught[1], 16) >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(0.005)
    raise AssertionError('the entry point is not reached')


@pytest.mark.parametrize('node', ['physics_node', 'gait_controller_node', 'render_node',
                                  'drive_node', 'recorder_node', 'trajectory_recorder_node'])
def test_every_node_stops_quietly(node: str, world_folder: Path, tmp_path: Path,
                                  domain: int) -> None:
    """Status 0, no traceback, no error; while it starts and when it runs."""
    arguments = {'physics_node': ['-p', f'world:={world_folder}'],
                 'render_node': ['-p', f'world:={world_folder}', '-p', 'camera.width:=160', '-p',
                                 'camera.height:=120', '-p', 'sgm.num_disparities:=32']}

    def start(k: int) -> subprocess.Popen[str]:
        output = {'recorder_node': ['-p', f'output:={tmp_path / f"bag{k}"}'],
                  'trajectory_recorder_node': ['-p', f'output:={tmp_path / f"{k}.txt"}']}
        return subprocess.Popen(
            [sys.executable, '-m', 'lunar_rover_sim.nodes.entry_points', node, '--ros-args',
             *arguments.get(node, output.get(node, []))],
            stdout=(tmp_path / f'{k}.log').open('w'), stderr=subprocess.STDOUT, text=True)

    log = tmp_path / '0.log'
    processes = [start(0)]
    try:
        for k, delay_s in enumerate(DELAYS_S, 1):
            processes.append(start(k))
            wait_for_entry_point(processes[-1].pid)
            time.sleep(delay_s)
            processes[-1].send_signal(signal.SIGINT if k % 2 else signal.SIGTERM)
        deadline = time.monotonic() + 60.0
        while 'ready' not in log.read_text():   # the first one started beside the others
            assert time.monotonic() < deadline
            time.sleep(0.05)
        processes[0].send_signal(signal.SIGINT)
        for process in processes:
            assert process.wait(20) == 0
    finally:
        for process in processes:
            process.kill()
            process.wait(20)
    for k in range(len(processes)):
        said = (tmp_path / f'{k}.log').read_text()
        bad = [line for line in said.splitlines()
               if any(word in line for word in ('Traceback', 'rror', 'FATAL', 'bort'))]
        assert not bad, said


def test_a_second_signal_does_no_harm(domain: int) -> None:
    """Ctrl-C reaches a node twice under ros2 launch. At its end Python gives signals back their
    default effect, which would be the death of the process, unless they are ignored.
    """
    script = """
import signal
from lunar_rover_sim.nodes import gait_controller_node
assert gait_controller_node.main(['gait_controller_node', '--ros-args', '-p', 'no:=1']) == 1
assert {signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)} == {signal.SIG_IGN}
"""
    finished = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              timeout=60)
    assert finished.returncode == 0, finished.stderr


def test_the_clock_monitor_leaves_with_its_input(domain: int) -> None:
    """It ends by itself: a participant that is killed leaves its shared memory behind."""
    monitor = subprocess.Popen([sys.executable, '-m', 'lunar_rover_sim.nodes.clock_monitor'],
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert monitor.stdout is not None
        assert monitor.stdout.readline() == '0\n'
        monitor.communicate(timeout=10)     # closes the input
        assert monitor.returncode == 0
    finally:
        monitor.kill()
        monitor.wait()
