"""slam_node: a program over pipes, beside the whole graph and beside a plain publisher."""

import dataclasses
import json
import math
from pathlib import Path
import shlex
import subprocess
import sys
import time
from typing import Any

from command_line import unfolded
from conftest import PLAIN, simulate, TINY
from judge.slam import closed_way, relief_walk
import numpy as np
import pytest
from waiting import LIMIT_S

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402  (needs rclpy)
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from peer import Peer, running  # noqa: E402
from sensor_msgs.msg import Image, Imu  # noqa: E402

from lunar_rover_sim.bag.messages import header_ns, xyz  # noqa: E402
from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.base.frames import wxyz_from_matrix  # noqa: E402
from lunar_rover_sim.cli.main import execute  # noqa: E402
from lunar_rover_sim.image.camera.config import CameraConfig  # noqa: E402
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate  # noqa: E402
from lunar_rover_sim.judge.evaluation.trajectory_files import load  # noqa: E402
from lunar_rover_sim.judge.slam.graph.measured import Stars  # noqa: E402
from lunar_rover_sim.judge.slam.graph.odometry import GraphOdometry  # noqa: E402
from lunar_rover_sim.products.inspection.check import check  # noqa: E402
from lunar_rover_sim.products.sequences.sensors import described_sensors  # noqa: E402
from lunar_rover_sim.rover.description import load_rover  # noqa: E402
from lunar_rover_sim.sensors.imu import ImuConfig  # noqa: E402

