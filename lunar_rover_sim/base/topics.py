"""The topic contract: name, type, rate class and frame of everything the graph publishes.

Nodes, recorder, bag check and documentation all read this one table. Names are relative, so that
namespaces and remappings apply.
"""

from __future__ import annotations

from collections.abc import Iterable
import dataclasses
import re

from lunar_rover_sim.base import frames
from lunar_rover_sim.base.parameters import NAME

LEG = 'LEG'          # stands for the name of a leg in the topics that each leg has

STATE = 'state'      # every publishing period of physics, 200 Hz by default
FRAME = 'frame'      # every camera frame, 20 Hz by default
DEPTH_FRAME = 'depth frame'     # every n-th of them, 10 Hz by default
SCAN = 'scan'        # every period of the LiDAR, 10 Hz by default
LATCHED = 'latched'  # once, and to every late joiner
EVENT = 'event'      # irregular


@dataclasses.dataclass(frozen=True)
class Topic:
    """One line of the contract.

    Attributes:
        type: As ROS 2 writes it, `package/msg/Name`.
        rate: STATE, FRAME, DEPTH_FRAME, SCAN, LATCHED or EVENT.
        frame_id: That of the header; empty where the type has none.
        in_all: Whether a recorder of `all` takes it; the others are named beside `all`.
    """

    name: str
    type: str
    rate: str
    node: str
    frame_id: str = ''
    note: str = ''
    in_all: bool = True

    def frame(self, separate_truth: bool) -> str:
        """Return the frame of its header.

        True poses keep the world frame when `odom` belongs to an estimator.

        Args:
            separate_truth: Whether it does.
        """
        in_world = self.frame_id == frames.ODOM_FRAME and self.name != 'odom'
        return frames.TRUE_ODOM_FRAME if separate_truth and in_world else self.frame_id

    @property
    def graph_name(self) -> str:
        """The name as nodes use it: relative, but for what all nodes of a graph share."""
        return f'/{self.name}' if self.name in ('clock', 'diagnostics') else self.name


CLOCK = Topic('clock', 'rosgraph_msgs/msg/Clock', STATE, 'physics_node', '',
              '`/clock` in every namespace')
ODOM = Topic('odom', 'nav_msgs/msg/Odometry', STATE, 'physics_node', frames.ODOM_FRAME,
             'true pose; twist in base_link')
TRUE_ODOM = Topic('ground_truth/odom', 'nav_msgs/msg/Odometry', STATE, 'physics_node',
                  frames.TRUE_ODOM_FRAME, 'the same instead, where `separate_truth` is set')
JOINT_STATES = Topic('joint_states', 'sensor_msgs/msg/JointState', STATE, 'physics_node', '',
                     'leg angles [rad, unwrapped], velocities [rad/s], motor torques [N m]')
IMU_RAW = Topic('imu/data_raw', 'sensor_msgs/msg/Imu', STATE, 'physics_node', frames.IMU_FRAME,
                'noisy; no orientation (REP-145)')
IMU_TRUTH = Topic('ground_truth/imu', 'sensor_msgs/msg/Imu', STATE, 'physics_node',
                  frames.IMU_FRAME, 'without noise, with orientation')
IMU_BIAS = Topic('ground_truth/imu_bias', 'geometry_msgs/msg/AccelStamped', STATE, 'physics_node',
                 frames.IMU_FRAME, 'accelerometer [m/s^2], gyroscope [rad/s]')
CONTACT = Topic(f'contacts/{LEG}', 'geometry_msgs/msg/WrenchStamped', STATE, 'physics_node',
                frames.leg_frame(LEG), 'of each leg: ground reaction [N], torque about its axle '
                '[N m]')
GROUND_CHANGES = Topic('ground/changes', 'sensor_msgs/msg/PointCloud2', FRAME, 'physics_node',
                       frames.ODOM_FRAME, 'on regolith: samples that changed since the message '
                       'before')
GROUND_SNAPSHOT = Topic('ground/snapshot', 'sensor_msgs/msg/PointCloud2', LATCHED, 'physics_node',
                        frames.ODOM_FRAME, 'on regolith: all changed samples', in_all=False)
SINKAGE = Topic('ground_truth/sinkage', 'sensor_msgs/msg/JointState', STATE, 'physics_node',
                frames.BASE_FRAME, 'on regolith: depth of each leg in the ground', in_all=False)
