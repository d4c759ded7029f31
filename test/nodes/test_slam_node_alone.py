"""slam_node in real time beside a plain publisher: which frames it drops, what the IMU gives."""

from __future__ import annotations

import json
from pathlib import Path
import shlex
import subprocess
import sys
import time
from typing import Any

import pytest
from waiting import LIMIT_S

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402  (needs rclpy)
from geometry_msgs.msg import PoseStamped  # noqa: E402
from peer import fails, Peer, running  # noqa: E402
from sensor_msgs.msg import Image, Imu  # noqa: E402

from lunar_rover_sim.bag.messages import header_ns  # noqa: E402

try:
    from tf2_msgs.msg import TFMessage
except ImportError:     # not in the wheels
    TFMessage = None

PERIOD_NS = 5_000_000   # of the IMU
# Notes what it is given; each frame waits for a file of the number of frames so far.
PROGRAM = """
import json, pathlib, sys, time
import numpy as np
from lunar_rover_sim.slam.client import serve
folder = pathlib.Path(sys.argv[1])
count = 0

def begin(settings):
    (folder / 'settings').write_text(json.dumps(settings))
    def track(frames, imu):
        global count
        count += 1
        seen = {'stamp_ns': frames.stamp_ns,
                'levels': [int(image.max()) for image in frames.images],
                'imu_ns': [int(ns) for part in imu for ns in part.stamps_ns],
                'forces': [float(f[2]) for part in imu for f in part.forces_mps2],
                'rates': [float(r[0]) for part in imu for r in part.rates_radps]}
        (folder / f'part{count}').write_text(json.dumps(seen))
        (folder / f'part{count}').rename(folder / f'frame{count}')
        deadline = time.monotonic() + 240.0
        while not (folder / f'go{count}').exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        pose = np.eye(4)
        pose[0, 3] = 0.1 * count
        return pose if count > 1 else None
    return track

serve(begin)
"""


class Feeder:
    """Publishes a pair of images, and samples of an IMU whose numbers are those of their stamp."""

    def __init__(self, peer: Peer) -> None:
        node = peer.node
        self._sides = [node.create_publisher(Image, f'stereo/{side}/image_raw', 10)
                       for side in ('left', 'right')]
        self._imu = node.create_publisher(Imu, 'imu/data_raw', 500)
        self.is_connected = lambda: all(p.get_subscription_count() == 1
                                        for p in (*self._sides, self._imu))
        self._next_ns = 0

    def frame(self, stamp_ms: int) -> None:
        for level, publisher in enumerate(self._sides, 1):
            msg = Image(width=64, height=48, step=64, encoding='mono8',
                        data=bytes([10 * level]) * (64 * 48))
            _stamp(msg, stamp_ms * 1_000_000)
            publisher.publish(msg)

    def imu_until(self, stamp_ms: int) -> None:
        while self._next_ns <= stamp_ms * 1_000_000:
            msg = Imu()
            msg.linear_acceleration.z = self._next_ns / 1e9
            msg.angular_velocity.x = -self._next_ns / 1e9
            _stamp(msg, self._next_ns)
            self._imu.publish(msg)
            self._next_ns += PERIOD_NS


def _stamp(msg: Any, stamp_ns: int) -> None:
    msg.header.stamp.sec, msg.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)


def samples(first_ms: int, last_ms: int) -> list[int]:
    return list(range(first_ms * 1_000_000, last_ms * 1_000_000 + 1, PERIOD_NS))