PERIOD_NS = 5_000_000   # of the IMU
# Notes what it is given; each frame waits for a file of the number of frames so far.
PROGRAM = """
import json, pathlib, sys, time
import numpy as np
from lunar_rover_sim.judge.slam.client import serve
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

    def __init__(self, peer: Peer, *, to_graph: bool = False) -> None:
        node = peer.node
        self._sides = [node.create_publisher(Image, f'stereo/{side}/image_raw', 10)
                       for side in ('left', 'right')]
        self._imu = node.create_publisher(Imu, 'imu/data_raw', 500)
        self._wheels = node.create_publisher(Odometry, 'wheel/odometry', 10)
        self._stars = node.create_publisher(Imu, 'star_tracker/attitude', 10)
        awaited = (*self._sides, self._imu, *([self._wheels, self._stars] if to_graph else []))
        self.is_connected = lambda: all(p.get_subscription_count() == 1 for p in awaited)
        self._next_ns = 0

    def frame(self, stamp_ms: int) -> None:
        for level, publisher in enumerate(self._sides, 1):
            msg = Image(width=64, height=48, step=64, encoding='mono8',
                        data=bytes([10 * level]) * (64 * 48))
            _stamp(msg, stamp_ms * 1_000_000)
            publisher.publish(msg)

    def step(self, step: closed_way.Step) -> None:
        """Publish what comes with a step of `closed_way`, but for the sun."""
        inertial, wheels, stars = step.aids.inertial, step.aids.wheels, step.aids.stars
        assert inertial is not None and wheels is not None
        if stars is not None:
            msg = Imu(orientation_covariance=stars.covariance_rad2.ravel())
            q = msg.orientation
            q.w, q.x, q.y, q.z = wxyz_from_matrix(stars.R_map_base).tolist()
            _stamp(msg, step.stamp_ns)
            self._stars.publish(msg)
        for ns, rate, force in zip(*inertial):
            msg = Imu()
            a, w = msg.linear_acceleration, msg.angular_velocity
            (a.x, a.y, a.z), (w.x, w.y, w.z) = force.tolist(), rate.tolist()
            _stamp(msg, int(ns))
            self._imu.publish(msg)
        for side, image in zip(self._sides, (step.left, step.right)):
            assert image is not None
            msg = Image(width=320, height=240, step=320, encoding='mono8', data=image.tobytes())
            _stamp(msg, step.stamp_ns)
            side.publish(msg)
        odometry = Odometry()
        pose = odometry.pose.pose
        pose.position.x, pose.position.y, yaw = wheels.pose.tolist()
        pose.orientation.w, pose.orientation.z = math.cos(yaw / 2), math.sin(yaw / 2)
        covariance = np.zeros((6, 6))
        covariance[np.ix_([0, 1, 5], [0, 1, 5])] = wheels.covariance
        odometry.pose.covariance = covariance.ravel()
        _stamp(odometry, step.stamp_ns)
        self._wheels.publish(odometry)

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
    transforms = peer.listen_tf()

    def told(subject: str) -> dict[str, str]:
        return {value.key: value.value for array in diagnostics[-3:] for status in array.status
                if status.name == f'slam_node: {subject}' for value in status.values}

    def seen(count: int) -> dict[str, Any]:
        path = tmp_path / f'frame{count}'
        peer.spin_until(path.exists)
        found: dict[str, Any] = json.loads(path.read_text())
        return found

    with running('slam_node', '-p', f'command:={program}', '-p', 'sensor:=stereo-inertial',
                 '-p', 'answer_s:=60.0', '-p', 'publish_tf:=true') as node:
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
    assert [(t.header.frame_id, t.child_frame_id) for t in transforms] \
        == [('slam_map', 'slam_camera')] * 2
    assert [t.transform.translation.x for t in transforms] == [p.pose.position.x for p in poses]


@pytest.mark.parametrize(('sensor', 'gravity_mps2', 'command', 'warns'), [
    ('stereo-inertial', 1.62, 'ls /', True), ('stereo-inertial', 1.62, 'ls {wheel}', False)])
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


# Of the ground only what odometry sees.
RECORDED = ('--set', 'recorder_node.topics=[odom, stereo/left/camera_info, slam/pose, '
            'slam/status, world_hash, scenario]', '--set', 'physics_node.ground.model=rigid',
            '--set', 'render_node.detail.far_rocks_m=0',
            '--set', 'render_node.detail.bounce=false')
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
    command = shlex.join([sys.executable, '-m', 'lunar_rover_sim.judge.slam.client'])
    finished = simulate(tmp_path / 'run', '--duration', '0.5', '--slam', command, *RECORDED,
                        '--set', 'render_node.frame_rate_hz=20')
    assert finished.returncode == 0, finished.stdout + finished.stderr
    bag = tmp_path / 'run' / 'bag'
    with open_bag(bag) as opened:
        frames = [opened.stamp_ns(m) for m in opened.raw(['/stereo/left/camera_info'])]
        statuses = [message for _, _, message in opened.messages(['/slam/status'])]
        assert [opened.stamp_ns(m) for m in opened.raw(['/slam/status'])] == frames
        assert len(frames) == 10
    assert {status.status[0].message for status in statuses} == {'tracking'}
    assert not check(bag).failed
    estimate = load(f'{bag}:/slam/pose')
    assert estimate.stamps_ns.tolist() == frames
    judged = evaluate(bag, estimate, estimate_frame='left', frame_stamps_ns=np.array(frames))
    assert judged.tracked_share == 1.0
    assert judged.ate_m.rmse < 0.01
    log = (tmp_path / 'run' / 'logs' / 'slam_node.log').read_text()
    assert '10 frames answered: 0 initialising, 10 tracking, 0 lost; 0 left out' in log
    assert 'slam: 10 frames answered: 10 tracking' in finished.stdout


# What the graph says is recorded with all that `all` takes; images are small and few.
WITH_GRAPH = ('--slam', 'graph', *RECORDED[2:], '--set', 'recorder_node.topics=[odom, '
              'stereo/left/camera_info, slam/pose, slam/pose_with_covariance, slam/status, '
              'world_hash, scenario]')


def test_the_graph_tells_its_covariance_in_lockstep(tmp_path: Path, world_folder: Path) -> None:
    """Every frame has a pose with covariance, which is recorded, checked, judged and exported."""
    pytest.importorskip('gtsam')
    finished = simulate(tmp_path / 'run', '--duration', '3', *WITH_GRAPH,
                        '--set', 'render_node.frame_rate_hz=2')
    assert finished.returncode == 0, finished.stdout + finished.stderr
    bag = tmp_path / 'run' / 'bag'
    with open_bag(bag) as opened:
        frames = [opened.stamp_ns(m) for m in opened.raw(['/stereo/left/camera_info'])]
        assert [opened.stamp_ns(m) for m in opened.raw(['/slam/status'])] == frames
    assert len(frames) == 6 and not check(bag).failed
    told, plain = load(f'{bag}:/slam/pose_with_covariance'), load(f'{bag}:/slam/pose')
    assert told.stamps_ns.tolist() == frames == plain.stamps_ns.tolist()
    np.testing.assert_array_equal(told.positions_m, plain.positions_m)
    assert told.covariances is not None and plain.covariances is None
    deviations = np.sqrt(np.linalg.eigvalsh(told.covariances[:, :3, :3])[:, -1])
    assert deviations[0] < deviations[-1] < 0.1
    assert execute(['evaluate', str(bag), f'{bag}:/slam/pose_with_covariance',
                    '--estimate-frame', 'left', '-o', str(tmp_path / 'judged')]) == 0
    again = load(tmp_path / 'judged' / 'estimate_covariance.txt')
    np.testing.assert_allclose(again.covariances, told.covariances, rtol=1e-12)
    judged = evaluate(bag, told, align='origin', estimate_frame='left')
    assert judged.consistency is not None and judged.ate_m.rmse < 0.03
    log = (tmp_path / 'run' / 'logs' / 'slam_node.log').read_text()
    assert '6 frames answered: 0 initialising, 6 tracking, 0 lost; 0 left out' in log
    assert 'keyframes of 6 frames' in log


def test_the_graph_says_live_what_it_says_of_a_bag(peer: Peer) -> None:
    """Poses and covariances are those of the odometry itself, given the same."""
    pytest.importorskip('gtsam')
    steps = [dataclasses.replace(step, aids=dataclasses.replace(step.aids, sun=None))
             for step in closed_way.drive(laps=0.1, heading=True)]
    feeder = Feeder(peer, to_graph=True)
    told = peer.listen(PoseWithCovarianceStamped, 'slam/pose_with_covariance')
    camera = ('camera.width:=320', 'camera.height:=240')
    with running('slam_node', '-p', 'system:=graph', '-p', 'time_mode:=lockstep',
                 *(word for setting in camera for word in ('-p', setting))):
        peer.spin_until(lambda: peer.node.count_publishers('slam/status') > 0
                        and feeder.is_connected())
        for count, step in enumerate(steps, 1):
            feeder.step(step)
            peer.spin_until(lambda count=count: len(told) == count)
    suite = described_sensors(load_rover(None), CameraConfig(width=320, height=240), ImuConfig(),
                              20.0, 200, 1.62)
    graph = GraphOdometry.of(suite)
    for message, step in zip(told, steps, strict=True):
        located = graph.add(*step.given)
        assert located is not None and header_ns(message) == step.stamp_ns
        np.testing.assert_allclose(xyz(message.pose.pose.position), located.T_map_left[:3, 3],
                                   atol=1e-6)
        np.testing.assert_allclose(np.reshape(message.pose.covariance, (6, 6)),
                                   located.covariance, rtol=1e-3, atol=1e-9)


def test_on_a_map_from_orbit_the_graph_says_what_it_knows_of_its_place(
        peer: Peer, tmp_path: Path) -> None:
    """Before the first fix that is the doubt; the poses are in the frame of the site."""
    pytest.importorskip('gtsam')
    relief_walk.orbital(0).save(tmp_path / 'map')
    steps = closed_way.drive(laps=0.05, heading=True)
    stars = Stars(steps[0].stamp_ns, steps[0].T_world_base[:3, :3], 4e-8 * np.eye(3))
    steps[0] = dataclasses.replace(steps[0], aids=dataclasses.replace(steps[0].aids, stars=stars))
    feeder = Feeder(peer, to_graph=True)
    told = peer.listen(PoseWithCovarianceStamped, 'slam/pose_with_covariance')
    statuses = peer.listen(DiagnosticArray, 'slam/status')
    given = ('system:=graph', 'time_mode:=lockstep', 'camera.width:=320', 'camera.height:=240',
             f'maps:={tmp_path / "map"}', 'near_x_m:=20.0', 'near_y_m:=-25.0', 'doubt_m:=40.0',
             'frame_id:=odom')
    with running('slam_node', *(word for setting in given for word in ('-p', setting))):
        peer.spin_until(lambda: peer.node.count_publishers('slam/status') > 0
                        and feeder.is_connected())
        for count, step in enumerate(steps, 1):
            feeder.step(step)
            peer.spin_until(lambda count=count: len(told) == len(statuses) == count)
    for message, status in zip(told, statuses, strict=True):
        assert message.header.frame_id == 'odom'
        assert math.dist(xyz(message.pose.pose.position)[:2], (20.0, -25.0)) < 1.0
        P = np.reshape(message.pose.covariance, (6, 6))
        np.testing.assert_allclose(np.sqrt(np.diag(P)[:2]), 20.0, rtol=0.01)
        assert [(v.key, v.value) for v in status.status[0].values] == [('place', 'looking')]


def test_without_gtsam_the_graph_says_so_in_a_line_and_is_the_window(peer: Peer) -> None:
    """The node tracks without covariances."""
    feeder = Feeder(peer, to_graph=True)
    statuses = peer.listen(DiagnosticArray, 'slam/status')
    hidden = ('import sys; sys.modules["gtsam"] = None; '
              'from lunar_rover_sim.nodes.entry_points import main; main()')
    with subprocess.Popen(
            [sys.executable, '-c', hidden, 'slam_node', '--ros-args', '-p', 'system:=graph'],
            stderr=subprocess.PIPE, text=True) as node:
        try:
            peer.spin_until(lambda: peer.node.count_publishers('slam/status') > 0
                            and feeder.is_connected())
            assert peer.node.count_publishers('slam/pose_with_covariance') == 0
            feeder.frame(50)
            peer.spin_until(lambda: len(statuses) == 1)
        finally:
            node.terminate()
            _, said = node.communicate(timeout=LIMIT_S)
    lines = [line for line in said.splitlines() if 'GTSAM' in line]
    assert len(lines) == 1 and 'this is the window of the reference' in lines[0]
    assert statuses[0].status[0].message == 'initialising'      # it has seen grey


@pytest.mark.parametrize(('parameters', 'word'), [
    (('sensor:=mono',), "sensor: 'mono' is not valid with system graph"),
    (('command:=ls',), "command: 'ls' is not valid with system graph"),
    (('maps:=/nowhere',), '/nowhere/orbital.json: cannot be read: no such file')])
def test_what_the_graph_cannot_use_is_one_line(parameters: tuple[str, ...], word: str) -> None:
    ended = subprocess.run(
        [sys.executable, '-m', 'lunar_rover_sim.nodes.entry_points', 'slam_node', '--ros-args',
         '-p', 'system:=graph', *(w for p in parameters for w in ('-p', p))],
        capture_output=True, text=True, timeout=LIMIT_S)
    assert ended.returncode == 1 and word in ended.stderr


def test_a_program_that_crashes_ends_the_run(tmp_path: Path, world_folder: Path) -> None:
    """With one line that names it; the bag up to there is whole."""
    (tmp_path / 'slam.py').write_text(CRASHING)
    finished = simulate(tmp_path / 'run', '--duration', '20', '--slam',
                        shlex.join([sys.executable, str(tmp_path / 'slam.py')]), *RECORDED,
                        *(word for setting in (*PLAIN, *TINY) for word in ('--set', setting)))
    assert finished.returncode == 1
    error = unfolded(finished.stderr).strip().splitlines()[-1]
    assert f'slam_node ended with status 1: {sys.executable}: crashed with SIGABRT' in error
    assert 'at the frame of 0.300 s' in error
    with open_bag(tmp_path / 'run' / 'bag') as bag:
        assert 'crashed with SIGABRT' in bag.incomplete     # why it ends here
        assert bag.counts['/slam/status'] == 2
