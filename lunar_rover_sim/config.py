"""Scenarios: one YAML file, itself a ROS 2 parameter file, that says all of a run.

Sections are `/**` (shared by all nodes), one per node, and three that no node reads by itself:
`world` (the recipe of the terrain), `rover` (deviations from config/rover.yaml) and `run`. Every
section holds `ros__parameters`, so that `ros2 run … --params-file scenario.yaml` takes it as is.
Defaults live in the dataclasses; a file only overrides.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import dataclasses
from pathlib import Path
from typing import Any

import yaml

from lunar_rover_sim import topics
from lunar_rover_sim.bag.config import RecorderConfig
from lunar_rover_sim.camera.config import RenderConfig
from lunar_rover_sim.drive.config import DriveConfig
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.gait.config import GaitConfig
from lunar_rover_sim.parameters import brief, group, merge, nearest, nest, param, Parameters
from lunar_rover_sim.physics.config import ImuConfig, PhysicsConfig
from lunar_rover_sim.resources import find_file, packaged_names
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.store import load_rover
from lunar_rover_sim.stereo.config import SgmConfig
from lunar_rover_sim.world.config import WorldConfig
from lunar_rover_sim.yaml_text import parse_yaml, read_text

FRAME_TOPICS = tuple(t.name for t in topics.CONTRACT if t.rate == topics.FRAME)

SHARED = '/**'
ROS_KEY = 'ros__parameters'
LOCKSTEP, REAL_TIME = 'lockstep', 'real_time'
MAX_SCENARIO_BYTES = 1 << 18


@dataclasses.dataclass(frozen=True)
class NodeConfig(Parameters):
    """What every node of the graph has."""

    seed: int = param(1, 'seed of everything random', low=0, high=2**31 - 1)
    world: str = param('', 'folder of a world made by `lunar_rover_sim world build`')
    rover: str = param('', 'rover description, YAML; empty for the packaged one')
    time_mode: str = param(REAL_TIME, 'lockstep waits for answers, real_time follows the wall '
                           'clock', choices=(LOCKSTEP, REAL_TIME))

    @property
    def lockstep(self) -> bool:
        """Whether time waits for answers."""
        return self.time_mode == LOCKSTEP


@dataclasses.dataclass(frozen=True)
class WaitConfig(Parameters):
    """Whose answers time waits for in lockstep; in real time, whose publishers it starts with."""

    topics: tuple[str, ...] = param((), 'topics whose stamps are awaited, besides those of the '
                                    'nodes of a run')
    lags_s: tuple[float, ...] = param((), 'lag that each of them may have', unit='s', low=0.0)
    silence_s: float = param(6.5, 'wall time after which a silent participant is an error',
                             unit='s', low=0.1)
    start_s: float = param(60.0, 'the same before its first answer', unit='s', low=0.1)

    def validate(self) -> None:
        """Check that each topic has its lag."""
        if len(self.topics) != len(self.lags_s):
            raise ConfigError(f'lags_s: {len(self.lags_s)} elements given for {len(self.topics)} '
                              'topics; valid is one lag per topic')

    def lag_ns_by_topic(self) -> dict[str, int]:
        """Return topic → lag [ns]."""
        return {t: round(s * 1e9) for t, s in zip(self.topics, self.lags_s)}


@dataclasses.dataclass(frozen=True)
class PhysicsNodeConfig(NodeConfig, PhysicsConfig):
    """Parameters of physics_node."""

    imu: ImuConfig = group(ImuConfig)
    wait: WaitConfig = group(WaitConfig)
    state_rate_hz: int = param(200, 'rate of state messages; its period is a whole number of '
                               'steps', unit='Hz', low=1, high=1000)
    real_time_factor: float = param(1.0, 'simulated per wall time in real_time', low=0.01,
                                    high=100.0)
    duration_s: float = param(0.0, 'simulated time after which the node ends; 0 for never',
                              unit='s', low=0.0)
    start_paused: bool = param(False, 'wait for ~/pause or ~/step before time starts')

    @property
    def step_ns(self) -> int:
        """The physics step [ns]."""
        return round(self.step_s * 1e9)

    @property
    def state_period_ns(self) -> int:
        """The period of state messages [ns]."""
        return 1_000_000_000 // self.state_rate_hz

    def validate(self) -> None:
        """Check that state messages fall on steps."""
        super().validate()
        if 1_000_000_000 % self.state_rate_hz or self.state_period_ns % self.step_ns:
            raise ConfigError(f'state_rate_hz: {self.state_rate_hz} is not valid; valid is a rate '
                              f'whose period is a multiple of step_s = {self.step_s:g} s')


@dataclasses.dataclass(frozen=True)
class GaitNodeConfig(NodeConfig, GaitConfig):
    """Parameters of gait_controller_node."""

    wait: WaitConfig = group(WaitConfig)
    enable_stamped_cmd_vel: bool = param(True, 'cmd_vel is TwistStamped (true) or Twist (false)')


@dataclasses.dataclass(frozen=True)
class DriveNodeConfig(NodeConfig, DriveConfig):
    """Parameters of drive_node."""

    rate_hz: int = param(20, 'rate of cmd_vel', unit='Hz', low=1, high=200)
    enable_stamped_cmd_vel: bool = param(True, 'cmd_vel is TwistStamped (true) or Twist (false)')


@dataclasses.dataclass(frozen=True)
class RenderNodeConfig(NodeConfig, RenderConfig):
    """Parameters of render_node."""

    sgm: SgmConfig = group(SgmConfig)
    frame_rate_hz: int = param(10, 'stereo pairs per second; its period is a whole number of '
                               'state periods', unit='Hz', low=1, high=200)
    await_readers: tuple[str, ...] = param((), 'topics whose readers must be there before the '
                                           'first frame is drawn in lockstep',
                                           choices=FRAME_TOPICS)

    @property
    def frame_period_ns(self) -> int:
        """The period of stereo pairs [ns]."""
        return 1_000_000_000 // self.frame_rate_hz


@dataclasses.dataclass(frozen=True)
class RecorderNodeConfig(NodeConfig, RecorderConfig):
    """Parameters of recorder_node."""

    scenario_file: str = param('', 'resolved scenario to put into the bag')
    acknowledge: tuple[str, ...] = param((), 'topics whose newest written stamps make '
                                         'recorder/written')


@dataclasses.dataclass(frozen=True)
class TrajectoryRecorderNodeConfig(NodeConfig):
    """Parameters of trajectory_recorder_node, which runs beside a graph, not in a scenario."""

    output: str = param('', 'TUM file to write; it must not exist')
    type: str = param('', 'message type of the topic `pose`; empty takes that of its publisher',
                      choices=('', 'geometry_msgs/msg/PoseStamped',
                               'geometry_msgs/msg/PoseWithCovarianceStamped',
                               'nav_msgs/msg/Odometry', 'nav_msgs/msg/Path'))


NODE_CONFIGS: dict[str, type[NodeConfig]] = {
    'physics_node': PhysicsNodeConfig,
    'gait_controller_node': GaitNodeConfig,
    'drive_node': DriveNodeConfig,
    'render_node': RenderNodeConfig,
    'recorder_node': RecorderNodeConfig,
}


@dataclasses.dataclass(frozen=True)
class RunConfig(Parameters):
    """What `lunar_rover_sim run` starts and for how long."""

    duration_s: float = param(20.0, 'simulated time, rounded up to whole camera frames', unit='s',
                              low=0.0, open_low=True)
    nodes: tuple[str, ...] = param(tuple(NODE_CONFIGS), 'nodes to start',
                                   choices=tuple(NODE_CONFIGS))


@dataclasses.dataclass(frozen=True)
class Scenario:
    """All parameters of a run, validated."""

    name: str
    shared: NodeConfig
    world: WorldConfig
    rover: RoverDescription
    run: RunConfig
    physics_node: PhysicsNodeConfig
    gait_controller_node: GaitNodeConfig
    drive_node: DriveNodeConfig
    render_node: RenderNodeConfig
    recorder_node: RecorderNodeConfig

    def node(self, name: str) -> NodeConfig:
        """Return the parameters of one node."""
        return getattr(self, name)

    def to_mapping(self) -> dict[str, Any]:
        """Return the whole scenario as plain values, in the layout of its YAML file."""
        shared = self.shared.to_mapping()
        result: dict[str, Any] = {SHARED: {ROS_KEY: shared}}
        for section in ('world', 'rover', 'run', *NODE_CONFIGS):
            values = getattr(self, section).to_mapping()
            if section in NODE_CONFIGS:
                values = {k: v for k, v in values.items() if k not in shared}
            result[section] = {ROS_KEY: values}
        return result

    def to_yaml(self) -> str:
        """Return the whole scenario as YAML; loading it gives an equal scenario.

        Empty lists are left out: they are defaults, and rcl's parser cannot type them.
        """
        return yaml.safe_dump(_without_empty_lists(self.to_mapping()), sort_keys=False)


def scenario_names() -> list[str]:
    """Return the names of the packaged scenarios."""
    return packaged_names('scenario')


def load_scenario(name_or_path: str, overrides: Iterable[str] = (),
                  seed: int | None = None) -> Scenario:
    """Load a scenario by packaged name or by path.

    overrides: `section.param=value` or, for shared parameters, `param=value`; values are YAML.
    seed: replaces the shared seed.
    Raises ConfigError that names the parameter and offers the nearest valid names.
    """
    path = find_file('scenario', name_or_path)
    sections = _read(path)
    for override in overrides:
        sections = merge(sections, _parse_override(override))
    if seed is not None:
        sections = merge(sections, {SHARED: {'seed': seed}})
    return _build(path.stem, sections)


def _read(path: Path) -> dict[str, Any]:
    """Return section → nested values of a scenario file, section names checked."""
    document = parse_yaml(read_text(path, MAX_SCENARIO_BYTES), str(path))
    if document is None:
        document = {}
    if not isinstance(document, Mapping):
        raise ConfigError(f'{path}: not a scenario; valid is a mapping of sections')
    sections: dict[str, Any] = {}
    for section, body in document.items():
        if section not in _section_names():
            raise ConfigError(f'{path}: no such section {brief(section)}; '
                              f'{nearest(str(section), _section_names())}')
        if not isinstance(body, Mapping) or set(body) != {ROS_KEY}:
            raise ConfigError(f'{path}: section {section!r} must hold {ROS_KEY!r} and nothing '
                              'else')
        values = body[ROS_KEY]
        if values is not None and not isinstance(values, Mapping):
            raise ConfigError(f'{path}: {section}.{ROS_KEY} is not a mapping of parameters')
        sections[section] = nest(values or {}, section)
    return sections


def _section_names() -> tuple[str, ...]:
    return (SHARED, 'world', 'rover', 'run', *NODE_CONFIGS)


def _shared_names() -> list[str]:
    return [field.name for field in dataclasses.fields(NodeConfig)]


def _parse_override(override: str) -> dict[str, Any]:
    name, equals, text = override.partition('=')
    if not equals or not name:
        raise ConfigError(f'--set {override}: valid is section.parameter=value')
    value = parse_yaml(text, f'--set {override}')
    section, dot, parameter = name.partition('.')
    if not dot and section in _shared_names():
        return {SHARED: {section: value}}
    if not dot or section not in _section_names():
        valid = [s for s in _section_names() if s != SHARED] + _shared_names()
        raise ConfigError(f'--set {override}: no such section {brief(section)}; '
                          f'{nearest(section, valid)}')
    return {section: nest({parameter: value})}


def _build(name: str, sections: Mapping[str, Any]) -> Scenario:
    shared_values = sections.get(SHARED, {})
    shared_values = merge({'time_mode': LOCKSTEP}, shared_values)
    shared = NodeConfig.from_mapping(shared_values, SHARED)
    nodes: dict[str, Any] = {
        node: cls.from_mapping(merge(shared.to_mapping(), sections.get(node, {})), node)
        for node, cls in NODE_CONFIGS.items()
    }
    rover = load_rover(shared.rover or None)
    rover_values = merge(rover.to_mapping(), sections.get('rover', {}))
    run = RunConfig.from_mapping(sections.get('run', {}), 'run')
    scenario = Scenario(
        name=name, shared=shared,
        world=WorldConfig.from_mapping(sections.get('world', {}), 'world'),
        rover=RoverDescription.from_mapping(rover_values, 'rover'), run=run, **nodes)
    _check_rates(scenario)
    return scenario


def _check_rates(scenario: Scenario) -> None:
    """Frames and commands must fall on state messages."""
    state_hz = scenario.physics_node.state_rate_hz
    for name, rate_hz in (('render_node.frame_rate_hz', scenario.render_node.frame_rate_hz),
                          ('drive_node.rate_hz', scenario.drive_node.rate_hz)):
        if state_hz % rate_hz:
            raise ConfigError(f'{name}: {rate_hz} is not valid; valid is a divisor of '
                              f'physics_node.state_rate_hz = {state_hz}')


def _without_empty_lists(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _without_empty_lists(v) for k, v in value.items() if v != []}
    return value
