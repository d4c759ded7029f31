"""Newest measurements of LiDAR and other sensors, for samples of a learner.

Of each topic counts the last message at or before the stamp of an image, with its own stamp: a
scan bears that of its start, and a sensor that is silent has last spoken long ago.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.message_validity import (laser_scan_problem, lidar_cloud_problem,
                                                  lidar_points)
from lunar_rover_sim.bag.messages import exposure_s
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.sensors.imu import Imu
from lunar_rover_sim.sensors.registry import sensor_of, SENSORS
from lunar_rover_sim.sensors.sensor import number

# Topic → name before .npy; and in the JSON.
_ARRAYS = {topics.LIDAR_POINTS.name: 'lidar', topics.LIDAR_DESKEWED.name: 'lidar_deskewed',
           topics.LIDAR_SCAN.name: 'lidar_scan'}
_NAMES = {**_ARRAYS, topics.EXPOSURE.name: 'exposure'}
# A single sample of the IMU says little of the time between two images.
_OF_SENSORS = tuple(topic for sensor in SENSORS if sensor is not Imu for topic in sensor.published)
CARRIED = (*_NAMES, *(topic.name for topic in _OF_SENSORS))


def carried(bag: Bag) -> tuple[str, ...]:
    """Return those of CARRIED that a bag has messages of, with the names of its legs."""
    of_sensors = topics.of_legs(_OF_SENSORS, topics.legs_of(bag.types))
    return tuple(name for name in (*_NAMES, *(topic.name for topic in of_sensors))
                 if bag.count(name))


class SensorSamples:
    """Keeps what was measured lately.

    Attributes:
        recorded: Those of CARRIED that the bag has messages of.
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
                values[_NAMES[topic]] = value
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
        return _OTHERS[topic](message) if sensor is None else sensor.read(topic, message)


def _cloud(message: Any) -> dict[str, Any]:
    return {'frame': message.header.frame_id, 'columns': list(COLUMNS)}


def _scan(message: Any) -> dict[str, Any]:
    return {'frame': message.header.frame_id, 'columns': list(SCAN_COLUMNS),
            'angle_min_rad': number(message.angle_min),
            'angle_increment_rad': number(message.angle_increment),
            'time_increment_s': number(message.time_increment)}


_OTHERS: dict[str, Callable[[Any], dict[str, Any]]] = {
    topics.LIDAR_POINTS.name: _cloud, topics.LIDAR_DESKEWED.name: _cloud,
    topics.LIDAR_SCAN.name: _scan,
    topics.EXPOSURE.name: lambda message: {'time_s': exposure_s(message)}}


KEPT_NS = NS_PER_S  # so long before its last message a topic is remembered
# Bags of other recorders hold messages by the time of their arrival, up to so much out of order.
LATE_NS = KEPT_NS // 2

V = TypeVar('V')


class RecentMessages(Generic[V]):
    """Keeps the last messages of each topic, and the one before them.

    Args:
        kept_ns: For so long.
    """

    def __init__(self, kept_ns: int = KEPT_NS) -> None:
        self._kept_ns = kept_ns
        self._kept: dict[str, deque[tuple[int, V]]] = defaultdict(deque)

    def add(self, topic: str, stamp_ns: int, value: V) -> None:
        """Take a message; those of a topic come in the order of their stamps."""
        kept = self._kept[topic]
        kept.append((stamp_ns, value))
        while len(kept) > 1 and kept[1][0] <= stamp_ns - self._kept_ns:
            kept.popleft()

    def at(self, topic: str, stamp_ns: int) -> tuple[int, V] | None:
        """Return stamp and value of the last message at or before a stamp; None if none was."""
        return next((each for each in reversed(self._kept.get(topic, ()))
                     if each[0] <= stamp_ns), None)


CLOUDS = (topics.LIDAR_POINTS.name, topics.LIDAR_DESKEWED.name)
COLUMNS = ('x_m', 'y_m', 'z_m', 'intensity_percent', 'ring', 'time_s')
SCAN_COLUMNS = ('range_m', 'intensity_percent')
_FIELDS = ('x', 'y', 'z', 'intensity', 'ring', 'time')


def cloud_rows(where: str, message: Any) -> NDArray[np.float32]:
    """Return the points that returned, (n, 6) as COLUMNS, in the order of the message.

    Args:
        where: Bag and topic, for messages.

    Raises:
        BagError: Where the cloud is not one of a LiDAR.
    """
    problem = lidar_cloud_problem(message)
    if problem:
        raise BagError(f'{where}: {problem}')
    points = lidar_points(message)
    rows = np.stack([points[name].astype(np.float32) for name in _FIELDS], axis=-1)
    return rows[np.isfinite(rows[:, :3]).all(axis=1)]


def scan_rows(where: str, message: Any) -> NDArray[np.float32]:
    """Return one ring, (n, 2) as SCAN_COLUMNS; the range is inf where nothing returns.

    Without intensities they are 0.

    Raises:
        BagError: Where the scan is not whole.
    """
    problem = laser_scan_problem(message)
    if problem:
        raise BagError(f'{where}: {problem}')
    ranges = np.asarray(message.ranges, np.float32)
    intensities = np.asarray(message.intensities, np.float32)
    if len(intensities) not in (0, len(ranges)):
        raise BagError(f'{where}: {len(intensities)} intensities for {len(ranges)} ranges')
    return np.stack([ranges, intensities if len(intensities) else np.zeros_like(ranges)], axis=-1)
