"""Topics of a bag as numpy arrays; images and calibrations from messages."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag import message_validity
from lunar_rover_sim.bag.messages import header_ns, imu_row, joints_row, odometry_row
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.totals import driven_distance_m, every_step
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.rover.description import Legs

Stamps = NDArray[np.int64]
Row = Callable[[Any], Iterable[float]]      # the numbers of a message
T = TypeVar('T')


class Series(NamedTuple):
    """stamps_ns (n,) and values (n, k)."""

    stamps_ns: Stamps
    values: Array


class Odometry(NamedTuple):
    """Poses and twists.

    Attributes:
        stamps_ns: (n,).
        positions_m: (n, 3) of the child frame in the header's frame.
        orientations_wxyz: (n, 4) of the child frame in the header's frame.
        twists: (n, 6) linear [m/s] and angular [rad/s] in the child frame.
    """

    stamps_ns: Stamps
    positions_m: Array
    orientations_wxyz: Array
    twists: Array

    def every_step(self) -> Odometry:
        """Return the first state of every 0.1 s, and the last one."""
        kept = every_step(self.stamps_ns)
        return Odometry(self.stamps_ns[kept], self.positions_m[kept],
                        self.orientations_wxyz[kept], self.twists[kept])

    @property
    def distance_m(self) -> float:
        """Distance driven [m]."""
        return driven_distance_m(self.stamps_ns, self.positions_m)


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
    def fx_fy_cx_cy_px(self) -> tuple[float, float, float, float]:
        """Focal lengths and principal point of K."""
        K = self.K
        return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])

    @property
    def baseline_m(self) -> float:
        """Distance to the left camera: -P[0, 3] / P[0, 0]; 0 for the left one."""
        return float(-self.P[0, 3] / self.P[0, 0])


class Rows:
    """Numbers of a topic as they are read: flat arrays, a tenth of the memory of objects."""

    def __init__(self) -> None:
        self._stamps_ns, self._values = array('q'), array('d')

    def __len__(self) -> int:
        return len(self._stamps_ns)

    def add(self, stamp_ns: int, row: Iterable[float]) -> None:
        """Take the next row; all have one width."""
        self._stamps_ns.append(stamp_ns)
        self._values.extend(row)

    def arrays(self) -> Series:
        """Return stamps (n,) [ns] and values (n, k); k is 0 where there are none."""
        n = len(self._stamps_ns)
        return Series(np.array(self._stamps_ns, np.int64), np.array(self._values, float).reshape(
            n, len(self._values) // n if n else 0))


def read_rows(bag: Bag, rows: Mapping[str, Row], start_ns: int | None = None,
              stop_ns: int | None = None) -> dict[str, Series]:
    """Return topics as numbers, read in one pass; bag times as `Bag.messages` takes them."""
    names = {bag.resolve(name): name for name in rows}
    read = {name: Rows() for name in rows}
    for topic, _, message in bag.messages(names, start_ns, stop_ns):
        name = names[topic]
        read[name].add(header_ns(message), rows[name](message))
    return {name: found.arrays() for name, found in read.items()}


def odometry_of(series: Series) -> Odometry:
    """Return the odometry whose rows are those of `odometry_row`."""
    rows = series.values.reshape(-1, 13)
    return Odometry(series.stamps_ns, rows[:, 0:3], rows[:, 3:7], rows[:, 7:13])


def read_odometry(bag: Bag, topic: str = '') -> Odometry:
    """Return a whole nav_msgs/Odometry topic, by default that of the truth."""
    topic = topic or bag.truth
    return odometry_of(read_rows(bag, {topic: odometry_row})[topic])


def read_imu(bag: Bag, topic: str = topics.IMU_RAW.name) -> ImuSeries:
    """Return a whole sensor_msgs/Imu topic."""
    stamps, values = read_rows(bag, {topic: imu_row})[topic]
    rows = values.reshape(-1, 6)
    return ImuSeries(stamps, rows[:, 0:3], rows[:, 3:6])


def read_motion(bag: Bag, legs: Legs, others: Mapping[str, Row] | None = None,
                start_ns: int | None = None, stop_ns: int | None = None) -> dict[str, Series]:
    """Return truth, leg states and others that are recorded, by topic, read in one pass.

    Rows are those of `odometry_row`, `joints_row` and `others`.

    Raises:
        BagError: Where there is no truth, or no leg states with all legs.
    """
    for name in (bag.truth, topics.JOINT_STATES.name):
        if not bag.count(name):
            raise BagError(f'{bag.path}: holds no drive: {name} is missing')
    return read_rows(bag, {
        bag.truth: odometry_row,
        topics.JOINT_STATES.name: lambda message: joints_row(message, legs, bag.path),
        **{name: row for name, row in (others or {}).items() if bag.has(name)}},
        start_ns, stop_ns)


def picture(bag: Bag, message: Any) -> Picture:
    """Return a sensor_msgs/Image as pixels; BagError where it is not of its declared size."""
    stamp_ns = header_ns(message)
    problem = message_validity.image_problem(message)
    if problem:
        raise BagError(f'{bag.path}: image at {stamp_ns * 1e-9:.3f} s: {problem}')
    return Picture(stamp_ns, message.encoding, message_validity.pixels(message))


def messages_at(bag: Bag, kinds: Iterable[topics.Topic], stamp_ns: int
                ) -> dict[topics.Topic, Any]:
    """Return the messages of some topics at a bag time [ns]; what there is not is left out."""
    names = {bag.resolve(topic.name): topic for topic in kinds if bag.has(topic.name)}
    return {names[name]: message for name, _, message
            in bag.messages(names, stamp_ns, stamp_ns + 1)} if names else {}


def spread(items: Sequence[T], most: int) -> list[T]:
    """Return at most so many items, evenly over all, the ends included."""
    places = np.unique(np.linspace(0, len(items) - 1, min(most, len(items))).round().astype(int))
    return [items[k] for k in places]


def common_stamps(bag: Bag, names: Sequence[str]) -> list[int]:
    """Return the bag times [ns], in order, at which each topic has a message.

    Topics that the bag lacks, or that are empty in it, do not count.
    """
    recorded = [found for name in names if bag.has(name)
                and (found := {message.time_ns for message in bag.raw([name])})]
    return sorted(set.intersection(*recorded)) if recorded else []


def read_calibration(bag: Bag, topic: str) -> CameraCalibration:
    """Return the first sensor_msgs/CameraInfo of a topic."""
    m = bag.first(topic)
    return CameraCalibration(m.width, m.height, m.k.reshape(3, 3), np.asarray(m.d, float),
                             m.r.reshape(3, 3), m.p.reshape(3, 4), m.distortion_model,
                             m.header.frame_id)


def hazard_topics(bag: Bag) -> dict[str, dict[topics.Topic, str]]:
    """Return camera → the contract's topics of hazard cameras → their names in the bag.

    Cameras are named as below `hazard/`, one of a pair with /left or /right, in the order of their
    names. Topics without messages are left out.
    """
    found: dict[str, dict[topics.Topic, str]] = {}
    for full in bag.types:
        name = full.removeprefix(bag.namespace + '/')
        known = topics.of_hazard(name)
        if known is not None and bag.counts[full]:
            found.setdefault(known[1], {})[known[0]] = name
    return dict(sorted(found.items()))
