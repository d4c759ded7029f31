"""render_node alone, beside a plain rclpy program: images, truth, clouds, further cameras."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytestmark = pytest.mark.ros
rclpy = pytest.importorskip('rclpy')

from geometry_msgs.msg import PoseStamped, Vector3Stamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402  (needs rclpy)
from peer import at_rest_odometry, ended, Peer, PLAIN_DETAIL, running, SMALL_CAMERA  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile  # noqa: E402
from sensor_msgs.msg import CameraInfo, CompressedImage, JointState, PointCloud2  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from stereo_msgs.msg import DisparityImage  # noqa: E402
from waiting import wait_until  # noqa: E402

from lunar_rover_sim.bag.messages import time_ns  # noqa: E402
from lunar_rover_sim.base.errors import GraphError  # noqa: E402
from lunar_rover_sim.nodes.conversions import time_msg  # noqa: E402

HAZARDS = [argument for name, value in (
    ('front.camera.width', 64), ('front.camera.height', 48),
    ('front.sensor.encoding', 'bayer_rggb8'),
    ('front.camera.fisheye_distortion', '[0.01, 0.0, 0.0, 0.0]'), ('rear.camera.model', 'pinhole'),
    ('rear.camera.horizontal_fov_deg', 90.0), ('rear.stereo_baseline_m', 0.05),
    ('rear.orientation_rpy_deg', '[0.0, 0.0, 180.0]'), ('rear.position_m', '[-0.17, 0.0, 0.05]'))
    for argument in ('-p', f'hazard.{name}:={value}')]


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
    with running('render_node', '-p', f'world:={world_folder}', *SMALL_CAMERA, *PLAIN_DETAIL, '-p',
                 'stereo.left.image_raw.compressed.format:=png', '-p', 'chase.enabled:=true', '-p',
                 'chase.camera.width:=128', '-p', 'chase.camera.height:=72', *HAZARDS):
        peer.spin_until(lambda: all(received.values()),
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
                        meanwhile=lambda: poses.publish(odometry))
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
    assert (image.encoding, image.step) == ('bayer_rggb8', 64)
    assert info.distortion_model == 'equidistant' and list(info.d) == [0.01, 0.0, 0.0, 0.0]
    assert np.ptp(np.frombuffer(bytes(image.data), np.uint8)) > 20
    right = received['hazard/rear/right/camera_info'][0]
    assert right.header.frame_id == 'hazard_rear_left_optical_frame'
    assert right.distortion_model == 'plumb_bob' and right.k[0] == pytest.approx(160.0)
    assert right.p[3] == pytest.approx(-160.0 * 0.05)
    assert received['hazard/rear/right/image_raw'][0].header == right.header
    label, depth = (received[f'ground_truth/hazard/{name}'][0]
                    for name in ('front/labels', 'rear/right/depth/image'))
    assert (label.encoding, label.header) == ('mono16', image.header)
    assert 1 in np.frombuffer(bytes(label.data), np.uint16)
    assert depth.header.stamp == right.header.stamp and depth.encoding == '32FC1'
    assert depth.header.frame_id == 'hazard_rear_right_optical_frame'       # it has no P
    assert 0.02 < np.frombuffer(bytes(depth.data), np.float32).min() < 1.0


def _check_chase(received: dict[str, list[Any]]) -> None:
    """The rover is in the middle of the image; pose and CameraInfo say so, too."""
    image, info, pose = (received[f'chase/{name}'][0] for name in ('image_raw', 'camera_info',
                                                                   'pose'))
    assert (info.width, info.height) == (image.width, image.height) == (128, 72)
    assert info.header == image.header and image.header.frame_id == 'chase_optical_frame'
    assert image.encoding == 'rgb8' and image.step == 3 * 128
    pixels = np.frombuffer(bytes(image.data), np.uint8).reshape(72, 128, 3)
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

    from lunar_rover_sim.base import topics
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
        peer.spin_until(lambda: bool(images),
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
    with ended('render_node', '-p', f'world:={world_folder}', *SMALL_CAMERA,
               *PLAIN_DETAIL, '-p', 'sgm.num_disparities:=160') as errors:
        peer.spin_until(lambda: bool(left),
                        meanwhile=lambda: poses.publish(odometry))
    assert errors[-1] == ('FATAL num_disparities: 160 is not valid; valid is less than the image '
                          'width, 160')
    assert len(left) <= 1 and not disparities


def test_render_node_listens_before_it_is_seen(world_folder: Path,
                                               monkeypatch: pytest.MonkeyPatch) -> None:
    """Its cameras take seconds to prepare: the first state may come as soon as topics are seen."""
    from lunar_rover_sim.nodes import render_node
    heard: list[set[str]] = []

    def advertise(node: Any, *_: Any) -> None:
        heard.append({subscription.topic_name for subscription in node.subscriptions})
        raise GraphError('far enough')

    monkeypatch.setattr(render_node, 'CameraPublisher', advertise)
    rclpy.init(args=['--ros-args', '-p', f'world:={world_folder}', '-p', 'camera.width:=64',
                     '-p', 'camera.height:=48'])
    try:
        with pytest.raises(GraphError, match='far enough'):
            render_node.RenderNode()
    finally:
        rclpy.shutdown()
    assert {'/odom', '/joint_states'} <= heard[0]


def test_light_exposure_and_rates_change_while_it_runs(peer: Peer, world_folder: Path) -> None:
    """What `ros2 param set` changes is seen in the next images; refusals say what is valid."""
    images = peer.listen(Image, 'stereo/left/image_raw')
    poses = peer.node.create_publisher(Odometry, 'odom', 10)
    odometry = at_rest_odometry()
    odometry.header.stamp.sec = 3

    def put(**values: Any) -> Any:
        return [(result.successful, result.reason) for result in peer.call(
            SetParameters, 'render_node/set_parameters', SetParameters.Request(
                parameters=[Parameter(name.replace('__', '.'), value=value).to_parameter_msg()
                            for name, value in values.items()])).results]

    def brightness() -> float:
        """Return the mean of the image of the next second."""
        odometry.header.stamp.sec += 1
        peer.spin_until(lambda: bool(images)
                        and images[-1].header.stamp.sec == odometry.header.stamp.sec,
                        meanwhile=lambda: poses.publish(odometry))
        return float(np.mean(images[-1].data))

    with running('render_node', '-p', f'world:={world_folder}', *SMALL_CAMERA,
                 *PLAIN_DETAIL, '-p', 'sensor.exposure_mode:=fixed', '-p',
                 'sensor.exposure_s:=0.002', '-p', 'sensor.companding:=linear', '-p',
                 'sun.elevation_deg:=5.0', '-p', 'miscalibration.gain_percent:=5.0'):
        before = brightness()
        suns = peer.echo(Vector3Stamped, 'sun')
        peer.spin_until(lambda: len(suns) == 1)
        told = peer.echo(String, 'ground_truth/miscalibration')
        peer.spin_until(lambda: len(told) == 1)
        assert abs(json.loads(told[0].data)['gain'] - 1.0) <= 0.05
        exposures = peer.listen(JointState, 'stereo/exposure', 10)
        assert put(sensor__exposure_s=0.004) == [(True, '')]
        assert brightness() > 1.3 * before
        peer.spin_until(lambda: bool(exposures) and exposures[-1].header == images[-1].header)
        assert list(exposures[-1].position) == [0.004, 0.004]
        assert put(sensor__exposure_s=0.002) == [(True, '')]
        assert brightness() == pytest.approx(before, rel=0.1)
        assert put(sun__elevation_deg=40.0, frame_rate_hz=10.0) == [(True, ''), (True, '')]
        peer.spin_until(lambda: len(suns) > 1)
        assert suns[-1].vector.z == pytest.approx(np.sin(np.radians(40.0)))
        wait_until(lambda: brightness() > 1.5 * before)     # it is computed beside the drawing
        for name, value, valid in (('sun__elevation_deg', 95.0, '90'),
                                   ('sensor__exposure_mode', 'manual', 'auto, fixed, sunlit')):
            ((successful, reason),) = put(**{name: value})
            assert not successful and valid in reason
        assert not put(sun__date='2026-11-28T00:00:00Z')[0][0]      # read-only


pytest.importorskip('rclpy')

PERIOD_NS = 100_000_000
STATE_NS = 5_000_000


def test_states_that_piled_up_are_not_drawn_one_by_one(peer: Peer, world_folder: Path) -> None:
    """Two seconds of states at once: a few frames, on their periods, and the last one among them.

    One by one they would be twenty frames, and the images of a drive would lag ever farther
    behind.
    """
    images = peer.listen(Image, 'stereo/left/image_raw', 50)
    poses = peer.node.create_publisher(Odometry, 'odom', QoSProfile(depth=1000))

    def publish(stamp_ns: int) -> None:
        odometry = at_rest_odometry()
        odometry.header.stamp.sec, odometry.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        poses.publish(odometry)

    def stamps_ns() -> list[int]:
        return [image.header.stamp.sec * 10**9 + image.header.stamp.nanosec for image in images]

    with running('render_node', '-p', f'world:={world_folder}', '-p', 'time_mode:=real_time',
                 '-p', 'frame_rate_hz:=10', *PLAIN_DETAIL):
        peer.spin_until(lambda: bool(images),
                        meanwhile=lambda: publish(3 * 10**9))
        images.clear()
        first, last = 4 * 10**9, 6 * 10**9
        for stamp in range(first, last + STATE_NS, STATE_NS):
            publish(stamp)
        peer.spin_until(lambda: bool(images) and stamps_ns()[-1] == last)
    assert len(images) <= 10
    assert all(stamp % PERIOD_NS == 0 for stamp in stamps_ns())
