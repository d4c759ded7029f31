"""Several rovers in one graph: `ros2 launch lunar_rover_sim several_rovers.launch.py output:=DIR`.

Each has a namespace, a physics of its own in a world of its own, and a bag in `DIR/NAME`. The
first publishes /clock; in lockstep all have one time. The rovers start side by side.
"""

from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import (DeclareLaunchArgument, GroupAction, IncludeLaunchDescription,
                            OpaqueFunction)
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.run.plan import check_launch_arguments, rover_overrides
from lunar_rover_sim.run.scenario import Scenario

_ARGUMENTS = {
    'rovers': ('rover1 rover2', 'namespaces of the rovers'),
    'spacing': ('1.5', 'distance between their starts, along y [m]'),
    'output': ('', 'folder for a folder of each rover; must not exist'),
    'scenario': ('baseline', 'name of a packaged scenario, or a YAML file'),
    'duration': ('', 'simulated time [s]; empty for that of the scenario'),
    'time_mode': ('', 'lockstep or real_time; empty for that of the scenario'),
    'set': ('', 'parameters for all rovers, as `set` of sim.launch.py'),
}
_OF_SCENARIO = ('scenario', 'duration', 'time_mode')


def _start(context: LaunchContext) -> list[Any]:
    check_launch_arguments(context.argv, _ARGUMENTS)
    values = {name: LaunchConfiguration(name).perform(context) for name in _ARGUMENTS}
    folder = Path(values['output']).resolve()
    if not values['output'] or folder.exists():
        raise ConfigError(f'output: {values["output"]!r} is not valid; valid is a folder that '
                          'does not exist')
    rovers = values['rovers'].split()
    try:
        spacing_m = float(values['spacing'])
    except ValueError:
        raise ConfigError(f'spacing: {values["spacing"]!r} is not valid; valid is a number') \
            from None
    overrides = [text.strip() for text in values['set'].split(';') if text.strip()]
    recorded = 'recorder_node' in Scenario.load(values['scenario'], overrides).run.nodes
    groups = []
    for k, rover in enumerate(rovers):
        start_m = (k - (len(rovers) - 1) / 2) * spacing_m
        settings = [*rover_overrides(rovers, rover, recorded),
                    f'physics_node.start.y_m={start_m}', *overrides]
        groups.append(GroupAction([IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(Path(__file__).with_name('sim.launch.py'))),
            launch_arguments=[('namespace', rover), ('output', str(folder / rover)),
                              ('set', '; '.join(settings)),
                              *((name, values[name]) for name in _OF_SCENARIO)])]))
    return groups


def generate_launch_description() -> LaunchDescription:
    """Return the nodes of all rovers."""
    return LaunchDescription(
        [DeclareLaunchArgument(name, default_value=default, description=text)
         for name, (default, text) in _ARGUMENTS.items()] + [OpaqueFunction(function=_start)])
