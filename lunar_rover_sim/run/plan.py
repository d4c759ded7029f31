"""The plan of a run: which nodes start, with which parameters, and which topics time waits for.

It needs no ROS: `record` and the launch file both start what `prepare` returns.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
import contextlib
import dataclasses
import difflib
import json
import math
from operator import attrgetter
from pathlib import Path
from typing import Any

from lunar_rover_sim.autonomy.navigation.config import SLAM
from lunar_rover_sim.autonomy.path_following.route import make_route
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import BAG_FOLDER, make_new_folder
from lunar_rover_sim.base.parameters import replaced
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.rover.description import save_rover
from lunar_rover_sim.rover.gait.calibration import packaged_calibration
from lunar_rover_sim.run.checkpoint import Checkpoint, CHECKPOINT_FOLDER
from lunar_rover_sim.run.child_process import executable, program_words
from lunar_rover_sim.run.node_config import (DEPTH_TOPICS, FOLLOWS, FRAME_TOPICS, LEG_CONTROLLERS,
                                             LIDAR, LIDAR_TOPICS, NODE_CONFIGS)
from lunar_rover_sim.run.publication import (is_recorded, period_of, recorded_beside_the_pair,
                                             recorded_periodic)
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.run.shared_config import WaitConfig

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

_WAYPOINT_STEP_M = 1.5      # between the waypoints that the navigator gets of a route
_WAY_TIMES = 3.0            # the time that a way may take, over that of the straight one
_ALIKE = 0.7        # least similarity of a mistyped name, from 0 to 1
_RENDERER_LAG_FRAMES = 2
_RECORDER_LAG_S = 0.5
_RECORDER_LAG_FRAMES = 5
_LIDAR_LAG_SCANS, _RECORDER_LAG_SCANS = 2, 4
# The gait controller reports a silent publisher of cmd_vel after this share of the time that
# physics allows. Otherwise physics would report the gait controller.
_GAIT_SILENCE_SHARE = 0.8


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
        scenario = replaced(scenario, _awaited(scenario))
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
    awaits_lidar = _awaits_lidar(scenario)
    step_ns = render.frame_period_ns
    if awaits_lidar:
        step_ns = math.lcm(step_ns, lidar.period_ns)
    step_s = step_ns / 1e9
    duration_s = round(math.ceil(round(scenario.run.duration_s / step_s, 6)) * step_s, 9)
    ground_gives = physics.ground.deforms and 'physics_node' in nodes
    values = {name: attrgetter(other)(scenario) for name, other in FOLLOWS.items()}
    values |= {
        'run.duration_s': duration_s, 'physics_node.duration_s': duration_s,
        'physics_node.checkpoint_period_s': _checkpoint_period_s(scenario, step_ns),
        # In real time nothing is awaited, but time starts only when these have publishers.
        'physics_node.wait': _extended(physics.wait,
                                       _answers(scenario, render.frame_period_ns / 1e9)),
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
    if awaits_lidar and not lidar.await_readers:
        values['lidar_node.await_readers'] = tuple(
            name for name in LIDAR_TOPICS
            if (name in scenario.recorder_node.topics and 'recorder_node' in nodes)
            or name == _mapped(scenario))
    excluded: list[str] = []
    if 'lidar_node' in nodes and not awaits_lidar and not _records_scans(scenario):
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


def _awaited(scenario: Scenario) -> dict[str, Any]:
    """Return the parameters by which the nodes of a run in lockstep wait for each other."""
    nodes = scenario.run.nodes
    acknowledge = scenario.recorder_node.acknowledge or _acknowledged(scenario)
    periods_ns = {topic.graph_name: period_of(scenario, topic) for topic in topics.of_legs(
        topics.CONTRACT, scenario.rover.legs.names)}
    values: dict[str, Any] = {
        **{f'{name}.wait': _wait_of(scenario, name) for name in LEG_CONTROLLERS},
        'recorder_node.acknowledge': acknowledge,
        'recorder_node.acknowledge_periods_s': tuple(
            periods_ns.get(name, 0) / 1e9 for name in acknowledge)}
    if 'render_node' in nodes and not scenario.render_node.await_readers:
        mapped = [name for name in (_mapped(scenario),) if name in FRAME_TOPICS]
        values['render_node.await_readers'] = tuple(dict.fromkeys(
            [*(name for name in acknowledge if name in FRAME_TOPICS), *mapped]))
    return values


def _wait_of(scenario: Scenario, controller: str) -> WaitConfig:
    """Return what a controller of the legs waits for."""
    physics, drive = scenario.physics_node, scenario.drive_node
    wait: WaitConfig = getattr(scenario, controller).wait
    if 'drive_node' in scenario.run.nodes and drive.mode != 'none' and (
            drive.enable_stamped_cmd_vel):
        wait = _extended(wait, {topics.CMD_VEL.name: 1.0 / drive.rate_hz})
    navigator = scenario.navigator_node
    if 'navigator_node' in scenario.run.nodes and navigator.enable_stamped_cmd_vel:
        wait = _extended(wait, {topics.CMD_VEL.name: 1.0 / navigator.rate_hz})
    if not wait.topics:
        return wait
    return dataclasses.replace(wait, silence_s=_share(wait.silence_s, physics.wait.silence_s),
                               start_s=_share(wait.start_s, physics.wait.start_s))


def _controller_waits(scenario: Scenario) -> tuple[str, ...]:
    """Return the topics that the controller of the legs waits for."""
    by_policy = 'policy_node' in scenario.run.nodes
    controller = scenario.policy_node if by_policy else scenario.gait_controller_node
    return controller.wait.topics


def _mapped(scenario: Scenario) -> str:
    """Return the topic of the depth that mapping_node reads; '' where it takes no part."""
    if 'mapping_node' not in scenario.run.nodes:
        return ''
    return DEPTH_TOPICS[scenario.mapping_node.depth].name


def _awaits_lidar(scenario: Scenario) -> bool:
    """Return whether time waits for scans: those that the run records, or that the user names."""
    if 'lidar_node' not in scenario.run.nodes or 'lidar_node' in scenario.run.may_fail:
        return False
    return (_records_scans(scenario) or _mapped(scenario) in LIDAR_TOPICS
            or topics.LIDAR_SCANNED.name in scenario.physics_node.wait.topics)


def _records_scans(scenario: Scenario) -> bool:
    recorded = {name.lstrip('/') for name in scenario.recorder_node.topics}
    return 'recorder_node' in scenario.run.nodes and not recorded.isdisjoint(
        (*LIDAR_TOPICS, topics.LIDAR_SCANNED.name))


def with_slam(scenario: Scenario, command: str, maps: Path | None = None,
              near_m: tuple[float, float] | None = None, doubt_m: float = 50.0) -> Scenario:
    """Return the scenario with slam_node among its nodes.

    Args:
        command: The program that it starts, or `graph` for its own.
        maps: With `graph`: folder of maps from orbit, on which it finds its place.
        near_m: Place that the start is near to; None: the start of the scenario, where the rover
            was to be set down.
        doubt_m: Radius around it.

    Raises:
        ConfigError: If the command is empty or no line of a shell, the maps are not for this
            program, or a node drives by its poses.
        ProcessError: If there is no such program.
        WorldError: If the maps cannot be read.
    """
    nodes = tuple(dict.fromkeys((*scenario.run.nodes, 'slam_node')))
    is_graph = command == 'graph'
    if not is_graph:
        executable(program_words(command, '--slam')[0])
    on_maps: dict[str, Any] = {}
    if maps is not None:
        if not is_graph:
            raise ConfigError(f'--orbital: is for --slam graph, and the program is {command}')
        # It takes time to import, which other runs need not wait for.
        from lunar_rover_sim.ground.world.orbital_map import OrbitalMap
        OrbitalMap.load(maps)       # what is wrong with them is said before anything starts
        start = scenario.physics_node.start
        x, y = (start.x_m, start.y_m) if near_m is None else near_m
        on_maps = {'slam_node.maps': str(maps.resolve()), 'slam_node.near_x_m': x,
                   'slam_node.near_y_m': y, 'slam_node.doubt_m': doubt_m,
                   'slam_node.frame_id': scenario.slam_node.truth.frame_id}
    return replaced(scenario, {
        'run.nodes': nodes, 'slam_node.system': 'graph' if is_graph else 'command',
        'slam_node.command': '' if is_graph else command, **on_maps})


def without_node(scenario: Scenario, name: str) -> Scenario:
    """Return the scenario without one of its nodes."""
    return replaced(scenario, {'run.nodes': tuple(n for n in scenario.run.nodes if n != name)})


def with_policy(scenario: Scenario, policy: str) -> Scenario:
    """Return the scenario with policy_node in the place of gait_controller_node.

    Args:
        policy: A file, or the name of a packaged policy.

    Raises:
        LearningError: The policy cannot be read, or is not for the rover of the scenario.
    """
    # It takes a second to import, which other runs need not wait for.
    from lunar_rover_sim.autonomy.learning.controller import PolicyController
    controller = PolicyController.load(policy, scenario.rover)
    nodes = tuple('policy_node' if name == 'gait_controller_node' else name
                  for name in scenario.run.nodes)
    return replaced(scenario, {'run.nodes': nodes,
                               'policy_node.policy': str(controller.policy.path.resolve())})


def with_navigator(scenario: Scenario, goals_m: Sequence[tuple[float, float]]) -> Scenario:
    """Return the scenario with mapping_node, and navigator_node in place of drive_node.

    Args:
        goals_m: Waypoints, the last of which is the goal; none: those of the scenario.

    Raises:
        ConfigError: If there is no goal at all.
    """
    nodes = [name for name in scenario.run.nodes
             if name not in ('drive_node', 'mapping_node', 'navigator_node')]
    values: dict[str, Any] = {'run.nodes': (*nodes, 'mapping_node', 'navigator_node')}
    if goals_m:
        *between, (x, y) = goals_m
        values |= {'navigator_node.has_goal': True, 'navigator_node.goal_x_m': float(x),
                   'navigator_node.goal_y_m': float(y),
                   'navigator_node.waypoints_x_m': tuple(float(p[0]) for p in between),
                   'navigator_node.waypoints_y_m': tuple(float(p[1]) for p in between)}
    scenario = replaced(scenario, values)
    if not scenario.navigator_node.goals:
        raise ConfigError('navigator_node.has_goal: false is not valid here; valid is a goal or '
                          'waypoints')
    return scenario


def check_places(scenario: Scenario) -> None:
    """Raise ConfigError if the start, or a goal of the navigator, lies beyond the site."""
    start = scenario.physics_node.start
    places = [('physics_node.start', (start.x_m, start.y_m))]
    if 'navigator_node' in scenario.run.nodes:
        places += [('goal', goal) for goal in scenario.navigator_node.goals]
    half_m = max(0.5 * scenario.world.size_m, 500.0 * scenario.world.site_km)
    for name, place in places:
        if max(map(abs, place)) > half_m:
            raise ConfigError(f'{name}: x {place[0]:g} m, y {place[1]:g} m is beyond the site; '
                              f'valid are -{half_m:g} to {half_m:g} m, see world.site_km')


def check_scenario(scenario: Scenario) -> None:
    """Check what needs no world: depth that is mapped, pose, policy, gait and physics.

    A program of the user may give depth and pose: time waits for it, or its topic is a
    participant's. Where physics runs elsewhere, so may the others.

    Raises:
        ConfigError: If nobody gives depth or pose, gait or start are for another number of legs,
            or steps are too long for the contacts.
        LearningError: If there is no such policy, or it is not for the rover.
        PhysicsError: If the rover cannot be simulated.
    """
    nodes, depth = scenario.run.nodes, scenario.mapping_node.depth
    given = {*scenario.physics_node.wait.topics, *scenario.shared.participants}
    needs = {'mapping_node.depth': (depth, DEPTH_TOPICS[depth], '')}
    needs |= {f'{name}.pose': (SLAM, topics.SLAM_POSE, ' (--slam)')
              for name in ('mapping_node', 'navigator_node')
              if getattr(scenario, name).pose == SLAM}
    for name, (value, topic, option) in needs.items():
        if ({'physics_node', name.partition('.')[0]} <= set(nodes) and topic.node not in nodes
                and topic.name not in given):
            raise ConfigError(f'{name}: {value!r} is not valid without {topic.node} in run.nodes'
                              f'{option}, or {topic.name} in physics_node.wait.topics')
    if 'policy_node' in nodes:
        with_policy(scenario, scenario.policy_node.policy)
    if 'gait_controller_node' in nodes:
        with _parameters_of('gait_controller_node'):
            scenario.gait_controller_node.for_rover(scenario.rover)
    if 'physics_node' in nodes:
        # MuJoCo takes 0.1 s to import, and the rest of this module does not need it.
        from lunar_rover_sim.rover.physics.model import check_contacts
        from lunar_rover_sim.rover.physics.placing import check_joint_angles
        with _parameters_of('physics_node'):
            check_joint_angles(scenario.physics_node.start, scenario.rover)
            check_contacts(scenario.rover, scenario.physics_node)


@contextlib.contextmanager
def _parameters_of(node: str) -> Iterator[None]:
    """Name the node in errors of its parameters."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(f'{node}.{error}') from None


