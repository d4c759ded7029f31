"""An EKF of robot_localization on visual odometry and gyroscope; start both beside it."""

from launch import LaunchDescription
from launch_ros.actions import Node

NO, YES = False, True
EKF = {
    'use_sim_time': True, 'frequency': 50.0, 'two_d_mode': False, 'publish_tf': True,
    'odom_frame': 'odom', 'base_link_frame': 'base_link', 'world_frame': 'odom',
    # Velocities of a visual odometry, here that of RTAB-Map.
    'odom0': 'rtabmap/odom',
    'odom0_config': [NO, NO, NO, NO, NO, NO, YES, YES, YES, NO, NO, NO, NO, NO, NO],
    # Rates only: the IMU has no orientation, and removing gravity would need one.
    'imu0': 'imu/data_raw',
    'imu0_config': [NO, NO, NO, NO, NO, NO, NO, NO, NO, YES, YES, YES, NO, NO, NO],
    'imu0_queue_size': 100, 'imu0_remove_gravitational_acceleration': False}


def generate_launch_description():
    """Return the filter; its estimate is `odometry/filtered`."""
    return LaunchDescription([
        Node(package='robot_localization', executable='ekf_node', name='ekf_filter_node',
             output='screen', parameters=[EKF])])