def test_the_newest_frame_wins_and_the_imu_has_no_gap(peer: Peer, tmp_path: Path) -> None:
    """Frames that come while the program is busy are counted; no sample is lost or repeated."""
    (tmp_path / 'slam.py').write_text(PROGRAM)
    program = shlex.join([sys.executable, str(tmp_path / 'slam.py'), str(tmp_path)])
    feeder = Feeder(peer)
    diagnostics = peer.listen(DiagnosticArray, '/diagnostics')
    poses = peer.listen(PoseStamped, 'slam/pose')
    statuses = peer.listen(DiagnosticArray, 'slam/status')
    transforms = peer.listen(TFMessage, 'tf') if TFMessage is not None else []

    def told(subject: str) -> dict[str, str]:
        return {value.key: value.value for array in diagnostics[-3:] for status in array.status
                if status.name == f'slam_node: {subject}' for value in status.values}

    def seen(count: int) -> dict[str, Any]:
        path = tmp_path / f'frame{count}'
        peer.spin_until(path.exists)
        found: dict[str, Any] = json.loads(path.read_text())
        return found

    with running('slam_node', '-p', f'command:={program}', '-p', 'sensor:=stereo-inertial',
                 '-p', 'answer_s:=60.0', '-p', f'publish_tf:={str(TFMessage is not None).lower()}',
                 ) as node:
        peer.spin_until(lambda: peer.node.count_publishers('slam/status') > 0
                        and feeder.is_connected())
        feeder.imu_until(50)
        feeder.frame(50)
        first = seen(1)
        assert (first['stamp_ns'], first['levels']) == (50_000_000, [10, 20])
        assert first['imu_ns'] == samples(0, 50)
        for stamp_ms in (100, 150, 200):    # the program is busy
            feeder.imu_until(stamp_ms)
            feeder.frame(stamp_ms)
        began_s = time.monotonic()
        peer.spin_until(lambda: told('Drops').get('Frames') == '2')
        assert told('Drops')['Lost since startup'] == '2'
        assert told('Tracking')['Latency (ms)'] == 'nan'      # nothing is answered
        least_ms = 1e3 * (time.monotonic() - began_s)
        (tmp_path / 'go1').touch()
        second = seen(2)
        assert second['stamp_ns'] == 200_000_000
        assert second['imu_ns'] == samples(55, 200)
        assert second['forces'] == [ns / 1e9 for ns in second['imu_ns']]
        assert second['rates'] == [-ns / 1e9 for ns in second['imu_ns']]
        peer.spin_until(lambda: told('Tracking')['Frames answered'] == '1')
        assert float(told('Tracking')['Latency (ms)']) >= round(least_ms, 1)
        (tmp_path / 'go2').touch()
        # A frame waits for the samples up to it.
        feeder.imu_until(245)
        feeder.frame(250)
        peer.spin_until(lambda: bool(poses))
        assert not (tmp_path / 'frame3').exists()
        feeder.imu_until(255)
        assert seen(3)['imu_ns'] == samples(205, 250)
        (tmp_path / 'go3').touch()
        peer.spin_until(lambda: len(statuses) == 3 and len(poses) == 2)
        assert node.poll() is None
    assert [header_ns(status) for status in statuses] == [50_000_000, 200_000_000, 250_000_000]
    assert [s.status[0].message for s in statuses] == ['initialising', 'tracking', 'tracking']
    assert [(header_ns(pose), round(pose.pose.position.x, 6)) for pose in poses] \
        == [(200_000_000, 0.2), (250_000_000, 0.3)]
    settings = json.loads((tmp_path / 'settings').read_text())
    assert (settings['sensor'], settings['gravity_mps2']) == ('stereo-inertial', 1.62)
    if TFMessage is not None:
        found = [t for message in transforms for t in message.transforms]
        assert [(t.header.frame_id, t.child_frame_id) for t in found] \
            == [('slam_map', 'slam_camera')] * 2
        assert [t.transform.translation.x for t in found] == [p.pose.position.x for p in poses]


@pytest.mark.parametrize(('sensor', 'gravity_mps2', 'command', 'warns'), [
    ('stereo-inertial', 1.62, 'ls /', True), ('stereo-inertial', 9.81, 'ls /', False),
    ('stereo', 1.62, 'ls /', False), ('stereo-inertial', 1.62, 'ls {wheel}', False)])
def test_another_gravity_than_orb_slam3_has_is_warned_of(
        sensor: str, gravity_mps2: float, command: str, warns: bool) -> None:
    """With an IMU, but for the wheel; the program prints, and ends the node."""
    ended = subprocess.run(
        [sys.executable, '-m', 'lunar_rover_sim.nodes.entry_points', 'slam_node', '--ros-args',
         '-p', f'command:={command}', '-p', f'sensor:={sensor}',
         '-p', f'gravity_mps2:={gravity_mps2}'],
        capture_output=True, text=True, timeout=LIMIT_S)
    assert 'does the program print to its standard output' in ended.stderr
    warnings = [line for line in ended.stderr.splitlines() if '[WARN]' in line]
    assert [f'gravity is {gravity_mps2:g} m/s^2: ORB-SLAM3 has 9.81' in line
            for line in warnings] == [True] * warns


@pytest.mark.skipif(TFMessage is not None, reason='tf2_msgs is installed')
def test_tf_needs_tf2_msgs() -> None:
    said = fails('slam_node', '-p', f'command:={sys.executable} -m lunar_rover_sim.slam.client',
                 '-p', 'publish_tf:=true')
    assert 'publish_tf: true needs tf2_msgs, which is not installed' in said
