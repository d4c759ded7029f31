"""Numbers that describe a recording, each with what it means.

Images are sampled: at most `SAMPLES` stereo sets, evenly over the recording. The ground is where
the true depth is finite.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lunar_rover_sim.bag.messages import accel_row, exposure_s, imu_row
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.series import (common_stamps, messages_at, picture, read_odometry,
                                        read_rows)
from lunar_rover_sim.bag.totals import simulated_end_ns
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.image.stereo.depth import disparity_from_depth
from lunar_rover_sim.image.stereo.error import disparity_errors_px
from lunar_rover_sim.judge.evaluation.image_statistics import levels_of, shadow_share
from lunar_rover_sim.products.inspection.disparity_error import disparity_map, is_textured
from lunar_rover_sim.products.sequences.sensors import recorded_sensors
from lunar_rover_sim.run.recorded_run import RecordedRun

SAMPLES = 40
_CORNER_THRESHOLD = 20   # grey levels of 255, as ORB-SLAM3's first threshold

MEANINGS: dict[str, str] = {
    'duration_s': 'simulated time [s]',
    'frames': 'images of the left camera',
    'exposure_s': 'mean exposure time of the pairs [s]',
    'distance_m': 'length of the true path, horizontal, in steps of 0.1 s [m]',
    'mean_speed_mps': 'distance over duration [m/s]',
    'climb_m': 'difference of the highest and the lowest point of the path [m]',
    'largest_tilt_deg': 'largest angle between the base and the vertical [deg]',
    'sun_azimuth_deg': 'direction to the sun, from x (east) towards y (north) [deg]',
    'sun_elevation_deg': 'height of the sun above the horizontal [deg]',
    'ground_share': 'share of the left image that shows ground, not sky',
    'shadow_share': 'share of the ground pixels with less than 5 % of the signal of the bright '
                    'ground (90th percentile) of the same image',
    'textured_share': 'share of the ground pixels whose brightness changes by more than 8 % of '
                      'full scale over two columns',
    'corners': 'FAST corners (threshold 20 of 255) per left image',
    'sgm_density': 'share of the ground pixels with a disparity from semi-global matching',
    'sgm_error_px': 'median absolute error of that disparity against the true depth [px]',
    'sgm_bias_px': 'median signed error of it, disparity less true disparity [px]',
    'accel_noise_density': 'standard deviation of raw minus truth and bias, times the root of '
                           'the sample period [m/s^2/sqrt(Hz)]',
    'gyro_noise_density': 'the same of the gyroscope [rad/s/sqrt(Hz)]',
    'bytes': 'size of the bag [bytes]',
}


_MEDIANS = ('sgm_error_px', 'sgm_bias_px')


def statistics(path: Path | str) -> dict[str, Any]:
    """Return name → number (None if the bag lacks what it needs), and the preset of an IMU.

    The names are those of `MEANINGS`.

    Raises:
        BagError: If the bag cannot be read.
    """
    result: dict[str, Any] = dict.fromkeys(MEANINGS)
    with open_bag(path) as bag:
        result['bytes'] = bag.size_bytes
        result['duration_s'] = simulated_end_ns(bag) / 1e9
        result['frames'] = bag.count(topics.LEFT_IMAGE.name)
        if bag.count(topics.EXPOSURE.name):
            result['exposure_s'] = float(np.mean(
                [exposure_s(m) for _, _, m in bag.messages([topics.EXPOSURE.name])]))
        if bag.has(bag.truth):
            result.update(_path(bag))
        if bag.has(topics.SUN.name):
            sun = bag.first(topics.SUN.name).vector
            result['sun_azimuth_deg'] = float(np.degrees(np.arctan2(sun.y, sun.x)))
            result['sun_elevation_deg'] = float(
                np.degrees(np.arctan2(sun.z, np.hypot(sun.x, sun.y))))
        result.update(_images(bag))
        result.update(_imu(bag))
        if bag.has(topics.IMU_RAW.name):
            result['imu_preset'] = str(
                RecordedRun(bag).scenario.get('physics_node', 'imu.preset', ''))
    return {name: round(value, 9) if isinstance(value, float) else value
            for name, value in result.items()}


def _path(bag: Bag) -> dict[str, float]:
    odometry = read_odometry(bag)
    if not len(odometry.stamps_ns):
        return {}
    distance = odometry.distance_m
    duration_s = float(odometry.stamps_ns[-1]) / 1e9
    return {'distance_m': distance,
            'mean_speed_mps': distance / duration_s if duration_s > 0.0 else 0.0,
            'climb_m': float(np.ptp(odometry.every_step().positions_m[:, 2])),
            'largest_tilt_deg': float(frames.tilt_deg(odometry.orientations_wxyz).max())}


def _images(bag: Bag) -> dict[str, float]:
    """Return means over the sampled frames; of the errors of disparity, medians."""
    if not bag.has(topics.LEFT_IMAGE.name):
        return {}
    linear = RecordedRun(bag).scenario.get('render_node', 'sensor.companding') == 'linear'
    wanted = topics.LEFT_IMAGE, topics.TRUE_DEPTH, topics.DISPARITY
    stamps = common_stamps(bag, [t.name for t in wanted if bag.has(t.name)])
    chosen = np.unique(np.linspace(0, len(stamps) - 1, min(SAMPLES, len(stamps))).astype(int))
    collected: dict[str, list[float]] = {}
    for k in chosen:
        found = messages_at(bag, wanted, stamps[k])
        for name, value in _describe(bag, found, linear).items():
            collected.setdefault(name, []).append(value)
    return {name: float(np.median(values) if name in _MEDIANS else np.mean(values))
            for name, values in collected.items()}


def _describe(bag: Bag, found: Mapping[topics.Topic, Any], linear: bool) -> dict[str, float]:
    """Return what the messages of a stereo set show."""
    left = picture(bag, found[topics.LEFT_IMAGE]).pixels
    levels = levels_of(left, linear=False)
    corners = cv2.FastFeatureDetector.create(_CORNER_THRESHOLD).detect(
        np.ascontiguousarray((levels * 255.0).astype(np.uint8)))
    result = {'corners': float(len(corners))}
    if topics.TRUE_DEPTH not in found:
        return result
    depth_m = picture(bag, found[topics.TRUE_DEPTH]).pixels
    ground = np.isfinite(depth_m)
    result['ground_share'] = float(ground.mean())
    if not ground.any():
        return result
    # mono16 is linear in any case, mono8 and rgb8 as the scenario says.
    signal = levels if linear or left.dtype == np.uint16 else levels**2
    result['shadow_share'] = shadow_share(signal[ground])
    result['textured_share'] = float(is_textured(left)[ground].mean())
    if topics.DISPARITY in found:
        message = found[topics.DISPARITY]
        disparity = disparity_map(message, picture(bag, message.image).pixels)
        matched = disparity.has_finite_depth & ground
        result['sgm_density'] = float(matched[ground].mean())
        if matched.any():
            true_px = disparity_from_depth(depth_m, message.f, message.t)
            errors_px = disparity_errors_px(disparity, true_px, matched)
            result['sgm_error_px'] = float(np.median(np.abs(errors_px)))
            result['sgm_bias_px'] = float(np.median(errors_px))
    return result


def _imu(bag: Bag) -> dict[str, float]:
    """Return the noise densities that the recording shows; the bias is taken off."""
    needed = (topics.IMU_RAW.name, topics.IMU_TRUTH.name, topics.IMU_BIAS.name)
    if not all(bag.has(name) for name in needed):
        return {}
    read = read_rows(bag, dict(zip(needed, (imu_row, imu_row, accel_row))))
    raw, truth, bias = (read[name].values for name in needed)
    rate_hz = recorded_sensors(bag).imu_rate_hz if bag.has(topics.LEFT_INFO.name) else 0.0
    if not len(raw) == len(truth) == len(bias) > 1 or not rate_hz:
        return {}
    gyro, accel = np.split(raw - truth - bias, 2, axis=1)
    return {'accel_noise_density': float(accel.std(axis=0).mean() / np.sqrt(rate_hz)),
            'gyro_noise_density': float(gyro.std(axis=0).mean() / np.sqrt(rate_hz))}
