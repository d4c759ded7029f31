"""Scenarios: one YAML file, itself a ROS 2 parameter file, that describes a run completely.

The sections are `/**` (parameters that all nodes share), one per node, and three that no node
reads: `world` (the recipe of the terrain), `rover` (deviations from the rover that `/**` names)
and `run`.
Each section holds `ros__parameters`, so that `ros2 run … --params-file scenario.yaml` accepts the
file. The section of a node holds in every namespace (`params_files`) and may be written
`/**/physics_node`. Defaults live in the dataclasses; a file overrides them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
import dataclasses
import html
from pathlib import Path
import re
from typing import Any, TYPE_CHECKING

from lunar_rover_sim.base.errors import (brief, check_path, ConfigError, did_you_mean, full_names,
                                         nearest, offered, WorldError)
from lunar_rover_sim.base.files.paths import find_file
from lunar_rover_sim.base.files.yaml_text import parse_yaml, read_yaml, yaml_of
from lunar_rover_sim.base.parameters import merge, nest, param, Parameters
from lunar_rover_sim.base.seconds import is_divisor
from lunar_rover_sim.ground.world.cache import cached
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.world_folder import load_world as load_world_folder
from lunar_rover_sim.image.lidar.beam_pattern import beam_pattern
from lunar_rover_sim.rover.description import load_rover, RoverDescription
from lunar_rover_sim.run.dated_sun import sun_of_run
from lunar_rover_sim.run.node_config import (DEFAULT_NODES, DriveNodeConfig, FOLLOWS,
                                             GaitNodeConfig, LEG_CONTROLLERS, LidarNodeConfig,
                                             MappingNodeConfig, NavigatorNodeConfig, NODE_CONFIGS,
                                             PhysicsNodeConfig, PolicyNodeConfig,
                                             RecorderNodeConfig, RenderNodeConfig, SlamNodeConfig)
from lunar_rover_sim.run.params_files import MAX_BYTES, ROS_KEY, section_names, SHARED
from lunar_rover_sim.run.shared_config import LOCKSTEP, MAX_DURATION_S, NodeConfig

if TYPE_CHECKING:
    from lunar_rover_sim.image.lidar.lidar import Lidar
    from lunar_rover_sim.image.rendering.renderer import Renderer
    from lunar_rover_sim.image.stereo.sgm import SgmMatcher
    from lunar_rover_sim.rover.gait.controller import GaitController
    from lunar_rover_sim.rover.physics.simulation import Simulation


@dataclasses.dataclass(frozen=True)
class RunConfig(Parameters):
    """The nodes of a run and its duration."""

    duration_s: float = param(20.0, 'rounded up to whole camera frames', unit='s',
                              low=0.0, open_low=True, high=MAX_DURATION_S)
    nodes: tuple[str, ...] = param(DEFAULT_NODES, 'nodes to start',
                                   choices=tuple(NODE_CONFIGS))
    may_fail: tuple[str, ...] = param((), 'nodes without which a run goes on if they die; time '
                                      'does not wait for them, so what they publish is not '
                                      'repeatable',
                                      choices=('lidar_node',))
    world_hash: str = param('', 'another world is refused; empty: any')

    def validate(self) -> None:
        """Raise ConfigError if a node is named twice or the hash is not one."""
        if self.world_hash and not re.fullmatch('[0-9a-f]{32}', self.world_hash):
            raise ConfigError(f'world_hash: {self.world_hash!r} is not valid; valid are 32 '
                              'hexadecimal digits, or nothing for any world')
        if set(self.nodes).issuperset(LEG_CONTROLLERS):
            raise ConfigError(f'nodes: {" and ".join(LEG_CONTROLLERS)} are not valid together; '
                              'valid is one of them')
        for name in self.nodes:
            if self.nodes.count(name) > 1:
                raise ConfigError(f'nodes: {name} is given {self.nodes.count(name)} times; valid '
                                  'is once')


@dataclasses.dataclass(frozen=True)
class Scenario:
    """All parameters of a run, validated."""

    name: str = dataclasses.field(compare=False)    # of the file, which may be a copy
    shared: NodeConfig
    world: WorldConfig
    rover: RoverDescription
    run: RunConfig
    physics_node: PhysicsNodeConfig
    gait_controller_node: GaitNodeConfig
    drive_node: DriveNodeConfig
    render_node: RenderNodeConfig
    recorder_node: RecorderNodeConfig
    slam_node: SlamNodeConfig
    lidar_node: LidarNodeConfig
    policy_node: PolicyNodeConfig
    mapping_node: MappingNodeConfig
    navigator_node: NavigatorNodeConfig

    @classmethod
    def load(cls, name_or_path: str | Path, overrides: Iterable[str] | Mapping[str, Any] = (), *,
             seed: int | None = None, duration_s: float | None = None,
             rover: str | Path | None = None, world: str | Path | None = None) -> Scenario:
        """Load a scenario by packaged name or by path.

        A date of the sun becomes azimuth and elevation.

        Args:
            overrides: `'section.param=value'` with a YAML value, or a mapping of `section.param`
                to values; parameters that all nodes share have no section.
            seed: Replaces the shared seed.
            duration_s: Replaces the simulated time of the run [s].
            rover: Replaces the rover: the name of a packaged one, or its file.
            world: Folder of a world that will be used instead of the scenario's own: it says where
                on the Moon the date of a sun holds; the scenario keeps the recipe of its own
                world.

        Raises:
            ConfigError: If a parameter is not valid, with the nearest valid names.
            WorldError: If the place of an elevation model or of a world is needed for the date and
                cannot be read.
        """
        if world is not None:
            check_path('world', world)
        path = find_file('scenario', str(name_or_path))
        sections = read_sections(path)
        changes = override_sections(overrides)
        if seed is not None:
            changes.append({SHARED: {'seed': seed}})
        if duration_s is not None:
            changes.append({'run': {'duration_s': duration_s}})
        if rover is not None:
            check_path('rover', rover)
            changes.append({SHARED: {'rover': str(rover)}})
        for change in changes:
            sections = merge(sections, change)
        scenario = _build(path.stem, sections)
        render = scenario.render_node
        sun = sun_of_run(render.sun, scenario.world, scenario.run.duration_s, changes, world)
        return dataclasses.replace(scenario, render_node=dataclasses.replace(render, sun=sun))

    def __repr__(self) -> str:
        return (f'Scenario(name={self.name!r}, seed={self.shared.seed}, '
                f'duration_s={self.run.duration_s:g})')

    def _repr_html_(self) -> str:
        """Return what the scenario is, in a table for a notebook."""
        sun, camera = self.render_node.sun, self.render_node.camera
        rows = {'scenario': self.name, 'seed': self.shared.seed,
                'duration': f'{self.run.duration_s:g} s', 'nodes': ', '.join(self.run.nodes),
                'ground': self.physics_node.ground.name,
                'sun': f'azimuth {sun.azimuth_deg:g}, elevation {sun.elevation_deg:g} deg',
                'camera': f'{camera.width} x {camera.height} px at '
                          f'{self.render_node.frame_rate_hz:g} Hz'}
        cells = ''.join(f'<tr><th>{name}</th><td>{html.escape(str(value))}</td></tr>'
                        for name, value in rows.items())
        return f'<table>{cells}</table>'

    def world_folder(self) -> Path:
        """Return the folder of the scenario's world, which is built if the cache lacks it.

        Raises:
            WorldError: If it cannot be built, or is not the one that `run.world_hash` names.
        """
        folder = cached(self.world, self.shared.seed)
        if self.run.world_hash:
            self.check_world(load_world_folder(folder, verify=False))
        return folder

    def check_world(self, world: World) -> None:
        """Raise WorldError if `run.world_hash` names another world."""
        wanted = self.run.world_hash
        if wanted and world.hash != wanted:
            raise WorldError(f'run.world_hash: {wanted} is not the world of these parameters '
                             f'here, {world.hash}; to go on with that one, set run.world_hash to '
                             'nothing')

    def load_world(self) -> World:
        """Return the scenario's world, which is built if the cache lacks it."""
        return load_world_folder(self.world_folder())

    def node(self, name: str) -> NodeConfig:
        """Return the parameters of one node; ConfigError if there is no such node."""
        if name not in tuple(NODE_CONFIGS):
            raise ConfigError(f'{brief(name)}: no such node; {nearest(str(name), NODE_CONFIGS)}')
        return getattr(self, name)

    def to_mapping(self) -> dict[str, Any]:
        """Return the scenario as plain values, in the layout of its YAML file."""
        shared = self.shared.to_mapping()
        result: dict[str, Any] = {SHARED: {ROS_KEY: shared}}
        for section in ('world', 'rover', 'run', *NODE_CONFIGS):
            values = getattr(self, section).to_mapping()
            if section in NODE_CONFIGS:
                values = {k: v for k, v in values.items() if k not in shared}
            result[section] = {ROS_KEY: values}
        return result

    # What a scenario makes is imported when it is made: a program that reads a scenario loads
    # neither MuJoCo nor a renderer.

    def simulation(self, world: World | None = None) -> Simulation:
        """Return the physics, on another world if one is given.

        Raises:
            ConfigError: If a parameter is not valid with the others.
            WorldError: If the world cannot be built or read.
        """
        from lunar_rover_sim.rover.physics.simulation import Simulation
        return Simulation(self._world(world), self.rover, self.physics_node)

    def gait_controller(self) -> GaitController:
        """Return the gait controller, with the calibration of its ground.

        Raises:
            ConfigError: If the gait does not fit the rover or its calibration cannot be read.
        """
        from lunar_rover_sim.rover.gait.calibration import GaitCalibration
        from lunar_rover_sim.rover.gait.controller import GaitController
        config = self.gait_controller_node.for_rover(self.rover)
        calibration = GaitCalibration.of(config, self.physics_node.ground.name, self.rover.name)
        return GaitController(config, calibration, self.rover.legs)

    def renderer(self, world: World | None = None) -> Renderer:
        """Return the renderer of the cameras, of another world if one is given.

        Each state is drawn in the window of the site that is that of its pose.

        Raises:
            RenderError: If there is no OpenGL.
            WorldError: If the world cannot be built or read.
        """
        from lunar_rover_sim.ground.world.follower import Follower
        from lunar_rover_sim.image.rendering.renderer import Renderer
        window = self._world(world)
        return Renderer(window, self.rover, self.render_node, self.shared.seed, Follower(window))

    def matcher(self) -> SgmMatcher:
        """Return the matcher of stereo pairs; its maps know the depth."""
        from lunar_rover_sim.image.camera.rig import StereoRig
        from lunar_rover_sim.image.stereo.sgm import SgmMatcher
        return SgmMatcher(self.render_node.sgm, StereoRig(self.rover, self.render_node.camera))

    def lidar(self, world: World | None = None) -> Lidar:
        """Return the LiDAR, on another world if one is given.

        Each scan is that of the window of the site in which it begins.

        Raises:
            ConfigError: If the rover is before every beam.
            WorldError: If the world cannot be built or read.
        """
        from lunar_rover_sim.ground.world.follower import Follower
        from lunar_rover_sim.image.lidar.lidar import Lidar
        config = dataclasses.replace(self.lidar_node,
                                     reflectance=self.render_node.reflectance)
        window = self._world(world)
        return Lidar(window, self.rover, config, self.shared.seed, Follower(window))

    def _world(self, world: World | None) -> World:
        return self.load_world() if world is None else world

    def to_yaml(self) -> str:
        """Return the scenario as YAML; loading it gives an equal scenario.

        Empty lists are left out: they are defaults, and rcl's parser cannot infer their type.
        """
        return yaml_of(_without_empty_lists(self.to_mapping()))


