"""Every node alone, beside a plain rclpy program, as in somebody else's stack."""

from __future__ import annotations

from contextlib import ExitStack
import importlib.util
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

import cv2
import numpy as np
import pytest

pytestmark = pytest.mark.ros
rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402  (needs rclpy)
from geometry_msgs.msg import PoseStamped, Twist  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from peer import at_rest_odometry, ended, fails, LEGS, Peer, running, SMALL_CAMERA  # noqa: E402
from rcl_interfaces.srv import DescribeParameters, SetParameters  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.publisher import Publisher  # noqa: E402
from rosbags.typesys import get_typestore, Stores  # noqa: E402
from sensor_msgs.msg import (CameraInfo, CompressedImage, Image, JointState,  # noqa: E402
                             PointCloud2)
from std_srvs.srv import SetBool, Trigger  # noqa: E402
from stereo_msgs.msg import DisparityImage  # noqa: E402

from lunar_rover_sim.bag.messages import time_ns  # noqa: E402
from lunar_rover_sim.errors import GraphError  # noqa: E402
from lunar_rover_sim.nodes.conversions import time_msg  # noqa: E402

HAZARDS = [argument for name, value in (
    ('front.camera.width', 64), ('front.camera.height', 48),
    ('front.camera.fisheye_distortion', '[0.01, 0.0, 0.0, 0.0]'), ('rear.camera.model', 'pinhole'),
    ('rear.camera.horizontal_fov_deg', 90.0), ('rear.stereo_baseline_m', 0.05),
    ('rear.orientation_rpy_deg', '[0.0, 0.0, 180.0]'), ('rear.position_m', '[-0.17, 0.0, 0.05]'))
    for argument in ('-p', f'hazard.{name}:={value}')]


def test_physics_node_walks_on_commands(peer: Peer, world_folder: Path) -> None:
    """Remapped commands from a script turn the legs; pause and step work; it says how it is."""
    told = peer.listen(DiagnosticArray, '/diagnostics')
    odometry = peer.listen(Odometry, 'odom')
    joints = peer.listen(JointState, 'joint_states')
    publisher = peer.node.create_publisher(JointState, 'my_commands', 10)

    def turn() -> None:
        publisher.publish(JointState(name=LEGS, velocity=[3.0] * 4))

    with running('physics_node', '-p', f'world:={world_folder}', '-r',
                 'joint_commands:=my_commands'):
        peer.spin_until(lambda: bool(joints) and min(joints[-1].position) > 2.0, meanwhile=turn)
        stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in odometry]
        assert all(b > a and (b - a) % 5_000_000 == 0 for a, b in zip(stamps, stamps[1:]))
        assert odometry[-1].header.frame_id == 'odom'

        assert peer.call(SetBool, 'physics_node/pause', SetBool.Request(data=True)).success
        peer.spin_until(lambda: True)
        before = odometry[-1].header.stamp
        assert peer.call(Trigger, 'physics_node/step', Trigger.Request()).success
        peer.spin_until(lambda: odometry[-1].header.stamp != before)
        assert peer.call(Trigger, 'physics_node/reset', Trigger.Request()).success
        assert peer.call(SetBool, 'physics_node/pause', SetBool.Request(data=False)).success
        count = len(odometry)
        peer.spin_until(lambda: len(odometry) > count + 5)
        peer.spin_until(lambda: bool(told))
        assert {status.name for status in told[-1].status} == {
            'physics_node: State rate', 'physics_node: Real-time factor',
            'physics_node: Participants', 'physics_node: Drops', 'physics_node: Attitude'}
        assert told[-1].header.stamp.sec > 0
        position = odometry[-1].pose.pose.position
        assert np.hypot(position.x, position.y) < 0.05


