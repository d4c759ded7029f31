"""Topics of a bag as numpy arrays, and images one by one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag import message_validity
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.errors import BagError

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]


class Odometry(NamedTuple):
    """Poses and twists.

    stamps_ns (n,); positions_m (n, 3) and orientations_wxyz (n, 4) of the child frame in the
    header's frame; twists (n, 6) linear [m/s] and angular [rad/s] in the child frame.
    """

    stamps_ns: Stamps
    positions_m: Array
    orientations_wxyz: Array
    twists: Array


class ImuSeries(NamedTuple):
    """stamps_ns (n,), rates_radps (n, 3), specific_forces_mps2 (n, 3), IMU axes."""

    stamps_ns: Stamps
    rates_radps: Array
    specific_forces_mps2: Array


class Picture(NamedTuple):
    """An image: stamp [ns], encoding, pixels (h, w) or (h, w, 3)."""

    stamp_ns: int
    encoding: str
    pixels: NDArray[Any]


class Disparity(NamedTuple):
    """Disparity (h, w) [px], NaN where nothing was matched; depth is focal_px baseline_m / d."""

    stamp_ns: int
    disparity_px: NDArray[np.float32]
    focal_px: float
    baseline_m: float


class CameraCalibration(NamedTuple):
    """Calibration of one camera as sensor_msgs/CameraInfo has it, and its frame."""

    width: int
    height: int
    K: Array
    D: Array
    R: Array
    P: Array
    distortion_model: str
    frame_id: str

    @property
    def baseline_m(self) -> float:
        """Distance to the left camera: -P[0, 3] / P[0, 0]; 0 for the left one."""
        return float(-self.P[0, 3] / self.P[0, 0])


def read_odometry(bag: Bag, topic: str = topics.ODOM.name) -> Odometry:
    """Return a whole nav_msgs/Odometry topic."""
    stamps, rows = _rows(bag, topic, _odometry_row, 13)
    return Odometry(stamps, rows[:, 0:3], rows[:, 3:7], rows[:, 7:13])


def read_imu(bag: Bag, topic: str = topics.IMU_RAW.name) -> ImuSeries:
    """Return a whole sensor_msgs/Imu topic."""
    stamps, rows = _rows(bag, topic, _imu_row, 6)
    return ImuSeries(stamps, rows[:, 0:3], rows[:, 3:6])


def read_images(bag: Bag, topic: str) -> Iterator[Picture]:
    """Yield the images of a topic one by one; BagError where one is not of its declared size."""
    for _, _, message in bag.messages([topic]):
        yield picture(bag, message)


def picture(bag: Bag, message: Any) -> Picture:
    """Return a sensor_msgs/Image as pixels; BagError where it is not of its declared size."""
    stamp_ns = header_ns(message)
    problem = message_validity.image_problem(message)
    if problem:
        raise BagError(f'{bag.path}: image at {stamp_ns * 1e-9:.3f} s: {problem}')
    return Picture(stamp_ns, message.encoding, message_validity.pixels(message))


def read_depth(bag: Bag, topic: str = topics.TRUE_DEPTH.name) -> Iterator[Picture]:
    """Yield depth images [m], float32; NaN where unknown, +Inf for the sky."""
    for image in read_images(bag, topic):
        if image.encoding == '16UC1':  # mm, 0 where unknown (REP-118)
            depth = np.where(image.pixels > 0, image.pixels * np.float32(1e-3), np.nan)
            image = Picture(image.stamp_ns, '32FC1', depth.astype(np.float32))
        yield image


def read_disparity(bag: Bag, topic: str = topics.DISPARITY.name) -> Iterator[Disparity]:
    """Yield disparity images; what was not matched is NaN."""
    for _, _, message in bag.messages([topic]):
        pixels = picture(bag, message.image).pixels
        valid = (pixels >= message.min_disparity) & (pixels > 0.0)
        yield Disparity(header_ns(message), np.where(valid, pixels, np.nan).astype(np.float32),
                        float(message.f), float(message.t))


def read_calibration(bag: Bag, topic: str) -> CameraCalibration:
    """Return the first sensor_msgs/CameraInfo of a topic."""
    m = bag.first(topic)
    return CameraCalibration(m.width, m.height, m.k.reshape(3, 3), np.asarray(m.d, float),
                             m.r.reshape(3, 3), m.p.reshape(3, 4), m.distortion_model,
                             m.header.frame_id)


def header_ns(message: Any) -> int:
    """Return the stamp of a message with a header [ns]."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def _rows(bag: Bag, topic: str, row: Any, width: int) -> tuple[Stamps, Array]:
    stamps, rows = [], []
    for _, _, message in bag.messages([topic]):
        stamps.append(header_ns(message))
        rows.append(row(message))
    return (np.array(stamps, dtype=np.int64),
            np.array(rows, dtype=float).reshape(len(rows), width))


def _odometry_row(m: Any) -> tuple[float, ...]:
    p, q, t = m.pose.pose.position, m.pose.pose.orientation, m.twist.twist
    return (p.x, p.y, p.z, q.w, q.x, q.y, q.z, t.linear.x, t.linear.y, t.linear.z,
            t.angular.x, t.angular.y, t.angular.z)


def _imu_row(m: Any) -> tuple[float, ...]:
    w, f = m.angular_velocity, m.linear_acceleration
    return (w.x, w.y, w.z, f.x, f.y, f.z)
