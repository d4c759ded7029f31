"""An EKF of robot_localization on wheel odometry, gyroscope and star tracker of the rover.

Its estimate is `odometry/filtered`, and it publishes odom to base_link: run the graph with
separate_truth, which leaves these frames to it.
"""

from launch import LaunchDescription
from launch_ros.actions import Node

NO, YES = False, True
EKF = {
    'use_sim_time': True, 'frequency': 50.0, 'two_d_mode': False, 'publish_tf': True,
    'odom_frame': 'odom', 'base_link_frame': 'base_link', 'world_frame': 'odom',
    # Rows: position, orientation, velocity, rates, acceleration. The speed alone: what the legs
    # tell of turns is far worse than the gyroscope. A foot hardly slides across or up.
    'odom0': 'wheel/odometry', 'odom0_queue_size': 100,
    'odom0_config': [NO, NO, NO, NO, NO, NO, YES, YES, NO, NO, NO, NO, NO, NO, NO],
    # Rates only: the IMU has no orientation, and removing gravity would need one.
    'imu0': 'imu/data_raw', 'imu0_queue_size': 100,
    'imu0_config': [NO, NO, NO, NO, NO, NO, NO, NO, NO, YES, YES, YES, NO, NO, NO],
    'imu0_remove_gravitational_acceleration': False,
    # The attitude in the world, whenever the rover is still enough to see stars.
    'imu1': 'star_tracker/attitude',
    'imu1_config': [NO, NO, NO, YES, YES, YES, NO, NO, NO, NO, NO, NO, NO, NO, NO],
    'imu1_remove_gravitational_acceleration': False}


def generate_launch_description():
    """Return the filter."""
    return LaunchDescription([
        Node(package='robot_localization', executable='ekf_node', name='ekf_filter_node',
             output='screen', parameters=[EKF])])