def test_gait_node_answers_a_hand_made_state(peer: Peer) -> None:
    """Each joint state gets the command that bears its stamp; cmd_vel moves it.

    NaN, Inf and a flood do not move the legs; the node goes on. Parameters change while it runs,
    as with `ros2 param set`: valid values are taken, others refused with the reason.
    """
    commands = peer.listen(JointState, 'joint_commands')
    states = peer.node.create_publisher(JointState, 'joint_states', 10)
    velocities = peer.node.create_publisher(Twist, 'cmd_vel', 10)
    ticks = [0]

    def tick(*speeds: float) -> None:
        for speed in speeds:
            twist = Twist()
            twist.linear.x = speed
            velocities.publish(twist)
        ticks[0] += 1
        state = JointState(name=LEGS, position=[0.0] * 4, velocity=[0.0] * 4)
        state.header.stamp = time_msg(5_000_000 * ticks[0])
        states.publish(state)

    def answer(name: str, value: Any) -> Any:
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()])
        return peer.call(SetParameters, 'gait_controller_node/set_parameters', request).results[0]

    with running('gait_controller_node'):
        nonsense = [float('nan'), float('inf'), -float('inf')] * 20
        peer.spin_until(lambda: len(commands) > 10, meanwhile=lambda: tick(*nonsense))
        assert all(np.isfinite(command.velocity).all() for command in commands)
        assert np.abs(commands[-1].velocity).max() < 1.0

        peer.spin_until(lambda: max(commands[-1].velocity) > 0.1,
                        meanwhile=lambda: tick(0.0, 0.1))
        assert all(time_ns(command.header.stamp) % 5_000_000 == 0 for command in commands)
        assert list(commands[-1].name) == LEGS
        assert len(commands[-1].position) == 4

        assert answer('duty_factor', 0.55).successful
        assert answer('gait', 'crawl').successful
        refused = answer('foot_width_deg', 150.0)
        assert not refused.successful
        assert 'foot_width' in refused.reason
        assert not answer('spokes', 4).successful
        described = peer.call(
            DescribeParameters, 'gait_controller_node/describe_parameters',
            DescribeParameters.Request(names=['duty_factor', 'spokes'])).descriptors
        assert 'stance' in described[0].description
        assert not described[0].read_only
        assert described[1].read_only
        assert described[1].integer_range[0].to_value == 12


