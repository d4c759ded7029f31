"""A wrapper of ORB-SLAM3 with the graph of a scenario, by the launch file of this package."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

# Settings by: lunar_rover_sim slam settings baseline --sensor stereo -o orb.yaml
ARGUMENTS = {'wrapper': 'orbslam3', 'sensor': 'stereo', 'scenario': 'baseline',
             'vocabulary': 'ORBvoc.txt', 'settings': 'orb.yaml', 'estimate': 'live',
             'output': 'runs/live', 'duration': '60'}


def generate_launch_description():
    """Return wrapper, trajectory recorder and the nodes of the scenario."""
    share = Path(get_package_share_directory('lunar_rover_sim'))
    return LaunchDescription([IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(share / 'launch' / 'slam.launch.py')),
        launch_arguments=ARGUMENTS.items())])