def _build(name: str, sections: Mapping[str, Any]) -> Scenario:
    shared_values = sections.get(SHARED, {})
    shared_values = merge({'time_mode': LOCKSTEP}, shared_values)
    shared = NodeConfig.from_mapping(shared_values)
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
    _check_lidar_mount(scenario)
    return scenario


def _check_rates(scenario: Scenario) -> None:
    """Raise ConfigError unless frames, commands and scans fall on state messages."""
    state_hz = scenario.physics_node.state_rate_hz
    for name, rate_hz in (('render_node.frame_rate_hz', scenario.render_node.frame_rate_hz),
                          ('drive_node.rate_hz', scenario.drive_node.rate_hz),
                          ('lidar_node.rate_hz', scenario.lidar_node.rate_hz),
                          *([('navigator_node.rate_hz', scenario.navigator_node.rate_hz)]
                            if 'navigator_node' in scenario.run.nodes else [])):
        if not is_divisor(rate_hz, state_hz):
            raise ConfigError(f'{name}: {rate_hz:g} is not valid; valid is a divisor of '
                              f'physics_node.state_rate_hz = {state_hz}')


def _check_lidar_mount(scenario: Scenario) -> None:
    """Raise ConfigError if the rover is before every beam of its LiDAR."""
    if 'lidar_node' not in scenario.run.nodes:
        return
    # Here, because MuJoCo takes time to import, and most runs have no LiDAR.
    from lunar_rover_sim.image.lidar.own_body import OwnBody
    sensor = scenario.lidar_node
    OwnBody(scenario.rover, beam_pattern(sensor.optics, sensor.rate_hz))