def test_render_node_shows_a_hand_made_pose(peer: Peer, world_folder: Path) -> None:
    """No physics at all: one odometry message gives a stereo set with its stamp."""
    topics = {'stereo/left/image_raw': Image, 'stereo/right/image_raw': Image,
              'stereo/left/camera_info': CameraInfo, 'stereo/disparity': DisparityImage,
              'stereo/depth/image': Image, 'ground_truth/depth/image': Image,
              'stereo/depth/camera_info': CameraInfo, 'stereo/points2': PointCloud2,
              'stereo/left/image_raw/compressed': CompressedImage,
              'ground_truth/right/labels': Image, 'ground_truth/right/normals': Image,
              'ground_truth/right/normals/image_color': Image,
              'ground_truth/normals/image_color': Image,
              'ground_truth/optical_flow': Image, 'ground_truth/scene_flow': Image,
              'ground_truth/optical_flow/image_color': Image,
              'ground_truth/scene_flow/image_color': Image,
              'chase/image_raw': Image, 'chase/camera_info': CameraInfo,
              'chase/pose': PoseStamped, 'hazard/front/image_raw': Image,
              'hazard/front/camera_info': CameraInfo, 'hazard/rear/right/image_raw': Image,
              'hazard/rear/right/camera_info': CameraInfo,
              'ground_truth/hazard/front/labels': Image,
              'ground_truth/hazard/rear/right/depth/image': Image}
    received = {topic: peer.listen(kind, topic) for topic, kind in topics.items()}
    poses = peer.node.create_publisher(Odometry, 'odom', 10)
    odometry = at_rest_odometry()
    odometry.header.stamp.sec = 3
    with running('render_node', '-p', f'world:={world_folder}', *SMALL_CAMERA, '-p',
                 'stereo.left.image_raw.compressed.format:=png', '-p', 'chase.enabled:=true', '-p',
                 'chase.camera.width:=128', '-p', 'chase.camera.height:=72', *HAZARDS):
        peer.spin_until(lambda: all(received.values()), limit_s=60.0,
                        meanwhile=lambda: poses.publish(odometry))
        answer = peer.call(SetParameters, 'render_node/set_parameters', SetParameters.Request(
            parameters=[Parameter(f'stereo.{name}', value=value).to_parameter_msg()
                        for name, value in (('left.image_raw.compressed.format', 'jpeg'),
                                            ('points2.step_px', 4))]))
        assert all(result.successful for result in answer.results)
        odometry.header.stamp.sec = 4
        images = received['stereo/left/image_raw/compressed']
        clouds = received['stereo/points2']
        peer.spin_until(lambda: images[-1].header.stamp.sec == clouds[-1].header.stamp.sec == 4,
                        limit_s=60.0, meanwhile=lambda: poses.publish(odometry))
        assert (clouds[-1].height, clouds[-1].width, clouds[-1].row_step) == (30, 40, 640)
        # Rays of every fourth pixel, those of the first cloud.
        few, all_of_them = rays(clouds[-1]), rays(clouds[0])[::4, ::4]
        both = np.isfinite(few) & np.isfinite(all_of_them)
        assert both.any() and np.allclose(few[both], all_of_them[both], atol=1e-4)
        assert images[-1].format == 'mono8; jpeg compressed mono8'
    for topic, messages in received.items():
        assert messages[0].header.stamp.sec == 3, topic
    left = received['stereo/left/image_raw'][0]
    pixels = np.frombuffer(bytes(left.data), np.uint8).reshape(left.height, left.width)
    assert pixels.shape == (120, 160)
    assert pixels.std() > 2
    depth = np.frombuffer(bytes(received['ground_truth/depth/image'][0].data), np.float32)
    assert np.isinf(depth).any()
    assert 0.2 < np.nanmin(depth) < 2.0
    compressed = received['stereo/left/image_raw/compressed'][0]
    assert compressed.format == 'mono8; png compressed '
    assert compressed.header == left.header
    assert np.array_equal(cv2.imdecode(np.frombuffer(bytes(compressed.data), np.uint8),
                                       cv2.IMREAD_UNCHANGED), pixels)
    labels, normals = (received[f'ground_truth/right/{name}'][0] for name in ('labels', 'normals'))
    assert (labels.encoding, normals.encoding) == ('mono16', '32FC3')
    assert labels.header.frame_id == 'stereo_right_optical_frame'
    label = np.frombuffer(bytes(labels.data), np.uint16)
    # In optical axes: level ground points up, against y.
    up = np.frombuffer(bytes(normals.data), np.float32).reshape(-1, 3)[label == 1]
    assert len(up) > 1000 and up[:, 1].mean() < -0.7
    _check_colours(received, np.frombuffer(bytes(normals.data), np.float32).reshape(-1, 3))
    _check_chase(received)
    _check_hazards(received)
    _check_cloud(received['stereo/points2'][0], received['stereo/depth/image'][0],
                 received['stereo/depth/camera_info'][0], pixels)


def _check_colours(received: dict[str, list[Any]], normal: np.ndarray) -> None:
    """Normals and flows as viewers show them: rgb8, with the header of what they show."""
    for name, images in received.items():
        if name.endswith('image_color'):
            assert images[0].encoding == 'rgb8' and images[0].step == 3 * images[0].width
            shown = received.get(name.removesuffix('/image_color'))
            assert shown is None or shown[0].header == images[0].header
    colours = colours_of(received['ground_truth/right/normals/image_color'][0])
    drawn = np.any(normal != 0.0, axis=1)
    assert np.abs(colours[drawn] - 127.5 * (1.0 + normal[drawn])).max() <= 1.0
    assert not colours[~drawn].any()
    # From the pose of 3 s to the same one of 4 s nothing moves: black, after the unknown grey.
    for name in ('optical', 'scene'):
        flows = received[f'ground_truth/{name}_flow/image_color']
        assert np.array_equal(np.unique(colours_of(flows[0])), [40])
        assert set(np.unique(colours_of(flows[-1]))) <= {0, 40}


