"""One pass over a bag: stamps and problems of every topic, the signals to compare, and periods."""

from __future__ import annotations

from array import array
from collections.abc import Callable
import dataclasses
from typing import Any

import numpy as np

from lunar_rover_sim.bag import message_validity
from lunar_rover_sim.bag.ground_points import changes_of
from lunar_rover_sim.bag.ground_points import problem as ground_problem
from lunar_rover_sim.bag.message_validity import laser_scan_problem, lidar_cloud_problem
from lunar_rover_sim.bag.messages import accel_row, imu_row, odometry_row, wxyz
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario, RecordedScenario
from lunar_rover_sim.bag.series import Rows
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.base.topics import DEPTH_FRAME, FRAME, STATE, Topic
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.image.stereo.depth import disparity_from_depth
from lunar_rover_sim.products.inspection.disparity_error import (disparity_map, frame_error,
                                                                 FrameError, is_textured)
from lunar_rover_sim.run.publication import period_ns

_WAITING = 16  # stereo sets that may be incomplete; those that stay so are missing stamps

_CONTENT: dict[str, tuple[Callable[[Any], str | None], ...]] = {
    topics.ODOM.name: (message_validity.quaternion_problem('pose.pose.orientation'),),
    topics.TRUE_ODOM.name: (message_validity.quaternion_problem('pose.pose.orientation'),),
    topics.IMU_TRUTH.name: (message_validity.quaternion_problem('orientation'),),
    topics.SLAM_COVARIANCE.name: (message_validity.quaternion_problem('pose.pose.orientation'),
                                  message_validity.covariance_problem('pose.covariance')),
    topics.JOINT_STATES.name: (message_validity.joints_problem,),
    topics.JOINT_COMMANDS.name: (message_validity.commands_problem,),
    topics.LEFT_IMAGE.name: (message_validity.image_problem,),
    topics.RIGHT_IMAGE.name: (message_validity.image_problem,),
    topics.DEPTH.name: (message_validity.image_problem, message_validity.depth_problem),
    topics.TRUE_DEPTH.name: (message_validity.image_problem, message_validity.true_depth_problem),
    topics.RIGHT_TRUE_DEPTH.name: (message_validity.image_problem,
                                   message_validity.true_depth_problem),
    topics.DISPARITY.name: (message_validity.disparity_problem,),
    topics.GROUND_CHANGES.name: (ground_problem,),
    topics.LIDAR_POINTS.name: (lidar_cloud_problem,),
    topics.LIDAR_DESKEWED.name: (lidar_cloud_problem,),
    topics.LIDAR_SCAN.name: (laser_scan_problem,),
    topics.ELEVATION.name: (message_validity.elevation_problem,),
    topics.TRAVERSABILITY.name: (message_validity.grid_problem,),
    topics.EXPOSURE.name: (message_validity.exposure_problem,),
    topics.LEFT_INFO.name: (message_validity.camera_info_problem,),
    topics.RIGHT_INFO.name: (message_validity.camera_info_problem,),
    topics.DEPTH_INFO.name: (message_validity.camera_info_problem,),
}


@dataclasses.dataclass
class TopicScan:
    """One topic of the contract as recorded; `stamps_ns` in the order of bag time.

    Attributes:
        checks: Each returns what is wrong with a message, or None.
    """

    topic: Topic
    name: str
    msgtype: str
    checks: tuple[Callable[[Any], str | None], ...] = ()
    stamps_ns: array[int] = dataclasses.field(default_factory=lambda: array('q'))
    late: int = 0  # messages whose bag time is not their stamp
    frame_ids: set[str] = dataclasses.field(default_factory=set)
    problems: list[str] = dataclasses.field(default_factory=list)
    last: Any = None

    def count_problem(self, expected: np.ndarray) -> str | None:
        """Return how the stamps differ from those expected [ns], or None."""
        have = np.unique(self.stamps_ns)
        missing = np.setdiff1d(expected, have)
        extra = np.setdiff1d(have, expected)
        parts = []
        if len(missing):
            parts.append(f'{len(missing)} of {len(expected)} missing, first at '
                         f'{missing[0] / NS_PER_S:.3f} s')
        if len(extra):
            parts.append(f'{len(extra)} off the grid, first at {extra[0] / NS_PER_S:.6f} s')
        if len(self.stamps_ns) > len(have) and self.topic is not topics.TF:
            parts.append(f'{len(self.stamps_ns) - len(have)} more than once')
        return ', '.join(parts) or None


@dataclasses.dataclass
class BagScan:
    """The topics of one namespace of a bag, by their names in the contract."""

    namespace: str
    topics: dict[str, TopicScan] = dataclasses.field(default_factory=dict)
    signals: dict[str, Rows] = dataclasses.field(default_factory=dict)
    frames: list[FrameError] = dataclasses.field(default_factory=list)
    depth_mismatch: list[str] = dataclasses.field(default_factory=list)
    contrast: int = 0  # left images with more than one grey level
    ground: Overlay = dataclasses.field(default_factory=Overlay)  # after all its changes

    @property
    def truth(self) -> Topic:
        """The topic of the true odometry."""
        return topics.TRUE_ODOM if topics.TRUE_ODOM.name in self.topics else topics.ODOM

    def signal(self, topic: Topic) -> tuple[np.ndarray, np.ndarray]:
        """Return stamps (n,) [ns] and the values (n, k) that `_SIGNALS` picks."""
        return self.signals.get(topic.name, Rows()).arrays()


