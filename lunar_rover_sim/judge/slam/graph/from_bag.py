"""The graph on a recorded bag: its pairs of images, and what else it holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import time
from typing import Any

import numpy as np

from lunar_rover_sim.bag.messages import header_ns, wxyz, xyz
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.series import picture
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, rpy_from_wxyz
from lunar_rover_sim.image.camera.encoding import eight_bits
from lunar_rover_sim.image.stereo.points import grey
from lunar_rover_sim.judge.slam.estimators import Estimate
from lunar_rover_sim.judge.slam.euroc_reader import Camera, Image
from lunar_rover_sim.judge.slam.graph.measured import Aids, Inertial, Stars, Sun, Wheels
from lunar_rover_sim.judge.slam.graph.odometry import GraphOdometry, Located
from lunar_rover_sim.judge.slam.graph.pose_graph import has_gtsam, MISSING
from lunar_rover_sim.judge.slam.reference.odometry import VisualOdometry
from lunar_rover_sim.products.sequences.sensors import SensorSuite

_PLANE = np.ix_([0, 1, 5], [0, 1, 5])
Step = tuple[int, 'Image | None', 'Image | None', Aids]


def odometry_of(suite: SensorSuite, loops: bool = True) -> GraphOdometry:
    """Return the graph for the sensors of a bag."""
    camera = Camera(suite.focal_px, suite.centre_px, suite.baseline_m,
                    tuple(suite.distortion[:4]))
    return GraphOdometry(camera, suite.T_base_imu @ suite.T_imu_left, suite.gravity_mps2, loops)


def run(bag: Bag, suite: SensorSuite, loops: bool = True,
        advance: Callable[[], None] = lambda: None,
        on_pose: Callable[[int, Located], None] = lambda _stamp_ns, _located: None,
        stop: Callable[[], bool] = lambda: False) -> GraphOdometry:
    """Return the graph after all pairs of a bag.

    Args:
        advance: Called after each pair.
        on_pose: Called with its stamp and its answer.
        stop: Once it returns True, the rest is left out.
    """
    odometry = odometry_of(suite, loops)
    for step in steps(bag, suite):
        located = odometry.add(*step)
        if located is not None:
            on_pose(step[0], located)
        advance()
        if stop():
            break
    return odometry


def estimate(bag: Bag, suite: SensorSuite, advance: Callable[[], None] = lambda: None,
             stop: Callable[[], bool] = lambda: False) -> Estimate:
    """Return the estimate of the graph for a bag; where there is no GTSAM, that of the reference.

    Args:
        advance: Called after each pair.
        stop: Once it returns True, the rest is left out.
    """
    start = time.monotonic()
    if not has_gtsam():
        return _of_reference(bag, suite, advance, stop, start)
    odometry = run(bag, suite, True, advance, stop=stop)
    try:
        trajectory = odometry.trajectory()
    except SlamError:
        return Estimate(None, 'lost: it located no frame', 'left', odometry.frames_ns,
                        time.monotonic() - start)
    return Estimate(trajectory, '', 'left', odometry.frames_ns, time.monotonic() - start,
                    odometry.counts.words)


def _of_reference(bag: Bag, suite: SensorSuite, advance: Callable[[], None],
                  stop: Callable[[], bool], start: float) -> Estimate:
    odometry = VisualOdometry(Camera(suite.focal_px, suite.centre_px, suite.baseline_m))
    stamps = []
    for stamp_ns, left, right, _ in steps(bag, suite):
        stamps.append(stamp_ns)
        if left is not None:
            odometry.add(stamp_ns, left, right)
        advance()
        if stop():
            break
    try:
        trajectory = odometry.trajectory()
    except SlamError:
        trajectory = None
    return Estimate(trajectory, f'{MISSING}; this is the window of the reference', 'left',
                    np.array(stamps, np.int64), time.monotonic() - start)


def steps(bag: Bag, suite: SensorSuite) -> Iterator[Step]:
    """Yield the pairs of a bag in their order, with what was measured since the one before.

    A CameraInfo without images, as where they were not recorded for a while, is a step without
    them.
    """
    names = {topic: bag.resolve(topic.name) for topic in (
        topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.LEFT_INFO, topics.IMU_RAW,
        topics.WHEEL_ODOM, topics.SUN_SENSOR, topics.STAR_TRACKER, topics.SUN)
        if bag.has(topic.name)}
    of = {name: topic for topic, name in names.items()}
    camera = Camera(suite.focal_px, suite.centre_px, suite.baseline_m,
                    tuple(suite.distortion[:4]))
    waiting: dict[int, dict[topics.Topic, Any]] = {}
    collected, last_ns = _Collected(suite), -1

    def step(stamp: int) -> Step:
        parts = waiting.pop(stamp)
        pair = parts.get(topics.LEFT_IMAGE), parts.get(topics.RIGHT_IMAGE)
        if any(image is None for image in pair):
            pair = None, None
        return stamp, *pair, collected.take(stamp)

    for name, _, message in bag.messages(list(of)):
        topic = of[name]
        if topic not in (topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.LEFT_INFO):
            collected.add(topic, message)
        elif header_ns(message) > last_ns:
            waiting.setdefault(header_ns(message), {})[topic] = (
                None if topic is topics.LEFT_INFO else _pixels(bag, message, camera))
        # Messages of a stamp may come in any order. The next pair but one tells that what is
        # missing will not come.
        while waiting:
            last = min(waiting)
            whole = {topics.LEFT_IMAGE, topics.RIGHT_IMAGE} <= waiting[last].keys()
            if len(waiting) < 3 and not (whole and collected.newest_ns >= last):
                break
            last_ns = last
            yield step(last)
    for stamp in sorted(waiting):
        yield step(stamp)


def _pixels(bag: Bag, message: Any, camera: Camera) -> Image:
    return camera.rectified(np.ascontiguousarray(eight_bits(grey(picture(bag, message).pixels))))


class _Collected:
    """What was measured and not yet taken."""

    def __init__(self, suite: SensorSuite) -> None:
        self._R_base_imu = suite.T_base_imu[:3, :3]
        self._imu: list[tuple[int, Any, Any]] = []
        self._wheels: list[tuple[int, Wheels]] = []
        self._sun: list[tuple[int, Array]] = []
        self._stars: list[Stars] = []
        self._to_sun: Array | None = None
        self.newest_ns = -1

    def add(self, topic: topics.Topic, message: Any) -> None:
        """Take a message."""
        stamp = header_ns(message)
        if topic is topics.SUN:
            self._to_sun = np.array(xyz(message.vector))
            return
        if topic is topics.IMU_RAW:
            self._imu.append((stamp, xyz(message.angular_velocity),
                              xyz(message.linear_acceleration)))
            self.newest_ns = max(self.newest_ns, stamp)
        elif topic is topics.WHEEL_ODOM:
            pose = message.pose.pose
            yaw = rpy_from_wxyz(wxyz(pose.orientation))[2]
            self._wheels.append((stamp, Wheels(
                np.array([pose.position.x, pose.position.y, yaw]),
                np.reshape(message.pose.covariance, (6, 6))[_PLANE])))
            self.newest_ns = max(self.newest_ns, stamp)
        elif topic is topics.SUN_SENSOR:
            self._sun.append((stamp, np.array(xyz(message.vector))))
        else:
            self._stars.append(Stars(stamp, matrix_from_wxyz(wxyz(message.orientation)),
                                     np.reshape(message.orientation_covariance, (3, 3))))

    def take(self, stamp_ns: int) -> Aids:
        """Return what was measured up to a stamp, and forget it."""
        imu = [s for s in self._imu if s[0] <= stamp_ns]
        self._imu = self._imu[len(imu):]
        wheels = [s for s in self._wheels if s[0] <= stamp_ns]
        self._wheels = self._wheels[len(wheels):]
        sun = [s for s in self._sun if s[0] <= stamp_ns]
        self._sun = self._sun[len(sun):]
        stars = [s for s in self._stars if s.stamp_ns <= stamp_ns]
        self._stars = self._stars[len(stars):]
        inertial = None
        if imu:
            ns, rates, forces = zip(*imu)
            inertial = Inertial(np.array(ns, np.int64), np.array(rates) @ self._R_base_imu.T,
                                np.array(forces) @ self._R_base_imu.T)
        return Aids(inertial, wheels[-1][1] if wheels else None,
                    Sun(*sun[-1], self._to_sun) if sun and self._to_sun is not None else None,
                    stars[-1] if stars else None)