def colours_of(image: Image) -> np.ndarray:
    return np.frombuffer(bytes(image.data), np.uint8).reshape(-1, 3).astype(float)


def _check_hazards(received: dict[str, list[Any]]) -> None:
    """A fisheye, and the right camera of a pinhole pair, with stamps of the stereo pair."""
    image, info = (received[f'hazard/front/{name}'][0] for name in ('image_raw', 'camera_info'))
    assert (image.width, image.height) == (info.width, info.height) == (64, 48)
    assert info.header == image.header and image.header.frame_id == 'hazard_front_optical_frame'
    assert info.header.stamp.sec == 3
    assert info.distortion_model == 'equidistant' and list(info.d) == [0.01, 0.0, 0.0, 0.0]
    assert np.ptp(np.frombuffer(bytes(image.data), np.uint8)) > 20
    right = received['hazard/rear/right/camera_info'][0]
    assert right.header.frame_id == 'hazard_rear_right_optical_frame'
    assert right.distortion_model == 'plumb_bob' and right.k[0] == pytest.approx(160.0)
    assert right.p[3] == pytest.approx(-160.0 * 0.05)
    assert received['hazard/rear/right/image_raw'][0].header == right.header
    label, depth = (received[f'ground_truth/hazard/{name}'][0]
                    for name in ('front/labels', 'rear/right/depth/image'))
    assert (label.encoding, label.header) == ('mono16', image.header)
    assert 1 in np.frombuffer(bytes(label.data), np.uint16)
    assert depth.header == right.header and depth.encoding == '32FC1'
    assert 0.02 < np.frombuffer(bytes(depth.data), np.float32).min() < 1.0


def _check_chase(received: dict[str, list[Any]]) -> None:
    """The rover is in the middle of the image; pose and CameraInfo say so, too."""
    image, info, pose = (received[f'chase/{name}'][0] for name in ('image_raw', 'camera_info',
                                                                   'pose'))
    assert (info.width, info.height) == (image.width, image.height) == (128, 72)
    assert info.header == image.header and image.header.frame_id == 'chase_optical_frame'
    pixels = np.frombuffer(bytes(image.data), np.uint8).reshape(72, 128)
    assert pixels[24:48, 44:84].max() > 200 and pixels.min() < 20
    camera = np.array([pose.pose.position.x, pose.pose.position.y, pose.pose.position.z])
    assert 1.4 < np.linalg.norm(camera[:2]) < 1.5 and pose.header.frame_id == 'odom'


def rays(cloud: PointCloud2) -> np.ndarray:
    """Return (h, w, 2) x / z and y / z of an organised cloud."""
    points = np.frombuffer(bytes(cloud.data), '<f4').reshape(cloud.height, cloud.width, 4)
    return points[..., :2] / points[..., 2:3]


def _check_cloud(cloud: PointCloud2, depth_image: Image, info: CameraInfo,
                 pixels: np.ndarray) -> None:
    """The points project to their pixels at the depth of SGM, with the grey of the left image."""
    assert cloud.header == depth_image.header == info.header
    assert cloud.header.frame_id == 'stereo_left_optical_frame'
    assert not cloud.is_dense and not cloud.is_bigendian
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (120, 160, 16, 2560)
    assert [(field.name, field.offset, field.datatype) for field in cloud.fields] == [
        ('x', 0, 7), ('y', 4, 7), ('z', 8, 7), ('intensity', 12, 7)]
    x, y, z, intensity = np.moveaxis(
        np.frombuffer(bytes(cloud.data), '<f4').reshape(120, 160, 4), -1, 0)
    depth = np.frombuffer(bytes(depth_image.data), '<f4').reshape(120, 160)
    known = np.isfinite(depth)
    assert known.mean() > 0.2
    assert np.array_equal(z[known], depth[known])
    assert np.isnan([x[~known], y[~known], z[~known]]).all()
    v, u = np.mgrid[:120, :160]
    assert np.allclose((info.k[0] * x / z + info.k[2])[known], u[known], atol=1e-3)
    assert np.allclose((info.k[4] * y / z + info.k[5])[known], v[known], atol=1e-3)
    assert np.array_equal(intensity, pixels)


