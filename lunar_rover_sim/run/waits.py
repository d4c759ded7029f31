"""Who waits for whom in a run: topics, and how far they may lag behind simulated time."""

from __future__ import annotations

import dataclasses
from typing import Any

from lunar_rover_sim.base import topics
from lunar_rover_sim.run.node_config import (DEPTH_TOPICS, FRAME_TOPICS, LEG_CONTROLLERS,
                                             LIDAR_TOPICS)
from lunar_rover_sim.run.publication import period_of, recorded_beside_the_pair, recorded_periodic
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.run.shared_config import WaitConfig

_RENDERER_LAG_FRAMES = 2
_RECORDER_LAG_S = 0.5
_RECORDER_LAG_FRAMES = 5
_LIDAR_LAG_SCANS, _RECORDER_LAG_SCANS = 2, 4
# The gait controller reports a silent publisher of cmd_vel after this share of the time that
# physics allows. Otherwise physics would report the gait controller.
_GAIT_SILENCE_SHARE = 0.8


def wait_parameters(scenario: Scenario) -> dict[str, Any]:
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
        mapped = [name for name in (mapped_topic(scenario),) if name in FRAME_TOPICS]
        values['render_node.await_readers'] = tuple(dict.fromkeys(
            [*(name for name in acknowledge if name in FRAME_TOPICS), *mapped]))
    return values


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


def participants_of(scenario: Scenario) -> tuple[str, ...]:
    """Return the topics that any node of a resolved scenario waits for, and cmd_vel."""
    names = [*scenario.physics_node.wait.topics, *_controller_waits(scenario)]
    if not {'drive_node', 'navigator_node'}.isdisjoint(scenario.run.nodes):
        names.append(topics.CMD_VEL.name)
    # Recorded ones are waited for, so that the bag has them from the first frame on.
    names += recorded_beside_the_pair(scenario)
    return tuple(dict.fromkeys([*scenario.shared.participants, *names]))


def lags_of_answers(scenario: Scenario, frame_s: float) -> dict[str, float]:
    """Return topic → lag [s] of the run's own nodes for which physics waits."""
    lags_s = {}
    nodes = scenario.run.nodes
    if not set(nodes).isdisjoint(LEG_CONTROLLERS):
        lags_s[topics.JOINT_COMMANDS.name] = 0.0
    if 'render_node' in nodes:
        lags_s[topics.LEFT_INFO.name] = _RENDERER_LAG_FRAMES * frame_s
    if 'slam_node' in nodes:
        # One frame more: it is tracked while the next one is drawn.
        lags_s[topics.SLAM_STATUS.name] = round((_RENDERER_LAG_FRAMES + 1) * frame_s, 9)
    scan_s = scenario.lidar_node.period_ns / 1e9
    if 'mapping_node' in nodes:
        # As many frames more: it maps while the next ones are drawn.
        period_s = (scan_s if mapped_topic(scenario) in LIDAR_TOPICS
                    else scenario.render_node.depth_period_ns / 1e9)
        lags_s[topics.TRAVERSABILITY.name] = round(
            period_s + (_RENDERER_LAG_FRAMES + 1) * frame_s, 9)
    if awaits_lidar(scenario):
        # A scan is computed after its last state, while physics goes on by one more scan.
        lags_s[topics.LIDAR_SCANNED.name] = round(
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
        if awaits_lidar(scenario):
            lag_s = max(lag_s, _RECORDER_LAG_SCANS * scan_s)
        lags_s[topics.RECORDED.name] = round(lag_s, 9)
    return lags_s


def _wait_of(scenario: Scenario, controller: str) -> WaitConfig:
    """Return what a controller of the legs waits for."""
    physics, drive = scenario.physics_node, scenario.drive_node
    wait: WaitConfig = getattr(scenario, controller).wait
    if 'drive_node' in scenario.run.nodes and drive.mode != 'none' and (
            drive.enable_stamped_cmd_vel):
        wait = extended(wait, {topics.CMD_VEL.name: 1.0 / drive.rate_hz})
    navigator = scenario.navigator_node
    if 'navigator_node' in scenario.run.nodes and navigator.enable_stamped_cmd_vel:
        wait = extended(wait, {topics.CMD_VEL.name: 1.0 / navigator.rate_hz})
    if not wait.topics:
        return wait
    return dataclasses.replace(wait, silence_s=_share(wait.silence_s, physics.wait.silence_s),
                               start_s=_share(wait.start_s, physics.wait.start_s))


def _controller_waits(scenario: Scenario) -> tuple[str, ...]:
    """Return the topics that the controller of the legs waits for."""
    by_policy = 'policy_node' in scenario.run.nodes
    controller = scenario.policy_node if by_policy else scenario.gait_controller_node
    return controller.wait.topics


def mapped_topic(scenario: Scenario) -> str:
    """Return the topic of the depth that mapping_node reads; '' where it takes no part."""
    if 'mapping_node' not in scenario.run.nodes:
        return ''
    return DEPTH_TOPICS[scenario.mapping_node.depth].name


def awaits_lidar(scenario: Scenario) -> bool:
    """Return whether time waits for scans: those that the run records, or that the user names."""
    if 'lidar_node' not in scenario.run.nodes or 'lidar_node' in scenario.run.may_fail:
        return False
    return (records_scans(scenario) or mapped_topic(scenario) in LIDAR_TOPICS
            or topics.LIDAR_SCANNED.name in scenario.physics_node.wait.topics)


def records_scans(scenario: Scenario) -> bool:
    """Return whether the run records topics of the LiDAR by their names."""
    recorded = {name.lstrip('/') for name in scenario.recorder_node.topics}
    return 'recorder_node' in scenario.run.nodes and not recorded.isdisjoint(
        (*LIDAR_TOPICS, topics.LIDAR_SCANNED.name))


def extended(wait: WaitConfig, lag_s_by_topic: dict[str, float]) -> WaitConfig:
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
