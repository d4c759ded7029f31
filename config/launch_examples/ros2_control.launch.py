"""ros2_control on the rover, over topics: a velocity controller in the place of the gait.

The description on `robot_description` has the hardware interface: `joint_states` in, and
`joint_commands` out.
"""

from pathlib import Path

from launch import LaunchDescription
from launch_ros.actions import Node, SetParameter

CONTROLLERS = ['joint_state_broadcaster', 'legs']


def generate_launch_description():
    """Return the manager and the spawner of its controllers."""
    parameters = str(Path(__file__).with_name('ros2_control.yaml'))
    return LaunchDescription([
        SetParameter('use_sim_time', True),
        Node(package='controller_manager', executable='ros2_control_node', output='screen',
             parameters=[parameters]),
        Node(package='controller_manager', executable='spawner', output='screen',
             arguments=[*CONTROLLERS, '--param-file', parameters])])
