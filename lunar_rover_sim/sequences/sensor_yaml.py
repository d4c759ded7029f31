"""calibration.yaml of an exported sequence: what the formats themselves do not hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from lunar_rover_sim.files.yaml_text import yaml_of
from lunar_rover_sim.frames import Array, inverse
from lunar_rover_sim.sequences.further import RecordedCamera
from lunar_rover_sim.sequences.sensors import SensorSuite

CALIBRATION_FILE = 'calibration.yaml'


def calibration_yaml(suite: SensorSuite, kind: str,
                     depth: Mapping[str, Mapping[str, Any]],
                     further: Iterable[RecordedCamera] = (),
                     T_base_lidar: Array | None = None) -> str:
    """Return cameras, mounts, IMU and depth units of a sequence as YAML.

    Pixels are counted from the centre of the first one; T_a_b maps points of b to a; optical
    frames are x right, y down, z forward; noise is in continuous time.

    Args:
        kind: Name of the format.
        depth: Its depth images and their units.
        further: Hazard cameras.
        T_base_lidar: (4, 4) where the LiDAR is, if the sequence has its scans.
    """
    def camera(T_imu_camera: Array) -> dict[str, Any]:
        return {'width_px': suite.width, 'height_px': suite.height,
                'fx_fy_cx_cy_px': [*map(float, suite.focal_px), *map(float, suite.centre_px)],
                'distortion_model': 'plumb_bob', 'k1_k2_p1_p2_k3': list(suite.distortion),
                'T_imu_camera': _rows(T_imu_camera)}

    def hazard(camera: RecordedCamera) -> dict[str, Any]:
        c = camera.calibration
        return {'width_px': c.width, 'height_px': c.height,
                'fx_fy_cx_cy_px': list(c.fx_fy_cx_cy_px),
                'distortion_model': c.distortion_model,
                'k1_k2_k3_k4' if camera.is_fisheye else 'k1_k2_p1_p2_k3': c.D.tolist(),
                'T_imu_camera': _rows(inverse(suite.T_base_imu) @ camera.T_base_camera)}

    noise = suite.noise
    document: dict[str, Any] = {
        'format': kind, 'frame_rate_hz': suite.frame_rate_hz,
        'baseline_m': round(suite.baseline_m, 9),
        'left': camera(suite.T_imu_left), 'right': camera(suite.T_imu_right),
        **{camera.word: hazard(camera) for camera in further},
        **({} if T_base_lidar is None else {'lidar': {
            'T_imu_lidar': _rows(inverse(suite.T_base_imu) @ T_base_lidar)}}),
        'T_base_imu': _rows(suite.T_base_imu),
        'imu': {'rate_hz': suite.imu_rate_hz,
                'accel_noise_density': noise.accel_noise_density,
                'accel_bias_random_walk': noise.accel_bias_random_walk,
                'gyro_noise_density': noise.gyro_noise_density,
                'gyro_bias_random_walk': noise.gyro_bias_random_walk},
        **{name: dict(units) for name, units in depth.items()}}
    return '# T_a_b maps points of b to a; rows of 4. Units: m, s, rad, px.\n' + yaml_of(
        document, default_flow_style=None, width=99)


def _rows(T: Array) -> list[list[float]]:
    return [[float(v) + 0.0 for v in row] for row in np.round(T, 12)]