def _without_empty_lists(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _without_empty_lists(v) for k, v in value.items() if v != []}
    return value


def read_sections(path: Path) -> dict[str, Any]:
    """Return section → nested values of a scenario file; ConfigError for unknown sections."""
    document = read_yaml(path, MAX_BYTES)
    if document is None:
        document = {}
    if not isinstance(document, Mapping):
        raise ConfigError(f'{path}: not a scenario; valid is a mapping of sections')
    sections: dict[str, Any] = {}
    programs = {name: node for node in NODE_CONFIGS for name in section_names(node)}
    for name, body in document.items():
        section = programs.get(name, name)
        if section not in _section_names():
            near = did_you_mean(str(section), _section_names())
            raise ConfigError(f'{path}: no such section {brief(section)}; '
                              + (near or 'see lunar_rover_sim parameters'))
        if section in sections:
            raise ConfigError(f'{path}: section {section} is given twice')
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


def _parameter_names() -> Iterator[str]:
    """Yield the parameters of all sections that --set may set."""
    for section, cls in {'world': WorldConfig, 'rover': RoverDescription, 'run': RunConfig,
                         **NODE_CONFIGS}.items():
        for name, *_ in cls().flatten(f'{section}.', documented=True):
            is_shared = section in NODE_CONFIGS and name.partition('.')[2] in _shared_names()
            if not is_shared and not name.startswith(tuple(FOLLOWS)):
                yield name


