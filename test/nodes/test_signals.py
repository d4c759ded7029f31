"""SIGINT and SIGTERM end every node quietly, at any moment of its life."""

from contextlib import nullcontext
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import time

import pytest
from waiting import LIMIT_S, wait_until

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from peer import Peer, PLAIN_DETAIL, SMALL_CAMERA  # noqa: E402  (needs rclpy)
from rosgraph_msgs.msg import Clock  # noqa: E402

from lunar_rover_sim.base.errors import GraphError  # noqa: E402
from lunar_rover_sim.run.ending import DONE  # noqa: E402
from lunar_rover_sim.run.node_processes import NodeProcesses  # noqa: E402
from lunar_rover_sim.run.plan import NodePlan  # noqa: E402
from lunar_rover_sim.run.ros_domain import check_domain  # noqa: E402

SCRIPTS = Path(__file__).resolve().parents[2] / 'resource' / 'nodes'

# After the entry point has been reached.
DELAYS_S = (0.0, 1.0)


def wait_for_mask(process: int, mask: str) -> None:
    """Return when SIGTERM is in a mask of the process: SigCgt, caught, or SigBlk, blocked."""
    def comes() -> bool:
        found = re.search(rf'{mask}:\s*(\w+)', Path(f'/proc/{process}/status').read_text())
        return bool(found and int(found[1], 16) >> (signal.SIGTERM - 1) & 1)

    wait_until(comes, f'SIGTERM does not come into {mask}', pause_s=0.002)


@pytest.mark.parametrize('node', ['physics_node', 'render_node', 'recorder_node'])
def test_every_node_stops_quietly(node: str, world_folder: Path, tmp_path: Path,
                                  domain: int) -> None:
    """Status 0, no traceback, no error; while it starts and when it runs.

    These three have something to close; others end as they do.
    """
    arguments = {'physics_node': ['-p', f'world:={world_folder}'],
                 'render_node': ['-p', f'world:={world_folder}', *SMALL_CAMERA, *PLAIN_DETAIL]}

    def start(k: int) -> subprocess.Popen[str]:
        output = {'recorder_node': ['-p', f'output:={tmp_path / f"bag{k}"}']}
        return subprocess.Popen(
            [sys.executable, '-m', 'lunar_rover_sim.nodes.entry_points', node, '--ros-args',
             *arguments.get(node, output.get(node, []))],
            stdout=(tmp_path / f'{k}.log').open('w'), stderr=subprocess.STDOUT, text=True)

    log = tmp_path / '0.log'
    processes = [start(0)]
    try:
        for k, delay_s in enumerate(DELAYS_S, 1):
            processes.append(start(k))
            wait_for_mask(processes[-1].pid, 'SigCgt')
            time.sleep(delay_s)
            processes[-1].send_signal(signal.SIGINT if k % 2 else signal.SIGTERM)
        # The first one started beside the others.
        wait_until(lambda: 'ready' in log.read_text())
        processes[0].send_signal(signal.SIGINT)
        for process in processes:
            assert process.wait(LIMIT_S) in DONE
    finally:
        for process in processes:
            process.kill()
            process.wait(LIMIT_S)
    for k in range(len(processes)):
        said = (tmp_path / f'{k}.log').read_text()
        bad = [line for line in said.splitlines()
               if any(word in line for word in ('Traceback', 'rror', 'FATAL', 'bort'))]
        assert not bad, said


def test_a_signal_waits_while_python_starts(tmp_path: Path) -> None:
    """The scripts of the nodes block signals until the node handles them: none is lost, and
    Python's own start prints nothing.
    """
    program = tmp_path / 'lunar_rover_sim_node'
    program.write_text(f'#!{sys.executable}\nimport sys\n'
                       'from lunar_rover_sim.nodes.entry_points import main\nsys.exit(main())\n')
    script = tmp_path / 'drive_node'
    shutil.copy(SCRIPTS / 'drive_node', script)
    for path in (program, script):
        path.chmod(0o755)
    processes = []
    try:
        for k, delay_s in enumerate((0.0, 0.02, 0.04, 0.08, 0.16)):
            process = subprocess.Popen([str(script)], stdout=(tmp_path / f'{k}.log').open('w'),
                                       stderr=subprocess.STDOUT)
            processes.append(process)
            wait_for_mask(process.pid, 'SigBlk')
            time.sleep(delay_s)
            process.send_signal(signal.SIGINT if k % 2 else signal.SIGTERM)
        for process in processes:
            assert process.wait(LIMIT_S) in DONE
    finally:
        for process in processes:
            process.kill()
            process.wait(LIMIT_S)
    assert not any((tmp_path / f'{k}.log').read_text() for k in range(len(processes)))