def test_a_render_node_from_its_first_pose_to_another_world(peer: Peer,
                                                            world_folder: Path) -> None:
    """A pose alone between periods is drawn: no stream follows, so that no period will begin.

    The same pose turning has less contrast along its rows than at rest. With a reader of the left
    image alone nothing else is drawn; a late reader is served. Where physics turns out to walk on
    another world, the node ends and says so.
    """
    from std_msgs.msg import String

    from lunar_rover_sim import topics
    from lunar_rover_sim.nodes import qos
    images = peer.listen(Image, 'stereo/left/image_raw')
    poses = peer.node.create_publisher(Odometry, 'odom', 10)
    hashes = peer.node.create_publisher(String, 'world_hash', qos.offered(topics.WORLD_HASH))
    odometry = at_rest_odometry()

    def contrast() -> float:
        image = images[-1]
        pixels = np.frombuffer(bytes(image.data), np.uint8).reshape(image.height, image.width)
        return float(np.abs(np.diff(pixels.astype(float), axis=1)).mean())

    def publish(stamp_ns: int) -> None:
        odometry.header.stamp = time_msg(stamp_ns)
        poses.publish(odometry)

    with ended('render_node', '-p', f'world:={world_folder}', *SMALL_CAMERA, '-p',
               'sensor.shot_noise:=false', '-p', 'sensor.read_noise:=false') as errors:
        peer.spin_until(lambda: bool(images), limit_s=60.0,
                        meanwhile=lambda: publish(123_456_789))
        assert time_ns(images[0].header.stamp) == 123_456_789

        peer.spin_until(lambda: time_ns(images[-1].header.stamp) == 10**9,
                        meanwhile=lambda: publish(10**9))
        at_rest = contrast()
        odometry.twist.twist.angular.z = 60.0    # 7 px in 1 ms
        peer.spin_until(lambda: time_ns(images[-1].header.stamp) == 2 * 10**9,
                        meanwhile=lambda: publish(2 * 10**9))
        assert contrast() < 0.6 * at_rest

        # A reader that comes late is served with the frame that is shown.
        depth = peer.listen(Image, 'ground_truth/depth/image')
        peer.spin_until(lambda: bool(depth))
        assert time_ns(depth[0].header.stamp) == 2 * 10**9
        hashes.publish(String(data='0123456789abcdef'))
    assert 'is not that of the physics, 0123456789ab' in errors[-1]


def test_an_error_of_matching_ends_the_render_node(peer: Peer, world_folder: Path) -> None:
    """Even that of the last frame: there is no next one that would notice it."""
    left = peer.listen(Image, 'stereo/left/image_raw')
    disparities = peer.listen(DisparityImage, 'stereo/disparity')
    poses = peer.node.create_publisher(Odometry, 'odom', 10)
    odometry = at_rest_odometry()
    with ended('render_node', '-p', f'world:={world_folder}', *SMALL_CAMERA, '-p',
               'sgm.num_disparities:=160') as errors:
        peer.spin_until(lambda: bool(left), limit_s=60.0,
                        meanwhile=lambda: poses.publish(odometry))
    assert errors[-1] == ('FATAL num_disparities: 160 is not valid; valid is less than the image '
                          'width, 160')
    assert len(left) <= 1 and not disparities


def test_drive_node_answers_odometry(peer: Peer) -> None:
    """A profile is driven on hand-made odometry."""
    velocities = peer.listen(Twist, 'cmd_vel')
    poses = peer.node.create_publisher(Odometry, 'odom', 10)
    odometry = Odometry()
    odometry.pose.pose.orientation.w = 1.0
    ticks = [0]

    def tick() -> None:
        ticks[0] += 1
        odometry.header.stamp.sec = ticks[0]
        odometry.pose.pose.position.x = 0.1 * ticks[0]
        poses.publish(odometry)

    with running('drive_node', '-p', 'mode:=profile', '-p', 'profile_forward_mps:=[0.08]', '-p',
                 'enable_stamped_cmd_vel:=false'):
        peer.spin_until(lambda: bool(velocities) and velocities[-1].linear.x > 0.07,
                        meanwhile=tick)


