"""A scenario in real time beside ORB-SLAM3: `ros2 launch lunar_rover_sim slam.launch.py ...`.

Starts a ROS 2 wrapper of ORB-SLAM3, which the user has installed, with its topics remapped to
those of the graph, then the graph of the scenario. The poses of the wrapper are recorded to a TUM
file for `lunar_rover_sim evaluate`. `lunar_rover_sim slam settings SCENARIO -o FILE --sensor
SENSOR` writes the settings.
"""

from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import (DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction,
                            TimerAction)
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.substitutions import ExecutableInPackage

from lunar_rover_sim.judge.slam.live import wrapper

_ARGUMENTS = {
    'wrapper': ('orbslam3', 'package: orbslam3 or orb_slam3_ros2_wrapper'),
    'sensor': ('stereo', 'mono, stereo or stereo-inertial'),
    'vocabulary': ('', 'vocabulary of ORB-SLAM3'),
    'settings': ('', 'settings file of ORB-SLAM3'),
    'estimate': ('', 'folder for what ORB-SLAM3 estimates; must not exist'),
    'delay': ('15.0', 'time until the scenario starts, in which the vocabulary is loaded [s]'),
    'scenario': ('baseline', 'name of a packaged scenario, or a YAML file'),
    'output': ('', 'folder for bag, resolved scenario and logs; must not exist'),
    'seed': ('', 'seed of everything random; empty for that of the scenario'),
    'duration': ('', 'simulated time [s]; empty for that of the scenario'),
}
_OF_SCENARIO = ('scenario', 'output', 'seed', 'duration')


def _start(context: LaunchContext) -> list[Any]:
    values = {name: LaunchConfiguration(name).perform(context) for name in _ARGUMENTS}
    files = {name: Path(values[name]).absolute() for name in ('vocabulary', 'settings')}
    for name, path in files.items():
        if not values[name] or not path.is_file():
            raise RuntimeError(f'{name}: {values[name]!r} is not valid; valid is a file')
    for name in ('estimate', 'output'):
        if not values[name] or Path(values[name]).exists():
            raise RuntimeError(f'{name}: {values[name]!r} is not valid; valid is a folder that '
                               'does not exist')
    chosen = wrapper(values['wrapper'], values['sensor'])
    # Raises for a package or a program that is not installed, before a folder is made.
    ExecutableInPackage(package=chosen.package, executable=chosen.executable).perform(context)
    folder = Path(values['estimate']).absolute()
    folder.mkdir(parents=True)
    actions = [Node(package=chosen.package, executable=chosen.executable, output='screen',
                    arguments=[str(files['vocabulary']), str(files['settings']),
                               *chosen.more_arguments],
                    parameters=[dict(chosen.parameters)] if chosen.parameters else [],
                    remappings=list(chosen.remappings), cwd=str(folder))]
    if chosen.pose:
        actions.append(Node(package='lunar_rover_sim', executable='trajectory_recorder_node',
                            output='screen', remappings=[('pose', chosen.pose)],
                            parameters=[{'output': str(folder / 'estimate.txt')}]))
    graph = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(Path(__file__).with_name('sim.launch.py'))),
        launch_arguments=[('time_mode', 'real_time'),
                          *((name, values[name]) for name in _OF_SCENARIO)])
    return [*actions, TimerAction(period=float(values['delay']), actions=[graph])]


def generate_launch_description() -> LaunchDescription:
    """Return wrapper, trajectory recorder and, a little later, the nodes of the scenario."""
    return LaunchDescription(
        [DeclareLaunchArgument(name, default_value=default, description=text)
         for name, (default, text) in _ARGUMENTS.items()] + [OpaqueFunction(function=_start)])