def test_a_graph_that_is_stopped_at_once_says_nothing(tmp_path: Path, domain: int) -> None:
    """As by Ctrl-C right after the start of a run."""
    (tmp_path / 'scenario.yaml').write_text('/**: {ros__parameters: {seed: 1}}\n')
    plans = [NodePlan(name, {}) for name in ('drive_node', 'gait_controller_node')]
    with NodeProcesses(plans, tmp_path, domain) as nodes:
        time.sleep(0.05)    # Python starts
    assert not any(log.read_text() for log in nodes.logs().values())


def test_a_second_signal_does_no_harm(domain: int) -> None:
    """Ctrl-C reaches a node twice under ros2 launch. At its end Python gives signals back their
    default effect, which would be the death of the process, unless they are ignored.
    """
    script = """
import signal
from lunar_rover_sim.nodes.gait_controller_node import GaitControllerNode
from lunar_rover_sim.nodes.node_main import run
assert run(GaitControllerNode, ['gait_controller_node', '--ros-args', '-p', 'no:=1']) == 1
assert {signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)} == {signal.SIG_IGN}
"""
    finished = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              timeout=LIMIT_S)
    assert finished.returncode == 0, finished.stderr


def test_a_node_that_cannot_leave_the_graph_is_ended(domain: int) -> None:
    """After it has closed what is its own; SIGALRM before that does nothing."""
    script = """
import os, signal
from lunar_rover_sim.nodes import node_main
node_main._LIMIT_S = 1

class Node(node_main.GraphNode):
    def __init__(self):
        super().__init__('captive')
        self.finished = True

    def close(self):
        os.kill(os.getpid(), signal.SIGALRM)
        print('closed', flush=True)

    def destroy_node(self):
        while True:
            pass

node_main.run(Node, ['captive'])
"""
    finished = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              timeout=LIMIT_S)
    assert (finished.returncode, finished.stdout) == (-signal.SIGALRM, 'closed\n')


@pytest.mark.parametrize('published', [True, False])
def test_a_probe_that_cannot_leave_the_graph_is_ended(
        peer: Peer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, published: bool) -> None:
    """What it found counts."""
    (tmp_path / 'sitecustomize.py').write_text("""
import rclpy.node
from lunar_rover_sim.nodes import node_main
node_main._LIMIT_S = 1

def destroy_node(self):
    while True:
        pass

rclpy.node.Node.destroy_node = destroy_node
""")
    monkeypatch.setenv('PYTHONPATH', f'{tmp_path}:{os.environ.get("PYTHONPATH", "")}')
    if published:
        peer.node.create_publisher(Clock, '/clock', 10)
    with (pytest.raises(GraphError, match=r'--domain \d+: peer publishes /clock there')
          if published else nullcontext()):
        check_domain(int(os.environ['ROS_DOMAIN_ID']), ['/clock'])


def test_the_clock_monitor_leaves_with_its_input(domain: int) -> None:
    """It ends by itself: a participant that is killed leaves its shared memory behind."""
    monitor = subprocess.Popen([sys.executable, '-m', 'lunar_rover_sim.nodes.clock_monitor'],
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert monitor.stdout is not None
        assert monitor.stdout.readline() == '0\n'
        monitor.communicate(timeout=LIMIT_S)     # closes the input
        assert monitor.returncode == 0
    finally:
        monitor.kill()
        monitor.wait()


def test_few_open_files_are_named() -> None:
    """Before a library fails to load."""
    ended = subprocess.run(
        ['bash', '-c', 'ulimit -n 16; exec "$@"', 'x', sys.executable, '-m',
         'lunar_rover_sim.nodes.entry_points', 'physics_node'],
        capture_output=True, text=True, timeout=LIMIT_S)
    assert ended.returncode == 1
    assert ended.stderr.startswith('FATAL 16 open files are allowed; at least 64 are needed')
    assert len(ended.stderr.splitlines()) == 1
