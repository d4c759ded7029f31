"""Damages of a synthetic bag, and what `bag check` says of each."""

from collections.abc import Callable
import copy
import dataclasses

import numpy as np
import synthetic_bag as synthetic
from synthetic_bag import Item

from lunar_rover_sim.bag.ground_points import POINT

SCENARIO = """
/**:
  ros__parameters: {seed: 1, world: /nowhere/world, time_mode: MODE}
run:
  ros__parameters: {duration_s: 0.6}
rover:
  ros__parameters: {imu: {position_m: [0.0, 0.0, 0.0], rpy_deg: [0.0, 0.0, 0.0]},
                    stereo: {baseline_m: 0.1}}
physics_node:
  ros__parameters: {state_rate_hz: 100, gravity_mps2: 1.62, ground: {model: regolith}}
render_node:
  ros__parameters: {frame_rate_hz: 10}
recorder_node:
  ros__parameters: {topics: [all]}
"""


def stamp_of(item: Item) -> int:
    if item.topic == 'clock':
        stamp = item.message.clock
    elif item.topic == 'tf':
        stamp = item.message.transforms[0].header.stamp
    elif not hasattr(item.message, 'header'):
        return 0
    else:
        stamp = item.message.header.stamp
    return stamp.sec * 10**9 + stamp.nanosec


def edited(items: list[Item], topic: str, edit: Callable[[object], object],
           at_s: float | None = None) -> list[Item]:
    """Return the items with `edit` applied to copies of the messages of a topic."""
    result = []
    for item in items:
        if item.topic == topic and (at_s is None or stamp_of(item) == round(at_s * 1e9)):
            item = dataclasses.replace(item, message=copy.deepcopy(item.message))
            if edit(item.message) is False:
                continue
        result.append(item)
    return result


def setter(path: str, value: object) -> Callable[[object], object]:
    """Return an edit that sets the dotted field `path`; a function changes the old value."""
    def edit(message: object) -> None:
        *parents, name = path.split('.')
        for parent in parents:
            message = getattr(message, parent)
        new = value(getattr(message, name)) if callable(value) else value
        setattr(message, name, new)
    return edit


def drop(_: object) -> bool:
    return False


def floats(image: object) -> np.ndarray:
    return image.data.view(np.float32).copy()


def with_floats(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[object], object]:
    def edit(message: object) -> None:
        image = getattr(message, 'image', message)
        image.data = change(floats(image)).astype(np.float32).view(np.uint8)
    return edit


def with_points(name: str, more: float) -> Callable[[object], object]:
    def edit(message: object) -> None:
        points = np.frombuffer(bytes(message.data), POINT).copy()
        points[name] += more
        message.data = np.frombuffer(points.tobytes(), np.uint8)
    return edit


def nan_at(path: str) -> Callable[[object], object]:
    return setter(path, float('nan'))


def shift(ns: int) -> Callable[[object], object]:
    return setter('header.stamp.nanosec', lambda old: old + ns)


def swapped(items: list[Item]) -> list[Item]:
    names = {'stereo/left/camera_info': 'stereo/right/camera_info',
             'stereo/right/camera_info': 'stereo/left/camera_info'}
    return [dataclasses.replace(i, topic=names.get(i.topic, i.topic)) for i in items]