def _imu(m: Any) -> tuple[float, ...]:
    return *imu_row(m), *wxyz(m.orientation)


_SIGNALS: dict[str, Callable[[Any], tuple[float, ...]]] = {
    topics.ODOM.name: odometry_row, topics.TRUE_ODOM.name: odometry_row,
    topics.IMU_TRUTH.name: _imu, topics.IMU_RAW.name: _imu,
    topics.IMU_BIAS.name: accel_row,
    topics.WORLD_WINDOW.name: lambda m: (m.point.x, m.point.y)}


def scan(bag: Bag, namespace: str, progress: Callable[[], None] | None = None) -> BagScan:
    """Read the contract's topics under `namespace` once; `progress` is called once per message."""
    result = BagScan(namespace)
    by_topic: dict[str, TopicScan] = {}
    hazards = {found[1] for name in bag.types
               if (found := topics.of_hazard(name.removeprefix(f'{namespace}/'))) is not None}
    for known in (*topics.of_legs(topics.CONTRACT, topics.legs_of(bag.types)),
                  *(topic for camera in sorted(hazards) for topic in topics.hazard(camera))):
        for name in (f'{namespace}/{known.name}', f'/{known.name}'):
            if name in bag.types:
                by_topic[name] = result.topics[known.name] = TopicScan(
                    known, name, bag.types[name], _CONTENT.get(_like(known), ()))
                break
    if topics.TRUE_ODOM.name in result.topics and topics.ODOM.name in result.topics:
        # Here `odom` is that of an estimator, which has its own rate and frames.
        del by_topic[result.topics.pop(topics.ODOM.name).name]
    if not by_topic:
        return result
    finite = message_validity.FiniteCheck(bag.typestore)
    pair = _DepthPair(result)
    for message in bag.raw(by_topic):
        if progress is not None:
            progress()
        topic = by_topic[message.topic]
        stamp_ns = bag.stamp_ns(message)
        where = message.time_ns if stamp_ns is None else stamp_ns
        topic.stamps_ns.append(where)
        if stamp_ns and stamp_ns != message.time_ns:
            topic.late += 1
        try:
            decoded = bag.decode(message.data, message.msgtype)
        except BagError as error:
            topic.problems.append(f'at {where * 1e-9:.3f} s: {error}')
            topic.last = None
            continue
        _look(topic, decoded, where, finite, result, pair)
    return result


def _like(topic: Topic) -> str:
    """Return the name of the topic whose content checks hold for `topic`, too."""
    hazard = topics.of_hazard(topic.name)
    if hazard is None:
        return topic.name
    if hazard[0] is topics.HAZARD_DEPTH:
        return topics.TRUE_DEPTH.name
    return topics.LEFT_IMAGE.name if topic.type == topics.LEFT_IMAGE.type else topic.name


def _look(topic: TopicScan, message: Any, stamp_ns: int, finite: message_validity.FiniteCheck,
          result: BagScan, pair: _DepthPair) -> None:
    name = topic.topic.name
    topic.last = message
    header = getattr(message, 'header', None)
    if header is not None:
        topic.frame_ids.add(header.frame_id)
    problem = None
    if message.__msgtype__ == topic.topic.type:
        problem = next((found for check in topic.checks if (found := check(message))), None)
    if not problem:
        problem = finite.problem(topic.msgtype, message)
    if problem:
        topic.problems.append(f'at {stamp_ns * 1e-9:.3f} s {problem}')
    if message.__msgtype__ != topic.topic.type:
        return
    if name in _SIGNALS:
        result.signals.setdefault(name, Rows()).add(stamp_ns, _SIGNALS[name](message))
    if problem:
        return
    if name == topics.GROUND_CHANGES.name:
        result.ground.apply(changes_of(message))
    elif name in (topics.DISPARITY.name, topics.TRUE_DEPTH.name, topics.DEPTH.name):
        pair.take(name, stamp_ns, message)
    elif name == topics.LEFT_IMAGE.name:
        grey = message_validity.pixels(message)
        result.contrast += int(grey.min() != grey.max())
        pair.take_image(stamp_ns, grey)