def test_recorder_node_records_what_it_finds(peer: Peer, tmp_path: Path) -> None:
    """A topic that nobody declared is recorded; those on request only where they are named."""
    from lunar_rover_sim.bag.reader import open_bag
    publisher = peer.node.create_publisher(Twist, 'somebody/elses_topic', 10)
    named, other = (peer.node.create_publisher(
        CompressedImage, f'stereo/{side}/image_raw/compressed', 10) for side in ('left', 'right'))
    bag = tmp_path / 'bag'
    with running('recorder_node', '-p', f'output:={bag}', '-p',
                 'topics:=[all, stereo/left/image_raw/compressed]'):
        peer.spin_until(lambda: publisher.get_subscription_count() > 0
                        and named.get_subscription_count() > 0)
        named.publish(CompressedImage())
        assert not other.get_subscription_count()
        for _ in range(20):
            publisher.publish(Twist())
            time.sleep(0.01)
        time.sleep(0.5)
    with open_bag(bag) as recorded:
        assert not recorded.incomplete
        assert recorded.counts['/somebody/elses_topic'] == 20
        assert recorded.counts['/stereo/left/image_raw/compressed'] == 1


def test_trajectory_recorder_node_writes_tum(peer: Peer, tmp_path: Path) -> None:
    """An estimator's poses become a file that `evaluate` reads; a Path repeats itself, once."""
    from nav_msgs.msg import Path as PathMsg

    from lunar_rover_sim.evaluation.trajectory_files import read_tum
    publishers = {kind: peer.node.create_publisher(kind, f'slam/{kind.__name__.lower()}', 10)
                  for kind in (Odometry, PoseStamped, PathMsg)}
    files = {kind: tmp_path / f'{kind.__name__}.txt' for kind in publishers}
    path = PathMsg()
    with ExitStack() as recorders:
        for kind, file in files.items():
            recorders.enter_context(running(
                'trajectory_recorder_node', '-p', f'output:={file}', '-r',
                f'pose:=slam/{kind.__name__.lower()}'))
        peer.spin_until(lambda: all(publisher.get_subscription_count()
                                    for publisher in publishers.values()))
        for k in range(1, 6):
            pose = PoseStamped()
            pose.header.stamp.sec, pose.header.stamp.nanosec = k, 5
            pose.pose.position.x = 0.1 * k
            pose.pose.orientation.w = 1.0
            path.poses.append(pose)
            odometry = Odometry(header=pose.header)
            odometry.pose.pose = pose.pose
            for kind, message in ((Odometry, odometry), (PoseStamped, pose), (PathMsg, path)):
                publishers[kind].publish(message)
            time.sleep(0.05)
        peer.spin_until(lambda: all(len(file.read_text().splitlines()) == 5
                                    for file in files.values()))
    for file in files.values():
        trajectory = read_tum(file)
        assert trajectory.stamps_ns.tolist() == [k * 10**9 + 5 for k in range(1, 6)]
        assert np.allclose(trajectory.positions_m[:, 0], 0.1 * np.arange(1, 6))
        assert np.allclose(trajectory.orientations_wxyz, [1, 0, 0, 0])


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_publishing_node(peer: Peer, world_folder: Path,
                                         number: signal.Signals) -> None:
    """The current callback is finished: no error is printed, and the status is 0."""
    odometry = peer.listen(Odometry, 'odom')
    process = subprocess.Popen(
        [sys.executable, '-m', 'lunar_rover_sim.nodes.physics_node', '--ros-args', '-p',
         f'world:={world_folder}', '-p', 'time_mode:=lockstep'],    # waits for nobody
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        peer.spin_until(lambda: bool(odometry))
        process.send_signal(number)
        output, _ = process.communicate(timeout=20)
        assert process.returncode == 0, output
        assert not any(word in output for word in ('Traceback', 'rror', 'FATAL')), output
    finally:
        process.kill()
        process.communicate()


def test_a_signal_ends_a_starting_node(domain: int, tmp_path: Path) -> None:
    """While the node is being constructed, too, the status is 0."""
    bag = tmp_path / 'bag'
    process = subprocess.Popen(
        [sys.executable, '-m', 'lunar_rover_sim.nodes.recorder_node', '--ros-args', '-p',
         f'output:={bag}'], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        deadline = time.monotonic() + 30.0
        while not bag.exists():     # made in the constructor
            assert time.monotonic() < deadline
            time.sleep(0.001)
        process.send_signal(signal.SIGTERM)
        output, _ = process.communicate(timeout=20)
        assert process.returncode == 0, output
        assert all(line.startswith('[INFO]') for line in output.splitlines())
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(('node', 'arguments', 'said'), [
    ('physics_node', (), "world: '' is not valid"),
    ('physics_node', ('-p', 'world:=/nowhere'), '/nowhere'),
    ('physics_node', ('-p', 'wrold:=/tmp'), 'did you mean world'),
    ('render_node', ('-p', 'sun.elevation_deg:=100.0'), 'sun.elevation_deg: 100.0 is not valid'),
    ('gait_controller_node', ('-p', 'duty_factor:=text'), "duty_factor: 'text' is not a number"),
    ('gait_controller_node', ('-p', 'foot_width_deg:=130.0'), 'foot_width'),
    ('recorder_node', ('-p', 'output:=/tmp'), 'exists already'),
    ('drive_node', ('-p', 'mode:=fly'), "mode: 'fly' is not valid"),
])
def test_wrong_parameters_are_one_line(node: str, arguments: tuple[str, ...], said: str,
                                       domain: int) -> None:
    """A node that cannot start says why and exits with 1."""
    assert said in fails(node, *arguments)


def test_a_joint_state_without_our_joints_is_named(peer: Peer) -> None:
    """A message that cannot be answered ends the node with what is missing in it."""
    states = peer.node.create_publisher(JointState, 'joint_states', 10)
    with ended('gait_controller_node') as errors:
        peer.spin_until(lambda: bool(states.get_subscription_count()))
        states.publish(JointState(name=['wheel'], position=[0.0], velocity=[0.0]))
    assert "of joints ['wheel']" in errors[-1]


def test_an_answer_from_the_future_does_not_hold_the_gate_open(peer: Peer,
                                                               world_folder: Path) -> None:
    """Stamps of another clock are refused and named; time waits for those of its own."""
    clocks = peer.listen(Odometry, 'odom')
    publisher = peer.node.create_publisher(JointState, 'joint_commands', 10)

    def answer(seconds: int) -> None:
        command = JointState(name=LEGS, velocity=[0.0] * 4)
        command.header.stamp.sec = seconds
        publisher.publish(command)

    with running('physics_node', '-p', f'world:={world_folder}', '-p', 'time_mode:=lockstep',
                 '-p', 'wait.topics:=[joint_commands]', '-p', 'wait.lags_s:=[0.0]',
                 '-p', 'start_paused:=true') as process:
        # Who gets a response is known: the one state that comes at first is not lost.
        peer.spin_until(lambda: peer.node.count_publishers('odom') > 0)
        assert peer.call(SetBool, 'physics_node/pause', SetBool.Request(data=False)).success
        peer.spin_until(lambda: bool(clocks), meanwhile=lambda: answer(1_700_000_000))
        # The node may not have discovered us when it publishes its first state.
        enough = time.monotonic() + 1.0
        peer.spin_until(lambda: time.monotonic() > enough,
                        meanwhile=lambda: answer(1_700_000_000))
        assert len(clocks) == 1
        # By stamps: many more states come at once than our queue holds.
        peer.spin_until(lambda: time_ns(clocks[-1].header.stamp) > 500_000_000,
                        meanwhile=lambda: answer(1))
        process.send_signal(signal.SIGINT)
        assert 'joint_commands: stamp 1700000000.000 s refused' in process.stdout.read()


def latched_description(peer: Peer) -> Publisher:
    """Publish a description of a robot, which has no stamp, as physics_node does."""
    from std_msgs.msg import String

    from lunar_rover_sim.nodes import qos
    latched = peer.node.create_publisher(String, 'robot_description', qos.newest(durable=True))
    latched.publish(String(data='<robot/>'))
    return latched


def test_view_node_serves_what_is_watched(peer: Peer) -> None:
    """A client without ROS gets the bytes of messages; latched ones come to every client."""
    pytest.importorskip('foxglove')
    from rclpy.serialization import deserialize_message
    from rosgraph_msgs.msg import Clock
    from std_msgs.msg import String
    from view_client import client, free_port

    from lunar_rover_sim import topics
    latched_description(peer)
    poses = peer.node.create_publisher(Odometry, 'odom', 10)
    port = free_port()
    with running('view_node', '-p', f'port:={port}'), client(port) as first:
        first.find('/odom')
        assert not poses.get_subscription_count()       # nobody watches: nothing is read
        first.subscribe('/odom')
        peer.spin_until(lambda: poses.get_subscription_count() > 0, meanwhile=first.attend)
        poses.publish(at_rest_odometry())
        number, _, data = first.message()
        assert number == 7 and deserialize_message(data, Odometry) == at_rest_odometry()
        if importlib.util.find_spec('tf2_msgs') is None:
            first.subscribe('/tf', 9)       # made of the odometry
            peer.spin_until(lambda: poses.get_subscription_count() > 1, meanwhile=first.attend)
            poses.publish(at_rest_odometry())
            got = {number: data for number, _, data in (first.message(), first.message())}
            message = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(got[9], topics.TF.type)
            assert [t.child_frame_id for t in message.transforms] == [
                at_rest_odometry().child_frame_id]
        clock = peer.node.create_publisher(Clock, '/clock', 10)
        peer.spin_until(lambda: clock.get_subscription_count() > 0)
        clock.publish(Clock(clock=time_msg(7_000_000_000)))
        while first.time_ns() != 7_000_000_000:     # that of the wall, as long as there was none
            pass
        first.subscribe('/robot_description', 8)
        _, stamp_ns, data = first.message()
        assert deserialize_message(data, String).data == '<robot/>'
        assert stamp_ns == 7_000_000_000        # it has none of its own
        with client(port) as second:
            second.subscribe('/robot_description')
            assert deserialize_message(second.message()[2], String).data == '<robot/>'
    peer.spin_until(lambda: not poses.get_subscription_count())


def test_view_node_hears_the_clock_before_what_has_no_stamp(peer: Peer) -> None:
    """A latched message comes at once; its first client gets it in simulated time too."""
    pytest.importorskip('foxglove')
    from rosgraph_msgs.msg import Clock
    from view_client import client, free_port
    latched = latched_description(peer)
    clock = peer.node.create_publisher(Clock, '/clock', 10)
    port = free_port()
    with running('view_node', '-p', f'port:={port}'), client(port) as first:
        first.find('/clock')
        first.subscribe('/robot_description')
        peer.spin_until(lambda: latched.get_subscription_count() > 0,
                        meanwhile=lambda: clock.publish(Clock(clock=time_msg(7_000_000_000))))
        assert first.message()[1] == 7_000_000_000


def test_render_node_listens_before_it_is_seen(world_folder: Path,
                                               monkeypatch: pytest.MonkeyPatch) -> None:
    """Its cameras take seconds to prepare: the first state may come as soon as topics are seen."""
    from lunar_rover_sim.nodes import render_node
    heard: list[set[str]] = []

    def advertise(node: Any, *_: Any) -> None:
        heard.append({subscription.topic_name for subscription in node.subscriptions})
        raise GraphError('far enough')

    monkeypatch.setattr(render_node, 'FramePublisher', advertise)
    rclpy.init(args=['--ros-args', '-p', f'world:={world_folder}', '-p', 'camera.width:=64',
                     '-p', 'camera.height:=48'])
    try:
        with pytest.raises(GraphError, match='far enough'):
            render_node.RenderNode()
    finally:
        rclpy.shutdown()
    assert {'/odom', '/joint_states'} <= heard[0]
