"""Nav2 on the rover: obstacles from the points of SGM, Twist to the gait controller."""

from pathlib import Path
import tempfile

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import Node
import yaml

POINTS = {'topic': '/stereo/points2', 'data_type': 'PointCloud2', 'marking': True,
          'clearing': True, 'min_obstacle_height': 0.08, 'max_obstacle_height': 1.0,
          'obstacle_max_range': 4.0, 'raytrace_max_range': 5.0}
COSTMAP = {'rolling_window': True, 'width': 12, 'height': 12, 'resolution': 0.05,
           'robot_radius': 0.25, 'plugins': ['voxel_layer', 'inflation_layer'],
           'voxel_layer': {'plugin': 'nav2_costmap_2d::VoxelLayer', 'z_voxels': 16,
                           'z_resolution': 0.1, 'observation_sources': 'points',
                           'points': POINTS}}


def parameters():
    """Return Nav2's own parameters with costmaps of ours and the reach of the gait."""
    document = yaml.safe_load((Path(get_package_share_directory('nav2_bringup')) / 'params'
                               / 'nav2_params.yaml').read_text(encoding='utf-8'))
    for name in ('local_costmap', 'global_costmap'):
        document[name][name]['ros__parameters'].update(COSTMAP)
    document['controller_server']['ros__parameters']['FollowPath'].update(
        vx_max=0.2, vx_min=-0.1, wz_max=0.5)
    document['velocity_smoother']['ros__parameters'].update(
        max_velocity=[0.2, 0.0, 0.5], min_velocity=[-0.1, 0.0, -0.5])
    # Without a source that is alive the monitor stops the rover.
    document['collision_monitor']['ros__parameters'].update(
        observation_sources=['points'],
        points={'type': 'pointcloud', 'topic': '/stereo/points2', 'min_height': 0.08,
                'max_height': 1.0, 'enabled': True})
    return document


def generate_launch_description():
    """Return Nav2 without a map server; map is odom unless a SLAM system says otherwise."""
    file = Path(tempfile.mkdtemp()) / 'nav2.yaml'
    file.write_text(yaml.safe_dump(parameters()), encoding='utf-8')
    bringup = Path(get_package_share_directory('nav2_bringup'))
    return LaunchDescription([
        Node(package='tf2_ros', executable='static_transform_publisher',
             arguments=['--frame-id', 'map', '--child-frame-id', 'odom']),
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(bringup / 'launch' / 'navigation_launch.py')),
            launch_arguments={'use_sim_time': 'true', 'params_file': str(file)}.items())])
