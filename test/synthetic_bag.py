"""A small bag of the topic contract, made without ROS and without simulation.

A rover drives an arc on a flat, textured plane while it rocks; everything is analytic, so that
IMU, odometry, images, depth and disparity agree.
"""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from scipy.spatial.transform import Rotation
import yaml

from lunar_rover_sim.bag.marker import METADATA_NAME
from lunar_rover_sim.bag.metadata import contract_qos
from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.rover.description import Legs, StereoMount

STORE = get_typestore(Stores.ROS2_JAZZY)
GRAVITY = 1.62
WIDTH, HEIGHT, FOCAL_PX = 160, 120, 120.0
MOUNT = StereoMount()
SPEED, RADIUS = 0.15, 2.0
EXPOSURE_S = 2.5e-3
# What an estimator is given and judged by.
FOR_ESTIMATORS = (topics.LEFT_IMAGE, topics.LEFT_INFO, topics.RIGHT_IMAGE, topics.RIGHT_INFO,
                  topics.ODOM, topics.IMU_RAW, topics.IMU_BIAS, topics.TF_STATIC, topics.SCENARIO)
SCENARIO = """
physics_node:
  ros__parameters:
    world: /nowhere/world
    time_mode: lockstep
"""
CONTACTS = topics.of_legs([topics.CONTACT], Legs().names)
CONTRACT = topics.of_legs(topics.CONTRACT, Legs().names)


@dataclasses.dataclass
class Item:
    """One message on its way into a bag."""

    topic: str
    msgtype: str
    message: Any
    fallback_ns: int = 0


def item(topic: topics.Topic, message: Any) -> Item:
    """Return a message of a topic."""
    return Item(topic.name, topic.type, message)


def text(topic: topics.Topic, data: str) -> Item:
    """Return a String of a topic."""
    return item(topic, msg('std_msgs/String', data=data))


def picture(topic: topics.Topic, ns: int, encoding: str, pixels: np.ndarray) -> Item:
    """Return an Image of a topic, in its frame."""
    return item(topic, image(ns, topic.frame_id, encoding, pixels))


def cloud(topic: topics.Topic, ns: int, frame: str, points: np.ndarray) -> Item:
    """Return a PointCloud2 of structured records, in one row; they may hold NaN."""
    assert points.dtype.fields is not None
    kinds = {'f4': 7, 'u2': 4}      # of PointField
    fields = [msg('sensor_msgs/PointField', name=name, offset=place[1],
                  datatype=kinds[place[0].str[1:]], count=1)
              for name, place in points.dtype.fields.items()]
    return item(topic, msg(
        'sensor_msgs/PointCloud2', header=header(ns, frame), height=1, width=len(points),
        fields=fields, is_bigendian=False, point_step=points.itemsize, row_step=points.nbytes,
        data=np.frombuffer(points.tobytes(), np.uint8),
        is_dense=bool(np.isfinite(points['x']).all())))


def odometry(ns: int, frame: str, T: np.ndarray, linear: Any = (0.0, 0.0, 0.0),
             angular: Any = (0.0, 0.0, 0.0)) -> Any:
    """Return an Odometry of base_link at T, with a twist in its axes."""
    x, y, z = (float(c) for c in T[:3, 3])
    pose = msg('geometry_msgs/Pose', position=msg('geometry_msgs/Point', x=x, y=y, z=z),
               orientation=quaternion(frames.wxyz_from_matrix(T[:3, :3])))
    twist = msg('geometry_msgs/Twist', linear=vector(linear), angular=vector(angular))
    return msg('nav_msgs/Odometry', header=header(ns, frame), child_frame_id=frames.BASE_FRAME,
               pose=msg('geometry_msgs/PoseWithCovariance', pose=pose, covariance=np.zeros(36)),
               twist=msg('geometry_msgs/TwistWithCovariance', twist=twist,
                         covariance=np.zeros(36)))


def transform(ns: int, parent: str, child: str, T: np.ndarray) -> Any:
    """Return a TransformStamped."""
    return msg('geometry_msgs/TransformStamped', header=header(ns, parent), child_frame_id=child,
               transform=msg('geometry_msgs/Transform', translation=vector(T[:3, 3]),
                             rotation=quaternion(frames.wxyz_from_matrix(T[:3, :3]))))


def msg(kind: str, /, **fields: Any) -> Any:
    """Make a message of type `package/Name` from its fields."""
    package, _, name = kind.partition('/')
    return STORE.types[f'{package}/msg/{name}'](**fields)


