"""The sensors as a SLAM program needs them: calibration, mounts, noise, rates.

calibration.yaml of an exported sequence holds of them what the formats themselves do not.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import dataclasses
from typing import Any

import numpy as np

from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.series import CameraCalibration, hazard_topics, read_calibration
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, ConfigError
from lunar_rover_sim.base.files.yaml_text import yaml_of
from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.base.parameters import Parameters
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.camera.hazard import HazardConfig, HazardRig
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import imu_pose
from lunar_rover_sim.rover.physics.config import PhysicsConfig
from lunar_rover_sim.run.recorded_run import RecordedRun
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoiseParameters, noise_parameters

FISHEYE = 'equidistant'     # distortion_model of CameraInfo


@dataclasses.dataclass(frozen=True)
class RecordedCamera:
    """A hazard camera whose images and CameraInfo are in a bag.

    Attributes:
        name: As below `hazard/`, of one of a pair with /left or /right.
        topics: The contract's topics of hazard cameras → their names in the bag.
        calibration: Its CameraInfo.
        T_base_camera: (4, 4) optical frame in base_link.
    """

    name: str
    topics: Mapping[topics.Topic, str]
    calibration: CameraCalibration
    T_base_camera: Array

    @property
    def word(self) -> str:
        """The name as a part of file names."""
        return 'hazard_' + self.name.replace('/', '_')

    @property
    def is_fisheye(self) -> bool:
        """Whether it is a fisheye."""
        return self.calibration.distortion_model == FISHEYE

    @property
    def fits_truth(self) -> bool:
        """Whether its images have the geometry of its labels: no distorted pinhole."""
        return self.is_fisheye or not self.calibration.D.any()


def further_cameras(bag: Bag) -> list[RecordedCamera]:
    """Return the hazard cameras of a bag, in the order of their names.

    One without CameraInfo is left out.

    Raises:
        BagError: Where the bag does not say where a camera is on the rover.
    """
    return [RecordedCamera(name, names, read_calibration(bag, names[topics.HAZARD_INFO]),
                           _place(bag, name))
            for name, names in hazard_topics(bag).items()
            if {topics.HAZARD_IMAGE, topics.HAZARD_INFO} <= set(names)]


def _place(bag: Bag, name: str) -> Array:
    """Return T_base_camera (4, 4): from tf_static, else from the recorded scenario."""
    run = RecordedRun(bag)
    T = run.frame_from_tf(topics.hazard_frame(name))
    if T is not None:
        return T
    camera, _, side = name.partition('/')
    sets = run.scenario.get('render_node', 'hazard')
    if not isinstance(sets, Mapping) or camera not in sets:
        raise BagError(f'{bag.path}: neither tf_static nor the scenario says where the hazard '
                       f'camera {camera} is on the rover')
    try:
        rig = HazardRig(HazardConfig.from_mapping(sets[camera], f'render_node.hazard.{camera}'))
    except ConfigError as error:
        raise BagError(f'{bag.path}: its scenario is not of this version: {error}') from None
    return rig.T_base_right if side == 'right' else rig.T_base_left


@dataclasses.dataclass(frozen=True)
class SensorSuite:
    """Two equal cameras and an IMU.

    Attributes:
        width, height: Of the images [px].
        focal_px, centre_px: fx, fy and cx, cy [px].
        distortion: k1, k2, p1, p2, k3 of the raw images (Brown-Conrady).
        T_imu_left, T_imu_right: (4, 4) optical frames in the IMU's frame.
        T_base_imu: (4, 4).
        frame_rate_hz, imu_rate_hz: 0 where there are no messages to measure them.
        noise: In continuous-time units.
        gravity_mps2: That the IMU feels.
    """

    width: int
    height: int
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, ...]
    T_imu_left: Array
    T_imu_right: Array
    T_base_imu: Array
    frame_rate_hz: float
    imu_rate_hz: float
    noise: ImuNoiseParameters
    gravity_mps2: float

    @property
    def K(self) -> Array:
        """(3, 3) camera matrix."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def P(self, baseline_m: float) -> Array:
        """Return the (3, 4) projection of a camera that lies a baseline to the right [m]."""
        return np.column_stack([self.K, (-self.focal_px[0] * baseline_m, 0.0, 0.0)])

    @property
    def mounts(self) -> dict[str, Array]:
        """left and right: (4, 4) optical frames in base_link."""
        return {'left': self.T_base_imu @ self.T_imu_left,
                'right': self.T_base_imu @ self.T_imu_right}

    @property
    def baseline_m(self) -> float:
        """Distance between the optical centres [m]."""
        return float(np.linalg.norm(self.T_imu_left[:3, 3] - self.T_imu_right[:3, 3]))

    @property
    def T_left_right(self) -> Array:
        """(4, 4) pose of the right camera in the left one: a shift of the baseline along x."""
        return inverse(self.T_imu_left) @ self.T_imu_right