FOOT_SLIP = Topic('ground_truth/slip', 'sensor_msgs/msg/JointState', STATE, 'physics_node',
                  frames.BASE_FRAME, 'slip and sweep of each foot along the heading',
                  in_all=False)
WHEEL_ODOM = Topic('wheel/odometry', 'nav_msgs/msg/Odometry', STATE, 'physics_node',
                   frames.WHEEL_ODOM_FRAME, 'from the encoders of the legs alone, with covariance',
                   in_all=False)
POWER = tuple(
    Topic(f'power/{line}', 'sensor_msgs/msg/BatteryState', STATE, 'physics_node', '',
          f'measured voltage and current of {of} [V, A]; negative where power is drawn',
          in_all=False)
    for line, of in ((LEG, 'the motor of each leg'), ('bus', 'all motors')))
SUN_SENSOR = Topic('sun_sensor/direction', 'geometry_msgs/msg/Vector3Stamped', EVENT,
                   'physics_node', frames.BASE_FRAME, 'measured unit vector to the sun, at '
                   'sun_sensor.rate_hz; silent in shadow', in_all=False)
STAR_TRACKER = Topic('star_tracker/attitude', 'sensor_msgs/msg/Imu', EVENT, 'physics_node',
                     frames.BASE_FRAME, 'measured orientation of base_link in the world, at '
                     'star_tracker.rate_hz; silent while stars cannot be seen', in_all=False)
SOLAR_POWER = Topic('power/solar', 'sensor_msgs/msg/BatteryState', EVENT, 'physics_node', '',
                    'voltage and current of the solar panel [V, A], at solar_panel.rate_hz',
                    in_all=False)
JOINT_COMMANDS = Topic('joint_commands', 'sensor_msgs/msg/JointState', STATE,
                       'gait_controller_node', '',
                       'velocity command [rad/s], reference angle [rad]; stamp of the state '
                       'answered')
CMD_VEL = Topic('cmd_vel', 'geometry_msgs/msg/TwistStamped', EVENT, 'drive_node',
                frames.BASE_FRAME, 'Twist where enable_stamped_cmd_vel is false')
LEFT_IMAGE = Topic('stereo/left/image_raw', 'sensor_msgs/msg/Image', FRAME, 'render_node',
                   frames.LEFT_OPTICAL_FRAME, 'mono8')
# The pair has one frame, as image_pipeline wants it; P of the right camera has the baseline.
RIGHT_IMAGE = Topic('stereo/right/image_raw', 'sensor_msgs/msg/Image', FRAME, 'render_node',
                    frames.LEFT_OPTICAL_FRAME, 'mono8')
LEFT_INFO = Topic('stereo/left/camera_info', 'sensor_msgs/msg/CameraInfo', FRAME, 'render_node',
                  frames.LEFT_OPTICAL_FRAME, 'the stamp is the middle of the exposure, '
                  'with a rolling shutter of that of the middle row')
RIGHT_INFO = Topic('stereo/right/camera_info', 'sensor_msgs/msg/CameraInfo', FRAME, 'render_node',
                   frames.LEFT_OPTICAL_FRAME, 'P[3] = -fx B')
EXPOSURE = Topic('stereo/exposure', 'sensor_msgs/msg/JointState', FRAME, 'render_node',
                 frames.LEFT_OPTICAL_FRAME, 'position: exposure time of the left and the right '
                 'image [s]')
DISPARITY = Topic('stereo/disparity', 'stereo_msgs/msg/DisparityImage', DEPTH_FRAME,
                  'render_node', frames.LEFT_OPTICAL_FRAME, 'by semi-global matching (SGM)')
DEPTH = Topic('stereo/depth/image', 'sensor_msgs/msg/Image', DEPTH_FRAME, 'render_node',
              frames.LEFT_OPTICAL_FRAME, 'by SGM, 32FC1 [m], NaN where unknown (REP-118)')
DEPTH_INFO = Topic('stereo/depth/camera_info', 'sensor_msgs/msg/CameraInfo', DEPTH_FRAME,
                   'render_node', frames.LEFT_OPTICAL_FRAME,
                   'that of the left camera, for the true depth too')
LEFT_COMPRESSED = Topic('stereo/left/image_raw/compressed', 'sensor_msgs/msg/CompressedImage',
                        FRAME, 'render_node', frames.LEFT_OPTICAL_FRAME, 'JPEG or PNG',
                        in_all=False)
RIGHT_COMPRESSED = Topic('stereo/right/image_raw/compressed', 'sensor_msgs/msg/CompressedImage',
                         FRAME, 'render_node', frames.LEFT_OPTICAL_FRAME, 'JPEG or PNG',
                         in_all=False)
