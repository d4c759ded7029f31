"""Nav2 on the rover: costmaps from the map of mapping_node, cmd_vel to the gait controller.

The commands are Twist, with `stamped:=true` TwistStamped: the gait controller takes both. The
parameters are in nav2.yaml.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

SERVERS = {'nav2_controller': 'controller_server', 'nav2_planner': 'planner_server',
           'nav2_behaviors': 'behavior_server', 'nav2_bt_navigator': 'bt_navigator'}


def generate_launch_description():
    """Return four servers and the manager that brings them up; odom is the frame of the map."""
    parameters = str(Path(__file__).with_name('nav2.yaml'))
    stamped = {'enable_stamped_cmd_vel': LaunchConfiguration('stamped')}
    return LaunchDescription([
        DeclareLaunchArgument('stamped', default_value='false'),
        *(Node(package=package, executable=server, output='screen',
               parameters=[parameters, stamped]) for package, server in SERVERS.items()),
        Node(package='nav2_lifecycle_manager', executable='lifecycle_manager', output='screen',
             name='lifecycle_manager_navigation', parameters=[parameters])])
