"""ROS 2 wrappers of ORB-SLAM3 in the graph: how they are fed, and where their poses come out.

Names are those of the wrappers' sources: github.com/zang09/ORB_SLAM3_ROS2 (package orbslam3) and
github.com/suchetanrs/ORB-SLAM3-ROS2-Docker (package orb_slam3_ros2_wrapper).
"""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.parameters import nearest

SENSORS = ('mono', 'stereo', 'stereo-inertial')
_LEFT, _RIGHT, _IMU = topics.LEFT_IMAGE.name, topics.RIGHT_IMAGE.name, topics.IMU_RAW.name


@dataclasses.dataclass(frozen=True)
class Wrapper:
    """One wrapper with one sensor.

    Attributes:
        remappings: From its topics to ours.
        parameters: Its own, where it takes topics as such.
        more_arguments: After vocabulary and settings.
        pose: Topic of its poses, empty where it has none and leaves KeyFrameTrajectory.txt (TUM,
            seconds) in its working directory.
    """

    package: str
    executable: str
    remappings: tuple[tuple[str, str], ...] = ()
    parameters: tuple[tuple[str, str | bool], ...] = ()
    more_arguments: tuple[str, ...] = ()
    pose: str = ''


# Rectified images: no rectification by the wrapper, nor equalisation.
_ZANG09 = {
    'mono': Wrapper('orbslam3', 'mono', (('camera', _LEFT),)),
    'stereo': Wrapper('orbslam3', 'stereo', (('camera/left', _LEFT), ('camera/right', _RIGHT)),
                      more_arguments=('false',)),
    'stereo-inertial': Wrapper(
        'orbslam3', 'stereo-inertial',
        (('camera/left', _LEFT), ('camera/right', _RIGHT), ('imu', _IMU)),
        more_arguments=('false', 'false')),
}
_PLAIN = (('visualization', False), ('publish_tf', False))
_PAIR = (('left_image_topic_name', _LEFT), ('right_image_topic_name', _RIGHT))
_SUCHETANRS = {
    'mono': Wrapper('orb_slam3_ros2_wrapper', 'mono', (),
                    (('image_topic_name', _LEFT), *_PLAIN), pose='robot_pose_slam'),
    'stereo': Wrapper('orb_slam3_ros2_wrapper', 'stereo', (), (*_PAIR, *_PLAIN),
                      pose='robot_pose_slam'),
    'stereo-inertial': Wrapper('orb_slam3_ros2_wrapper', 'stereo_imu', (),
                               (*_PAIR, ('imu_topic_name', _IMU), *_PLAIN),
                               pose='robot_pose_slam'),
}
WRAPPERS = {'orbslam3': _ZANG09, 'orb_slam3_ros2_wrapper': _SUCHETANRS}


def wrapper(package: str, sensor: str) -> Wrapper:
    """Return how a wrapper is fed; raise SlamError that lists the known ones."""
    for name, value, valid in (('wrapper', package, tuple(WRAPPERS)),
                               ('sensor', sensor, SENSORS)):
        if value not in valid:
            raise SlamError(f'{name}: {value!r} is not valid; {nearest(value, valid)}')
    return WRAPPERS[package][sensor]