POINTS = Topic('stereo/points2', 'sensor_msgs/msg/PointCloud2', DEPTH_FRAME, 'render_node',
               frames.LEFT_OPTICAL_FRAME, 'by SGM', in_all=False)
TRUE_DEPTH = Topic('ground_truth/depth/image', 'sensor_msgs/msg/Image', DEPTH_FRAME, 'render_node',
                   frames.LEFT_OPTICAL_FRAME, '32FC1 [m], +Inf for the sky')
CHASE_IMAGE = Topic('chase/image_raw', 'sensor_msgs/msg/Image', EVENT, 'render_node',
                    frames.CHASE_OPTICAL_FRAME, 'the rover from outside, where chase.enabled is '
                    'set; at chase.rate_hz', in_all=False)
CHASE_INFO = Topic('chase/camera_info', 'sensor_msgs/msg/CameraInfo', EVENT, 'render_node',
                   frames.CHASE_OPTICAL_FRAME, in_all=False)
CHASE_POSE = Topic('chase/pose', 'geometry_msgs/msg/PoseStamped', EVENT, 'render_node',
                   frames.ODOM_FRAME, 'of its optical frame', in_all=False)
HAZARD_IMAGE = Topic(f'hazard/{NAME}/image_raw', 'sensor_msgs/msg/Image', EVENT, 'render_node',
                     f'hazard_{NAME}_optical_frame', 'of each camera in hazard, at its rate_hz; '
                     f'of a pair, hazard/{NAME}/left/image_raw and right', in_all=False)
HAZARD_INFO = Topic(f'hazard/{NAME}/camera_info', 'sensor_msgs/msg/CameraInfo', EVENT,
                    'render_node', f'hazard_{NAME}_optical_frame', 'equidistant or plumb_bob',
                    in_all=False)
LABELS = Topic('ground_truth/labels', 'sensor_msgs/msg/Image', DEPTH_FRAME, 'render_node',
               frames.LEFT_OPTICAL_FRAME, 'mono16', in_all=False)
CRATERS = Topic('ground_truth/craters', 'sensor_msgs/msg/Image', DEPTH_FRAME, 'render_node',
                frames.LEFT_OPTICAL_FRAME, 'mono16', in_all=False)
SHADOW = Topic('ground_truth/shadow', 'sensor_msgs/msg/Image', DEPTH_FRAME, 'render_node',
               frames.LEFT_OPTICAL_FRAME, 'rgb8, shares over 255', in_all=False)
NORMALS = Topic('ground_truth/normals', 'sensor_msgs/msg/Image', DEPTH_FRAME, 'render_node',
                frames.LEFT_OPTICAL_FRAME, '32FC3', in_all=False)
OPTICAL_FLOW = Topic('ground_truth/optical_flow', 'sensor_msgs/msg/Image', DEPTH_FRAME,
                     'render_node', frames.LEFT_OPTICAL_FRAME, '32FC2 [px]', in_all=False)
SCENE_FLOW = Topic('ground_truth/scene_flow', 'sensor_msgs/msg/Image', DEPTH_FRAME, 'render_node',
                   frames.LEFT_OPTICAL_FRAME, '32FC3 [m]', in_all=False)
OF_RIGHT = tuple(
    dataclasses.replace(left, name=left.name.replace('/', '/right/', 1), in_all=False,
                        note='as of the left camera', frame_id=frames.RIGHT_OPTICAL_FRAME)
    for left in (TRUE_DEPTH, LABELS, CRATERS, SHADOW, NORMALS))
RIGHT_TRUE_DEPTH, RIGHT_LABELS, RIGHT_CRATERS, RIGHT_SHADOW, RIGHT_NORMALS = OF_RIGHT
# Pictures of images of two or three floats, which viewers do not show.
OF_COLOURS = tuple(
    Topic(f'{shown.name}/image_color', 'sensor_msgs/msg/Image', DEPTH_FRAME, 'render_node',
          shown.frame_id, f'rgb8, for viewers: {colours}', in_all=False)
    for shown, colours in (
        (NORMALS, '127.5 (1 + n); black for the sky'),
        (RIGHT_NORMALS, '127.5 (1 + n); black for the sky'),
        (OPTICAL_FLOW, 'the hue is its direction, the brightness its length, full at 32 px'),
        (SCENE_FLOW, 'the hue is its direction in the image, the brightness its length across '
                     'it, full at 0.1 m')))
