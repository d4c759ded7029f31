"""Whether a bag can be trusted: complete, in step, and true to itself.

Time starts at one period: with states at 200 Hz the first stamp is 5 ms and the last the
duration, so that counts are rate x duration exactly. Rates are those of the scenario in the bag,
or measured where it has none.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from pathlib import Path
import re

import numpy as np
import yaml

from lunar_rover_sim import frames, topics
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario, RecordedScenario
from lunar_rover_sim.inspection import consistency
from lunar_rover_sim.inspection.matching import FrameError
from lunar_rover_sim.inspection.report import grouped, Report, Status
from lunar_rover_sim.inspection.scan import Scan, scan, TopicScan
from lunar_rover_sim.topics import EVENT, FRAME, LATCHED, STATE

NS_PER_S = 1_000_000_000
# tf2_msgs may not be installed; velocity commands come at the pace of who commands.
OPTIONAL = (topics.TF.name, topics.TF_STATIC.name, topics.CMD_VEL.name)
STEREO_SET = (topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.LEFT_INFO, topics.RIGHT_INFO,
              topics.DISPARITY, topics.DEPTH, topics.TRUE_DEPTH)

# Drift of the noise-free IMU over one second. The samples are exact means, so that what remains
# is the rounding of their messages and the middle attitude standing for the interval.
MAX_ATTITUDE_DRIFT_RAD = 2e-3
MAX_VELOCITY_DRIFT_MPS = 5e-3
# Position against twist is a trapezoid over impacts that are shorter than an interval.
MAX_POSITION_DRIFT_M = 5e-3
MAX_ATTITUDE_OFFSET_RAD = 1e-6
MAX_NOISE_SIGMAS = 6.0
# Semi-global matching errs by 0.3 px on textured ground, most of it a lag (see matching.py); a
# wrong baseline, focal length, a shift of half a pixel or exchanged images err by more.
MAX_MEDIAN_ERROR_PX = 0.5
MAX_SHIFT_PX = 0.35
MAX_LAG_ROWS = 1.2
MAX_SCALE = 0.01
MIN_MATCHED = 0.2


def check(path: Path | str, progress: Callable[[], None] | None = None) -> Report:
    """Check a bag; `progress` is called once a message. Raises BagError if it cannot be read."""
    report = Report()
    with open_bag(path) as bag:
        if bag.incomplete:
            report.add('complete', Status.FAIL, bag.incomplete)
        else:
            report.add('complete', Status.PASS, f'{bag.message_count} messages on '
                       f'{len(bag.types)} topics')
        if not bag.namespaces:
            report.add('contract', Status.FAIL, 'no odometry and no stereo images in the bag')
            return report
        for namespace in bag.namespaces:
            _Check(bag, namespace, report).run(progress)
    return report


class _Check:
    """The checks on one rover of a bag."""

    def __init__(self, bag: Bag, namespace: str, report: Report) -> None:
        self._bag = bag
        self._scenario: RecordedScenario = recorded_scenario(bag, namespace)
        self._report = report
        self._prefix = f'{namespace.lstrip("/")} ' if len(bag.namespaces) > 1 else ''
        self._namespace = namespace
        self._real_time = self._scenario.get('physics_node', 'time_mode') == 'real_time'
        self._scan = Scan(namespace)
        self._state_ns = self._frame_ns = self._end_ns = 0

    def run(self, progress: Callable[[], None] | None) -> None:
        self._scan = scan(self._bag, self._namespace, progress)
        self._time()
        self._topics()
        self._counts()
        self._stamps()
        self._stereo_sets()
        self._contents()
        self._world_hash()
        self._truth()
        self._stereo_truth()

    def _add(self, name: str, status: Status, detail: str) -> None:
        self._report.add(self._prefix + name, status, detail)

    def _verdict(self, name: str, problems: list[str], fine: str,
                 bad: Status = Status.FAIL) -> None:
        self._report.verdict(self._prefix + name, problems, fine, bad)

    def _time(self) -> None:
        """Find the periods, and whether the recording is as long as it was meant to be."""
        self._state_ns = self._period('state', topics.ODOM.name, topics.CLOCK.name,
                                      self._scenario.number('physics_node', 'state_rate_hz', 0))
        self._frame_ns = self._period('frame', topics.LEFT_IMAGE.name, topics.LEFT_INFO.name,
                                      self._scenario.number('render_node', 'frame_rate_hz', 0))
        stamps = [t.stamps_ns[-1] for t in self._of_rate(STATE) if t.stamps_ns]
        stamps = stamps or [t.stamps_ns[-1] for t in self._of_rate(FRAME) if t.stamps_ns]
        self._end_ns = max(stamps, default=0)
        meant_s = self._scenario.number('run', 'duration_s', 0.0)
        if not meant_s:
            return
        step = self._frame_ns or self._state_ns or 1
        meant_ns = math.ceil(round(meant_s * NS_PER_S) / step) * step
        problems = []
        if self._end_ns < meant_ns:
            problems.append(f'ends at {self._end_ns / NS_PER_S:.3f} s of the '
                            f'{meant_ns / NS_PER_S:.3f} s that the scenario runs')
        self._verdict('duration', problems, f'{self._end_ns / NS_PER_S:.3f} s',
                      Status.WARN if self._real_time else Status.FAIL)

    def _period(self, kind: str, name: str, other: str, rate_hz: float) -> int:
        """Return the period [ns] of a class of topics, and compare it with the scenario's."""
        topic = self._scan.topics.get(name) or self._scan.topics.get(other)
        measured = 0
        if topic is not None and len(topic.stamps_ns) > 1:
            measured = int(np.median(np.diff(np.unique(topic.stamps_ns))))
        if not rate_hz:
            return measured
        period = round(NS_PER_S / rate_hz)
        if measured and abs(measured - period) > 1000:
            self._add(f'{kind} rate', Status.WARN if self._real_time else Status.FAIL,
                      f'{NS_PER_S / measured:g} Hz measured, {rate_hz:g} Hz in the scenario')
        return period

    def _of_rate(self, rate: str) -> list[TopicScan]:
        return [t for t in self._scan.topics.values()
                if t.topic.rate == rate and t.topic is not topics.CMD_VEL]

    def _topics(self) -> None:
        """Every topic that was to be recorded is there, and has its type."""
        listed = self._scenario.get('recorder_node', 'topics', ['all'])
        excluded = self._names(self._scenario.get('recorder_node', 'exclude', []))
        nodes = self._scenario.get('run', 'nodes')
        missing = []
        for topic in topics.CONTRACT:
            if topic.rate == EVENT or topic.name in OPTIONAL or topic.name in excluded:
                continue
            if 'all' not in listed and topic.name not in self._names(listed):
                continue
            if isinstance(nodes, list) and topic.node not in nodes:
                continue
            if topic.name not in self._scan.topics:
                missing.append(topic.name)
        wrong = [f'{t.name} has type {t.msgtype}, not {t.topic.type}'
                 for t in self._scan.topics.values()
                 if t.msgtype != t.topic.type and t.topic is not topics.CMD_VEL]
        problems = wrong + ([f'missing: {", ".join(missing)}'] if missing else [])
        only_missing = bool(missing) and not wrong and not self._scenario
        self._verdict('topics', problems, f'{len(self._scan.topics)} of the contract',
                      Status.WARN if only_missing else Status.FAIL)

    def _names(self, listed: object) -> set[str]:
        names = listed if isinstance(listed, list) else []
        return {str(name).removeprefix(self._namespace).lstrip('/') for name in names}

    def _counts(self) -> None:
        """Counts are rate x duration, stamp by stamp; latched topics came once."""
        for rate, period in ((STATE, self._state_ns), (FRAME, self._frame_ns)):
            found = self._of_rate(rate)
            if not found:
                continue
            if not period:
                self._add(f'{rate} counts', Status.FAIL, 'too few messages to find their rate')
                continue
            expected = np.arange(period, self._end_ns + 1, period)
            if self._real_time:
                problems = grouped({t.name: f'{len(set(t.stamps_ns))} of {len(expected)}'
                                    for t in found if len(set(t.stamps_ns)) < len(expected)})
            else:
                problems = grouped({t.name: p for t in found
                                    if (p := _count_problem(t, expected))})
            fine = f'{len(found)} topics x {len(expected)} at {NS_PER_S / period:g} Hz'
            self._verdict(f'{rate} counts', problems, fine,
                          Status.WARN if self._real_time else Status.FAIL)
        problems = [f'{t.name}: {len(t.stamps_ns)} messages' for t in self._of_rate(LATCHED)
                    if len(t.stamps_ns) != 1 and t.topic.name != topics.TF_STATIC.name]
        self._verdict('latched', problems, f'{len(self._of_rate(LATCHED))} topics, once each')

    def _stamps(self) -> None:
        """Stamps increase strictly; bag time is the stamp."""
        repeated, late = [], []
        for t in self._scan.topics.values():
            if t.topic.rate in (STATE, FRAME) and t.topic is not topics.TF:
                steps = np.diff(t.stamps_ns)
                if (steps <= 0).any():
                    at = t.stamps_ns[int(np.argmax(steps <= 0)) + 1] / NS_PER_S
                    repeated.append(f'{t.name}: {int((steps <= 0).sum())} not after the one '
                                    f'before, first at {at:.3f} s')
            if t.late:
                late.append(f'{t.name}: {t.late} messages')
        self._verdict('stamps increase', repeated, 'strictly, on every topic')
        self._verdict('bag time', late, 'is the stamp', Status.WARN)

    def _stereo_sets(self) -> None:
        """One stamp per stereo set, and a pose for every image."""
        sets = {t.name: set(self._scan.topics[t.name].stamps_ns) for t in STEREO_SET
                if t.name in self._scan.topics}
        if not sets:
            return
        union = set().union(*sets.values())
        if not union:
            self._add('stereo sets', Status.SKIP, 'no stereo image in the bag')
            return
        problems = [f'{name} lacks {len(union - have)} of {len(union)} stamps, first '
                    f'{min(union - have) / NS_PER_S:.6f} s'
                    for name, have in sets.items() if union - have]
        self._verdict('stereo sets', problems, f'{len(union)} sets of {len(sets)} with one stamp')
        odom = self._scan.topics.get(topics.ODOM.name)
        if odom is None:
            return
        lonely = sorted(union - set(odom.stamps_ns))
        self._verdict('pose per image', [f'no odometry at {s / NS_PER_S:.6f} s' for s in lonely],
                      f'{len(union)} stamps')

    def _contents(self) -> None:
        """Numbers are finite, images have their size, frames are those of the contract."""
        problems = [f'{t.name} {t.problems[0]}' + (f' (in {len(t.problems)} messages)'
                                                   if len(t.problems) > 1 else '')
                    for t in self._scan.topics.values() if t.problems]
        self._verdict('contents', problems, 'finite, of the declared size')
        wrong = [f'{t.name} in frame {sorted(t.frame_ids)}, not {t.topic.frame_id!r}'
                 for t in self._scan.topics.values() if t.frame_ids and t.topic.frame_id
                 and t.frame_ids != {t.topic.frame_id}]
        self._verdict('frames', wrong, 'as in the contract')

    def _world_hash(self) -> None:
        """The world that was driven on is named, and is the one in the scenario's folder."""
        topic = self._scan.topics.get(topics.WORLD_HASH.name)
        if topic is None or topic.last is None:
            self._add('world hash', Status.FAIL, 'is not in the bag')
            return
        value = str(topic.last.data)
        problems = []
        if not re.fullmatch('[0-9a-f]{16,128}', value):
            problems.append(f'{value[:40]!r} is not a hexadecimal hash')
        folder = self._scenario.get('physics_node', 'world')
        on_disk = _hash_of_world(Path(folder)) if isinstance(folder, str) and folder else None
        if on_disk is not None and on_disk != value:
            problems.append(f'{value} is not that of {folder}, {on_disk}')
        self._verdict('world hash', problems, value)

    def _truth(self) -> None:
        """The noise-free IMU integrates to odometry; raw is truth, bias and noise."""
        rover = self._scenario
        position = _vector(rover.get('rover', 'imu.position_m'))
        rpy = np.radians(_vector(rover.get('rover', 'imu.rpy_deg')))
        R_base_imu = frames.matrix_from_wxyz(frames.wxyz_from_rpy(*rpy))
        drift = consistency.imu_drift(self._scan, position,
                                      rover.number('physics_node', 'gravity_mps2', 1.62))
        if drift is None:
            self._add('imu and odometry', Status.SKIP, 'not both in the bag, or not finite')
            return
        problems = []
        if not drift.attitude_rad <= MAX_ATTITUDE_DRIFT_RAD:
            problems.append(f'angular velocity drifts {drift.attitude_rad:.4f} rad from the '
                            f'attitude within 1 s (valid: {MAX_ATTITUDE_DRIFT_RAD:g})')
        if not drift.velocity_mps <= MAX_VELOCITY_DRIFT_MPS:
            problems.append(f'specific force drifts {drift.velocity_mps:.4f} m/s from the '
                            f'velocity within 1 s (valid: {MAX_VELOCITY_DRIFT_MPS:g})')
        if not drift.position_m <= MAX_POSITION_DRIFT_M:
            problems.append(f'twist drifts {drift.position_m:.4f} m from the position within 1 s '
                            f'(valid: {MAX_POSITION_DRIFT_M:g})')
        offset = consistency.attitude_offset_rad(self._scan, R_base_imu)
        if offset is not None and offset > MAX_ATTITUDE_OFFSET_RAD:
            problems.append(f'the IMU is turned {offset:.4f} rad from its mount')
        self._verdict('imu and odometry', problems,
                      f'drift in 1 s: {drift.attitude_rad:.1e} rad, {drift.velocity_mps:.1e} m/s, '
                      f'{drift.position_m:.1e} m')
        self._raw_imu()

    def _raw_imu(self) -> None:
        imperfect = [name for name in ('accel_scale_error', 'gyro_scale_error',
                                       'accel_misalignment_deg', 'gyro_misalignment_deg',
                                       'accel_range_mps2', 'gyro_range_radps')
                     if np.any(self._scenario.get('physics_node', f'imu.{name}', 0))]
        if imperfect:
            self._add('imu noise', Status.SKIP, f'{", ".join(imperfect)} given')
            return
        offset = consistency.raw_imu_offset(self._scan)
        if offset is None:
            self._add('imu noise', Status.SKIP, 'raw signal, truth and bias not all in the bag')
            return
        problems = []
        if offset.sigmas > MAX_NOISE_SIGMAS:
            problems.append(f'raw minus truth minus bias is not noise: {offset.worst}, '
                            f'{offset.sigmas:.1f} standard errors from 0')
        self._verdict('imu noise', problems, f'mean within {offset.sigmas:.1f} standard errors')

    def _stereo_truth(self) -> None:
        """Disparity agrees with true depth; depth with disparity; the calibration with both."""
        self._calibration()
        errors = self._scan.frames
        if not errors:
            self._add('disparity and depth', Status.SKIP, 'not both in the bag')
            return
        matched = np.array([e.matched for e in errors])
        seen = [e for e in errors if np.isfinite(e.median_px)]
        if not seen and np.max(matched) > 0.0:
            self._add('disparity and depth', Status.SKIP, 'too little texture to judge')
        elif not seen:
            self._add('disparity and depth', Status.FAIL, 'no pixel was matched in any frame')
        else:
            self._matching(seen)
        if np.median(matched) < MIN_MATCHED:
            self._add('matched share', Status.WARN, f'only {100 * np.median(matched):.0f} % of '
                      'the pixels in range were matched')
        self._verdict('depth and disparity', self._scan.depth_mismatch, 'depth is f t / d')
        left = self._scan.topics.get(topics.LEFT_IMAGE.name)
        if left is not None and left.stamps_ns and not self._scan.contrast:
            self._add('images', Status.FAIL, 'every left image is of one single grey')

    def _matching(self, seen: list[FrameError]) -> None:
        median, shift, lag, scale, outliers = (
            float(np.median([getattr(e, name) for e in seen]))
            for name in ('median_px', 'shift_px', 'lag_rows', 'scale', 'outliers'))
        problems = [f'{what} {value:+.3g} (valid: {bound:g})' for what, value, bound in (
            ('median error [px]', median, MAX_MEDIAN_ERROR_PX),
            ('shift [px]', shift, MAX_SHIFT_PX),
            ('lag [rows]', lag, MAX_LAG_ROWS), ('scale', scale, MAX_SCALE))
            if not abs(value) <= bound]
        wild = [e for e in seen if e.median_px > 4.0 * MAX_MEDIAN_ERROR_PX]
        if wild and not problems:
            problems.append(f'median error {wild[0].median_px:.2f} px at '
                            f'{wild[0].stamp_ns / NS_PER_S:.3f} s, {len(wild)} such frames')
        self._verdict('disparity and depth', problems,
                      f'median error {median:.2f} px, shift {shift:+.2f} px, lag {lag:+.2f} rows, '
                      f'scale {1.0 + scale:.4f}, {100 * outliers:.1f} % outliers')

    def _calibration(self) -> None:
        """Both camera infos, the disparity message and the images tell of one camera."""
        last = {name: t.last for name, t in self._scan.topics.items()
                if t.topic in STEREO_SET and t.last is not None and not t.problems}
        left, right = last.get(topics.LEFT_INFO.name), last.get(topics.RIGHT_INFO.name)
        if left is None or right is None:
            return
        problems = []
        baseline_m = -right.p[3] / right.p[0]
        if not baseline_m > 0.0:
            problems.append(f'right P[3] = {right.p[3]:g} is not -fx times a baseline')
        if left.p[3] != 0.0:
            problems.append(f'left P[3] = {left.p[3]:g} is not 0')
        if not np.array_equal(np.delete(left.p, 3), np.delete(right.p, 3)):
            problems.append('left and right projections differ in more than the baseline')
        disparity = last.get(topics.DISPARITY.name)
        if disparity is not None:
            if abs(disparity.t - baseline_m) > 1e-5 or abs(disparity.f / left.p[0] - 1.0) > 1e-5:
                problems.append(f'disparity has f = {disparity.f:g} px, t = {disparity.t:g} m; '
                                f'camera_info f = {left.p[0]:g} px, t = {baseline_m:g} m')
        meant = self._scenario.number('rover', 'stereo.baseline_m', 0.0)
        if meant and abs(meant - baseline_m) > 1e-6:
            problems.append(f'baseline {baseline_m:g} m, {meant:g} m in the scenario')
        for name, message in last.items():
            shape = getattr(message, 'image', message)
            if (shape.width, shape.height) != (left.width, left.height):
                problems.append(f'{name} is {shape.width}x{shape.height}, camera_info '
                                f'{left.width}x{left.height}')
        self._verdict('calibration', problems,
                      f'{left.width}x{left.height}, f = {left.p[0]:g} px, b = {baseline_m:g} m')


def _count_problem(topic: TopicScan, expected: np.ndarray) -> str:
    have = np.unique(topic.stamps_ns)
    missing = np.setdiff1d(expected, have)
    extra = np.setdiff1d(have, expected)
    parts = []
    if len(missing):
        parts.append(f'{len(missing)} of {len(expected)} missing, first at '
                     f'{missing[0] / NS_PER_S:.3f} s')
    if len(extra):
        parts.append(f'{len(extra)} off the grid, first at {extra[0] / NS_PER_S:.6f} s')
    if len(topic.stamps_ns) > len(have) and topic.topic is not topics.TF:
        parts.append(f'{len(topic.stamps_ns) - len(have)} more than once')
    return ', '.join(parts)


def _hash_of_world(folder: Path) -> str | None:
    try:
        document = yaml.safe_load((folder / 'world.yaml').read_text(encoding='utf-8'))
        return str(document['hash'])
    except (OSError, yaml.YAMLError, KeyError, TypeError, UnicodeDecodeError):
        return None


def _vector(value: object) -> np.ndarray:
    if isinstance(value, (list, tuple)) and len(value) == 3:
        try:
            return np.array([float(v) for v in value])
        except (TypeError, ValueError):
            pass
    return np.zeros(3)