def with_route(scenario: Scenario, shape: str, avoid: bool) -> Scenario:
    """Return the scenario with a ready-made route from its start on.

    Args:
        shape: One of `drive_node.shape`; its size is `drive_node.shape_size_m`.
        avoid: The navigator drives it, from one waypoint to the next; else drive_node, blindly.
    """
    scenario = replaced(scenario, {
        'drive_node.shape': shape, 'drive_node.relative': False,
        'drive_node.mode': (scenario.drive_node.mode if scenario.drive_node.mode in
                            ('waypoints', 'spline') else 'spline')})
    if not avoid:
        return scenario
    start, drive = scenario.physics_node.start, scenario.drive_node
    route = make_route(drive, (start.x_m, start.y_m), math.radians(start.yaw_deg))
    count = max(2, math.ceil(route.length_m / _WAYPOINT_STEP_M))
    return with_navigator(scenario, [(float(x), float(y)) for x, y in route.at(
        [route.length_m * k / count for k in range(1, count + 1)])])


def navigated_duration_s(scenario: Scenario) -> float:
    """Return a time in which the navigator has arrived, or never will [s]."""
    start, nav = scenario.physics_node.start, scenario.navigator_node
    points = [(start.x_m, start.y_m), *nav.goals]
    way = sum(math.dist(a, b) for a, b in zip(points, points[1:]))
    # A near goal may lie behind a wall.
    return max(300.0, 60.0 + math.ceil(_WAY_TIMES * way / nav.speed_mps))


