"""Checks of disparity, depth and calibration against each other."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim import topics
from lunar_rover_sim.inspection.disparity_error import FrameError
from lunar_rover_sim.inspection.report import CheckReport, Status
from lunar_rover_sim.inspection.rover_data import DEPTH_SET, IMAGE_SET, RoverData
from lunar_rover_sim.seconds import NS_PER_S

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
        _matching(seen, report)
    if np.median(matched) < MIN_MATCHED:
        report.add('matched share', Status.WARN, f'only {100 * np.median(matched):.0f} % of '
                   'the pixels in range were matched')
    report.verdict('depth and disparity', rover.scan.depth_mismatch, 'depth is f t / d')
    left = rover.scan.topics.get(topics.LEFT_IMAGE.name)
    if left is not None and left.stamps_ns and not rover.scan.contrast:
        report.add('images', Status.FAIL, 'every left image is of one single grey')


def _matching(seen: list[FrameError], report: CheckReport) -> None:
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
                   f'{100 * outliers:.1f} % outliers')
