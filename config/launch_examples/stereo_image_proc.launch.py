"""stereo_image_proc on the simulated pair; start the graph of the rover beside it.

With `rectify:=true`, for cameras with distortion, image_proc rectifies the images first.
"""

from launch import LaunchDescription
from launch.actions import (DeclareLaunchArgument, ExecuteProcess, OpaqueFunction,
                            RegisterEventHandler)
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import ComposableNodeContainer, LoadComposableNodes, SetParameter
from launch_ros.descriptions import ComposableNode

# The images are rectified as they come (distortion 0): image_raw is image_rect.
PAIR = [('left/image_rect', 'stereo/left/image_raw'),
        ('left/image_rect_color', 'stereo/left/image_raw'),
        ('left/camera_info', 'stereo/left/camera_info'),
        ('right/image_rect', 'stereo/right/image_raw'),
        ('right/camera_info', 'stereo/right/camera_info'),
        ('disparity', 'stereo_image_proc/disparity'), ('points2', 'stereo_image_proc/points2')]
RECTIFIED = {'stereo/left/image_raw': 'stereo/left/image_rect',
             'stereo/right/image_raw': 'stereo/right/image_rect'}
# Of best effort, which these nodes ask for by themselves, pairs of 640 x 480 may be lost, all of
# them. RectifyNode reads as its topic is published: it is loaded when that is there, else it would
# read by best effort.
RELIABLE = {**{f'qos_overrides./{topic}.subscription.reliability': 'reliable'
               for topic in (*dict(PAIR).values(), *RECTIFIED.values())},
            **{f'qos_overrides./{topic}.publisher.reliability': 'reliable'
               for topic in RECTIFIED.values()}}
# Large images stay in the process.
INSIDE = [{'use_intra_process_comms': True}]


def container(context):
    """Return disparity and points in one container, with two nodes that rectify if asked for."""
    pair, later = PAIR, []
    if LaunchConfiguration('rectify').perform(context).lower() == 'true':
        pair = [(theirs, RECTIFIED.get(ours, ours)) for theirs, ours in PAIR]
        published = ExecuteProcess(cmd=['ros2', 'topic', 'echo', '--once', '--field', 'header',
                                        'stereo/right/camera_info', 'sensor_msgs/msg/CameraInfo'])
        rectifiers = LoadComposableNodes(
            target_container='stereo_image_proc', composable_node_descriptions=[
                ComposableNode(package='image_proc', plugin='image_proc::RectifyNode',
                               name=f"rectify_{raw.split('/')[1]}", extra_arguments=INSIDE,
                               parameters=[RELIABLE],
                               remappings=[('image', raw), ('image_rect', rect)])
                for raw, rect in RECTIFIED.items()])
        later = [published, RegisterEventHandler(OnProcessExit(target_action=published,
                                                               on_exit=[rectifiers]))]
    return [*later, ComposableNodeContainer(
        name='stereo_image_proc', namespace='', package='rclcpp_components',
        executable='component_container', output='screen', composable_node_descriptions=[
            ComposableNode(package='stereo_image_proc', remappings=pair,
                           plugin='stereo_image_proc::DisparityNode',
                           parameters=[{'approximate_sync': False, 'stereo_algorithm': 1,
                                        'disparity_range': 128, 'correlation_window_size': 7},
                                       RELIABLE],
                           extra_arguments=INSIDE),
            ComposableNode(package='stereo_image_proc', remappings=pair,
                           plugin='stereo_image_proc::PointCloudNode',
                           parameters=[{'approximate_sync': False}, RELIABLE],
                           extra_arguments=INSIDE)])]


def generate_launch_description():
    """Return the container."""
    return LaunchDescription([DeclareLaunchArgument('rectify', default_value='false'),
                              SetParameter('use_sim_time', True),
                              OpaqueFunction(function=container)])
