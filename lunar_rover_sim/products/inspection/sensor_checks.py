"""The checks of one kind of sensor each: LiDAR, hazard cameras, IMU, stereo."""

from __future__ import annotations

from collections.abc import Mapping
import functools

import numpy as np
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.gravity import MOON_MPS2
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.image.camera.fisheye import geometry_of
from lunar_rover_sim.image.camera.hazard import HazardConfig, sides
from lunar_rover_sim.products.inspection.bag_scan import BagScan, DEPTH_SET, IMAGE_SET, RoverData
from lunar_rover_sim.products.inspection.disparity_error import FrameError
from lunar_rover_sim.products.inspection.report import CheckReport, Status

_SCANS = (topics.LIDAR_POINTS, topics.LIDAR_DESKEWED, topics.LIDAR_SCAN)


def scans(rover: RoverData, report: CheckReport) -> None:
    """Each topic has a scan of every period that ends within the recording.

    With `run.may_fail` scans may be missing, as in real time.
    """
    found = [rover.scan.topics[t.name] for t in _SCANS if t.name in rover.scan.topics]
    rate_hz = rover.scenario.number('lidar_node', 'rate_hz', 0.0)
    if not found or not rate_hz:
        return
    period = round(NS_PER_S / rate_hz)
    expected = np.arange(period, rover.end_ns - period + 1, period)
    may_miss = rover.real_time or 'lidar_node' in (rover.scenario.get('run', 'may_fail') or [])
    problems = [f'{topic.name}: {problem}' for topic in found
                if (problem := topic.count_problem(expected))]
    report.verdict('scans', problems, f'{len(found)} topics x {len(expected)} at {rate_hz:g} Hz',
                   Status.WARN if may_miss else Status.FAIL)


def hazards(rover: RoverData, report: CheckReport) -> None:
    """Images and CameraInfos of hazard cameras that were to be recorded are there, and fit."""
    sets = rover.scenario.get('render_node', 'hazard')
    if not isinstance(sets, Mapping):
        return
    listed = rover.names(rover.scenario.get('recorder_node', 'topics', ['all']))
    problems, found = [], 0
    for name, values in sets.items():
        try:
            config = HazardConfig.from_mapping(values, f'render_node.hazard.{name}')
        except ConfigError as error:
            problems.append(f'the scenario is not of this version: {error}')
            continue
        for side, camera in enumerate(sides(str(name), config)):
            for topic in topics.hazard(camera):
                if topic.name not in listed:
                    continue
                found += 1
                problem = _topic_problem(rover, topic.name, config, side)
                if problem:
                    problems.append(f'{topic.name}: {problem}')
    if found or problems:
        report.verdict('hazard cameras', problems, f'{found} topics, as in the scenario',
                       Status.WARN if rover.real_time else Status.FAIL)


def _topic_problem(rover: RoverData, name: str, config: HazardConfig,
                   side: int) -> str | None:
    """Return what is wrong with one topic of a camera; side: 0 left or the only one, 1 right."""
    topic = rover.scan.topics.get(name)
    if topic is None:
        return 'missing'
    period_ns = NS_PER_S // config.rate_hz
    problem = topic.count_problem(np.arange(period_ns, rover.end_ns + 1, period_ns))
    if problem:
        return problem
    last, camera = topic.last, geometry_of(config)
    if last is None or topic.msgtype != topic.topic.type:
        return None
    if (last.width, last.height) != (camera.width, camera.height):
        return (f'{last.width} x {last.height} px, {camera.width} x {camera.height} px in the '
                'scenario')
    if name.endswith('camera_info') and (
            last.distortion_model != camera.distortion_model
            or not np.allclose(last.k, camera.K.ravel()) or not np.allclose(last.d, camera.D)
            or not np.isclose(last.p[3], -side * camera.focal_px * config.stereo_baseline_m)):
        return 'not the camera of the scenario'
    return None


WINDOW_S = 1.0


