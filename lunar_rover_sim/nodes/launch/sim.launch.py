"""The graph of a scenario.

    ros2 launch lunar_rover_sim sim.launch.py scenario:=baseline output:=DIR

The plan is that of `lunar_rover_sim run`, in the ROS domain of the shell, in any namespace. When
physics_node has finished, or a signal has ended a node, the others are stopped and the recorder
writes its bag. A node that dies ends the launch with an error and a non-zero status, unless
`run.may_fail` names it. What each node prints is in `DIR/logs` too.
"""  # noqa: E501

from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import (DeclareLaunchArgument, EmitEvent, LogInfo, OpaqueFunction,
                            RegisterEventHandler)
from launch.event_handlers import OnProcessExit, OnProcessIO
from launch.events import matches_action
from launch.events.process import ShutdownProcess
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from lunar_rover_sim.bag.marker import mark_failed
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.paths import BAG_FOLDER, check_new_folder
from lunar_rover_sim.run.ending import DONE, Ending
from lunar_rover_sim.run.plan import (check_launch_arguments, LOG_FOLDER, prepare, resolve,
                                      SCENARIO_FILE)
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.run.scenario_options import with_slam

_ARGUMENTS = {
    'scenario': ('baseline', 'name of a packaged scenario, or a YAML file', None),
    'output': ('', 'folder for bag, resolved scenario and logs; must not exist', None),
    'seed': ('', 'seed of everything random; empty for that of the scenario', None),
    'duration': ('', 'simulated time [s]; empty for that of the scenario', None),
    'time_mode': ('', 'empty for that of the scenario', ('', 'lockstep', 'real_time')),
    'rover': ('', 'name of a packaged rover, or a YAML file; empty for that of the scenario',
              None),
    'world': ('', 'folder of a world; empty for that of the scenario', None),
    'slam': ('', 'SLAM program to feed, with its arguments, as `run --slam`', None),
    'set': ('', 'parameters as `run --set` takes them, with semicolons in between: '
            '"drive_node.speed_mps=0.1; seed=3"', None),
    'namespace': ('', 'of all nodes and topics but /clock', None),
    'use_sim_time': ('', 'parameter of all nodes; they work either way', ('', 'true', 'false')),
    'cmd_vel_type': ('', 'what drive_node publishes; empty for that of the scenario',
                     ('', 'Twist', 'TwistStamped')),
    'log_level': ('', 'of all nodes; empty for info',
                  ('', 'debug', 'info', 'warn', 'error', 'fatal')),
}


def _scenario(values: dict[str, str]) -> Scenario:
    """Return the resolved scenario that the arguments describe."""
    overrides = [text.strip() for text in values['set'].split(';') if text.strip()]
    if values['duration']:
        overrides.append(f'run.duration_s={values["duration"]}')
    if values['time_mode']:
        overrides.append(f'time_mode={values["time_mode"]}')
    if values['cmd_vel_type']:
        stamped = str(values['cmd_vel_type'] == 'TwistStamped').lower()
        overrides.append(f'drive_node.enable_stamped_cmd_vel={stamped}')
    try:
        seed = int(values['seed']) if values['seed'] else None
    except ValueError:
        raise ConfigError(f'seed: {values["seed"]!r} is not valid; valid is a whole number') \
            from None
    scenario = Scenario.load(values['scenario'], overrides, seed=seed,
                             rover=values['rover'] or None, world=values['world'] or None)
    return resolve(with_slam(scenario, values['slam']) if values['slam'] else scenario)


def _start(context: LaunchContext) -> list[Any]:
    check_launch_arguments(context.argv, _ARGUMENTS)
    values = {name: LaunchConfiguration(name).perform(context) for name in _ARGUMENTS}
    if not values['output']:
        raise ConfigError("output: '' is not valid; valid is a folder that does not exist")
    scenario = _scenario(values)
    folder = Path(values['output']).resolve()
    check_new_folder(folder, 'output')
    world = Path(values['world'] or scenario.world_folder()).resolve()
    options = []
    if values['use_sim_time']:
        options += ['-p', f'use_sim_time:={values["use_sim_time"]}']
    if values['log_level']:
        options += ['--log-level', values['log_level']]
    nodes = {
        # Not `parameters`: launch would write them to files of its own.
        plan.name: Node(package='lunar_rover_sim', executable=plan.name, name=plan.name,
                        namespace=values['namespace'] or None, output='screen',
                        sigterm_timeout='15',
                        ros_arguments=[*plan.ros_arguments(folder / SCENARIO_FILE)[1:], *options])
        for plan in prepare(scenario, folder, world)}
    ended = OnProcessExit(target_action=lambda action: action in nodes.values(),
                          on_exit=_Exits(nodes, folder / BAG_FOLDER,
                                         scenario.run.may_fail).on_exit)
    return [RegisterEventHandler(ended), *_logs(nodes, folder / LOG_FOLDER), *nodes.values()]


def _logs(nodes: dict[str, Node], folder: Path) -> list[Any]:
    """Return the actions that write what each node prints to a file of its own."""
    folder.mkdir()
    actions = []
    for name, node in nodes.items():
        path = folder / f'{name}.log'
        path.touch()

        def write(event: Any, path: Path = path) -> None:
            with path.open('ab') as log:
                log.write(event.text)

        actions.append(RegisterEventHandler(OnProcessIO(target_action=node, on_stdout=write,
                                                        on_stderr=write)))
    return actions


class _Exits:
    """Does what is to follow when a node of one rover has ended."""

    def __init__(self, nodes: dict[str, Node], bag: Path, may_fail: tuple[str, ...]) -> None:
        self._nodes = nodes
        self._bag = bag
        self._ending = Ending(nodes, may_fail)

    def on_exit(self, event: Any, context: LaunchContext) -> list[Any]:
        """Stop the next nodes; raise RuntimeError, which ends the launch, if the run has failed.

        On Ctrl-C a node may be faster than launch itself.
        """
        name = next(name for name, node in self._nodes.items() if node is event.action)
        step = self._ending.after(name, f'{name} has ended with status {event.returncode}',
                                  event.returncode in DONE, context.is_shutdown)
        if step.mark:
            mark_failed(self._bag, step.mark)
        if step.failure:
            raise RuntimeError(step.failure)
        # Without processes the launch ends by itself, once another rover has finished too.
        return [*([LogInfo(msg=step.lost)] if step.lost else []),
                *(EmitEvent(event=ShutdownProcess(process_matcher=matches_action(
                    self._nodes[stopped]))) for stopped in step.stop)]


def generate_launch_description() -> LaunchDescription:
    """Return the nodes of the scenario."""
    return LaunchDescription(
        [DeclareLaunchArgument(name, default_value=default, description=text, choices=choices)
         for name, (default, text, choices) in _ARGUMENTS.items()]
        + [OpaqueFunction(function=_start)])