NORMALS_COLOUR, RIGHT_NORMALS_COLOUR, FLOW_COLOUR, SCENE_FLOW_COLOUR = OF_COLOURS
HAZARD_LABELS = Topic(f'ground_truth/hazard/{NAME}/labels', 'sensor_msgs/msg/Image', EVENT,
                      'render_node', f'hazard_{NAME}_optical_frame', 'as of the pair',
                      in_all=False)
HAZARD_CRATERS = Topic(f'ground_truth/hazard/{NAME}/craters', 'sensor_msgs/msg/Image', EVENT,
                       'render_node', f'hazard_{NAME}_optical_frame', 'as of the pair',
                       in_all=False)
HAZARD_DEPTH = Topic(f'ground_truth/hazard/{NAME}/depth/image', 'sensor_msgs/msg/Image', EVENT,
                     'render_node', f'hazard_{NAME}_optical_frame', 'of a fisheye the distance '
                     'from it', in_all=False)
OF_HAZARD = HAZARD_IMAGE, HAZARD_INFO, HAZARD_LABELS, HAZARD_CRATERS, HAZARD_DEPTH
LABEL_INFO = Topic('ground_truth/label_info', 'std_msgs/msg/String', LATCHED, 'render_node', '',
                   'names of the labels, catalogues of rocks and craters, as JSON', in_all=False)
BOXES = Topic('ground_truth/boxes', 'vision_msgs/msg/Detection2DArray', DEPTH_FRAME,
              'render_node', frames.LEFT_OPTICAL_FRAME, 'where vision_msgs is installed',
              in_all=False)
MISCALIBRATION = Topic('ground_truth/miscalibration', 'std_msgs/msg/String', LATCHED,
                       'render_node', '', 'how the right camera differs from its CameraInfo, '
                       'as JSON, where miscalibration is set')
LABEL_CLASSES = Topic('ground_truth/label_classes', 'vision_msgs/msg/LabelInfo', LATCHED,
                      'render_node', frames.LEFT_OPTICAL_FRAME, 'where vision_msgs is installed',
                      in_all=False)
VISION_INFO = Topic('ground_truth/vision_info', 'vision_msgs/msg/VisionInfo', LATCHED,
                    'render_node', frames.LEFT_OPTICAL_FRAME, 'where vision_msgs is installed',
                    in_all=False)
LIDAR_POINTS = Topic('lidar/points', 'sensor_msgs/msg/PointCloud2', EVENT, 'lidar_node',
                     frames.LIDAR_FRAME, 'each point as the sensor sees it at its time; the '
                     'stamp is the start of the scan', in_all=False)
LIDAR_DESKEWED = Topic('lidar/points_deskewed', 'sensor_msgs/msg/PointCloud2', EVENT,
                       'lidar_node', frames.LIDAR_FRAME, 'the same points in the frame of the '
                       'start of the scan, by the true motion', in_all=False)
LIDAR_SCAN = Topic('lidar/scan', 'sensor_msgs/msg/LaserScan', EVENT, 'lidar_node',
                   frames.LIDAR_FRAME, 'one ring of it', in_all=False)
OF_LIDAR = LIDAR_POINTS, LIDAR_DESKEWED, LIDAR_SCAN
LIDAR_SCANNED = Topic('lidar/scanned', 'std_msgs/msg/Header', SCAN, 'lidar_node', '',
                      'stamp by whose time all scans that had ended are published')
SUN = Topic('sun', 'geometry_msgs/msg/Vector3Stamped', LATCHED, 'render_node', frames.ODOM_FRAME,
            'unit vector to the sun; that of a date moves: a message every `sun.step_deg`, '
            'stamped with the time from which it holds')
WORLD_HASH = Topic('world_hash', 'std_msgs/msg/String', LATCHED, 'physics_node', '')
WORLD_WINDOW = Topic('world/window', 'geometry_msgs/msg/PointStamped', LATCHED, 'physics_node',
                     frames.ODOM_FRAME, 'x, y: middle of the window of the site in which the '
                     'rover is; the stamp is that of the first state in it')
ROBOT_DESCRIPTION = Topic('robot_description', 'std_msgs/msg/String', LATCHED, 'physics_node', '',
                          'URDF')
SCENARIO = Topic('scenario', 'std_msgs/msg/String', LATCHED, 'recorder_node', '',
                 'resolved scenario, YAML')