Signals = tuple[np.ndarray, np.ndarray, np.ndarray]     # stamps [ns], odometry, true IMU at them


def _rotation(quat_wxyz: np.ndarray) -> Rotation:
    return Rotation.from_quat(quat_wxyz[:, [1, 2, 3, 0]])


def _common(scan: BagScan) -> Signals | None:
    """Return odometry and IMU at their common stamps; None where there are few, or no numbers."""
    odom_ns, odom = scan.signal(scan.truth)
    imu_ns, imu = scan.signal(topics.IMU_TRUTH)
    stamps, at_odom, at_imu = np.intersect1d(odom_ns, imu_ns, return_indices=True)
    if len(stamps) < 3:
        return None
    odom, imu = odom[at_odom], imu[at_imu]
    lengths = np.linalg.norm([odom[:, 3:7], imu[:, 6:10]], axis=2)
    if not (np.isfinite(odom).all() and np.isfinite(imu).all()) or (lengths < 0.5).any():
        return None
    return stamps, odom, imu


def imu_drift(signals: Signals, imu_position_m: np.ndarray,
              gravity_mps2: float) -> list[float]:
    """Return how far the true IMU signal drifts from odometry.

    Args:
        imu_position_m: (3,) origin of the IMU in base_link.

    Returns:
        Largest drifts over one second of attitude [rad], velocity [m/s] and position [m].
    """
    stamps, odom, imu = signals
    step_s = np.diff(stamps) * 1e-9
    whole = step_s < 1.5 * np.median(step_s)  # an interval with a gap is not judged
    base, body = _rotation(odom[:, 3:7]), _rotation(imu[:, 6:10])
    turn = (body[:-1].inv() * body[1:]).as_rotvec()
    rate = imu[1:, 0:3]
    attitude = ((Rotation.from_rotvec(-rate * step_s[:, None]))
                * Rotation.from_rotvec(turn)).as_rotvec()
    velocity = base.apply(odom[:, 7:10] + np.cross(odom[:, 10:13], imu_position_m))
    middle = body[:-1] * Rotation.from_rotvec(0.5 * turn)
    gain = (middle.apply(imu[1:, 3:6]) - [0.0, 0.0, gravity_mps2]) * step_s[:, None]
    change = np.diff(velocity, axis=0) - gain
    base_velocity = base.apply(odom[:, 7:10])
    moved = (np.diff(odom[:, 0:3], axis=0)
             - 0.5 * (base_velocity[1:] + base_velocity[:-1]) * step_s[:, None])
    starts_s = (stamps[:-1] - stamps[0]) * 1e-9
    window = (starts_s // WINDOW_S).astype(int)
    drifts = []
    for residual in (attitude, change, moved):
        total = np.zeros((window[-1] + 1, 3))
        np.add.at(total, window[whole], residual[whole])
        drifts.append(float(np.linalg.norm(total, axis=1).max()))
    return drifts


def raw_imu_offset(scan: BagScan) -> tuple[float, str] | None:
    """Return the mean of raw minus truth minus bias; None where not all of them are recorded.

    It is that of the worst axis, in its own standard errors, and a text that names it.
    """
    signals = [scan.signal(topic)
               for topic in (topics.IMU_RAW, topics.IMU_TRUTH, topics.IMU_BIAS)]
    if any(not len(ns) or len(np.unique(ns)) != len(ns) or not np.isfinite(values).all()
           for ns, values in signals):
        return None
    stamps = functools.reduce(np.intersect1d, (ns for ns, _ in signals))
    if len(stamps) < 10:
        return None
    raw, truth, bias = (values[np.searchsorted(ns, stamps), :6] for ns, values in signals)
    noise = raw - truth - bias
    error = noise.std(axis=0) / np.sqrt(len(noise)) + 1e-6
    sigmas = np.abs(noise.mean(axis=0)) / error
    axis = int(np.argmax(sigmas))
    name = ('angular velocity', 'specific force')[axis // 3] + ' ' + 'xyz'[axis % 3]
    return float(sigmas[axis]), f'{name}: mean {noise[:, axis].mean():.4g}'


# Drift of the noise-free IMU over one second. The samples are exact means; what remains is the
# rounding of their messages, and the mean attitude that stands for the interval.
MAX_ATTITUDE_DRIFT_RAD = 2e-3
MAX_VELOCITY_DRIFT_MPS = 5e-3
# The trapezoidal rule from twist to position misses impacts shorter than an interval.
MAX_POSITION_DRIFT_M = 5e-3
MAX_ATTITUDE_OFFSET_RAD = 1e-6
MAX_NOISE_SIGMAS = 6.0


def imu_and_odometry(rover: RoverData, report: CheckReport) -> None:
    """The noise-free IMU integrates to odometry."""
    position = _vector(rover.scenario.get('rover', 'imu.position_m'))
    rpy = np.radians(_vector(rover.scenario.get('rover', 'imu.rpy_deg')))
    R_base_imu = frames.matrix_from_wxyz(frames.wxyz_from_rpy(*rpy))
    signals = _common(rover.scan)
    if signals is None:
        report.add('imu and odometry', Status.SKIP, 'not both in the bag, or not finite')
        return
    drifts = imu_drift(signals, position,
                       rover.scenario.number('physics_node', 'gravity_mps2', MOON_MPS2))
    problems = [f'{what} drifts {drift:.4f} {unit} from the {of} within 1 s (valid: {most:g})'
                for drift, (what, of, unit, most) in zip(drifts, (
                    ('angular velocity', 'attitude', 'rad', MAX_ATTITUDE_DRIFT_RAD),
                    ('specific force', 'velocity', 'm/s', MAX_VELOCITY_DRIFT_MPS),
                    ('twist', 'position', 'm', MAX_POSITION_DRIFT_M))) if not drift <= most]
    _, odom, imu = signals
    expected = _rotation(odom[:, 3:7]) * Rotation.from_matrix(R_base_imu)
    offset_rad = float((expected.inv() * _rotation(imu[:, 6:10])).magnitude().max())
    if offset_rad > MAX_ATTITUDE_OFFSET_RAD:
        problems.append(f'the IMU is turned {offset_rad:.4f} rad from its mount')
    attitude_rad, velocity_mps, position_m = drifts
    report.verdict('imu and odometry', problems, f'drift in 1 s: {attitude_rad:.1e} rad, '
                   f'{velocity_mps:.1e} m/s, {position_m:.1e} m')


def imu_noise(rover: RoverData, report: CheckReport) -> None:
    """The raw signal is truth, bias and white noise."""
    imperfect = [name for name in ('accel_scale_error', 'gyro_scale_error',
                                   'accel_misalignment_deg', 'gyro_misalignment_deg',
                                   'accel_range_mps2', 'gyro_range_radps')
                 if np.any(rover.scenario.get('physics_node', f'imu.{name}', 0))]
    if imperfect:
        report.add('imu noise', Status.SKIP, f'{", ".join(imperfect)} given')
        return
    offset = raw_imu_offset(rover.scan)
    if offset is None:
        report.add('imu noise', Status.SKIP, 'raw signal, truth and bias not all in the bag')
        return
    sigmas, worst = offset
    problems = []
    if sigmas > MAX_NOISE_SIGMAS:
        problems.append(f'raw minus truth minus bias is not noise: {worst}, '
                        f'{sigmas:.1f} standard errors from 0')
    report.verdict('imu noise', problems, f'mean within {sigmas:.1f} standard errors')


def _vector(value: object) -> np.ndarray:
    if isinstance(value, (list, tuple)) and len(value) == 3:
        try:
            return np.array([float(v) for v in value])
        except (TypeError, ValueError):
            pass
    return np.zeros(3)


# Semi-global matching errs by 0.1 px on textured ground, by 0.3 px without refinement; a wrong
# baseline, focal length, a shift of half a pixel or exchanged images err by more.
MAX_MEDIAN_ERROR_PX = 0.5
MAX_SHIFT_PX = 0.35
MAX_LAG_ROWS = 1.2
MAX_SCALE = 0.01
MIN_MATCHED = 0.2


def calibration(rover: RoverData, report: CheckReport) -> None:
    """Both camera infos, the disparity message and the images describe one camera."""
    last = {name: t.last for name, t in rover.scan.topics.items()
            if t.topic in IMAGE_SET + DEPTH_SET and t.last is not None and not t.problems}
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
    meant = rover.scenario.number('rover', 'stereo.baseline_m', 0.0)
    if meant and abs(meant - baseline_m) > 1e-6:
        problems.append(f'baseline {baseline_m:g} m, {meant:g} m in the scenario')
    for name, message in last.items():
        shape = getattr(message, 'image', message)
        if (shape.width, shape.height) != (left.width, left.height):
            problems.append(f'{name} is {shape.width}x{shape.height}, camera_info '
                            f'{left.width}x{left.height}')
    report.verdict('calibration', problems,
                   f'{left.width}x{left.height}, f = {left.p[0]:g} px, b = {baseline_m:g} m')


def disparity_and_depth(rover: RoverData, report: CheckReport) -> None:
    """Disparity agrees with true depth, and depth with disparity."""
    errors = rover.scan.frames
    if not errors:
        report.add('disparity and depth', Status.SKIP, 'not both in the bag')
        return
    matched = np.array([e.matched for e in errors])
    seen = [e for e in errors if np.isfinite(e.median_px)]
    if not seen and np.max(matched) > 0.0:
        report.add('disparity and depth', Status.SKIP, 'too little texture to judge')
    elif not seen:
        report.add('disparity and depth', Status.FAIL, 'no pixel was matched in any frame')
    else:
        # A pair that is out of adjustment by intent matches worse.
        told = topics.MISCALIBRATION.name in rover.scan.topics
        _matching(seen, report, Status.WARN if told else Status.FAIL)
    if np.median(matched) < MIN_MATCHED:
        report.add('matched share', Status.WARN, f'only {100 * np.median(matched):.0f} % of '
                   'the pixels in range were matched')
    report.verdict('depth and disparity', rover.scan.depth_mismatch, 'depth is f t / d')
    left = rover.scan.topics.get(topics.LEFT_IMAGE.name)
    if left is not None and left.stamps_ns and not rover.scan.contrast:
        report.add('images', Status.FAIL, 'every left image is of one single grey')


def _matching(seen: list[FrameError], report: CheckReport, bad: Status) -> None:
    median, bias, shift, lag, scale, outliers = (
        float(np.median([getattr(e, name) for e in seen]))
        for name in ('median_px', 'bias_px', 'shift_px', 'lag_rows', 'scale', 'outliers'))
    problems = [f'{what} {value:+.3g} (valid: {bound:g})' for what, value, bound in (
        ('median error [px]', median, MAX_MEDIAN_ERROR_PX),
        ('shift [px]', shift, MAX_SHIFT_PX),
        ('lag [rows]', lag, MAX_LAG_ROWS), ('scale', scale, MAX_SCALE))
        if not abs(value) <= bound]
    wild = [e for e in seen if e.median_px > 4.0 * MAX_MEDIAN_ERROR_PX]
    if wild and not problems:
        problems.append(f'median error {wild[0].median_px:.2f} px at '
                        f'{wild[0].stamp_ns / NS_PER_S:.3f} s, {len(wild)} such frames')
    report.verdict('disparity and depth', problems,
                   f'median error {median:.2f} px (signed {bias:+.3f}), shift {shift:+.2f} px, '
                   f'lag {lag:+.2f} rows, scale {1.0 + scale:.4f}, '
                   f'{100 * outliers:.1f} % outliers', bad)