def at(value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(values: np.ndarray) -> np.ndarray:
        values[-1] = value
        return values
    return change


FORCE = 'linear_acceleration'
DAMAGES: dict[str, tuple[Callable[[list[Item]], list[Item]], str, str]] = {
    'odometry message lost': (
        lambda b: edited(b, 'odom', drop, 0.5), 'state counts', 'odom: 1 of 60 missing'),
    'joint command twice': (
        lambda b: b + [i for i in b if i.topic == 'joint_commands'][:1], 'stamps increase',
        'joint_commands'),
    'right image late': (
        lambda b: edited(b, 'stereo/right/image_raw', shift(4_000_000), 0.5), 'stereo sets',
        'stereo/right/image_raw lacks 1'),
    'pose of an image lost': (
        lambda b: edited(b, 'odom', drop, 0.6), 'pose per image', 'no odometry at 0.600000 s'),
    'stereo set between states': (
        lambda b: [i for t in b for i in (edited([t], t.topic, shift(1_000_000), 0.5)
                                          if t.topic.startswith(('stereo', 'ground_truth/depth'))
                                          else [t])],
        'frame counts', 'off the grid'),
    'topic missing': (
        lambda b: [i for i in b if i.topic != 'ground_truth/imu_bias'], 'topics',
        'ground_truth/imu_bias'),
    'command stamped with wall time': (
        lambda b: [*b, Item('cmd_vel', 'geometry_msgs/msg/TwistStamped', synthetic.msg(
            'geometry_msgs/TwistStamped', header=synthetic.header(1_800_000_000 * 10**9, ''),
            twist=synthetic.msg('geometry_msgs/Twist', linear=synthetic.vector((0, 0, 0)),
                                angular=synthetic.vector((0, 0, 0)))))],
        'one clock', '/cmd_vel: up to 1800000000.000 s'),
    'world hash missing': (
        lambda b: [i for i in b if i.topic != 'world_hash'], 'world hash', 'not in the bag'),
    'world hash nonsense': (
        lambda b: edited(b, 'world_hash', setter('data', 'the moon')), 'world hash', 'hexadec'),
    'a change of the ground lost': (
        lambda b: edited(b, 'ground/changes', drop, 0.3), 'frame counts',
        'ground/changes: 1 of 6 missing'),
    'soil lost with it': (
        lambda b: edited(b, 'ground/changes', drop, 0.3), 'ground changes', 'do not add up'),
    'ground not recorded': (
        lambda b: [i for i in b if i.topic != 'ground/changes'], 'topics', 'ground/changes'),
    'ground changes cut': (
        lambda b: edited(b, 'ground/changes', setter('data', lambda d: d[:-4]), 0.5),
        'contents', 'ground/changes at 0.500 s'),
    'ground changes between samples': (
        lambda b: edited(b, 'ground/changes', with_points('x', 0.002), 0.5),
        'contents', 'x is not a multiple of 5 mm'),
    'cut short': (
        lambda b: [i for i in b if stamp_of(i) < 5 * 10**8],
        'duration', 'of the 0.600 s'),
    'NaN in a joint': (
        lambda b: edited(b, 'joint_states', setter('position', np.array([0, np.nan, 0, 0])), 0.5),
        'contents', 'joint_states at 0.500 s position holds nan'),
    'NaN in a pose': (
        lambda b: edited(b, 'odom', nan_at('pose.pose.position.z'), 0.5), 'contents', 'odom'),
    'infinite contact': (
        lambda b: edited(b, 'contacts/rear_left', setter('wrench.force.x', float('inf')), 0.5),
        'contents', 'contacts/rear_left at 0.500 s wrench.force.x is inf'),
    'NaN in true depth': (
        lambda b: edited(b, 'ground_truth/depth/image', with_floats(at(np.nan)), 0.5),
        'contents', 'ground_truth/depth/image at 0.500 s 1 pixels are NaN'),
    'short quaternion': (
        lambda b: edited(b, 'odom', setter('pose.pose.orientation.w', 0.9), 0.5), 'contents',
        'has length'),
    'joint without position': (
        lambda b: edited(b, 'joint_states', setter('position', np.zeros(3)), 0.5), 'contents',
        '3 values for 4 joints'),
    'image cut': (
        lambda b: edited(b, 'stereo/left/image_raw', setter('data', lambda d: d[:-160]), 0.5),
        'contents', 'stereo/left/image_raw at 0.500 s data holds'),
    'black images': (
        lambda b: edited(b, 'stereo/left/image_raw', setter('data', lambda d: d * 0)), 'images',
        'one single grey'),
    'wrong frame': (
        lambda b: edited(b, 'stereo/depth/image', setter('header.frame_id', 'base_link')),
        'frames', 'base_link'),
    'gravity with the wrong sign': (
        lambda b: edited(b, 'ground_truth/imu', setter(f'{FORCE}.z', lambda z: -z)),
        'imu and odometry', 'specific force drifts'),
    'gyroscope in degrees': (
        lambda b: edited(b, 'ground_truth/imu', setter('angular_velocity.y',
                                                       lambda w: np.degrees(w))),
        'imu and odometry', 'angular velocity drifts'),
    'twist in the world frame': (
        lambda b: edited(b, 'odom', setter('twist.twist.linear.y', lambda v: v + 0.01)),
        'imu and odometry', 'twist drifts'),
    'IMU turned': (
        lambda b: edited(b, 'ground_truth/imu', setter('orientation.x', lambda x: x + 1e-4)),
        'imu and odometry', 'turned'),
    'IMU one sample late': (
        lambda b: late_imu(b), 'imu and odometry', 'drifts'),
    'raw IMU without gravity': (
        lambda b: edited(b, 'imu/data_raw', setter(f'{FORCE}.z', lambda z: z - 1.62)),
        'imu noise', 'specific force z'),
    'disparity scaled': (
        lambda b: edited(b, 'stereo/disparity', with_floats(lambda d: d * 1.1)),
        'disparity and depth', 'px'),
    'disparity off by half a pixel': (
        lambda b: edited(b, 'stereo/disparity', with_floats(lambda d: d + 0.45)),
        'disparity and depth', 'shift'),
    'one disparity of another frame': (
        lambda b: edited(b, 'stereo/disparity', with_floats(lambda d: d[::-1]), 0.5),
        'disparity and depth', 'at 0.500 s'),
    'disparity scaled by two percent': (
        lambda b: edited(b, 'stereo/disparity', with_floats(lambda d: d * 1.02)),
        'disparity and depth', 'scale'),
    'disparity of another baseline': (
        lambda b: edited(b, 'stereo/disparity', setter('t', 0.12)), 'calibration', 't = 0.12 m'),
    'camera infos exchanged': (swapped, 'calibration', 'P[3]'),
    'depth in millimetres': (
        lambda b: edited(b, 'stereo/depth/image', with_floats(lambda z: z * 1000)),
        'depth and disparity', 'differs from f t / d'),
}


def late_imu(items: list[Item]) -> list[Item]:
    """Give every true IMU sample the signal of the one before."""
    signal = [i for i in items if i.topic == 'ground_truth/imu']
    before = {stamp_of(now): then.message for then, now in zip(signal, signal[1:])}

    def edit(message: object) -> None:
        stamp = message.header.stamp
        old = before.get(stamp.sec * 10**9 + stamp.nanosec)
        if old is not None:
            message.linear_acceleration = old.linear_acceleration
            message.angular_velocity = old.angular_velocity
    return edited(items, 'ground_truth/imu', edit)