TF = Topic('tf', 'tf2_msgs/msg/TFMessage', STATE, 'physics_node', frames.ODOM_FRAME,
           'odom to base_link, and from there to the legs')
TF_STATIC = Topic('tf_static', 'tf2_msgs/msg/TFMessage', LATCHED, 'physics_node',
                  frames.BASE_FRAME, 'sensors on base_link')
RECORDED = Topic('recorder/written', 'std_msgs/msg/Header', EVENT, 'recorder_node', '',
                 'stamp up to which everything is written')
DIAGNOSTICS = Topic('diagnostics', 'diagnostic_msgs/msg/DiagnosticArray', EVENT, 'physics_node',
                    '', 'by other nodes too, see below', in_all=False)
SLAM_POSE = Topic('slam/pose', 'geometry_msgs/msg/PoseStamped', EVENT, 'slam_node', '',
                  'of the left camera in the map of the program, for every tracked frame')
SLAM_COVARIANCE = Topic('slam/pose_with_covariance',
                        'geometry_msgs/msg/PoseWithCovarianceStamped', EVENT, 'slam_node', '',
                        'the same, where slam_node.system is graph')
SLAM_STATUS = Topic('slam/status', 'diagnostic_msgs/msg/DiagnosticArray', FRAME, 'slam_node', '',
                    'initialising, tracking or lost, and the place on a map from orbit; in '
                    'lockstep of every frame')
TRAVERSABILITY = Topic('map/traversability', 'nav_msgs/msg/OccupancyGrid', DEPTH_FRAME,
                       'mapping_node', frames.ODOM_FRAME, '0 free to 99, 100 not to be crossed, '
                       '-1 unknown; map_load_time is the stamp of the newest depth in it')
ELEVATION = Topic('map/elevation', 'sensor_msgs/msg/PointCloud2', EVENT, 'mapping_node',
                  frames.ODOM_FRAME, 'known cells, with the standard deviation of z [m], every '
                  'mapping_node.elevation_period_s')
PLAN = Topic('plan', 'nav_msgs/msg/Path', EVENT, 'navigator_node', frames.ODOM_FRAME,
             'what the navigator follows; sent when it changes, empty without a plan')
GLOBAL_PLAN = Topic('global_plan', 'nav_msgs/msg/Path', LATCHED, 'navigator_node',
                    frames.ODOM_FRAME, 'the way to a far goal over the map from orbit, along '
                    'which plan leads; sent when it changes')
GOAL = Topic('goal', 'geometry_msgs/msg/PoseStamped', EVENT, 'navigator_node', frames.ODOM_FRAME,
             'what it drives to, sent when that changes')
NAVIGATOR_STATUS = Topic('navigator/status', 'diagnostic_msgs/msg/DiagnosticArray', LATCHED,
                         'navigator_node', '', 'waiting, following, looking, backing off, '
                         'turning, arrived or failed, with its reason; sent when that changes')
NAVIGATED = Topic('navigator/finished', 'std_msgs/msg/Header', EVENT, 'navigator_node', '',
                  'stamp at which a run ends, since the navigator (or drive_node, with its '
                  'end_after_s) has arrived or given up')

CONTRACT: tuple[Topic, ...] = (
    CLOCK, ODOM, TRUE_ODOM, JOINT_STATES, IMU_RAW, IMU_TRUTH, IMU_BIAS, CONTACT, GROUND_CHANGES,
    GROUND_SNAPSHOT, SINKAGE, FOOT_SLIP, WHEEL_ODOM, *POWER, SUN_SENSOR, STAR_TRACKER, SOLAR_POWER,
    JOINT_COMMANDS, CMD_VEL, LEFT_IMAGE, RIGHT_IMAGE, LEFT_INFO, RIGHT_INFO, EXPOSURE, DISPARITY,
    DEPTH, DEPTH_INFO, TRUE_DEPTH, LEFT_COMPRESSED, RIGHT_COMPRESSED, POINTS, LABELS, CRATERS,
    SHADOW, NORMALS, OPTICAL_FLOW, SCENE_FLOW, *OF_RIGHT, *OF_COLOURS, LABEL_INFO, BOXES,
    MISCALIBRATION, LABEL_CLASSES, VISION_INFO, CHASE_IMAGE, CHASE_INFO, CHASE_POSE, *OF_HAZARD,
    *OF_LIDAR, LIDAR_SCANNED, SUN, WORLD_HASH, WORLD_WINDOW, ROBOT_DESCRIPTION, SCENARIO, TF,
    TF_STATIC, RECORDED, DIAGNOSTICS, SLAM_POSE, SLAM_COVARIANCE, SLAM_STATUS, TRAVERSABILITY,
    ELEVATION, PLAN, GLOBAL_PLAN, GOAL, NAVIGATOR_STATUS, NAVIGATED)
