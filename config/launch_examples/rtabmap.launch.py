"""RTAB-Map: stereo odometry and SLAM on the simulated pair; start the graph beside it."""

from launch import LaunchDescription
from launch_ros.actions import Node, SetParameter

RELIABLE = 1
PARAMETERS = {'frame_id': 'base_link', 'subscribe_stereo': True, 'approx_sync': False,
              'qos': RELIABLE, 'qos_camera_info': RELIABLE, 'wait_imu_to_init': False}
REMAPPINGS = [('left/image_rect', 'stereo/left/image_raw'),
              ('left/camera_info', 'stereo/left/camera_info'),
              ('right/image_rect', 'stereo/right/image_raw'),
              ('right/camera_info', 'stereo/right/camera_info'),
              # `odom` is the true odometry of the simulation.
              ('odom', 'rtabmap/odom')]


def generate_launch_description():
    """Return odometry, which makes odom to base_link, and SLAM, which makes map to odom."""
    return LaunchDescription([
        SetParameter('use_sim_time', True),
        Node(package='rtabmap_odom', executable='stereo_odometry', output='screen',
             parameters=[PARAMETERS, {'odom_frame_id': 'odom', 'publish_tf': True}],
             remappings=REMAPPINGS),
        Node(package='rtabmap_slam', executable='rtabmap', output='screen', arguments=['-d'],
             parameters=[PARAMETERS], remappings=REMAPPINGS)])
