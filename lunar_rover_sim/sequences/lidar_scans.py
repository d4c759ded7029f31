"""Scans of a LiDAR in a bag as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag.scan_validity import laser_scan_problem, lidar_cloud_problem, lidar_points
from lunar_rover_sim.errors import BagError

CLOUDS = (topics.LIDAR_POINTS.name, topics.LIDAR_DESKEWED.name)
COLUMNS = ('x_m', 'y_m', 'z_m', 'intensity_percent', 'ring', 'time_s')
SCAN_COLUMNS = ('range_m', 'intensity_percent')
_FIELDS = ('x', 'y', 'z', 'intensity', 'ring', 'time')


def cloud_rows(where: str, message: Any) -> NDArray[np.float32]:
    """Return the points that returned, (n, 6) as COLUMNS, in the order of the message.

    where: bag and topic, for messages
    Raises BagError where the cloud is not one of a LiDAR.
    """
    problem = lidar_cloud_problem(message)
    if problem:
        raise BagError(f'{where}: {problem}')
    points = lidar_points(message)
    rows = np.stack([points[name].astype(np.float32) for name in _FIELDS], axis=-1)
    return rows[np.isfinite(rows[:, :3]).all(axis=1)]


def scan_rows(where: str, message: Any) -> NDArray[np.float32]:
    """Return one ring, (n, 2) as SCAN_COLUMNS; the range is inf where nothing returns.

    Without intensities they are 0. Raises BagError where the scan is not whole.
    """
    problem = laser_scan_problem(message)
    if problem:
        raise BagError(f'{where}: {problem}')
    ranges = np.asarray(message.ranges, np.float32)
    intensities = np.asarray(message.intensities, np.float32)
    if len(intensities) not in (0, len(ranges)):
        raise BagError(f'{where}: {len(intensities)} intensities for {len(ranges)} ranges')
    return np.stack([ranges, intensities if len(intensities) else np.zeros_like(ranges)], axis=-1)
