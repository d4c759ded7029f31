"""The parameters of each node: those that all nodes share, and those of its core classes."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.autonomy.navigation.config import (MapConfig, NavigatorConfig, POSES,
                                                        TraversabilityConfig, TRUTH)
from lunar_rover_sim.autonomy.path_following.config import DriveConfig
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.gravity import MOON_MPS2
from lunar_rover_sim.base.parameters import group, Named, named, param, Parameters
from lunar_rover_sim.base.seconds import is_divisor, NS_PER_S
from lunar_rover_sim.image.camera.cameras import (CameraEntry, chase_camera, hazard_camera,
                                                  stereo_pair)
from lunar_rover_sim.image.camera.chase import ChaseConfig
from lunar_rover_sim.image.camera.config import (CameraConfig, CompressionConfig,
                                                 FurtherCameraConfig)
from lunar_rover_sim.image.camera.hazard import HazardConfig
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.lidar.optics import LidarConfig
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.stereo.config import SgmConfig
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.physics.config import PhysicsConfig
from lunar_rover_sim.run.shared_config import MAX_DURATION_S, NodeConfig, WaitConfig
from lunar_rover_sim.sensors.imu import ImuConfig
from lunar_rover_sim.sensors.registry import SENSORS, SensorsConfig

ALL = 'all'
US_PER_S = 1_000_000


class PacedConfig(Parameters):
    """Parameters of a node with a rate, at whose whole periods stamps are due."""

    def validate(self) -> None:
        """Raise ConfigError for a rate whose period is no whole number of microseconds."""
        super().validate()
        for name in ('rate_hz', 'frame_rate_hz'):
            rate_hz = getattr(self, name, 1)
            if not is_divisor(rate_hz, US_PER_S):
                raise ConfigError(f'{name}: {rate_hz:g} is not valid; valid is a divisor of '
                                  'physics_node.state_rate_hz, such as 5, 10, 20, 25 or 40')


@dataclasses.dataclass(frozen=True)
class RecorderConfig(Parameters):
    """Parameters of a recording."""

    output: str = param('', 'folder of the bag; it must not exist')
    topics: tuple[str, ...] = param((ALL,), 'all: every topic but those on request, which may be '
                                    'named beside it')
    exclude: tuple[str, ...] = param((), 'topics that all leaves out, too')
    storage: str = param('mcap', 'bags of SQLite are read only', choices=('mcap',))
    compression: str = param('zstd', 'without loss', choices=('none', 'zstd'))
    max_bag_size_mb: int = param(0, 'of a file of the bag, after which the next begins; 0: one '
                                 'file', unit='MB', low=0, high=1_000_000)


FRAME_TOPICS = tuple(t.name for t in topics.CONTRACT if t.node == 'render_node'
                     and t.rate in (topics.FRAME, topics.DEPTH_FRAME)
                     and t not in topics.OF_VISION)
LIDAR_TOPICS = tuple(t.name for t in topics.OF_LIDAR)


@dataclasses.dataclass(frozen=True)
class PhysicsNodeConfig(SensorsConfig, NodeConfig, PhysicsConfig):
    """Parameters of physics_node."""

    sun: SunConfig = group(SunConfig)
    wait: WaitConfig = group(WaitConfig)
    state_rate_hz: int = param(200, 'its period is a whole number of steps',
                               unit='Hz', low=1, high=1000)
    ground_rate_hz: float = param(10.0, 'rate of ground/changes where ground.model is regolith; a '
                                  'run sets that of the frames', unit='Hz', low=0.1, high=200.0)
    real_time_factor: float = param(1.0, 'simulated per wall time, in time_mode real_time',
                                    low=0.01, high=100.0)
    duration_s: float = param(0.0, 'simulated time after which the node ends; 0 for never',
                              unit='s', low=0.0, high=MAX_DURATION_S)
    end_when_navigated: bool = param(False, 'end at the stamp of navigator/finished, where that '
                                     'is before duration_s', by_run=True)
    checkpoint_period_s: float = param(
        0.0, 'in lockstep, for `run --resume`; each begins a file of the bag; 0: none',
        unit='s', low=0.0, high=1e6)
    checkpoint_nodes: tuple[str, ...] = param((), 'nodes that write their states at checkpoints',
                                              by_run=True)
    start_paused: bool = param(False, 'wait for ~/pause or ~/step before time starts')
    publish_tf: bool = param(True, 'odom to base_link and base_footprint; false where an '
                             'estimator does; legs and sensors are on tf in any case')
    publish_clock: bool = param(True, 'false for all but one of several rovers in one graph')

    @property
    def base_frame(self) -> str:
        """The frame of the true pose."""
        return frames.TRUE_BASE_FRAME if self.separate_truth else frames.BASE_FRAME

    @property
    def pose_frames(self) -> tuple[str, str] | None:
        """Parent and child of the true pose on tf; None where it is not published."""
        return (self.truth.frame_id, self.base_frame) if self.publish_tf else None

    @property
    def step_ns(self) -> int:
        """The physics step [ns]."""
        return round(self.step_s * 1e9)

    @property
    def state_period_ns(self) -> int:
        """The period of state messages [ns]."""
        return NS_PER_S // self.state_rate_hz

    @property
    def ground_period_ns(self) -> int:
        """The period of ground/changes [ns]."""
        return round(NS_PER_S / self.ground_rate_hz)

    def validate(self) -> None:
        """Raise ConfigError unless state messages fall on steps, and what is slower on states."""
        super().validate()
        if NS_PER_S % self.state_rate_hz or self.state_period_ns % self.step_ns:
            raise ConfigError(f'state_rate_hz: {self.state_rate_hz} is not valid; valid is a rate '
                              f'whose period is a multiple of step_s = {self.step_s:g} s')
        if self.ground.deforms and not is_divisor(self.ground_rate_hz, self.state_rate_hz):
            raise ConfigError(f'ground_rate_hz: {self.ground_rate_hz:g} is not valid; valid is a '
                              f'divisor of state_rate_hz = {self.state_rate_hz}')
        for sensor in SENSORS:
            config = getattr(self, sensor.name, None)
            rate_hz = getattr(config, 'rate_hz', self.state_rate_hz)
            if not is_divisor(rate_hz, self.state_rate_hz):
                raise ConfigError(f'{sensor.name}.rate_hz: {rate_hz} is not valid; valid is a '
                                  f'divisor of state_rate_hz = {self.state_rate_hz}')


@dataclasses.dataclass(frozen=True)
class GaitNodeConfig(NodeConfig, GaitConfig):
    """Parameters of gait_controller_node."""

    wait: WaitConfig = group(WaitConfig)


@dataclasses.dataclass(frozen=True)
class PolicyNodeConfig(NodeConfig):
    """Parameters of policy_node."""

    policy: str = param('', 'ONNX file of a policy, or the name of a packaged one')
    ground: str = param('', 'rigid or a soil; the node says whether the policy knows it; empty: '
                        'in a run its ground')
    observation_timeout_s: float = param(
        0.5, 'wall time without an observation after which the legs stop, in time_mode real_time',
        unit='s', low=0.05, high=10.0)
    wait: WaitConfig = group(WaitConfig)


_END_AFTER = 'time from {} to the end of the run; negative: it lasts its whole duration'


@dataclasses.dataclass(frozen=True)
class EndOfRunConfig(Parameters):
    """When a run ends that has got where it was to go."""

    end_after_s: float = param(1.0, _END_AFTER.format('arrival, or giving up,'), unit='s',
                               low=-1.0, high=3600.0)
    end_step_s: float = param(1.0, 'that end is a multiple of this; a run sets it', unit='s',
                              low=0.001, high=1000.0)

    def end_ns(self, now_ns: int) -> int:
        """Return the stamp at which the run ends that is done now [ns]; negative: it does not."""
        if self.end_after_s < 0.0:
            return -1
        step_ns = round(self.end_step_s * 1e9)
        return -(-(now_ns + round(self.end_after_s * 1e9)) // step_ns) * step_ns


@dataclasses.dataclass(frozen=True)
class DriveNodeConfig(EndOfRunConfig, PacedConfig, NodeConfig, DriveConfig):
    """Parameters of drive_node."""

    end_after_s: float = param(-1.0, _END_AFTER.format('the end of the drive, or a stop,'),
                               unit='s', low=-1.0, high=3600.0)
    rate_hz: int = param(20, 'rate of cmd_vel', unit='Hz', low=1, high=200)
    enable_stamped_cmd_vel: bool = param(
        True, 'cmd_vel is TwistStamped, else Twist, for which time cannot wait')


@dataclasses.dataclass(frozen=True)
class RawTopicConfig(Parameters):
    """Parameters of the transports of an image topic."""

    compressed: CompressionConfig = group(CompressionConfig)


@dataclasses.dataclass(frozen=True)
class CameraTopicsConfig(Parameters):
    """The image topic of one camera."""

    image_raw: RawTopicConfig = group(RawTopicConfig)


@dataclasses.dataclass(frozen=True)
class PointsConfig(Parameters):
    """The point cloud."""

    step_px: int = param(1, 'points of every n-th row and column, 16 bytes each',
                         unit='px', low=1, high=64, live=True)


@dataclasses.dataclass(frozen=True)
class StereoTopicsConfig(Parameters):
    """Topics below `stereo/`; image_transport derives names of parameters from those of topics."""

    left: CameraTopicsConfig = group(CameraTopicsConfig)
    right: CameraTopicsConfig = group(CameraTopicsConfig)
    points2: PointsConfig = group(PointsConfig)


@dataclasses.dataclass(frozen=True)
class RenderNodeConfig(PacedConfig, NodeConfig, RenderConfig):
    """Parameters of render_node."""

    sgm: SgmConfig = group(SgmConfig)
    stereo: StereoTopicsConfig = group(StereoTopicsConfig)
    chase: ChaseConfig = group(ChaseConfig)
    hazard: Named[HazardConfig] = named(HazardConfig)
    frame_rate_hz: float = param(20.0, 'a whole number of state periods; trackers lose a walking '
                                 'body at 10 Hz', unit='Hz', low=0.1,
                                 high=200.0, live=True)
    depth_every: int = param(2, 'disparity, depth, points and true depth are made of every n-th '
                             'frame',
                             unit='frames', low=1, high=200, live=True)
    await_readers: tuple[str, ...] = param((), 'topics that must have subscribers before the '
                                           'first frame is drawn in lockstep',
                                           choices=FRAME_TOPICS, by_run=True)
    await_ground: bool = param(False, 'in lockstep a frame is drawn when ground/changes of its '
                               'stamp has arrived', by_run=True)

    @property
    def frame_period_ns(self) -> int:
        """The period of stereo pairs [ns]."""
        return round(NS_PER_S / self.frame_rate_hz)

    @property
    def depth_period_ns(self) -> int:
        """The period of disparity, depth and true depth [ns]."""
        return self.depth_every * self.frame_period_ns

    @property
    def cameras(self) -> tuple[CameraEntry, ...]:
        """All cameras, the stereo pair first."""
        pair = FurtherCameraConfig(self.camera, self.lens, self.sensor)
        return (stereo_pair(pair, self.frame_rate_hz, self.depth_every),
                *(hazard_camera(name, config) for name, config in self.hazard.items()),
                *((chase_camera(self.chase),) if self.chase.enabled else ()))

    def validate(self) -> None:
        """Raise ConfigError unless images of all cameras fall on stereo pairs."""
        super().validate()
        for camera in self.cameras:
            if not is_divisor(camera.rate_hz, self.frame_rate_hz):
                raise ConfigError(f'{camera.name}.rate_hz: {camera.rate_hz} is not valid; valid '
                                  f'is a divisor of frame_rate_hz = {self.frame_rate_hz:g}')
        names = [frame for camera in self.cameras for _, frame, _ in camera.frames]
        twice = sorted({frame for frame in names if names.count(frame) > 1})
        if twice:
            raise ConfigError(f'hazard: {", ".join(self.hazard)} is not valid: two cameras have '
                              f'the frame {twice[0]}; valid are names that differ')


@dataclasses.dataclass(frozen=True)
class LidarNodeConfig(PacedConfig, NodeConfig, LidarConfig):
    """Parameters of lidar_node."""

    await_readers: tuple[str, ...] = param((), 'topics that must have subscribers before the '
                                           'first scan in lockstep', choices=LIDAR_TOPICS,
                                           by_run=True)
    await_ground: bool = param(False, 'in lockstep a scan is made when ground/changes up to its '
                               'start have arrived', by_run=True)


@dataclasses.dataclass(frozen=True)
class RecorderNodeConfig(NodeConfig, RecorderConfig):
    """Parameters of recorder_node."""

    scenario_file: str = param('', 'file of the resolved scenario, which the bag stores',
                               by_run=True)
    acknowledge: tuple[str, ...] = param((), 'topics whose newest written stamps make '
                                         'recorder/written', by_run=True)
    acknowledge_periods_s: tuple[float, ...] = param(
        (), 'period of each of these topics, which is complete until its next message is due; 0 '
        'where it has none; empty: 0 for all', unit='s', low=0.0, by_run=True)

    def validate(self) -> None:
        """Raise ConfigError unless each acknowledged topic has one period, or none has."""
        super().validate()
        if len(self.acknowledge_periods_s) not in (0, len(self.acknowledge)):
            raise ConfigError(f'acknowledge_periods_s: {len(self.acknowledge_periods_s)} elements '
                              f'given for {len(self.acknowledge)} topics; valid is one period per '
                              'topic')

    def period_ns_by_topic(self) -> dict[str, int]:
        """Return acknowledged topic → period [ns], 0 where it is not known."""
        periods_s = self.acknowledge_periods_s or (0.0,) * len(self.acknowledge)
        return {t: round(s * 1e9) for t, s in zip(self.acknowledge, periods_s)}


@dataclasses.dataclass(frozen=True)
class SlamNodeConfig(NodeConfig):
    """Parameters of slam_node."""

    system: str = param('command', 'command: the program of `command`; graph: the odometry with a '
                        'memory',
                        choices=('command', 'graph'))
    command: str = param('', 'program of docs/reference/slam_protocol.md, and its arguments; '
                         '{settings} is a settings file of ORB-SLAM3, {wheel} the packaged '
                         'program for a Python with its wheel')
    sensor: str = param('stereo', 'what the program gets',
                        choices=('mono', 'stereo', 'stereo-inertial'))
    maps: str = param('', 'with system graph: folder of `world export --orbital`, on which it '
                      'finds its place')
    near_x_m: float = param(0.0, 'with maps: the start is near to this place', unit='m',
                            low=-1e5, high=1e5)
    near_y_m: float = param(0.0, 'with maps: the start is near to this place',
                            unit='m', low=-1e5, high=1e5)
    doubt_m: float = param(50.0, 'with maps: radius around it', unit='m', low=1.0, high=500.0)
    frame_id: str = param('slam_map', 'of the poses')
    publish_tf: bool = param(False, 'publish the pose on tf, too')
    child_frame_id: str = param('slam_camera', "on tf; not one of the rover's, which have a "
                                "parent")
    ready_s: float = param(50.0, 'wall time after which a program that is not ready is an error',
                           unit='s', low=0.1, high=3600.0)
    answer_s: float = param(5.0, 'wall time after which a frame without an answer is an error',
                            unit='s', low=0.1, high=3600.0)
    camera: CameraConfig = group(CameraConfig)
    imu: ImuConfig = group(ImuConfig)
    frame_rate_hz: float = param(20.0, 'of the images; a run sets it, and camera, imu and '
                                 'imu_rate_hz', unit='Hz', low=0.1, high=200.0)
    imu_rate_hz: int = param(200, 'of the IMU', unit='Hz', low=1, high=1000)
    gravity_mps2: float = param(MOON_MPS2, 'that the IMU feels; a run sets it', unit='m/s^2',
                                low=0.0, high=30.0)

    def validate(self) -> None:
        """Raise ConfigError where parameters do not go together."""
        super().validate()
        if self.is_graph and self.sensor != 'stereo':
            raise ConfigError(f'sensor: {self.sensor!r} is not valid with system graph; valid is '
                              'stereo')
        if self.is_graph and self.command:
            raise ConfigError(f'command: {self.command!r} is not valid with system graph, which '
                              "starts no program; valid is ''")
        if self.maps and not self.is_graph:
            raise ConfigError(f'maps: {self.maps!r} is not valid with system command; valid is '
                              "'', or system graph")

    @property
    def is_graph(self) -> bool:
        """Whether it is the graph, and no program."""
        return self.system == 'graph'

    @property
    def is_stereo(self) -> bool:
        """Whether the program gets both images."""
        return self.sensor.startswith('stereo')

    @property
    def has_imu(self) -> bool:
        """Whether the program gets the IMU."""
        return self.sensor.endswith('inertial')


STEREO, TRUE_DEPTH, LIDAR = 'stereo', 'true_depth', 'lidar'
DEPTH_TOPICS = {STEREO: topics.DEPTH, TRUE_DEPTH: topics.TRUE_DEPTH, LIDAR: topics.LIDAR_DESKEWED}
_POSE = ('truth: odom; wheels: wheel/odometry, with the angles of imu/data_raw; slam: '
         'slam/pose from the true start, in odom as is')


@dataclasses.dataclass(frozen=True)
class MappingNodeConfig(NodeConfig):
    """Parameters of mapping_node."""

    pose: str = param(TRUTH, _POSE, choices=POSES)
    depth: str = param(STEREO, 'stereo/depth/image, ground_truth/depth/image or '
                       'lidar/points_deskewed', choices=(STEREO, TRUE_DEPTH, LIDAR))
    elevation_period_s: float = param(1.0, 'of map/elevation: the first map in each is sent',
                                      unit='s', low=0.05, high=3600.0)
    map: MapConfig = group(MapConfig)
    limits: TraversabilityConfig = group(TraversabilityConfig)
    camera: CameraConfig = group(CameraConfig)


@dataclasses.dataclass(frozen=True)
class NavigatorNodeConfig(EndOfRunConfig, PacedConfig, NodeConfig, NavigatorConfig):
    """Parameters of navigator_node."""

    pose: str = param(TRUTH, _POSE, choices=POSES)
    rate_hz: int = param(20, 'rate of cmd_vel', unit='Hz', low=1, high=200)
    map_lag_s: float = param(0.25, 'in lockstep, age of the map and, with slam, of the pose that '
                             'a command is made from',
                             unit='s', low=0.05, high=5.0)
    map_period_s: float = param(0.1, 'period of map/traversability, that of the depth', unit='s',
                                low=0.005, high=10.0, by_run=True)
    maps: str = param('', 'folder of `world export --orbital` by which far goals are planned to; '
                      'empty: made of the world')
    radius_m: float = param(0.0, 'of the circle around the rover and its spokes; 0: by its '
                            'description', unit='m', low=0.0, high=10.0)
    sun: SunConfig = group(SunConfig)
    enable_stamped_cmd_vel: bool = param(True, 'cmd_vel is TwistStamped, else Twist, for which '
                                         'time cannot wait')

    def validate(self) -> None:
        """Raise ConfigError also where maps would always be too old to drive by."""
        super().validate()
        if self.map_age_s < self.map_lag_s + self.map_period_s:
            raise ConfigError(f'map_age_s: {self.map_age_s:g} is not valid; valid is >= '
                              f'{self.map_lag_s + self.map_period_s:g} [s], map_lag_s and a period'
                              ' of the depth')


VIEW_PORT = 8765


@dataclasses.dataclass(frozen=True)
class TrajectoryRecorderNodeConfig(NodeConfig):
    """Parameters of trajectory_recorder_node."""

    output: str = param('', 'TUM file to write; it must not exist')
    type: str = param('', 'message type of the topic `pose`; empty: that of its publisher',
                      choices=('', 'geometry_msgs/msg/PoseStamped',
                               'geometry_msgs/msg/PoseWithCovarianceStamped',
                               'nav_msgs/msg/Odometry', 'nav_msgs/msg/Path'))


@dataclasses.dataclass(frozen=True)
class ViewNodeConfig(NodeConfig):
    """Parameters of view_node."""

    port: int = param(VIEW_PORT, 'port of page and websocket, on this machine only', low=1024,
                      high=65535)
    allow_origin: tuple[str, ...] = param(
        (), 'origins of other pages, such as https://app.foxglove.dev, that may see and drive '
        'the rover, with the token')


NODE_CONFIGS: dict[str, type[NodeConfig]] = {
    'physics_node': PhysicsNodeConfig,
    'gait_controller_node': GaitNodeConfig,
    'drive_node': DriveNodeConfig,
    'render_node': RenderNodeConfig,
    'recorder_node': RecorderNodeConfig,
    'slam_node': SlamNodeConfig,
    'lidar_node': LidarNodeConfig,
    'policy_node': PolicyNodeConfig,
    'mapping_node': MappingNodeConfig,
    'navigator_node': NavigatorNodeConfig,
}
# One of these drives the legs.
LEG_CONTROLLERS = 'gait_controller_node', 'policy_node'
# Nodes of a run by default; slam_node needs a program, lidar_node is an extra sensor, policy_node
# takes the place of gait_controller_node, and the navigator that of drive_node.
DEFAULT_NODES = ('physics_node', 'gait_controller_node', 'drive_node', 'render_node',
                 'recorder_node')
# These run beside a graph, and in no scenario.
COMPANION_CONFIGS: dict[str, type[NodeConfig]] = {
    'trajectory_recorder_node': TrajectoryRecorderNodeConfig,
    'view_node': ViewNodeConfig,
}

# Parameter → the one of another node that it takes over.
FOLLOWS = {
    'physics_node.ground_rate_hz': 'render_node.frame_rate_hz',
    'physics_node.sun': 'render_node.sun',
    'navigator_node.sun': 'render_node.sun',
    'lidar_node.reflectance': 'render_node.reflectance',
    'mapping_node.camera': 'render_node.camera',
    'slam_node.camera': 'render_node.camera',
    'slam_node.frame_rate_hz': 'render_node.frame_rate_hz',
    'slam_node.imu': 'physics_node.imu',
    'slam_node.imu_rate_hz': 'physics_node.state_rate_hz',
    'slam_node.gravity_mps2': 'physics_node.gravity_mps2'}
