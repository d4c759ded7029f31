"""What LiDAR and other sensors measured last, for samples of a learner.

Of each topic counts the last message at or before the stamp of an image, with its own stamp: a
scan bears that of its start, and a sensor that is silent has last spoken long ago.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.sensors.imu import Imu
from lunar_rover_sim.sensors.registry import sensor_of, SENSORS
from lunar_rover_sim.sensors.sensor import number
from lunar_rover_sim.sequences.lidar_scans import cloud_rows, COLUMNS, SCAN_COLUMNS, scan_rows
from lunar_rover_sim.sequences.recent_messages import RecentMessages

# Topic → name in the JSON and before .npy.
_ARRAYS = {topics.LIDAR_POINTS.name: 'lidar', topics.LIDAR_DESKEWED.name: 'lidar_deskewed',
           topics.LIDAR_SCAN.name: 'lidar_scan'}
# A single sample of the IMU says little of the time between two images.
_OF_SENSORS = tuple(topic for sensor in SENSORS if sensor is not Imu for topic in sensor.published)
CARRIED = (*_ARRAYS, *(topic.name for topic in _OF_SENSORS))


def carried(bag: Bag) -> tuple[str, ...]:
    """Return those of CARRIED that a bag has messages of, with the names of its legs."""
    of_sensors = topics.of_legs(_OF_SENSORS, topics.legs_of(bag.types))
    return tuple(name for name in (*_ARRAYS, *(topic.name for topic in of_sensors))
                 if bag.count(name))


class SensorSamples:
    """Keeps what was measured lately.

    recorded: those of CARRIED that the bag has messages of
    """

    def __init__(self, bag: Bag) -> None:
        self._path = bag.path
        self.recorded = list(carried(bag))
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
            sensor = sensor_of(topic)
            if sensor is None:
                values[_ARRAYS[topic]] = value
            elif sensor.groups_as:
                values.setdefault(sensor.groups_as, {})[topic.rpartition('/')[2]] = value
            else:
                values[sensor.name] = value
        return arrays, values

    def _rows(self, topic: str, message: Any) -> NDArray[np.float32]:
        read = scan_rows if topic == topics.LIDAR_SCAN.name else cloud_rows
        return read(f'{self._path}: {topic}', message)

    @staticmethod
    def _value(topic: str, message: Any) -> dict[str, Any]:
        sensor = sensor_of(topic)
        return _LIDAR[topic](message) if sensor is None else sensor.read(topic, message)


def _cloud(message: Any) -> dict[str, Any]:
    return {'frame': message.header.frame_id, 'columns': list(COLUMNS)}


def _scan(message: Any) -> dict[str, Any]:
    return {'frame': message.header.frame_id, 'columns': list(SCAN_COLUMNS),
            'angle_min_rad': number(message.angle_min),
            'angle_increment_rad': number(message.angle_increment),
            'time_increment_s': number(message.time_increment)}


_LIDAR: dict[str, Callable[[Any], dict[str, Any]]] = {
    topics.LIDAR_POINTS.name: _cloud, topics.LIDAR_DESKEWED.name: _cloud,
    topics.LIDAR_SCAN.name: _scan}
