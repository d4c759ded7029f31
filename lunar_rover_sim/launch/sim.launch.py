"""The graph of a scenario: `ros2 launch lunar_rover_sim sim.launch.py scenario:=baseline output:=DIR`.

The plan is that of `lunar_rover_sim run`, in the ROS domain of the shell. The run ends when
physics_node has finished. A node that dies ends it with an error and a non-zero status.
"""  # noqa: E501

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import matches_action, Shutdown
from launch.events.process import ShutdownProcess
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from lunar_rover_sim.run.plan import prepare, resolve, SCENARIO_FILE, STOP_ORDER
from lunar_rover_sim.run.scenario import Scenario

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
    scenario = resolve(Scenario.load(values['scenario'], overrides,
                                     seed=int(values['seed']) if values['seed'] else None))
    folder = Path(values['output']).resolve()
    world = Path(values['world'] or scenario.world_folder()).resolve()
    nodes = {
        # Not `parameters`: launch writes those for `/**`, and the sections of the scenario win.
        plan.name: Node(package='lunar_rover_sim', executable=plan.name, name=plan.name,
                        output='screen', sigterm_timeout='15',
                        ros_arguments=plan.ros_arguments(folder / SCENARIO_FILE)[1:])
        for plan in prepare(scenario, folder, world)}
    ended = OnProcessExit(target_action=lambda action: action in nodes.values(),
                          on_exit=_Ending(nodes).on_exit)
    return [RegisterEventHandler(ended), *nodes.values()]


class _Ending:
    """Stops the nodes one by one, the recorder last, once physics_node has finished."""

    def __init__(self, nodes):
        self._nodes = nodes
        self._stopping = False

    def on_exit(self, event, context):
        """Stop the next node; raise RuntimeError, which ends the launch, for one that has died."""
        if context.is_shutdown:
            return None
        name = next(name for name, node in self._nodes.items() if node is event.action)
        self._stopping |= name == 'physics_node' and event.returncode == 0
        if event.returncode != 0 or not self._stopping:
            raise RuntimeError(f'{name} has ended with status {event.returncode}')
        for other in STOP_ORDER:
            node = self._nodes.get(other)
            if node is not None and node.return_code is None:
                return EmitEvent(event=ShutdownProcess(process_matcher=matches_action(node)))
        return EmitEvent(event=Shutdown(reason='the run is complete'))


def generate_launch_description():
    """Return the nodes of the scenario."""
    return LaunchDescription(
        [DeclareLaunchArgument(name, default_value=default, description=text)
         for name, (default, text) in _ARGUMENTS.items()] + [OpaqueFunction(function=_start)])
