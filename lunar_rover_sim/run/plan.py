"""The plan of a run: which nodes start, with which parameters, and which topics time waits for.

It needs no ROS: `record` and the launch file both start what `prepare` returns.
"""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

from lunar_rover_sim import topics
from lunar_rover_sim.bag.config import ALL
from lunar_rover_sim.camera.hazard import sides
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.atomic import atomic_write
from lunar_rover_sim.files.paths import make_new_folder
from lunar_rover_sim.gait.calibration import packaged_calibration
from lunar_rover_sim.rover.rover_file import save_rover
from lunar_rover_sim.run.node_config import (FRAME_TOPICS, LIDAR_TOPICS, LidarNodeConfig,
                                             NODE_CONFIGS)
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.run.shared_config import WaitConfig

SCENARIO_FILE = 'scenario.yaml'
ROVER_FILE = 'rover.yaml'
BAG_FOLDER = 'bag'
WORLD_LINK = 'world'
LOG_FOLDER = 'logs'

# The order in which nodes are stopped: the recorder last, since it records the others.
STOP_ORDER = ('drive_node', 'physics_node', 'gait_controller_node', 'render_node', 'lidar_node',
              'slam_node', 'recorder_node')

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

    name: of the node and of its console script
    parameters: name → value: paths on this machine, topics
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
    publishes Twist, which has no stamp. Raises ConfigError if the scenario says where the bag is.
    """
    nodes = scenario.run.nodes
    for name in ('output', 'scenario_file'):
        value = getattr(scenario.recorder_node, name)
        if value:
            raise ConfigError(f'recorder_node.{name}: {value!r} is not valid in a run, which '
                              'places the bag itself; leave it out')
    frame_s = scenario.render_node.frame_period_ns / 1e9
    step_s = frame_s
    if _awaits_lidar(scenario):
        step_s = 1e-9 * math.lcm(scenario.render_node.frame_period_ns,
                                 scenario.lidar_node.period_ns)
    duration_s = math.ceil(round(scenario.run.duration_s / step_s, 6)) * step_s
    duration_s = round(duration_s, 9)
    physics, gait = scenario.physics_node, scenario.gait_controller_node
    # The gait controller does not know the ground.
    gait = dataclasses.replace(gait, calibration=gait.calibration
                               or packaged_calibration(physics.ground.name))
    recorder, render = scenario.recorder_node, scenario.render_node
    physics = dataclasses.replace(physics, ground_rate_hz=render.frame_rate_hz, sun=render.sun)
    render = dataclasses.replace(render, await_ground=render.await_ground or (
        physics.ground.deforms and 'physics_node' in nodes))
    # In real time nothing is awaited, but time starts only when these topics have publishers.
    physics = dataclasses.replace(
        physics, wait=_extended(physics.wait, _answers(scenario, frame_s)))
    if 'lidar_node' in nodes and not _awaits_lidar(scenario) and not _records_scans(scenario):
        # lidar_node follows the rover only while somebody reads one of its topics.
        recorder = dataclasses.replace(recorder, exclude=tuple(
            dict.fromkeys((*recorder.exclude, topics.LIDAR_SCANNED.name))))
        scenario = dataclasses.replace(scenario, recorder_node=recorder)
    if scenario.shared.lockstep:
        drive = scenario.drive_node
        if 'drive_node' in nodes and drive.mode != 'none' and drive.enable_stamped_cmd_vel:
            gait = dataclasses.replace(gait, wait=_extended(
                gait.wait, {topics.CMD_VEL.name: 1.0 / scenario.drive_node.rate_hz}))
        if gait.wait.topics:
            gait = dataclasses.replace(gait, wait=dataclasses.replace(
                gait.wait, silence_s=_share(gait.wait.silence_s, physics.wait.silence_s),
                start_s=_share(gait.wait.start_s, physics.wait.start_s)))
        if not recorder.acknowledge:
            recorder = dataclasses.replace(recorder, acknowledge=_acknowledged(scenario))
        recorder = dataclasses.replace(recorder, acknowledge_periods_s=tuple(
            _period_s(scenario, name) for name in recorder.acknowledge))
        if 'render_node' in nodes and not render.await_readers:
            render = dataclasses.replace(render, await_readers=tuple(
                name for name in recorder.acknowledge if name in FRAME_TOPICS))
    return dataclasses.replace(
        scenario, run=dataclasses.replace(scenario.run, duration_s=duration_s),
        physics_node=dataclasses.replace(physics, duration_s=duration_s),
        gait_controller_node=gait, recorder_node=recorder, render_node=render,
        lidar_node=_resolved_lidar(scenario),
        slam_node=dataclasses.replace(
            scenario.slam_node, camera=render.camera, imu=physics.imu,
            frame_rate_hz=render.frame_rate_hz, imu_rate_hz=physics.state_rate_hz,
            gravity_mps2=physics.gravity_mps2))


def _resolved_lidar(scenario: Scenario) -> LidarNodeConfig:
    """Return the parameters of lidar_node that follow from those of others."""
    lidar, ground = scenario.lidar_node, scenario.physics_node.ground
    if not lidar.await_readers and _awaits_lidar(scenario):
        lidar = dataclasses.replace(lidar, await_readers=tuple(
            name for name in LIDAR_TOPICS if name in scenario.recorder_node.topics
            and 'recorder_node' in scenario.run.nodes))
    return dataclasses.replace(
        lidar, reflectance=scenario.render_node.reflectance,
        await_ground=lidar.await_ground or (ground.deforms
                                            and 'physics_node' in scenario.run.nodes))


def _awaits_lidar(scenario: Scenario) -> bool:
    """Return whether time waits for scans: those that the run records, or that the user names."""
    if 'lidar_node' not in scenario.run.nodes or 'lidar_node' in scenario.run.may_fail:
        return False
    return (_records_scans(scenario)
            or topics.LIDAR_SCANNED.name in scenario.physics_node.wait.topics)


def _records_scans(scenario: Scenario) -> bool:
    recorded = {name.lstrip('/') for name in scenario.recorder_node.topics}
    return 'recorder_node' in scenario.run.nodes and not recorded.isdisjoint(
        (*LIDAR_TOPICS, topics.LIDAR_SCANNED.name))


def with_slam(scenario: Scenario, command: str) -> Scenario:
    """Return the scenario with slam_node, which starts `command`, among its nodes."""
    nodes = tuple(dict.fromkeys((*scenario.run.nodes, 'slam_node')))
    return dataclasses.replace(
        scenario, run=dataclasses.replace(scenario.run, nodes=nodes),
        slam_node=dataclasses.replace(scenario.slam_node, command=command))


def _answers(scenario: Scenario, frame_s: float) -> dict[str, float]:
    """Return topic → lag [s] of the run's own nodes for which physics waits."""
    awaited = {}
    nodes = scenario.run.nodes
    if 'gait_controller_node' in nodes:
        awaited[topics.JOINT_COMMANDS.name] = 0.0
    if 'render_node' in nodes:
        awaited[topics.LEFT_INFO.name] = _RENDERER_LAG_FRAMES * frame_s
    if 'slam_node' in nodes:
        # One frame more: it is tracked while the next one is drawn.
        awaited[topics.SLAM_STATUS.name] = round((_RENDERER_LAG_FRAMES + 1) * frame_s, 9)
    scan_s = scenario.lidar_node.period_ns / 1e9
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
            if 'slam_node' in nodes:
                least += 1
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
    """Return the periodic topics of the contract that this run publishes and records."""
    recorder = scenario.recorder_node
    result = []
    for topic in topics.CONTRACT:
        periodic = topic.rate in (topics.STATE, topics.FRAME, topics.DEPTH_FRAME, topics.SCAN)
        if topic.node not in scenario.run.nodes or not periodic:
            continue
        if topic in _unpublished(scenario) or topic.node in scenario.run.may_fail:
            continue
        # The same choice as in recorder_node.
        in_all = (ALL in recorder.topics and topic.name not in recorder.exclude
                  and not topic.on_request)
        if in_all or topic.name in recorder.topics:
            result.append(topic.graph_name)
    return tuple(result)


