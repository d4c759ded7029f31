"""The campaign file: a base scenario, what is fixed, what varies and how; and its episodes.

Each episode is a whole scenario of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import dataclasses
import hashlib
import itertools
import json
import math
from pathlib import Path
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

from lunar_rover_sim.base.errors import brief, ConfigError
from lunar_rover_sim.base.files.paths import find_file
from lunar_rover_sim.base.files.yaml_text import parse_yaml, read_text
from lunar_rover_sim.base.parameters import nearest, param, Parameters
from lunar_rover_sim.ground.world.config import PROCEDURAL
from lunar_rover_sim.products.sequences.export import FORMATS
from lunar_rover_sim.rover.gait.calibration import is_packaged
from lunar_rover_sim.run.node_config import NODE_CONFIGS
from lunar_rover_sim.run.plan import resolve
from lunar_rover_sim.run.scenario import Scenario

LATIN_HYPERCUBE, SOBOL, RANDOM, GRID = 'latin_hypercube', 'sobol', 'random', 'grid'
DESIGNS = (SOBOL, LATIN_HYPERCUBE, RANDOM, GRID)


def unit_points(design: str, count: int, dimensions: int, seed: int) -> NDArray[np.float64]:
    """Return (count, dimensions) points in [0, 1), the same for the same arguments.

    Args:
        design: `latin_hypercube`: each of `count` equal slices of each dimension holds one point
            (McKay, Beckman and Conover, 1979). `sobol`: a scrambled low-discrepancy sequence
            (Owen, 1998), which more episodes continue. `random`: independent points.
    """
    generator = np.random.default_rng(seed)
    if not count or not dimensions:
        return np.zeros((count, dimensions))
    if design == LATIN_HYPERCUBE:
        return qmc.LatinHypercube(dimensions, seed=generator).random(count)
    if design == SOBOL:
        # Sobol points are balanced for powers of two: draw the next power, keep the first ones.
        sampler = qmc.Sobol(dimensions, scramble=True, seed=generator)
        return sampler.random_base2(max(count - 1, 0).bit_length())[:count]
    return generator.random((count, dimensions))


def episode_seed(seed: int, index: int) -> int:
    """Return the seed of an episode, in [0, 2^31): independent streams from one seed."""
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0] & 0x7fffffff)


KINDS = ('uniform', 'log_uniform', 'normal', 'integer', 'choice')
MAX_CHOICES = 1000
MAX_LEVELS = 1000
_CUT_SIGMAS = 3.0
_LARGEST = 1e12
# Digits that are kept: enough for any parameter, and files stay readable.
_DIGITS = 9


@dataclasses.dataclass(frozen=True)
class Distribution:
    """One distribution; `numbers` are its two numbers, or its values for a choice.

    Attributes:
        levels: Number of values in a grid; 0 if the file names none.
    """

    kind: str
    numbers: tuple[Any, ...]
    levels: int = 0

    @classmethod
    def parse(cls, name: str, text: object) -> Distribution:
        """Return the distribution that a campaign file describes; ConfigError names `name`."""
        if not isinstance(text, Mapping):
            raise ConfigError(f'{name}: {brief(text)} is not a distribution; valid is a mapping '
                              f'with one of {", ".join(KINDS)}')
        for key in text:
            if key not in (*KINDS, 'levels'):
                raise ConfigError(f'{name}: no such distribution {brief(key)}; '
                                  f'{nearest(str(key), KINDS)}')
        kinds = [kind for kind in KINDS if kind in text]
        if len(kinds) != 1:
            raise ConfigError(f'{name}: {len(kinds)} distributions given; valid is one of '
                              f'{", ".join(KINDS)}')
        kind, numbers = kinds[0], text[kinds[0]]
        if isinstance(numbers, (str, bytes)) or not isinstance(numbers, Sequence):
            raise ConfigError(f'{name}.{kind}: {brief(numbers)} is not a list')
        levels = text.get('levels', 0)
        if not _is_int(levels) or not 0 <= levels <= MAX_LEVELS:
            raise ConfigError(f'{name}.levels: {brief(levels)} is not valid; valid is a whole '
                              f'number from 2 to {MAX_LEVELS}')
        if kind == 'choice':
            if not 1 <= len(numbers) <= MAX_CHOICES:
                raise ConfigError(f'{name}.choice: {len(numbers)} values given; valid are 1 to '
                                  f'{MAX_CHOICES}')
            return cls(kind, tuple(numbers), len(numbers))
        if levels == 1:
            raise ConfigError(f'{name}.levels: 1 is not valid; valid is 2 or more, or a choice')
        return cls(kind, _two_numbers(f'{name}.{kind}', kind, numbers), levels)

    def quantile(self, probability: float) -> Any:
        """Return the value below which a share in [0, 1] of the distribution lies."""
        if self.kind == 'choice':
            return self.numbers[min(int(probability * len(self.numbers)), len(self.numbers) - 1)]
        a, b = self.numbers
        if self.kind == 'integer':
            return min(a + int(probability * (b - a + 1)), b)
        if self.kind == 'log_uniform':
            value = math.exp(math.log(a) + probability * (math.log(b) - math.log(a)))
        elif self.kind == 'normal':
            value = _normal(probability, a, b)
        else:
            value = a + probability * (b - a)
        rounded = _rounded(value)
        if self.kind == 'normal' or a <= rounded <= b:
            return rounded
        return _rounded(min(max(rounded, a), b))

    def grid(self) -> list[Any]:
        """Return the values of a grid, in order."""
        if self.kind == 'choice':
            return list(self.numbers)
        if self.kind == 'integer':
            a, b = self.numbers
            count = min(self.levels, b - a + 1)
            return [a + round(k * (b - a) / max(count - 1, 1)) for k in range(count)]
        return [self.quantile(k / (self.levels - 1)) for k in range(self.levels)]

    def to_mapping(self) -> dict[str, Any]:
        """Return what `parse` reads."""
        result: dict[str, Any] = {self.kind: list(self.numbers)}
        if self.levels and self.kind != 'choice':
            result['levels'] = self.levels
        return result


def _two_numbers(name: str, kind: str, numbers: Sequence[Any]) -> tuple[Any, Any]:
    valid = _is_int if kind == 'integer' else _is_number
    if len(numbers) != 2 or not all(valid(n) for n in numbers):
        what = 'whole numbers' if kind == 'integer' else 'finite numbers'
        raise ConfigError(f'{name}: {brief(numbers)} is not valid; valid are two {what} of at '
                          f'most {_LARGEST:g}')
    a, b = numbers
    if kind == 'normal':
        if not b > 0.0:
            raise ConfigError(f'{name}: standard deviation {b} is not valid; valid is > 0')
    elif not a < b:
        raise ConfigError(f'{name}: {brief(numbers)} is not valid; valid is lower, then upper')
    if kind == 'log_uniform' and not a > 0.0:
        raise ConfigError(f'{name}: {a} is not valid; valid is > 0')
    return (a, b) if kind == 'integer' else (float(a), float(b))


def _normal(probability: float, mean: float, sd: float) -> float:
    """Return the quantile of a normal distribution cut off at `_CUT_SIGMAS`."""
    low = ndtr(-_CUT_SIGMAS)
    return float(mean + sd * ndtri(low + probability * (1.0 - 2.0 * low)))


def _rounded(value: float) -> float:
    return float(f'{value:.{_DIGITS}g}')


def _is_int(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) <= _LARGEST


def _is_number(value: object) -> bool:
    return _is_int(value) or (isinstance(value, float) and math.isfinite(value)
                              and abs(value) <= _LARGEST)


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
        rows = list(itertools.product(*(d.grid() for d in campaign.vary.values())))
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