def described_sensors(rover: RoverDescription, camera: CameraConfig, imu: ImuConfig,
                      frame_rate_hz: float, imu_rate_hz: float,
                      gravity_mps2: float) -> SensorSuite:
    """Return the sensors of a description."""
    rig = StereoRig(rover, camera)
    T_base_imu = imu_pose(rover)
    return SensorSuite(
        rig.width, rig.height, (rig.focal_px, rig.focal_px),
        (float(rig.K[0, 2]), float(rig.K[1, 2])), tuple(camera.distortion),
        inverse(T_base_imu) @ rig.T_base_left, inverse(T_base_imu) @ rig.T_base_right, T_base_imu,
        frame_rate_hz, imu_rate_hz, noise_parameters(imu), gravity_mps2)


def recorded_sensors(bag: Bag, images: Iterable[str] = ()) -> SensorSuite:
    """Return the sensors of a bag: its camera_infos, mounts, rates, and its scenario's noise.

    Without a scenario noise and gravity are the defaults.

    Args:
        images: Topics that are used together; the frame rate is that of the slowest one.

    Raises:
        BagError: Where the bag has no left camera_info.
    """
    left = read_calibration(bag, topics.LEFT_INFO.name)
    run = RecordedRun(bag)
    T_base_imu = run.frame('imu')
    scenario = run.scenario
    try:
        values = scenario.get('physics_node', 'imu', {})
        imu = ImuConfig.from_mapping(_known(ImuConfig, values))
        gravity_mps2 = scenario.number('physics_node', 'gravity_mps2',
                                       PhysicsConfig().gravity_mps2)
    except ConfigError as error:
        raise BagError(f'{bag.path}: the IMU of its scenario is not of this version: '
                       f'{error}') from None
    distortion = np.zeros(5)
    distortion[:min(5, len(left.D))] = left.D[:5]
    return SensorSuite(
        left.width, left.height, (float(left.K[0, 0]), float(left.K[1, 1])),
        (float(left.K[0, 2]), float(left.K[1, 2])), tuple(float(v) for v in distortion),
        inverse(T_base_imu) @ run.frame('left'),
        inverse(T_base_imu) @ run.frame('right'), T_base_imu,
        min(filter(None, (_rate_hz(bag, name) for name in (topics.LEFT_INFO.name, *images))),
            default=0.0),
        _rate_hz(bag, topics.IMU_RAW.name),
        noise_parameters(imu), gravity_mps2)


def _known(kind: type[Parameters], values: object) -> dict[str, object]:
    names = {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    return {k: v for k, v in values.items() if k in names} if isinstance(values, dict) else {}


def _rate_hz(bag: Bag, topic: str) -> float:
    """Return the median rate of a topic, to 1 mHz; 0 where there are fewer than two messages."""
    if not bag.has(topic):
        return 0.0
    stamps = []
    for message in bag.raw([topic]):
        stamps.append(message.time_ns)
        if len(stamps) == 100:
            break
    return round(1e9 / float(np.median(np.diff(stamps))), 3) if len(stamps) > 1 else 0.0


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
