"""The graph of a scenario: `ros2 launch lunar_rover_sim sim.launch.py scenario:=baseline output:=DIR`.

The same plan as `lunar_rover_sim run`, under ros2 launch: its domain is that of the shell, and the
run ends when physics_node has finished or any node dies.
"""  # noqa: E501

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from lunar_rover_sim.config import load_scenario
from lunar_rover_sim.graph import prepare, resolve, SCENARIO_FILE
from lunar_rover_sim.world.store import cached

_ARGUMENTS = {
    'scenario': ('baseline', 'name of a packaged scenario, or a YAML file'),
    'output': ('', 'folder for bag, resolved scenario and logs; must not exist'),
    'seed': ('', 'seed of everything random; empty for that of the scenario'),
    'duration': ('', 'simulated time [s]; empty for that of the scenario'),
    'time_mode': ('', 'lockstep or real_time; empty for that of the scenario'),
    'world': ('', 'folder of a world; empty for that of the scenario'),
}


def _start(context):
    values = {name: LaunchConfiguration(name).perform(context) for name in _ARGUMENTS}
    if not values['output']:
        raise RuntimeError("output: '' is not valid; valid is a folder that does not exist")
    overrides = []
    if values['duration']:
        overrides.append(f'run.duration_s={values["duration"]}')
    if values['time_mode']:
        overrides.append(f'time_mode={values["time_mode"]}')
    scenario = resolve(load_scenario(values['scenario'], overrides,
                                     int(values['seed']) if values['seed'] else None))
    folder = Path(values['output']).resolve()
    world = Path(values['world'] or cached(scenario.world, scenario.shared.seed)).resolve()
    actions = []
    for plan in prepare(scenario, folder, world):
        node = Node(package='lunar_rover_sim', executable=plan.name, name=plan.name,
                    output='screen', parameters=[str(folder / SCENARIO_FILE), plan.parameters],
                    sigterm_timeout='15')
        ended = EmitEvent(event=Shutdown(reason=f'{plan.name} has ended'))
        actions += [node, RegisterEventHandler(OnProcessExit(target_action=node,
                                                             on_exit=[ended]))]
    return actions


def generate_launch_description():
    """Return the nodes of the scenario."""
    return LaunchDescription(
        [DeclareLaunchArgument(name, default_value=default, description=text)
         for name, (default, text) in _ARGUMENTS.items()] + [OpaqueFunction(function=_start)])
