"""stereo_image_proc on the simulated pair; start the graph of the rover beside it."""

from launch import LaunchDescription
from launch_ros.actions import ComposableNodeContainer, SetParameter
from launch_ros.descriptions import ComposableNode

# The images are rectified as they come (distortion 0): image_raw is image_rect.
PAIR = [('left/image_rect', 'stereo/left/image_raw'),
        ('left/image_rect_color', 'stereo/left/image_raw'),
        ('left/camera_info', 'stereo/left/camera_info'),
        ('right/image_rect', 'stereo/right/image_raw'),
        ('right/camera_info', 'stereo/right/camera_info'),
        ('disparity', 'stereo_image_proc/disparity'), ('points2', 'stereo_image_proc/points2')]


def generate_launch_description():
    """Return disparity and points in one container: the large images stay in the process."""
    return LaunchDescription([
        SetParameter('use_sim_time', True),
        ComposableNodeContainer(
            name='stereo_image_proc', namespace='', package='rclcpp_components',
            executable='component_container', output='screen', composable_node_descriptions=[
                ComposableNode(package='stereo_image_proc', remappings=PAIR,
                               plugin='stereo_image_proc::DisparityNode',
                               parameters=[{'approximate_sync': False, 'stereo_algorithm': 1,
                                            'disparity_range': 128,
                                            'correlation_window_size': 7}],
                               extra_arguments=[{'use_intra_process_comms': True}]),
                ComposableNode(package='stereo_image_proc', remappings=PAIR,
                               plugin='stereo_image_proc::PointCloudNode',
                               parameters=[{'approximate_sync': False}],
                               extra_arguments=[{'use_intra_process_comms': True}])])])
