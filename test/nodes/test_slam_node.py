"""A SLAM program over pipes, beside the whole graph."""

from __future__ import annotations

from pathlib import Path
import shlex
import sys

from conftest import simulate
import numpy as np
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.evaluation.trajectory_evaluation import evaluate  # noqa: E402
from lunar_rover_sim.evaluation.trajectory_sources import load  # noqa: E402
from lunar_rover_sim.inspection.check import check  # noqa: E402

RECORDED = ('--set', 'recorder_node.topics=[odom, stereo/left/camera_info, slam/pose, '
            'slam/status, world_hash, scenario]')
# Takes two frames, then ends as a program does whose assertion failed.
CRASHING = """
import os, struct, sys
def message():
    _, _, kind, length = struct.unpack('<4sHHI', sys.stdin.buffer.read(12))
    return kind, sys.stdin.buffer.read(length)
def send(kind, body=b''):
    os.write(1, struct.pack('<4sHHI', b'LRSP', 1, kind, len(body)) + body)
message()
send(5)
for _ in range(2):
    kind, body = message()
    send(6, body[:8] + struct.pack('<I7d', 0, *[0] * 7))
message()
os.abort()
"""


def test_in_lockstep_every_frame_is_tracked(tmp_path: Path, world_folder: Path) -> None:
    """The built-in odometry answers all frames, in their order, and knows where it is."""
    command = shlex.join([sys.executable, '-m', 'lunar_rover_sim.slam.client'])
    finished = simulate(tmp_path / 'run', '--duration', '1', '--slam', command, *RECORDED,
                        '--set', 'render_node.frame_rate_hz=20')
    assert finished.returncode == 0, finished.stdout + finished.stderr
    bag = tmp_path / 'run' / 'bag'
    with open_bag(bag) as opened:
        frames = [opened.stamp_ns(m) for m in opened.raw(['/stereo/left/camera_info'])]
        statuses = [message for _, _, message in opened.messages(['/slam/status'])]
        assert [opened.stamp_ns(m) for m in opened.raw(['/slam/status'])] == frames
        assert len(frames) == 20
    assert {status.status[0].message for status in statuses} == {'tracking'}
    assert not check(bag).failed
    estimate = load(f'{bag}:/slam/pose')
    assert estimate.stamps_ns.tolist() == frames
    judged = evaluate(bag, estimate, estimate_frame='left', frame_stamps_ns=np.array(frames))
    assert judged.tracked_share == 1.0
    assert judged.ate_m.rmse < 0.01
    log = (tmp_path / 'run' / 'logs' / 'slam_node.log').read_text()
    assert '20 frames answered: 0 initialising, 20 tracking, 0 lost; 0 left out' in log
    assert 'slam: 20 frames answered: 20 tracking' in finished.stdout


def test_a_program_that_crashes_ends_the_run(tmp_path: Path, world_folder: Path) -> None:
    """With one line that names it; the bag up to there is whole."""
    (tmp_path / 'slam.py').write_text(CRASHING)
    finished = simulate(tmp_path / 'run', '--duration', '20', '--slam',
                        shlex.join([sys.executable, str(tmp_path / 'slam.py')]), *RECORDED)
    assert finished.returncode == 1
    error = finished.stderr.strip().splitlines()[-1]
    assert f'slam_node ended with status 1: {sys.executable}: crashed with SIGABRT' in error
    assert 'at the frame of 0.300 s' in error
    with open_bag(tmp_path / 'run' / 'bag') as bag:
        assert 'crashed with SIGABRT' in bag.incomplete     # why it ends here
        assert bag.counts['/slam/status'] == 2