def _answers(scenario: Scenario, frame_s: float) -> dict[str, float]:
    """Return topic → lag [s] of the run's own nodes for which physics waits."""
    awaited = {}
    nodes = scenario.run.nodes
    if not set(nodes).isdisjoint(LEG_CONTROLLERS):
        awaited[topics.JOINT_COMMANDS.name] = 0.0
    if 'render_node' in nodes:
        awaited[topics.LEFT_INFO.name] = _RENDERER_LAG_FRAMES * frame_s
    if 'slam_node' in nodes:
        # One frame more: it is tracked while the next one is drawn.
        awaited[topics.SLAM_STATUS.name] = round((_RENDERER_LAG_FRAMES + 1) * frame_s, 9)
    scan_s = scenario.lidar_node.period_ns / 1e9
    if 'mapping_node' in nodes:
        # As many frames more: it maps while the next ones are drawn.
        period_s = (scan_s if _mapped(scenario) in LIDAR_TOPICS
                    else scenario.render_node.depth_period_ns / 1e9)
        awaited[topics.TRAVERSABILITY.name] = round(
            period_s + (_RENDERER_LAG_FRAMES + 1) * frame_s, 9)
    if _awaits_lidar(scenario):
        # A scan is computed after its last state, while physics goes on by one more scan.
        awaited[topics.LIDAR_SCANNED.name] = round(
            _LIDAR_LAG_SCANS * scan_s + (frame_s if scenario.physics_node.ground.deforms else 0.0),
            9)
    if 'recorder_node' in nodes and _acknowledged(scenario):
        lag_s = _RECORDER_LAG_S
        if 'render_node' in nodes:
            # Images are written after they are published, and the renderer may lag.
            least = _RENDERER_LAG_FRAMES + 2
            if 'slam_node' in nodes or 'mapping_node' in nodes:
                least += 1
            if 'mapping_node' in nodes:
                least += scenario.render_node.depth_every
            lag_s = max(min(lag_s, _RECORDER_LAG_FRAMES * frame_s), least * frame_s)
        if _awaits_lidar(scenario):
            lag_s = max(lag_s, _RECORDER_LAG_SCANS * scan_s)
        awaited[topics.RECORDED.name] = round(lag_s, 9)
    return awaited