def time(ns: int) -> Any:
    return msg('builtin_interfaces/Time', sec=ns // 10**9, nanosec=ns % 10**9)


def header(ns: int, frame: str) -> Any:
    return msg('std_msgs/Header', stamp=time(ns), frame_id=frame)


def vector(v: Any) -> Any:
    x, y, z = (float(c) for c in v)
    return msg('geometry_msgs/Vector3', x=x, y=y, z=z)


def quaternion(q_wxyz: Any) -> Any:
    w, x, y, z = (float(c) for c in q_wxyz)
    return msg('geometry_msgs/Quaternion', x=x, y=y, z=z, w=w)


def pose_at(t: float) -> np.ndarray:
    """Return T_odom_base at time t [s]."""
    yaw = SPEED * t / RADIUS
    position = [RADIUS * np.sin(yaw), RADIUS * (1 - np.cos(yaw)),
                0.1 + 0.004 * np.sin(2 * np.pi * 2.0 * t)]
    quat = frames.wxyz_from_rpy(0.03 * np.sin(2 * np.pi * 1.5 * t),
                                0.04 * np.sin(2 * np.pi * 2.0 * t + 0.3), yaw)
    return frames.se3(frames.matrix_from_wxyz(quat), position)


def velocity_at(t: float) -> np.ndarray:
    """Return the velocity of base in the world [m/s]."""
    h = 1e-5
    return (pose_at(t + h)[:3, 3] - pose_at(t - h)[:3, 3]) / (2 * h)


def turn(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the rotation vector [rad] from attitude `before` to `after`, in base."""
    return Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).as_rotvec()


def motion_at(t: float, interval_s: float) -> tuple[np.ndarray, ...]:
    """Return velocity and rate in base, and mean rate and specific force of the last interval."""
    h = 1e-5
    then, middle, now = pose_at(t - interval_s), pose_at(t - interval_s / 2), pose_at(t)
    gain = (velocity_at(t) - velocity_at(t - interval_s)) / interval_s
    return (now[:3, :3].T @ velocity_at(t), turn(pose_at(t - h), pose_at(t + h)) / (2 * h),
            turn(then, now) / interval_s, middle[:3, :3].T @ (gain + [0.0, 0.0, GRAVITY]))


def T_base_camera(side: float) -> np.ndarray:
    """Return the pose of the left (side = +1) or right (-1) optical frame in base_link."""
    down = frames.matrix_from_wxyz(frames.wxyz_from_rpy(0.0, np.radians(MOUNT.pitch_deg), 0.0))
    position = np.array(MOUNT.position_m) + [0.0, side * MOUNT.baseline_m / 2, 0.0]
    return frames.se3(down @ frames.R_BODY_OPTICAL, position)


class Scene:
    """The textured plane z = 0."""

    def __init__(self, seed: int = 0) -> None:
        self.texture = np.random.default_rng(seed).random((512, 512))
        u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        self.rays = np.stack([(u - (WIDTH - 1) / 2) / FOCAL_PX, (v - (HEIGHT - 1) / 2) / FOCAL_PX,
                              np.ones((HEIGHT, WIDTH))], axis=-1)

    def view(self, T_world_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the (h, w) uint8 image and the float32 depth, +Inf above the horizon."""
        rays = self.rays @ T_world_camera[:3, :3].T
        origin = T_world_camera[:3, 3]
        with np.errstate(divide='ignore', invalid='ignore'):
            depth = np.where(rays[..., 2] < -1e-6, -origin[2] / rays[..., 2], np.inf)
        hit = np.isfinite(depth)
        xy = origin[:2] + np.where(hit, depth, 0.0)[..., None] * rays[..., :2]
        cell = np.floor(xy / 0.02).astype(int) % 512
        image = np.where(hit, 30 + 200 * self.texture[cell[..., 1], cell[..., 0]], 0)
        return image.astype(np.uint8), depth.astype(np.float32)


def image(ns: int, frame: str, encoding: str, pixels: np.ndarray) -> Any:
    return msg('sensor_msgs/Image', header=header(ns, frame), height=pixels.shape[0],
               width=pixels.shape[1], encoding=encoding, is_bigendian=0,
               step=pixels[0].nbytes,
               data=np.frombuffer(pixels.tobytes(), np.uint8))


def camera_info(ns: int, frame: str, baseline_m: float) -> Any:
    cx, cy = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    k = np.array([FOCAL_PX, 0, cx, 0, FOCAL_PX, cy, 0, 0, 1.0])
    p = np.array([FOCAL_PX, 0, cx, -FOCAL_PX * baseline_m, 0, FOCAL_PX, cy, 0, 0, 0, 1.0, 0])
    roi = msg('sensor_msgs/RegionOfInterest', x_offset=0, y_offset=0, height=0, width=0,
              do_rectify=False)
    return msg('sensor_msgs/CameraInfo', header=header(ns, frame), height=HEIGHT, width=WIDTH,
               distortion_model='plumb_bob', d=np.zeros(5), k=k, r=np.eye(3).ravel(), p=p,
               binning_x=0, binning_y=0, roi=roi)


def imu(ns: int, rate: np.ndarray, force: np.ndarray, quat: Any = None) -> Any:
    no_orientation = np.zeros(9)
    if quat is None:
        no_orientation[0] = -1.0
    return msg('sensor_msgs/Imu', header=header(ns, frames.IMU_FRAME),
               orientation=quaternion([1.0, 0, 0, 0] if quat is None else quat),
               orientation_covariance=no_orientation, angular_velocity=vector(rate),
               angular_velocity_covariance=np.zeros(9), linear_acceleration=vector(force),
               linear_acceleration_covariance=np.zeros(9))


def state_items(ns: int, step_ns: int, rng: np.random.Generator) -> list[Item]:
    """Return everything that comes with every publishing period of physics."""
    t = ns * 1e-9
    T = pose_at(t)
    velocity, omega, rate, force = motion_at(t, step_ns * 1e-9)
    quat = frames.wxyz_from_matrix(T[:3, :3])
    joints = msg('sensor_msgs/JointState', header=header(ns, ''), name=list(Legs().joint_names),
                 position=np.full(4, 2.0 * t), velocity=np.full(4, 2.0), effort=np.full(4, 0.1))
    bias = msg('geometry_msgs/Accel', linear=vector([0.01, 0, 0]), angular=vector([1e-3, 0, 0]))
    wrench = msg('geometry_msgs/Wrench', force=vector([0, 0, 0.9]), torque=vector([0, 0, 0]))
    made = [
        (topics.CLOCK, msg('rosgraph_msgs/Clock', clock=time(ns))),
        (topics.ODOM, odometry(ns, frames.ODOM_FRAME, T, velocity, omega)),
        (topics.JOINT_STATES, joints),
        (topics.JOINT_COMMANDS, joints),
        (topics.IMU_TRUTH, imu(ns, rate, force, quat)),
        (topics.IMU_RAW, imu(ns, rate + [1e-3, 0, 0] + 1e-3 * rng.standard_normal(3),
                             force + [0.01, 0, 0] + 1e-2 * rng.standard_normal(3))),
        (topics.IMU_BIAS, msg('geometry_msgs/AccelStamped', header=header(ns, frames.IMU_FRAME),
                              accel=bias)),
        (topics.TF, msg('tf2_msgs/TFMessage', transforms=[
            transform(ns, frames.ODOM_FRAME, frames.BASE_FRAME, T)])),
        *((contact, msg('geometry_msgs/WrenchStamped', header=header(ns, contact.frame_id),
                        wrench=wrench)) for contact in CONTACTS)]
    return [item(topic, message) for topic, message in made]


def frame_items(ns: int, scene: Scene, with_depth: bool = True) -> list[Item]:
    """Return one stereo set."""
    T = pose_at(ns * 1e-9)
    left, depth = scene.view(T @ T_base_camera(+1.0))
    right, _ = scene.view(T @ T_base_camera(-1.0))
    disparity = (FOCAL_PX * MOUNT.baseline_m / depth).astype(np.float32)
    seen = disparity >= 1.0
    frame = frames.LEFT_OPTICAL_FRAME
    roi = msg('sensor_msgs/RegionOfInterest', x_offset=0, y_offset=0, height=HEIGHT, width=WIDTH,
              do_rectify=False)
    disparity_image = msg(
        'stereo_msgs/DisparityImage', header=header(ns, frame),
        image=image(ns, frame, '32FC1', np.where(seen, disparity, -1).astype(np.float32)),
        f=FOCAL_PX, t=MOUNT.baseline_m, valid_window=roi, min_disparity=0.0, max_disparity=64.0,
        delta_d=0.0625)
    sgm_depth = np.where(seen, depth, np.nan).astype(np.float32)
    exposure = msg('sensor_msgs/JointState', header=header(ns, frame), name=['left', 'right'],
                   position=np.full(2, EXPOSURE_S), velocity=np.empty(0), effort=np.empty(0))
    made = [
        (topics.EXPOSURE, exposure),
        (topics.LEFT_IMAGE, image(ns, frame, 'mono8', left)),
        (topics.RIGHT_IMAGE, image(ns, frame, 'mono8', right)),
        (topics.LEFT_INFO, camera_info(ns, frame, 0.0)),
        (topics.RIGHT_INFO, camera_info(ns, frame, MOUNT.baseline_m)),
        (topics.DISPARITY, disparity_image),
        (topics.DEPTH, image(ns, frame, '32FC1', sgm_depth)),
        (topics.DEPTH_INFO, camera_info(ns, frame, 0.0)),
        (topics.TRUE_DEPTH, image(ns, frame, '32FC1', depth))]
    return [item(topic, message) for topic, message in made
            if with_depth or topic.rate != topics.DEPTH_FRAME]


def window(ns: int, middle_m: tuple[float, float]) -> Item:
    """Return the message that the rover is in a window of the site from a stamp on."""
    x, y = middle_m
    return item(topics.WORLD_WINDOW, msg('geometry_msgs/PointStamped',
                                         header=header(ns, frames.ODOM_FRAME),
                                         point=msg('geometry_msgs/Point', x=x, y=y, z=0.0)))


def latched_items() -> list[Item]:
    """Return what is said once."""
    static = [transform(0, frames.BASE_FRAME, child, T)
              for child, T in ((frames.LEFT_OPTICAL_FRAME, T_base_camera(+1.0)),
                               (frames.RIGHT_OPTICAL_FRAME, T_base_camera(-1.0)),
                               (frames.IMU_FRAME, np.eye(4)))]
    made = [
        (topics.SUN, msg('geometry_msgs/Vector3Stamped', header=header(0, frames.ODOM_FRAME),
                         vector=vector(frames.sun_direction(30.0, 10.0)))),
        (topics.WORLD_HASH, msg('std_msgs/String', data='ab' * 32)),
        (topics.WORLD_WINDOW, window(0, (0.0, 0.0)).message),
        (topics.ROBOT_DESCRIPTION, msg('std_msgs/String', data='<robot name="rover"/>')),
        (topics.SCENARIO, msg('std_msgs/String', data=SCENARIO)),
        (topics.TF_STATIC, msg('tf2_msgs/TFMessage', transforms=static))]
    return [item(topic, message) for topic, message in made]


def drive(duration_s: float = 1.0, state_hz: int = 200, frame_hz: int = 10,
          seed: int = 0, depth_every: int = 1,
          only: Collection[topics.Topic] = CONTRACT) -> list[Item]:
    """Return a whole drive in the order of time; state stamps begin at one period.

    only: the topics that a test needs; to write and read one more takes rosbags 10 ms
    """
    rng = np.random.default_rng(seed)
    scene = Scene(seed)
    items = latched_items()
    step_ns = 10**9 // state_hz
    frame_ns = 10**9 // frame_hz
    for ns in range(step_ns, round(duration_s * 1e9) + 1, step_ns):
        items += state_items(ns, step_ns, rng)
        if ns % frame_ns == 0:
            items += frame_items(ns, scene, with_depth=ns % (depth_every * frame_ns) == 0)
    names = {topic.name for topic in only}
    return [item for item in items if item.topic in names]


def serialise(item: Item) -> bytes:
    """Return the CDR bytes as a raw subscription gives them."""
    return bytes(STORE.serialize_cdr(item.message, item.msgtype))


def write(path: Path, items: list[Item], namespace: str = '', **options: Any) -> Path:
    """Write the items as a finished bag and return its path."""
    with BagWriter(path, **options) as writer:
        for item in items:
            writer.write(f'{namespace}/{item.topic}', item.msgtype, serialise(item),
                         item.fallback_ns)
    return path


def metadata(bag: Path) -> dict[str, Any]:
    """Return what metadata.yaml says of a bag."""
    return yaml.safe_load((bag / METADATA_NAME).read_text())['rosbag2_bagfile_information']


@contextmanager
def changed_metadata(bag: Path) -> Iterator[dict[str, Any]]:
    """Give what metadata.yaml says of a bag, to be changed."""
    told = metadata(bag)
    yield told
    (bag / METADATA_NAME).write_text(yaml.safe_dump({'rosbag2_bagfile_information': told}))


def write_sqlite(path: Path, items: list[Item], namespace: str = '', **options: Any) -> Path:
    """Write the items as other recorders do: SQLite, or another storage, by rosbags.

    Messages are compressed, or with mode=CompressionMode.FILE the whole file.
    """
    writer = Writer(path, version=9,
                    storage_plugin=options.get('storage', StoragePlugin.SQLITE3))
    if options.get('compression') == 'zstd':
        writer.set_compression(options.get('mode', CompressionMode.MESSAGE),
                               CompressionFormat.ZSTD)
    known: dict[str, Any] = {}
    with writer:
        for item in items:
            topic, raw = f'{namespace}/{item.topic}', serialise(item)
            if topic not in known:
                known[topic] = writer.add_connection(
                    topic, item.msgtype, typestore=STORE,
                    offered_qos_profiles=[contract_qos(topic)])
            writer.write(known[topic], stamp_ns(item.msgtype, raw) or item.fallback_ns, raw)
    return path


WRITERS = {'mcap': write, 'sqlite3': write_sqlite}      # by storage