def override_sections(overrides: Iterable[str] | Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return each override as nested sections; ConfigError where they are no texts."""
    items: list[Any] = list(overrides) if isinstance(overrides, Iterable) else [overrides]
    if isinstance(overrides, str) or not all(isinstance(item, str) for item in items):
        raise ConfigError(f'overrides: {brief(overrides)} is not valid; valid is a list of '
                          "'section.parameter=value', or a mapping of 'section.parameter' to "
                          'values')
    if isinstance(overrides, Mapping):
        return [_override(name, value, f'overrides: {name}') for name, value in overrides.items()]
    return [_parse_override(text) for text in items]


def _parse_override(override: str) -> dict[str, Any]:
    name, equals, text = override.partition('=')
    if not equals or not name:
        raise ConfigError(f'--set {override}: valid is section.parameter=value')
    return _override(name, parse_yaml(text, f'--set {override}'), f'--set {override}')


def _override(name: str, value: Any, where: str) -> dict[str, Any]:
    """Return one parameter as nested sections; `where` names it in the ConfigError."""
    section, dot, parameter = name.partition('.')
    if not dot and section in _shared_names():
        return {SHARED: {section: value}}
    if not dot or section not in _section_names():
        if found := full_names(name, (*_shared_names(), *_parameter_names())):
            raise ConfigError(f'{where}: no such parameter; {offered(found)}')
        valid = [s for s in _section_names() if s != SHARED]
        valid += [] if dot else _shared_names()
        raise ConfigError(f'{where}: no such section {brief(section)}; '
                          + (did_you_mean(section, valid) or 'see lunar_rover_sim parameters'))
    return {section: nest({parameter: value})}
