"""From a campaign to its episodes: each one a whole scenario of its own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

from lunar_rover_sim.base.errors import brief, ConfigError
from lunar_rover_sim.campaign.campaign_file import (BASE, Campaign, episode_seed, GRID, grid_rows,
                                                    unit_points)
from lunar_rover_sim.ground.world.config import PROCEDURAL
from lunar_rover_sim.rover.gait.calibration import is_packaged
from lunar_rover_sim.run.node_config import NODE_CONFIGS
from lunar_rover_sim.run.plan import resolve
from lunar_rover_sim.run.scenario import Scenario


@dataclasses.dataclass(frozen=True)
class EpisodePlan:
    """One episode: its name (a folder name), what was drawn for it, and its scenario's text."""

    name: str
    drawn: dict[str, Any]
    scenario_yaml: str
    duration_s: float

    @property
    def scenario_hash(self) -> str:
        """SHA-256 of the scenario's text, hexadecimal."""
        return hashlib.sha256(self.scenario_yaml.encode()).hexdigest()


def draw(campaign: Campaign) -> list[dict[str, Any]]:
    """Return what varies, episode by episode: parameter → value.

    The shared seed is drawn for each episode, unless the campaign names one.
    """
    names = list(campaign.vary)
    if campaign.config.design == GRID:
        rows = grid_rows([d.grid() for d in campaign.vary.values()])
    else:
        points = unit_points(campaign.config.design, campaign.count, len(names),
                             campaign.config.seed)
        rows = [tuple(campaign.vary[name].quantile(share)
                      for name, share in zip(names, row)) for row in points.tolist()]
    result = []
    for index, row in enumerate(rows):
        drawn: dict[str, Any] = {}
        for name, value in zip(names, row):
            drawn.update(_settings_of(name, value))
        if 'seed' not in drawn and 'seed' not in campaign.settings:
            drawn['seed'] = episode_seed(campaign.config.seed, index)
        result.append(drawn)
    return result


def episode_names(campaign: Campaign) -> Iterator[str]:
    """Yield the names of the episodes, which are those of their folders."""
    digits = max(4, len(str(campaign.count - 1)))
    for index in range(campaign.count):
        yield f'{index:0{digits}d}'


def plan(campaign: Campaign) -> Iterator[EpisodePlan]:
    """Yield the episodes; raises ConfigError as `episode` does."""
    for name, drawn in zip(episode_names(campaign), draw(campaign)):
        yield episode(campaign, name, drawn)


def episode(campaign: Campaign, name: str, drawn: Mapping[str, Any]) -> EpisodePlan:
    """Return one episode; raises ConfigError as `episode_scenario` does."""
    scenario = episode_scenario(campaign, name, drawn)
    return EpisodePlan(name, dict(drawn), scenario.to_yaml(), scenario.run.duration_s)


def episode_scenario(campaign: Campaign, name: str, drawn: Mapping[str, Any]) -> Scenario:
    """Return the scenario of an episode: the base, the settings, and what was drawn.

    Raises:
        ConfigError: If the parameters do not fit together; it names the episode.
    """
    values = {**campaign.settings, **drawn}
    base = values.pop(BASE, campaign.config.base)
    try:
        scenario = Scenario.load(_base(campaign, base), _overrides(values))
        return resolve(_self_contained(scenario))
    except ConfigError as error:
        raise ConfigError(f'episode {name}: {error}') from None


def _settings_of(name: str, value: Any) -> dict[str, Any]:
    """Return the parameters that a drawn value sets: one, or those of a mapping."""
    if not isinstance(value, Mapping):
        return {name: value}
    for key in value:
        if not isinstance(key, str):
            raise ConfigError(f'vary.{name}.choice: {brief(key)} is not the name of a parameter')
    return dict(value)


def _overrides(values: Mapping[str, Any]) -> list[str]:
    overrides = []
    for name, value in values.items():
        if '=' in name:
            raise ConfigError(f'{brief(name)}: a name of a parameter has no =')
        try:
            # JSON is YAML, and keeps every number as it is.
            overrides.append(f'{name}={json.dumps(value)}')
        except (TypeError, ValueError):
            raise ConfigError(f'{name}: {brief(value)} is not a plain value') from None
    return overrides


def _base(campaign: Campaign, base: object) -> str:
    if not isinstance(base, str):
        raise ConfigError(f'{BASE}: {brief(base)} is not valid; valid is the name of a scenario, '
                          'or a file beside the campaign file')
    if base.endswith(('.yaml', '.yml')):
        return str(campaign.folder / base)
    return base


def _self_contained(scenario: Scenario) -> Scenario:
    """Return the scenario without anything that depends on the folder or machine.

    The rover is spelled out; paths of elevation models and calibrations are made absolute; those
    of world and rover, which each run chooses by itself, are left out.
    """
    changes: dict[str, Any] = {
        name: dataclasses.replace(scenario.node(name), world='', rover='')
        for name in NODE_CONFIGS}
    gait = changes['gait_controller_node']
    if gait.calibration and not is_packaged(gait.calibration):
        gait = dataclasses.replace(gait, calibration=str(Path(gait.calibration).resolve()))
    changes['gait_controller_node'] = gait
    changes['shared'] = dataclasses.replace(scenario.shared, world='', rover='')
    if scenario.world.source != PROCEDURAL:
        changes['world'] = dataclasses.replace(
            scenario.world, path=str(Path(scenario.world.path).resolve()))
    return dataclasses.replace(scenario, **changes)
