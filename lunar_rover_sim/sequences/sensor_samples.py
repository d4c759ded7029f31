"""What LiDAR, heading sensors and power monitors measured last, for samples of a learner.

Of each topic counts the last message at or before the stamp of an image, with its own stamp: a
scan bears that of its start, and a sensor that is silent has last spoken long ago.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag.messages import pose_matrix, wxyz, xyz
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.sequences.lidar_scans import cloud_rows, COLUMNS, SCAN_COLUMNS, scan_rows
from lunar_rover_sim.sequences.recent_messages import RecentMessages

_DIGITS = 12
_SMALL_DIGITS = 20      # of variances
# Topic → name in the JSON and, of arrays, before .npy.
_ARRAYS = {topics.LIDAR_POINTS.name: 'lidar', topics.LIDAR_DESKEWED.name: 'lidar_deskewed',
           topics.LIDAR_SCAN.name: 'lidar_scan'}
_HEADING = {topics.SUN_SENSOR.name: 'sun_sensor', topics.STAR_TRACKER.name: 'star_tracker',
            topics.WHEEL_ODOM.name: 'wheel_odometry'}
_POWER = {topic.name: topic.name.rpartition('/')[2]
          for topic in (*topics.POWER, topics.SOLAR_POWER)}
POWER_KEY = 'power'     # of all lines
CARRIED = (*_ARRAYS, *_HEADING, *_POWER)


class SensorSamples:
    """Keeps what was measured lately.

    recorded: those of CARRIED that the bag has messages of
    """

    def __init__(self, bag: Bag) -> None:
        self._path = bag.path
        self.recorded = [name for name in CARRIED if bag.count(name)]
        self._recent: RecentMessages[Any] = RecentMessages()

    def add(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Take a message of one of CARRIED."""
        self._recent.add(topic, stamp_ns, message)

    def at(self, stamp_ns: int) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
        """Return arrays by extension, and values of JSON, at the stamp of an image.

        Of a sensor that has not spoken yet there is no array, and its value is None.
        """
        arrays: dict[str, NDArray[np.float32]] = {}
        values: dict[str, Any] = {}
        for topic in self.recorded:
            found = self._recent.at(topic, stamp_ns)
            value = None
            if found is not None:
                own_ns, message = found
                value = {'stamp_ns': own_ns, **self._value(topic, message)}
                if topic in _ARRAYS:
                    arrays[f'{_ARRAYS[topic]}.npy'] = self._rows(topic, message)
            if topic in _POWER:
                values.setdefault(POWER_KEY, {})[_POWER[topic]] = value
            else:
                values[{**_ARRAYS, **_HEADING}[topic]] = value
        return arrays, values

    def _rows(self, topic: str, message: Any) -> NDArray[np.float32]:
        read = scan_rows if topic == topics.LIDAR_SCAN.name else cloud_rows
        return read(f'{self._path}: {topic}', message)

    @staticmethod
    def _value(topic: str, message: Any) -> dict[str, Any]:
        return (_power if topic in _POWER else _VALUES[topic])(message)


def _cloud(message: Any) -> dict[str, Any]:
    return {'frame': message.header.frame_id, 'columns': list(COLUMNS)}


def _scan(message: Any) -> dict[str, Any]:
    return {'frame': message.header.frame_id, 'columns': list(SCAN_COLUMNS),
            'angle_min_rad': _number(message.angle_min),
            'angle_increment_rad': _number(message.angle_increment),
            'time_increment_s': _number(message.time_increment)}


def _sun(message: Any) -> dict[str, Any]:
    return {'frame': message.header.frame_id, 'direction': _numbers(xyz(message.vector))}


def _attitude(message: Any) -> dict[str, Any]:
    covariance = np.reshape(message.orientation_covariance, (3, 3))
    return {'frame': message.header.frame_id,
            'wxyz_world_base': _numbers(wxyz(message.orientation)),
            'covariance_rad2': [_numbers(row, _SMALL_DIGITS) for row in covariance]}


def _odometry(message: Any) -> dict[str, Any]:
    twist = message.twist.twist
    return {'frame': message.header.frame_id,
            'T_wheel_odom_base': [_numbers(row) for row in pose_matrix(message)],
            'linear_mps': _numbers(xyz(twist.linear)),
            'angular_radps': _numbers(xyz(twist.angular))}


def _power(message: Any) -> dict[str, Any]:
    return {'voltage_v': _number(message.voltage), 'current_a': _number(message.current)}


_VALUES: dict[str, Callable[[Any], dict[str, Any]]] = {
    topics.LIDAR_POINTS.name: _cloud, topics.LIDAR_DESKEWED.name: _cloud,
    topics.LIDAR_SCAN.name: _scan, topics.SUN_SENSOR.name: _sun,
    topics.STAR_TRACKER.name: _attitude, topics.WHEEL_ODOM.name: _odometry}


def _number(value: Any, digits: int = _DIGITS) -> float | None:
    """Return a number for JSON, which has none that are not finite: None."""
    return round(float(value), digits) if math.isfinite(value) else None


def _numbers(values: Any, digits: int = _DIGITS) -> list[float | None]:
    return [_number(value, digits) for value in values]
