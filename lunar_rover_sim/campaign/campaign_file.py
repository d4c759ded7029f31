"""The campaign file: a base scenario, what is fixed, what varies and how."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import math
from pathlib import Path
import re
from typing import Any

from lunar_rover_sim.arguments import brief
from lunar_rover_sim.campaign.design import DESIGNS, GRID, SOBOL
from lunar_rover_sim.campaign.distribution import Distribution
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.paths import find_file
from lunar_rover_sim.files.yaml_text import parse_yaml, read_text
from lunar_rover_sim.parameters import param, Parameters
from lunar_rover_sim.sequences.export import FORMATS

MAX_CAMPAIGN_BYTES = 1 << 18
MAX_EPISODES = 100_000
MAX_VARIED = 200
BASE = 'base'       # may vary, too
ELEVATION, DATE = 'render_node.sun.elevation_deg', 'render_node.sun.date'
# A low sun is what makes the poles of the Moon difficult: the default of a campaign.
DEFAULT_ELEVATION = Distribution('uniform', (0.0, 15.0))
_NAME = re.compile(r'[A-Za-z0-9][A-Za-z0-9_.-]{0,63}')


@dataclasses.dataclass(frozen=True)
class CampaignConfig(Parameters):
    """The plain part of a campaign file."""

    name: str = param('', 'name of the data set: letters, digits, _ . -; empty: that of the file')
    description: str = param('', 'what the data set is for, in a sentence or two')
    license: str = param('CC-BY-4.0', 'licence of the recordings, as SPDX names it')
    base: str = param('baseline', 'scenario that everything starts from: a packaged name, or a '
                      'file beside the campaign file; `vary` may name several')
    episodes: int = param(0, 'number of episodes; a grid has as many as its levels make',
                          low=0, high=MAX_EPISODES)
    design: str = param(SOBOL, 'how episodes are spread', choices=DESIGNS)
    seed: int = param(1, 'seed of the design and of the seeds of the episodes', low=0,
                      high=2**31 - 1)
    formats: tuple[str, ...] = param((), 'formats to export besides the bag',
                                     choices=tuple(FORMATS))
    keep_bag: bool = param(True, 'keep the bag of an episode that has been exported')
    timeout_s: float = param(0.0, 'wall time after which an episode has failed; 0: 300 s and '
                             'a minute per simulated second', unit='s', low=0.0)

    def validate(self) -> None:
        """Check the name, which becomes part of file names and titles."""
        if self.name and not _NAME.fullmatch(self.name):
            raise ConfigError(f'name: {brief(self.name)} is not valid; valid are up to 64 '
                              'letters, digits, _, . and -')
        if not self.keep_bag and not self.formats:
            raise ConfigError('keep_bag: false is not valid without formats: nothing would be '
                              'kept')


@dataclasses.dataclass(frozen=True)
class Campaign:
    """A campaign file as read.

    Attributes:
        settings: Value by full name of the parameter.
        vary: Distribution by full name of the parameter.
        folder: That of the campaign file, in which a base scenario by relative path is looked up.
    """

    config: CampaignConfig
    settings: dict[str, Any]
    vary: dict[str, Distribution]
    folder: Path

    @property
    def count(self) -> int:
        """The number of episodes."""
        if self.config.design == GRID:
            return math.prod(len(d.grid()) for d in self.vary.values())
        return self.config.episodes

    def to_mapping(self) -> dict[str, Any]:
        """Return the campaign as plain values, in the layout of its file."""
        return {**self.config.to_mapping(), 'settings': dict(self.settings),
                'vary': {name: d.to_mapping() for name, d in self.vary.items()}}


def load_campaign(name_or_path: str | Path) -> Campaign:
    """Return a campaign by packaged name or path; raise ConfigError if it is not valid."""
    path = find_file('campaign', str(name_or_path))
    return parse_campaign(read_text(path, MAX_CAMPAIGN_BYTES), path)


def parse_campaign(text: str, path: Path) -> Campaign:
    """Return the campaign that a file holds; `path` names it and places its base scenario."""
    document = parse_yaml(text, str(path))
    if not isinstance(document, Mapping):
        raise ConfigError(f'{path}: not a campaign; valid is a mapping with base, episodes and '
                          'vary')
    plain = {k: v for k, v in document.items() if k not in ('settings', 'vary')}
    try:
        config = CampaignConfig.from_mapping(plain)
        if not config.name:
            config = dataclasses.replace(config, name=path.stem)
        settings = _mapping(document, 'settings')
        vary = {name: Distribution.parse(f'vary.{name}', value)
                for name, value in _mapping(document, 'vary').items()}
        if len(vary) > MAX_VARIED:
            raise ConfigError(f'vary: {len(vary)} parameters given; valid are up to '
                              f'{MAX_VARIED}')
        for name in vary:
            if name in settings:
                raise ConfigError(f'vary.{name}: is in settings too; valid is one of them')
        _check_design(config, vary)
        if not {ELEVATION, DATE} & _named(settings, vary) and config.design != GRID:
            vary[ELEVATION] = DEFAULT_ELEVATION
    except ConfigError as error:
        raise ConfigError(f'{path}: {error}') from None
    return Campaign(config, settings, vary, path.resolve().parent)


def _named(settings: Mapping[str, Any], vary: Mapping[str, Distribution]) -> set[str]:
    """Return all names that are set or varied, including those inside choices."""
    names = {*settings, *vary}
    for distribution in vary.values():
        for value in distribution.numbers if distribution.kind == 'choice' else ():
            if isinstance(value, Mapping):
                names.update(str(name) for name in value)
    return names


def _check_design(config: CampaignConfig, vary: Mapping[str, Distribution]) -> None:
    if config.design != GRID:
        if config.episodes < 1:
            raise ConfigError(f'episodes: {config.episodes} is not valid; valid is 1 to '
                              f'{MAX_EPISODES}')
        return
    count = 1
    for name, distribution in vary.items():
        if not distribution.levels:
            raise ConfigError(f'vary.{name}: a grid needs levels, or a choice')
        count *= len(distribution.grid())
        if count > MAX_EPISODES:
            raise ConfigError(f'vary: the grid has more than {MAX_EPISODES} episodes')
    if config.episodes not in (0, count):
        raise ConfigError(f'episodes: {config.episodes} is not valid; the grid has {count}')


def _mapping(document: Mapping[str, Any], key: str) -> dict[str, Any]:
    value = document.get(key)
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ConfigError(f'{key}: {brief(value)} is not a mapping of parameters')
    for name in value:
        if not isinstance(name, str):
            raise ConfigError(f'{key}: {brief(name)} is not the name of a parameter')
    return dict(value)
