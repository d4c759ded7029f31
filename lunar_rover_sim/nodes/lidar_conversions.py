"""Scans as ROS 2 messages."""

from __future__ import annotations

import array
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan, PointCloud2, PointField
from std_msgs.msg import Header

from lunar_rover_sim.lidar.optics import LidarOptics
from lunar_rover_sim.lidar.scan import PlanarScan, POINT

_TYPES = {'f4': PointField.FLOAT32, 'u2': PointField.UINT16}


def cloud(points: NDArray[np.void], frame_id: str, stamp: Time) -> PointCloud2:
    """Return (rows, columns) or (n,) records of POINT; only the former may hold NaN."""
    organized = points.ndim == 2
    height, width = points.shape if organized else (1, len(points))
    msg = PointCloud2(
        header=Header(stamp=stamp, frame_id=frame_id), height=height, width=width,
        point_step=POINT.itemsize, row_step=POINT.itemsize * width, is_dense=not organized,
        fields=[_field(name) for name in POINT.names or ()])
    msg.data = points.tobytes()
    return msg


def _field(name: str) -> PointField:
    assert POINT.fields is not None
    kind, offset = POINT.fields[name][:2]
    return PointField(name=name, offset=offset, datatype=_TYPES[kind.str[1:]], count=1)


def planar_scan(scan: PlanarScan, optics: LidarOptics, period_ns: int, frame_id: str,
                stamp: Time) -> LaserScan:
    """Return one ring."""
    count = len(scan.range_m)
    return LaserScan(
        header=Header(stamp=stamp, frame_id=frame_id), angle_min=scan.angle_min_rad,
        angle_max=scan.angle_min_rad + scan.angle_step_rad * (count - 1),
        angle_increment=scan.angle_step_rad, time_increment=scan.time_step_s,
        scan_time=1e-9 * period_ns, range_min=optics.min_range_m, range_max=optics.max_range_m,
        ranges=_floats(scan.range_m), intensities=_floats(scan.intensity))


def _floats(values: NDArray[np.float32]) -> Any:
    # The one type that rclpy takes over without looking at each element.
    return array.array('f', values.tobytes())