def _extended(wait: WaitConfig, lag_s_by_topic: dict[str, float]) -> WaitConfig:
    """Return `wait` with the topics that it lacks; the scenario's own entries stay."""
    new = {t: lag for t, lag in lag_s_by_topic.items() if t not in wait.topics}
    return dataclasses.replace(wait, topics=(*wait.topics, *new),
                               lags_s=(*wait.lags_s, *new.values()))


def _share(limit_s: float, physics_s: float) -> float:
    """Return a limit of the gait controller, below that of physics [s]."""
    return max(0.1, min(limit_s, round(physics_s * _GAIT_SILENCE_SHARE, 3)))


def _acknowledged(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the topics whose stamps make `recorder/written`."""
    return tuple(topic.graph_name for topic in recorded_periodic(scenario))


def awaits_others(scenario: Scenario) -> bool:
    """Return whether time waits for programs that a resolved scenario does not start."""
    of_run = {topic.name for topic in topics.of_legs(topics.CONTRACT, scenario.rover.legs.names)
              if topic.node in scenario.run.nodes}
    # The contract names one of those that publish these.
    if 'policy_node' in scenario.run.nodes:
        of_run.add(topics.JOINT_COMMANDS.name)
    if 'navigator_node' in scenario.run.nodes:
        of_run.add(topics.CMD_VEL.name)
    return not of_run.issuperset((*scenario.physics_node.wait.topics,
                                  *_controller_waits(scenario)))


def _participants(scenario: Scenario) -> tuple[str, ...]:
    """Return the topics that any node of a resolved scenario waits for, and cmd_vel."""
    awaited = [*scenario.physics_node.wait.topics, *_controller_waits(scenario)]
    if not {'drive_node', 'navigator_node'}.isdisjoint(scenario.run.nodes):
        awaited.append(topics.CMD_VEL.name)
    # Recorded ones are waited for, so that the bag has them from the first frame on.
    awaited += recorded_beside_the_pair(scenario)
    return tuple(dict.fromkeys([*scenario.shared.participants, *awaited]))


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
    participants = _participants(scenario)
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
