"""The plan of a run: which nodes start, with which parameters.

It needs no ROS: `record` and the launch file both start what `prepare` returns.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
import dataclasses
import difflib
import json
import math
from operator import attrgetter
from pathlib import Path
from typing import Any

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import BAG_FOLDER, make_new_folder
from lunar_rover_sim.base.parameters import replaced
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.rover.description import save_rover
from lunar_rover_sim.rover.gait.calibration import packaged_calibration
from lunar_rover_sim.run.checkpoint import Checkpoint, CHECKPOINT_FOLDER
from lunar_rover_sim.run.node_config import (FOLLOWS, LEG_CONTROLLERS, LIDAR, LIDAR_TOPICS,
                                             NODE_CONFIGS)
from lunar_rover_sim.run.publication import is_recorded
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.run.scenario_checks import check_scenario
from lunar_rover_sim.run.waits import (awaits_lidar, awaits_others, extended, lags_of_answers,
                                       mapped_topic, participants_of, records_scans,
                                       wait_parameters)

SCENARIO_FILE = 'scenario.yaml'
ROVER_FILE = 'rover.yaml'
WORLD_LINK = 'world'
LOG_FOLDER = 'logs'

# The order in which nodes are stopped: the recorder last, since it records the others.
STOP_ORDER = ('drive_node', 'physics_node', *LEG_CONTROLLERS, 'render_node', 'lidar_node',
              'slam_node', 'mapping_node', 'navigator_node', 'recorder_node')

# Those that write their states at checkpoints.
RESUMED_NODES = ('drive_node', 'physics_node', 'gait_controller_node', 'render_node',
                 'lidar_node', 'mapping_node', 'navigator_node', 'recorder_node')

_ALIKE = 0.7        # least similarity of a mistyped name, from 0 to 1


@dataclasses.dataclass(frozen=True)
class NodePlan:
    """One node process.

    Attributes:
        name: Of the node and of its console script.
        parameters: Name → value: paths on this machine, topics.
    """

    name: str
    parameters: dict[str, str | bool | tuple[str, ...]]

    def ros_arguments(self, params_file: Path) -> list[str]:
        """Return the arguments of the process."""
        arguments = ['--ros-args', '--params-file', str(params_file)]
        for name, value in self.parameters.items():
            # The quotes keep a path of digits text.
            arguments += ['-p', f'{name}:={json.dumps(value, ensure_ascii=False)}']
        return arguments


def resolve(scenario: Scenario) -> Scenario:
    """Return the scenario with the parameters that depend on the nodes of the run.

    The duration is rounded up to whole camera frames, and to whole scans of a LiDAR. In lockstep
    physics waits for the gait controller, the renderer (at most one frame behind), the LiDAR where
    its scans are recorded, and the recorder; the gait controller waits for drive_node, unless that
    publishes Twist, which has no stamp. There are no checkpoints at which it could not go on.

    Raises:
        ConfigError: If the scenario says where the bag is, or nobody gives what a node maps or
            drives by.
        LearningError: If the policy to walk by cannot be used.
    """
    check_scenario(scenario)
    for name in ('output', 'scenario_file'):
        value = getattr(scenario.recorder_node, name)
        if value:
            raise ConfigError(f'recorder_node.{name}: {value!r} is not valid in a run, which '
                              'places the bag itself; leave it out')
    scenario = replaced(scenario, _following(scenario))
    if scenario.shared.lockstep:
        scenario = replaced(scenario, wait_parameters(scenario))
    if why_no_checkpoints(scenario):
        scenario = replaced(scenario, {'physics_node.checkpoint_period_s': 0.0})
    return scenario


def why_no_checkpoints(scenario: Scenario) -> str:
    """Return why a resolved scenario could not go on at a checkpoint; '' where it can."""
    others = [name for name in scenario.run.nodes if name not in RESUMED_NODES]
    if not scenario.shared.lockstep:
        return 'in time_mode real_time'
    if others:
        return f'with {", ".join(others)}, whose state is not kept'
    if scenario.run.may_fail:
        return f'with run.may_fail: {", ".join(scenario.run.may_fail)}'
    if awaits_others(scenario):
        return 'where time waits for programs that the run does not start'
    return ''


def _checkpoint_period_s(scenario: Scenario, step_ns: int) -> float:
    """Return the period, rounded up to where all that has a period is due [s]."""
    render, nodes = scenario.render_node, scenario.run.nodes
    step_ns = math.lcm(step_ns, scenario.physics_node.ground_period_ns, *(
        output.period_ns for camera in render.cameras for output in camera.outputs),
        *(NS_PER_S // getattr(scenario, name).rate_hz
          for name in ('drive_node', 'navigator_node') if name in nodes))
    period_ns = round(scenario.physics_node.checkpoint_period_s * 1e9)
    return -(-period_ns // step_ns) * step_ns / 1e9


def _following(scenario: Scenario) -> dict[str, Any]:
    """Return the parameters that follow from those of other nodes, by their dotted names."""
    nodes, physics = scenario.run.nodes, scenario.physics_node
    gait, render, lidar = (scenario.gait_controller_node, scenario.render_node,
                           scenario.lidar_node)
    with_scans = awaits_lidar(scenario)
    step_ns = render.frame_period_ns
    if with_scans:
        step_ns = math.lcm(step_ns, lidar.period_ns)
    step_s = step_ns / 1e9
    duration_s = round(math.ceil(round(scenario.run.duration_s / step_s, 6)) * step_s, 9)
    ground_gives = physics.ground.deforms and 'physics_node' in nodes
    values = {name: attrgetter(other)(scenario) for name, other in FOLLOWS.items()}
    values |= {
        'run.duration_s': duration_s, 'physics_node.duration_s': duration_s,
        'physics_node.checkpoint_period_s': _checkpoint_period_s(scenario, step_ns),
        # In real time nothing is awaited, but time starts only when these have publishers.
        'physics_node.wait': extended(physics.wait, lags_of_answers(
            scenario, render.frame_period_ns / 1e9)),
        # The controllers of the legs do not know the ground.
        'gait_controller_node.calibration':
            gait.calibration or packaged_calibration(physics.ground.name, scenario.rover.name),
        'policy_node.ground': scenario.policy_node.ground or physics.ground.name,
        'render_node.await_ground': render.await_ground or ground_gives,
        'lidar_node.await_ground': lidar.await_ground or ground_gives}
    for name in ('drive_node', 'navigator_node'):
        if name in nodes:
            if getattr(scenario, name).end_after_s >= 0.0:
                values['physics_node.end_when_navigated'] = True
            # There every topic with a period has a message.
            values[f'{name}.end_step_s'] = math.lcm(step_ns, NS_PER_S) / 1e9
    if 'navigator_node' in nodes:
        values['navigator_node.map_period_s'] = (
            lidar.period_ns if scenario.mapping_node.depth == LIDAR else render.depth_period_ns
        ) / 1e9
    if with_scans and not lidar.await_readers:
        values['lidar_node.await_readers'] = tuple(
            name for name in LIDAR_TOPICS
            if (name in scenario.recorder_node.topics and 'recorder_node' in nodes)
            or name == mapped_topic(scenario))
    excluded: list[str] = []
    if 'lidar_node' in nodes and not with_scans and not records_scans(scenario):
        # lidar_node follows the rover only while somebody reads one of its topics.
        excluded.append(topics.LIDAR_SCANNED.name)
    if not any(is_recorded(topic, scenario.recorder_node.topics, scenario.recorder_node.exclude)
               for topic in topics.OF_IMAGES):
        # Nobody exposes images for their times alone.
        excluded.append(topics.EXPOSURE.name)
    if excluded:
        values['recorder_node.exclude'] = tuple(dict.fromkeys(
            (*scenario.recorder_node.exclude, *excluded)))
    return values


def prepare(scenario: Scenario, folder: Path, world: Path,
            resumed: Checkpoint | None = None) -> list[NodePlan]:
    """Write the resolved scenario and the rover to the run's folder; return the nodes' plans.

    Args:
        resumed: The checkpoint at which the run in the folder goes on; all is there then.

    Raises:
        ConfigError: Where the folder exists or cannot be written: nothing is ever overwritten.
    """
    if not scenario.run.nodes:
        raise ConfigError(f'run.nodes: [] is not valid; valid are some of '
                          f'{", ".join(NODE_CONFIGS)}')
    if resumed is None:
        make_new_folder(folder, 'folder')
        atomic_write(folder / SCENARIO_FILE, scenario.to_yaml(), ConfigError)
        save_rover(scenario.rover, folder / ROVER_FILE)
        # Tools that read the bag later find its world here.
        (folder / WORLD_LINK).symlink_to(world)
    paths = {'world': str(world), 'rover': str(folder / ROVER_FILE)}
    participants = participants_of(scenario)
    plans = []
    for name in scenario.run.nodes:
        parameters: dict[str, str | bool | tuple[str, ...]] = dict(paths)
        if participants:
            parameters['participants'] = participants
        if scenario.physics_node.checkpoint_period_s:
            parameters['checkpoints'] = str(folder / CHECKPOINT_FOLDER)
        if resumed is not None:
            parameters['resume_from'] = str(resumed.folder)
        if name == 'physics_node' and scenario.physics_node.checkpoint_period_s:
            parameters['checkpoint_nodes'] = scenario.run.nodes
        if name == 'recorder_node':
            parameters['output'] = str(folder / BAG_FOLDER)
            parameters['scenario_file'] = str(folder / SCENARIO_FILE)
        plans.append(NodePlan(name, parameters))
    return plans


def check_launch_arguments(given: Iterable[str], valid: Collection[str]) -> None:
    """Raise ConfigError for a launch argument that is mistyped: `ros2 launch` ignores it.

    Args:
        given: `NAME:=VALUE`, perhaps with arguments of a launch file that includes this one.
        valid: The names of the arguments here.
    """
    for text in given:
        name, sign, _ = text.partition(':=')
        if sign and name not in valid:
            near = difflib.get_close_matches(name, valid, n=1, cutoff=_ALIKE)
            if near:
                raise ConfigError(f'{name}: no such launch argument; did you mean {near[0]}?')


def rover_overrides(rovers: Sequence[str], rover: str, recorded: bool) -> list[str]:
    """Return the overrides of a scenario, `section.parameter=value`, for one of several rovers.

    Each rover of a graph is in a namespace, with its own physics, on a world of its own that
    equals that of the others: rovers neither touch nor see each other. Each physics_node waits for
    the joint states of all others as for any participant. So in lockstep all have the same
    simulated time after every state; in real time they start together and follow the wall clock.
    The first publishes /clock for all, and begins when the recorders of all have subscribed it.

    Args:
        rovers: The namespaces of all rovers, without slashes.
        rover: One of them.
        recorded: Each rover has a recorder.
    """
    others = [other for other in rovers if other != rover]
    states = [f'/{other}/{topics.JOINT_STATES.name}' for other in others]
    overrides = [f'physics_node.wait.topics=[{", ".join(states)}]',
                 f'physics_node.wait.lags_s=[{", ".join(["0.0"] * len(states))}]',
                 f'physics_node.publish_clock={str(rover == rovers[0]).lower()}']
    if recorded:
        # A recorder tells that it is there when it has subscribed what participants publish.
        awaited = ([f'/{other}/{topics.RECORDED.name}' for other in others]
                   if rover == rovers[0] else [topics.CLOCK.graph_name])
        overrides.append(f'participants=[{", ".join(awaited)}]')
    return overrides
