"""Messages of LiDAR, heading sensors and power monitors for the synthetic bag.

The LiDAR looks at the plane on which the rover of `synthetic_bag` drives; others measure what is
true there.
"""

import numpy as np
import synthetic_bag as synthetic

from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.image.lidar.scan import POINT
from lunar_rover_sim.rover.description import Legs

T_BASE_LIDAR = frames.se3(frames.matrix_from_wxyz(frames.wxyz_from_rpy(0.05, 0.1, -0.2)),
                          [0.11, -0.02, 0.25])
POWER = topics.of_legs(topics.POWER, Legs().names)
SUN = frames.sun_direction(30.0, 10.0)      # that of the synthetic bag
PERIOD_S = 0.1
_NAN = float('nan')


def scan_points(start_ns: int, deskewed: bool, rings: int = 8, columns: int = 180) -> np.ndarray:
    """Return records of POINT: beams on the plane, each in the frame of its own time or the start.
    """
    azimuth = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    elevation = np.radians(np.linspace(-60.0, -5.0, rings))
    start = synthetic.pose_at(start_ns * 1e-9) @ T_BASE_LIDAR
    points = np.zeros((columns, rings), POINT)
    for k, angle in enumerate(azimuth):
        offset_s = PERIOD_S * k / columns
        T = synthetic.pose_at(start_ns * 1e-9 + offset_s) @ T_BASE_LIDAR
        beams = np.stack([np.cos(elevation) * np.cos(angle), np.cos(elevation) * np.sin(angle),
                          np.sin(elevation)], axis=-1)
        down = beams @ T[2, :3]
        place = beams * np.where(down < -1e-3, -T[2, 3] / down, np.nan)[:, None]
        if deskewed:
            place = (place @ T[:3, :3].T + T[:3, 3] - start[:3, 3]) @ start[:3, :3]
        for axis, name in enumerate('xyz'):
            points[name][k] = place[:, axis]
        points['time'][k], points['ring'][k] = offset_s, np.arange(rings)
        points['intensity'][k] = 20.0 + np.arange(rings)
    flat = points.ravel()
    return flat[np.isfinite(flat['x'])]


def cloud_item(topic: topics.Topic, ns: int, points: np.ndarray) -> synthetic.Item:
    """Return records of POINT as a message; they may hold NaN."""
    return synthetic.cloud(topic, ns, frames.LIDAR_FRAME, points)


def scan_item(ns: int) -> synthetic.Item:
    """Return a LaserScan of 360 ranges, of which every tenth returns nothing."""
    ranges = np.where(np.arange(360) % 10 == 0, np.inf, 3.0).astype(np.float32)
    return synthetic.item(topics.LIDAR_SCAN, synthetic.msg(
        'sensor_msgs/LaserScan', header=synthetic.header(ns, frames.LIDAR_FRAME),
        angle_min=-np.pi, angle_max=-np.pi + 359.0 * np.radians(1.0),
        angle_increment=float(np.radians(1.0)), time_increment=PERIOD_S / 360,
        scan_time=PERIOD_S, range_min=0.5, range_max=100.0, ranges=ranges,
        intensities=np.full(360, 30.0, np.float32)))


def power_item(topic: topics.Topic, ns: int, current_a: float) -> synthetic.Item:
    """Return a BatteryState at 12 V, with NaN where nobody measures."""
    return synthetic.item(topic, synthetic.msg(
        'sensor_msgs/BatteryState', header=synthetic.header(ns, ''), voltage=12.0,
        temperature=_NAN, current=current_a, charge=_NAN, capacity=_NAN, design_capacity=_NAN,
        percentage=_NAN, power_supply_status=2, power_supply_health=0, power_supply_technology=0,
        present=True, cell_voltage=np.zeros(0, np.float32),
        cell_temperature=np.zeros(0, np.float32), location='line', serial_number=''))


def heading_items(ns: int) -> list[synthetic.Item]:
    """Return the direction to the sun, the attitude and the odometry, all true."""
    T = synthetic.pose_at(ns * 1e-9)
    sun = synthetic.msg('geometry_msgs/Vector3Stamped',
                        header=synthetic.header(ns, frames.BASE_FRAME),
                        vector=synthetic.vector(T[:3, :3].T @ SUN))
    attitude = synthetic.imu(ns, np.zeros(3), np.zeros(3), frames.wxyz_from_matrix(T[:3, :3]))
    odometry = synthetic.odometry(ns, frames.WHEEL_ODOM_FRAME, T, (0.15, 0.0, 0.0),
                                  (0.0, 0.0, 0.075))
    return [synthetic.item(topic, message) for topic, message in (
        (topics.SUN_SENSOR, sun), (topics.STAR_TRACKER, attitude),
        (topics.WHEEL_ODOM, odometry))]


def power_items(ns: int) -> list[synthetic.Item]:
    """Return what every line draws, and what the panel gives."""
    return [*(power_item(topic, ns, -0.1 * k) for k, topic in enumerate(POWER, 1)),
            power_item(topics.SOLAR_POWER, ns, 0.8)]


def with_lidar_frame(items: list[synthetic.Item]) -> list[synthetic.Item]:
    """Return items whose tf_static says where the LiDAR is."""
    mount = synthetic.transform(0, frames.BASE_FRAME, frames.LIDAR_FRAME, T_BASE_LIDAR)
    return [*items, synthetic.item(topics.TF_STATIC, synthetic.msg(
        'tf2_msgs/TFMessage', transforms=[mount]))]


def foot_items(ns: int) -> list[synthetic.Item]:
    """Return slip and sinkage: 1 mm of each leg, swept 1 cm."""
    legs = list(Legs().names)
    return [synthetic.item(topic, synthetic.msg(
        'sensor_msgs/JointState', header=synthetic.header(ns, ''), name=names,
        position=np.array(position), velocity=np.array(velocity), effort=np.zeros(0)))
        for topic, names, position, velocity in (
            (topics.FOOT_SLIP, [*legs, *(f'{leg}_sweep' for leg in legs)],
             [0.001] * 4 + [0.01] * 4, [0.0] * 8),
            (topics.SINKAGE, legs, [0.001] * 4, []))]