# Latched topics of what changes: sent again then, and none of it is to be lost.
CHANGING: tuple[Topic, ...] = (SUN, NAVIGATOR_STATUS, GLOBAL_PLAN, WORLD_WINDOW)
# What the navigator reads; its users publish it.
GOAL_POSE = Topic('goal_pose', 'geometry_msgs/msg/PoseStamped', EVENT, '')
WAYPOINTS = Topic('waypoints', 'nav_msgs/msg/Path', EVENT, '')
# One of each with every stereo pair: the first that is recorded tells of all.
OF_PAIRS: tuple[Topic, ...] = (LEFT_IMAGE, LEFT_INFO)
# For these a pair is exposed.
OF_IMAGES: tuple[Topic, ...] = (LEFT_IMAGE, RIGHT_IMAGE, LEFT_COMPRESSED, RIGHT_COMPRESSED,
                                DISPARITY, DEPTH, POINTS)
# Of a package that may not be installed.
OF_VISION: tuple[Topic, ...] = (BOXES, LABEL_CLASSES, VISION_INFO)
OF_SOFT_GROUND: tuple[Topic, ...] = (GROUND_CHANGES, GROUND_SNAPSHOT, SINKAGE)

_HAZARD = tuple((topic, re.compile(topic.name.replace(NAME, '([a-z0-9_]+(?:/left|/right)?)')))
                for topic in OF_HAZARD)
_EXACT = {topic.name: topic for topic in CONTRACT}
_OF_LEG = tuple((topic, re.compile(topic.name.replace(LEG, '([a-z][a-z0-9_]*)')))
                for topic in CONTRACT if LEG in topic.name)


def of_legs(listed: Iterable[Topic], legs: Iterable[str]) -> tuple[Topic, ...]:
    """Return topics of which those that each leg has are there once for each of the legs."""
    names = tuple(legs)
    return tuple(one for topic in listed for one in (
        [dataclasses.replace(topic, name=topic.name.replace(LEG, leg),
                             frame_id=topic.frame_id.replace(LEG, leg)) for leg in names]
        if LEG in topic.name else [topic]))


def of_leg(name: str) -> tuple[Topic, str] | None:
    """Return which topic of each leg a relative name is, and of which leg; None if it is none."""
    for topic, pattern in _OF_LEG:
        match = pattern.fullmatch(name)
        if match is not None and name not in _EXACT:
            return topic, match[1]
    return None


def topic_of(name: str) -> Topic | None:
    """Return the topic of the contract that a relative name is; None if it is none.

    Of what each leg or each hazard camera has, that is the topic that stands for all of them.
    """
    if name in _EXACT:
        return _EXACT[name]
    found = of_leg(name) or of_hazard(name)
    return None if found is None else found[0]


def legs_of(names: Iterable[str]) -> tuple[str, ...]:
    """Return the legs, sorted, whose topics are among full or relative names."""
    found = (of_leg('/'.join(name.split('/')[-2:])) for name in names)
    return tuple(sorted({one[1] for one in found if one is not None}))


def hazard(camera: str) -> tuple[Topic, ...]:
    """Return the topics of a hazard camera, in the order of OF_HAZARD.

    Image and CameraInfo of a pair have one frame, that of the left camera; the truth has its own.

    Args:
        camera: Its name; of a pair, with /left or /right.
    """
    own = hazard_frame(camera)
    left = hazard_frame(f'{camera[:-6]}/left') if camera.endswith('/right') else own
    return tuple(dataclasses.replace(
        topic, name=topic.name.replace(NAME, camera),
        frame_id=left if topic in (HAZARD_IMAGE, HAZARD_INFO) else own) for topic in OF_HAZARD)


def hazard_frame(camera: str) -> str:
    """Return the optical frame of a hazard camera, which is named as in `hazard`."""
    return HAZARD_IMAGE.frame_id.replace(NAME, camera.replace('/', '_'))


def of_hazard(name: str) -> tuple[Topic, str] | None:
    """Return which of OF_HAZARD a relative name is, and of which camera; None if it is none."""
    for topic, pattern in _HAZARD:
        match = pattern.fullmatch(name)
        if match is not None:
            return topic, match[1]
    return None