def _period_s(scenario: Scenario, name: str) -> float:
    """Return the period [s] of a topic of the contract; 0 if it has none."""
    render = scenario.render_node
    period_ns = {topics.STATE: scenario.physics_node.state_period_ns,
                 topics.FRAME: render.frame_period_ns,
                 topics.DEPTH_FRAME: render.depth_period_ns,
                 topics.SCAN: scenario.lidar_node.period_ns}
    rates = [topic.rate for topic in topics.CONTRACT if topic.graph_name == name]
    return period_ns.get(rates[0], 0) / 1e9 if rates else 0.0


def _unpublished(scenario: Scenario) -> tuple[topics.Topic, ...]:
    """Return the topics that are not published in this run, or perhaps not."""
    separate = scenario.shared.separate_truth
    clock = () if scenario.physics_node.publish_clock else (topics.CLOCK,)
    ground = () if scenario.physics_node.ground.deforms else topics.OF_SOFT_GROUND
    # tf2_msgs and vision_msgs may be missing.
    odometry = topics.ODOM if separate else topics.TRUE_ODOM
    return topics.TF, *topics.OF_VISION, odometry, *clock, *ground


def awaits_others(scenario: Scenario) -> bool:
    """Return whether time waits for programs that a resolved scenario does not start."""
    of_run = {topic.name for topic in topics.CONTRACT if topic.node in scenario.run.nodes}
    return not of_run.issuperset((*scenario.physics_node.wait.topics,
                                  *scenario.gait_controller_node.wait.topics))


def _participants(scenario: Scenario) -> tuple[str, ...]:
    """Return the topics that any node of a resolved scenario waits for, and cmd_vel."""
    awaited = [*scenario.physics_node.wait.topics, *scenario.gait_controller_node.wait.topics]
    if 'drive_node' in scenario.run.nodes:
        awaited.append(topics.CMD_VEL.name)
    # Recorded ones are waited for, so that the bag has them from the first frame on.
    awaited += _recorded_hazards(scenario)
    return tuple(dict.fromkeys([*scenario.shared.participants, *awaited]))


def _recorded_hazards(scenario: Scenario) -> list[str]:
    """Return the topics of hazard cameras that are offered and recorded."""
    if not {'render_node', 'recorder_node'} <= set(scenario.run.nodes):
        return []
    offered = [topic.name for name, hazard in scenario.render_node.hazard.items()
               for camera in sides(name, hazard) for topic in topics.hazard(camera)]
    return [name for name in offered if name in scenario.recorder_node.topics]


def prepare(scenario: Scenario, folder: Path, world: Path) -> list[NodePlan]:
    """Write the resolved scenario and the rover to the run's folder; return the nodes' plans.

    Raises ConfigError where the folder exists or cannot be written: nothing is ever overwritten.
    """
    if not scenario.run.nodes:
        raise ConfigError(f'run.nodes: [] is not valid; valid are some of '
                          f'{", ".join(NODE_CONFIGS)}')
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
        if name == 'recorder_node':
            parameters['output'] = str(folder / BAG_FOLDER)
            parameters['scenario_file'] = str(folder / SCENARIO_FILE)
        plans.append(NodePlan(name, parameters))
    return plans
