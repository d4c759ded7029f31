"""EuRoC sequences: mav0/cam0, cam1, imu0, state_groundtruth_estimate0, and times.txt.

The body frame is that of the IMU, as in the EuRoC data sets (Burri et al., IJRR 35 (10), 2016);
`T_BS` maps points of a sensor to the body. Hazard cameras are cam2, cam3 and so on; a fisheye has
the distortion model `equidistant`, as Kalibr names it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.messages import accel_row, imu_row, pose_matrix, xyz
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import Array, inverse, wxyz_from_matrix
from lunar_rover_sim.base.seconds import sortable_ns
from lunar_rover_sim.products.sequences.sensors import RecordedCamera
from lunar_rover_sim.products.sequences.sequence import numbers, PngWriter, Sequence

_CAMERAS = {topics.LEFT_IMAGE.name: 'cam0', topics.RIGHT_IMAGE.name: 'cam1'}
TIMES_FILE, TIMES_IMU_FILE = 'times.txt', 'times_imu.txt'
_IMU = 'mav0/imu0/data.csv'
_TRUTH = 'mav0/state_groundtruth_estimate0/data.csv'
_IMU_TITLE = ('#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],'
              'a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]')
_TRUTH_TITLE = ('#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],'
                'q_RS_y [],q_RS_z [],v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],'
                'b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],b_w_RS_S_z [rad s^-1],'
                'b_a_RS_S_x [m s^-2],b_a_RS_S_y [m s^-2],b_a_RS_S_z [m s^-2]')


class EurocSequence(Sequence):
    """Writes an EuRoC sequence; without a right camera or an IMU, their folders are missing."""

    needs = (topics.LEFT_IMAGE.name, topics.LEFT_INFO.name)
    uses = (topics.RIGHT_IMAGE.name, topics.IMU_RAW.name, topics.IMU_BIAS.name, topics.ODOM.name)
    of_further = (topics.HAZARD_IMAGE,)
    further_needs = 'they need their camera_info in the bag'
    poses_of = ('mav0/state_groundtruth_estimate0/data.csv: true poses of the IMU (imu_link), the '
                'body frame of EuRoC, in odom; not of a camera: T_BS in mav0/cam0/sensor.yaml '
                'is the pose of the left camera in the IMU')
    layout = 'EuRoC/ASL: mav0/cam0, cam1, imu0, ground truth of the IMU; sensor.yaml each'
    is_dated = True

    def __init__(self, bag: Bag, folder: Path, png: PngWriter) -> None:
        super().__init__(bag, folder, png)
        self._bias: dict[int, Array] = {}
        self._odometry: dict[int, Any] = {}
        self._has_bias = bag.has(topics.IMU_BIAS.name)
        self._imu_ns: list[int] = []        # first and last stamp
        self._pairs_ns: list[int] = []
        for name, camera in _CAMERAS.items():
            if bag.has(name):
                mount = self.suite.T_imu_left if camera == 'cam0' else self.suite.T_imu_right
                self._begin(camera, self._camera_lines(mount))
        self._further = {hazard.name: f'cam{k}' for k, hazard in enumerate(self.further, 2)}
        for hazard in self.further:
            self._begin(self._further[hazard.name], self._further_lines(hazard))
        if bag.has(topics.IMU_RAW.name):
            self.line(_IMU, _IMU_TITLE)
            self._sensor('imu0', self._imu_lines())
        if bag.has(bag.truth):
            self.line(_TRUTH, _TRUTH_TITLE)
            self._sensor('state_groundtruth_estimate0',
                         ['sensor_type: visual-inertial', 'comment: true pose of the IMU',
                          *_transform(np.eye(4))])

    def images(self, stamp_ns: int, pixels: dict[str, NDArray[Any]]) -> None:
        """Write the pair and its line in times.txt."""
        for name, camera in _CAMERAS.items():
            if name in pixels:
                self._image(camera, stamp_ns, pixels[name])
        self.line(TIMES_FILE, self._stamp(stamp_ns))
        self._pairs_ns.append(stamp_ns)

    def further_images(self, camera: RecordedCamera, stamp_ns: int,
                       pixels: dict[str, NDArray[Any]]) -> None:
        """Write an image of a hazard camera, whose stamps are its own."""
        self._image(self._further[camera.name], stamp_ns,
                    pixels[camera.topics[topics.HAZARD_IMAGE]])

    def data(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Write IMU samples as they come, truth once its bias is there."""
        if topic == topics.IMU_RAW.name:
            self._imu_ns = [*self._imu_ns[:1], stamp_ns]
            self.line(_IMU, f'{self._stamp(stamp_ns)},' + numbers(imu_row(message), separator=','))
        elif topic == topics.ODOM.name:
            self._odometry[stamp_ns] = message
            if not self._has_bias:
                self._truth(stamp_ns, np.zeros(6))
        else:
            self._bias[stamp_ns] = np.array(accel_row(message))
        if stamp_ns in self._odometry and stamp_ns in self._bias:
            self._truth(stamp_ns, self._bias.pop(stamp_ns))
        for waiting in (self._odometry, self._bias):
            if len(waiting) > 1000:  # the counterpart was lost
                del waiting[min(waiting)]

    def notes(self) -> list[str]:
        """Write times_imu.txt; return what of the format is missing."""
        notes = []
        if self._imu_ns:
            between = [ns for ns in self._pairs_ns if self._imu_ns[0] <= ns < self._imu_ns[-1]]
            for ns in between:
                self.line(TIMES_IMU_FILE, self._stamp(ns))
            if len(between) < len(self._pairs_ns):
                notes.append(f'{TIMES_IMU_FILE}: {len(between)} of {len(self._pairs_ns)} image '
                             'sets, those with an IMU sample before and after them')
        else:
            notes.append('no IMU in the bag: imu0 is missing')
        if not (self.folder / _TRUTH).exists():
            notes.append('no odometry in the bag: the ground truth is missing')
        if self._further:
            notes.append('hazard cameras: ' + ', '.join(
                f'{folder} is {name}' for name, folder in self._further.items()))
        return notes

    def _begin(self, camera: str, lines: list[str]) -> None:
        (self.folder / 'mav0' / camera / 'data').mkdir(parents=True)
        self.line(f'mav0/{camera}/data.csv', '#timestamp [ns],filename')
        self._sensor(camera, lines)

    def _image(self, camera: str, stamp_ns: int, pixels: NDArray[Any]) -> None:
        stamp = self._stamp(stamp_ns)
        self.png.write(self.folder / 'mav0' / camera / 'data' / f'{stamp}.png', pixels)
        self.line(f'mav0/{camera}/data.csv', f'{stamp},{stamp}.png')

    def _stamp(self, stamp_ns: int) -> str:
        return sortable_ns(stamp_ns + self.epoch_ns)

    def _truth(self, stamp_ns: int, bias: Array) -> None:
        message = self._odometry.pop(stamp_ns)
        T_odom_base = pose_matrix(message)
        T = T_odom_base @ self.suite.T_base_imu
        twist = message.twist.twist
        lever = self.suite.T_base_imu[:3, 3]
        velocity = T_odom_base[:3, :3] @ (xyz(twist.linear) + np.cross(xyz(twist.angular), lever))
        self.line(_TRUTH, f'{self._stamp(stamp_ns)},' + numbers(
            T[:3, 3], wxyz_from_matrix(T[:3, :3]), velocity, bias, separator=','))

    def _sensor(self, folder: str, lines: list[str]) -> None:
        for line in lines:
            self.line(f'mav0/{folder}/sensor.yaml', line)

    def _camera_lines(self, T_imu_camera: Array) -> list[str]:
        suite = self.suite
        k1, k2, p1, p2 = suite.distortion[:4]
        return [*_camera('simulated', T_imu_camera, (suite.width, suite.height),
                         (suite.focal_px, suite.centre_px), 'radial-tangential',
                         [k1, k2, p1, p2]), f'rate_hz: {suite.frame_rate_hz:g}']

    def _further_lines(self, camera: RecordedCamera) -> list[str]:
        c = camera.calibration
        model = 'equidistant' if camera.is_fisheye else 'radial-tangential'
        return _camera(f'simulated hazard camera {camera.name}',
                       inverse(self.suite.T_base_imu) @ camera.T_base_camera,
                       (c.width, c.height), (c.fx_fy_cx_cy_px,), model, c.D[:4])

    def _imu_lines(self) -> list[str]:
        noise = self.suite.noise
        return ['sensor_type: imu', 'comment: simulated', *_transform(np.eye(4)),
                f'rate_hz: {self.suite.imu_rate_hz:g}',
                f'gyroscope_noise_density: {noise.gyro_noise_density!r}',
                f'gyroscope_random_walk: {noise.gyro_bias_random_walk!r}',
                f'accelerometer_noise_density: {noise.accel_noise_density!r}',
                f'accelerometer_random_walk: {noise.accel_bias_random_walk!r}']


def _camera(comment: str, T_imu_camera: Array, size: tuple[int, int], intrinsics: tuple[Any, ...],
            model: str, distortion: Array | list[float]) -> list[str]:
    """Return the lines of a camera; intrinsics: fx, fy, cx, cy, in any parts."""
    return ['sensor_type: camera', f'comment: {comment}', *_transform(T_imu_camera),
            f'resolution: [{size[0]}, {size[1]}]', 'camera_model: pinhole',
            f'intrinsics: [{numbers(*intrinsics, separator=", ")}]', f'distortion_model: {model}',
            f'distortion_coefficients: [{numbers(distortion, separator=", ")}]']


def _transform(T: Array) -> list[str]:
    return ['T_BS:', '  cols: 4', '  rows: 4', f'  data: [{numbers(T, separator=", ")}]']