class _DepthPair:
    """Compares disparity with true depth and with depth as soon as both of one stamp are read."""

    def __init__(self, result: BagScan) -> None:
        self._result = result
        self._waiting: dict[int, dict[str, Any]] = {}
        self._images: dict[int, np.ndarray] = {}

    def take_image(self, stamp_ns: int, grey: np.ndarray) -> None:
        self._images[stamp_ns] = grey
        if len(self._images) > _WAITING:
            del self._images[min(self._images)]

    def take(self, name: str, stamp_ns: int, message: Any) -> None:
        entry = self._waiting.setdefault(stamp_ns, {})
        entry[name] = message
        disparity = entry.get(topics.DISPARITY.name)
        if disparity is not None:
            for other, compare in ((topics.TRUE_DEPTH.name, self._true_depth),
                                   (topics.DEPTH.name, self._depth)):
                if entry.get(other) is not None:
                    compare(stamp_ns, disparity, message_validity.pixels(entry[other]))
                    entry[other] = None
        if len(self._waiting) > _WAITING:
            del self._waiting[min(self._waiting)]

    def _true_depth(self, stamp_ns: int, message: Any, depth: np.ndarray) -> None:
        disparity = disparity_map(message, message_validity.pixels(message.image))
        if depth.shape == disparity.disparity_px.shape:
            true_px = disparity_from_depth(depth, message.f, message.t)
            grey = self._images.pop(stamp_ns, None)
            texture = is_textured(grey) if grey is not None else None
            self._result.frames.append(frame_error(stamp_ns, disparity, true_px, texture))

    def _depth(self, stamp_ns: int, message: Any, depth: np.ndarray) -> None:
        disparity = message_validity.pixels(message.image)
        at = f'at {stamp_ns * 1e-9:.3f} s'
        if depth.shape != disparity.shape:
            self._result.depth_mismatch.append(f'{at} sizes differ')
            return
        both = disparity_map(message, disparity).has_finite_depth & np.isfinite(depth)
        if both.any():
            product = depth[both].astype(float) * disparity[both]
            ratio = float(np.abs(product / (message.f * message.t) - 1.0).max())
            if not ratio <= 1e-3:
                self._result.depth_mismatch.append(
                    f'{at} depth differs from f t / d by {100 * ratio:.1f} %')


IMAGE_SET = (topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.LEFT_INFO, topics.RIGHT_INFO)
DEPTH_SET = (topics.DISPARITY, topics.DEPTH, topics.TRUE_DEPTH)

# The topics that the rates are measured on.
_MEASURED = {STATE: (topics.TRUE_ODOM, topics.ODOM, topics.CLOCK),
             FRAME: topics.OF_PAIRS,
             DEPTH_FRAME: (topics.DISPARITY, topics.TRUE_DEPTH, topics.DEPTH)}


@dataclasses.dataclass(frozen=True)
class RoverData:
    """What one rover recorded.

    Attributes:
        state_ns, frame_ns, depth_ns: Periods of states, of frames, and of frames with depth [ns];
            0 where they are not known.
        end_ns: Last stamp of the states, else of the frames; 0 in an empty recording.
    """

    namespace: str
    scenario: RecordedScenario
    scan: BagScan
    state_ns: int
    frame_ns: int
    depth_ns: int
    end_ns: int

    @property
    def real_time(self) -> bool:
        """Whether it was recorded in real time, where samples may be lost."""
        return self.scenario.get('physics_node', 'time_mode') == 'real_time'

    def names(self, listed: object) -> set[str]:
        """Return names as in the contract of topics that the scenario lists."""
        names = listed if isinstance(listed, list) else []
        return {str(name).removeprefix(self.namespace).lstrip('/') for name in names}

    def of_rate(self, rate: str) -> list[TopicScan]:
        """Return the topics of a rate class; velocity commands belong to none."""
        return [t for t in self.scan.topics.values()
                if t.topic.rate == rate and t.topic is not topics.CMD_VEL]


def read_rover_data(bag: Bag, namespace: str, progress: Callable[[], None] | None) -> RoverData:
    """Scan one namespace of a bag; `progress` is called once per message."""
    scenario = recorded_scenario(bag, namespace)
    found = scan(bag, namespace, progress)
    rover = RoverData(namespace, scenario, found, _period_ns(STATE, scenario, found),
                      _period_ns(FRAME, scenario, found),
                      _period_ns(DEPTH_FRAME, scenario, found), end_ns=0)
    ends = [t.stamps_ns[-1] for t in rover.of_rate(STATE) if t.stamps_ns]
    ends = ends or [t.stamps_ns[-1] for t in rover.of_rate(FRAME) if t.stamps_ns]
    return dataclasses.replace(rover, end_ns=max(ends, default=0))


def scenario_period_ns(rate: str, scenario: RecordedScenario) -> int:
    """Return the period [ns] of a rate class in the scenario; 0 where there is none."""
    # Recordings of versions before depth_every have depth with every frame.
    return period_ns(rate, scenario.number('physics_node', 'state_rate_hz', 0.0),
                     scenario.number('render_node', 'frame_rate_hz', 0.0),
                     scenario.number('render_node', 'depth_every', 1.0))


def measured_period_ns(rate: str, found: BagScan) -> int:
    """Return the median period [ns] of a rate class; 0 where too little was recorded."""
    recorded = next((found.topics[t.name] for t in _MEASURED[rate] if t.name in found.topics),
                    None)
    steps = np.diff(np.unique(recorded.stamps_ns if recorded is not None else []))
    return int(np.median(steps)) if len(steps) else 0


def _period_ns(rate: str, scenario: RecordedScenario, found: BagScan) -> int:
    return scenario_period_ns(rate, scenario) or measured_period_ns(rate, found)
