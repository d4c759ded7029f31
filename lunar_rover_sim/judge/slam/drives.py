"""Drives of a benchmark and what became of each, kept as CSV, and put together from many places.

One line of the CSV is one drive with one system and one sensor: the fields of `Drive`, those of
`SlamResult`, and `failed`. Parts of a benchmark that were run on several machines are joined from
their folders or their CSVs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import csv
import dataclasses
import io
import json
from pathlib import Path
import re
from typing import Any

from lunar_rover_sim.base.errors import brief, SlamError
from lunar_rover_sim.base.files.results import csv_table
from lunar_rover_sim.base.files.yaml_text import read_text
from lunar_rover_sim.judge.slam.run_on_bag import SlamResult
from lunar_rover_sim.run.scenario import Scenario

_MOST_SEEDS = 10_000


def seeds_of(text: str) -> tuple[int, ...]:
    """Return the seeds that a text names: `6` is 1 to 6, `7-10` and `1,4,7-10` are as they stand.

    Raises:
        SlamError: If it names none, or one twice.
    """
    found: list[int] = []
    for part in text.split(','):
        match = re.fullmatch(r'\s*(\d{1,9})\s*(?:-\s*(\d{1,9})\s*)?', part, re.ASCII)
        if match is None:
            raise SlamError(f'seeds: {brief(text)} is not valid; valid is N for 1 to N, FROM-TO, '
                            'or several of these with commas')
        first, last = int(match[1]), int(match[2] or match[1])
        if match[2] is None and ',' not in text:
            first = 1
        if not 1 <= first <= last or last - first >= _MOST_SEEDS:
            raise SlamError(f'seeds: {brief(part.strip())} is not valid; valid are seeds from 1, '
                            f'the lower one first, at most {_MOST_SEEDS}')
        found += range(first, last + 1)
    double = next((seed for seed in found if found.count(seed) > 1), None)
    if double is not None:
        raise SlamError(f'seeds: {brief(text)} names {double} twice')
    return tuple(found)


def text_of_seeds(seeds: Iterable[int]) -> str:
    """Return seeds in words: `1 to 6, 9`."""
    runs: list[list[int]] = []
    for seed in sorted(set(seeds)):
        if runs and runs[-1][-1] == seed - 1:
            runs[-1].append(seed)
        else:
            runs.append([seed])
    return ', '.join(str(run[0]) if len(run) == 1 else f'{run[0]} to {run[-1]}' for run in runs)


CELLS = 'cells'         # in the folder of a benchmark: a folder for each of its cells
RESULT = 'result.json'
MAX_BYTES = 1 << 24     # of a result
_MAX_CSV_BYTES = 1 << 28
_NEEDED = ('scenario', 'seed', 'sensor', 'system', 'tracked_share', 'ate_m', 'scale')
# Settings that change what is recorded, not the drive; and those that drives of one benchmark may
# differ in.
_RECORDER, _WAY = 'recorder_node.', 'drive_node.waypoints_'


@dataclasses.dataclass(frozen=True)
class Drive:
    """One simulated drive.

    Attributes:
        scenario: Packaged name, or path of a file.
        parameter, value: What a sweep changes, as NODE.PARAM and text; empty without a sweep.
        overrides: Further settings of the scenario, NODE.PARAM=VALUE.
    """

    scenario: str
    seed: int
    duration_s: float
    parameter: str = ''
    value: str = ''
    overrides: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the folder of its recording."""
        swept = f'-{self.parameter}={self.value}' if self.parameter else ''
        return re.sub(r'[^\w.=+-]', '_', f'{Path(self.scenario).stem}{swept}-seed{self.seed}')

    @property
    def settings(self) -> list[str]:
        """All settings of the scenario, as NODE.PARAM=VALUE."""
        return [*self.overrides, *([f'{self.parameter}={self.value}'] if self.parameter else [])]

    def load_scenario(self, *more: str) -> Scenario:
        """Return the scenario; `more` are settings that come before those of the drive.

        Raises:
            ConfigError: If a setting is not valid.
        """
        return Scenario.load(self.scenario, [*more, *self.settings], seed=self.seed,
                             duration_s=self.duration_s)


@dataclasses.dataclass(frozen=True)
class Judged:
    """What one system made of one drive with one sensor.

    Attributes:
        failed: The result has a reason and no numbers.
        folder: With the files of `run_on_bag`; None where they are not at hand.
    """

    drive: Drive
    result: SlamResult
    failed: bool = False
    folder: Path | None = None

    @property
    def key(self) -> tuple[str, str, str, int, str, str]:
        """What no other of a benchmark has: scenario, sweep, value, seed, sensor, system."""
        return (self.drive.scenario, self.drive.parameter, self.drive.value, self.drive.seed,
                self.result.sensor, self.result.system)

    @property
    def text(self) -> str:
        """The key, to be read by people."""
        return ' '.join(filter(None, (self.drive.name, self.result.sensor, self.result.system)))


# CSV

_DRIVE = ('scenario', 'parameter', 'value', 'seed', 'asked_s', 'settings')
_RESULT = tuple(field.name for field in dataclasses.fields(SlamResult))
_NUMBERS = tuple(field.name for field in dataclasses.fields(SlamResult)
                 if field.name not in ('system', 'sensor', 'reason', 'frames', 'words'))


def csv_of_drives(judged: Iterable[Judged]) -> str:
    """Return a CSV with a line for each, and all digits; see `read_csv`."""
    rows = []
    for one in judged:
        drive, result = one.drive, one.result.to_mapping()
        rows.append([drive.scenario, drive.parameter, drive.value, drive.seed,
                     f'{drive.duration_s:.12g}', json.dumps(drive.overrides), int(one.failed),
                     *(result[name] for name in _RESULT)])
    return csv_table([*_DRIVE, 'failed', *_RESULT], rows)


def read_csv(path: Path) -> list[Judged]:
    """Read what `csv_of_drives` wrote, or any CSV that has at least the columns it needs.

    These are scenario, seed, sensor, system, tracked_share, ate_m and scale; a number that is
    left empty is unknown.

    Raises:
        SlamError: For anything else, with line and column.
    """
    reader = csv.DictReader(io.StringIO(read_text(path, _MAX_CSV_BYTES, SlamError)))
    lacking = [name for name in _NEEDED if name not in (reader.fieldnames or ())]
    if lacking:
        raise SlamError(f'{path}: is no CSV of drives: it lacks {", ".join(lacking)}')
    try:
        return [_of_row(path, reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise SlamError(f'{path}: line {reader.line_num}: {error}') from None


def _of_row(path: Path, line: int, row: dict[str, Any]) -> Judged:
    def text(name: str) -> str:
        value = row.get(name)
        return value.strip() if isinstance(value, str) else ''

    def number(name: str, otherwise: float = float('nan')) -> float:
        try:
            return float(text(name) or otherwise)
        except ValueError:
            raise SlamError(f'{path}: line {line}: {name}: {brief(text(name))} is not a '
                            'number') from None

    for name in ('scenario', 'sensor', 'system'):
        if not text(name):
            raise SlamError(f'{path}: line {line}: {name} is empty')
    if not re.fullmatch(r'\d{1,9}', text('seed'), re.ASCII):
        raise SlamError(f'{path}: line {line}: seed: {brief(text("seed"))} is not a whole number')
    if text('failed') not in ('', '0', '1'):
        raise SlamError(f'{path}: line {line}: failed: {brief(text("failed"))} is not valid; '
                        'valid are 0, 1')
    try:
        overrides = tuple(map(str, json.loads(text('settings') or '[]')))
    except (ValueError, TypeError, RecursionError):
        raise SlamError(f'{path}: line {line}: settings: {brief(text("settings"))} is not a list '
                        'of texts') from None
    numbers = {name: number(name, 0.0 if name == 'tracked_share' else float('nan'))
               for name in _NUMBERS}
    if not 0.0 <= numbers['tracked_share'] <= 1.0:
        raise SlamError(f'{path}: line {line}: tracked_share: {numbers["tracked_share"]:g} is not '
                        'valid; valid is 0 to 1')
    if not numbers['ate_percent'] == numbers['ate_percent'] and numbers['distance_m']:
        numbers['ate_percent'] = 100.0 * numbers['ate_m'] / numbers['distance_m']
    frames = number('frames', 0.0)
    if not 0.0 <= frames < 2**53:
        raise SlamError(f'{path}: line {line}: frames: {frames:g} is not valid; valid is >= 0')
    drive = Drive(text('scenario'), int(text('seed')), number('asked_s'), text('parameter'),
                  text('value'), overrides)
    return Judged(drive, SlamResult(text('system'), text('sensor'), text('reason'),
                                    int(frames), words=text('words'), **numbers),
                  text('failed') == '1')


# Folders, and parts together

def read_folder(folder: Path) -> list[Judged]:
    """Return what is done of the benchmark in a folder.

    Raises:
        SlamError: If there is none, or a result is not one.
    """
    paths = sorted((folder / CELLS).glob(f'*/{RESULT}'))
    if not paths:
        raise SlamError(f'{folder}: holds no results of a benchmark; valid is a folder that '
                        f'`benchmark` wrote, or its SYSTEM_drives.csv')
    return [read_result(path)[0] for path in paths]


def read_result(path: Path) -> tuple[Judged, Any]:
    """Return what a RESULT says of a drive, and what was asked for as it stands there.

    Raises:
        SlamError: If it cannot be read.
    """
    try:
        kept = json.loads(read_text(path, MAX_BYTES, SlamError))
    except (ValueError, RecursionError) as error:
        raise SlamError(f'{path}: cannot be read: {error}') from None
    try:
        asked = dict(kept['request']['drive'])
        asked['overrides'] = tuple(asked['overrides'])
        return Judged(Drive(**asked), SlamResult.from_mapping(kept['result']),
                      bool(kept['failed']), path.parent), kept['request']
    except (KeyError, TypeError, AttributeError):
        raise SlamError(f'{path}: is not a result of a benchmark') from None


def join(sources: Sequence[Path]) -> list[Judged]:
    """Return the drives of all parts of a benchmark, by scenario, value, sensor, system and seed.

    What several parts hold with the same numbers counts once.

    Args:
        sources: Folders of benchmarks, finished or not, and CSVs of drives.

    Raises:
        SlamError: If two parts have different results of one drive, drives of one scenario last
            different times or have different settings, or more than one parameter is swept.
    """
    found: dict[tuple[str, str, str, int, str, str], tuple[Judged, Path]] = {}
    for source in sources:
        for one in read_folder(source) if source.is_dir() else read_csv(source):
            other, where = found.setdefault(one.key, (one, source))
            if where is source and other is not one:
                raise SlamError(f'{source}: {one.text} is in it twice')
            if _numbers(one) != _numbers(other):
                raise SlamError(f'{one.text}: {where} and {source} have different results; name '
                                'one of them')
    _check_alike(list(found.values()))
    scenarios = list(dict.fromkeys(one.drive.scenario for one, _ in found.values()))
    return sorted((one for one, _ in found.values()), key=lambda one: (
        scenarios.index(one.drive.scenario), _place(one.drive.value), one.result.sensor,
        one.result.system != 'reference', one.result.system, one.drive.seed))


def _numbers(one: Judged) -> tuple[object, ...]:
    """Return what is the same in two results of one run: all but how long it took."""
    values = one.result.to_mapping()
    return (one.failed, *(values[name] for name in ('tracked_share', 'ate_m', 'scale')))


def _check_alike(found: Sequence[tuple[Judged, Path]]) -> None:
    parameters = {one.drive.parameter for one, _ in found}
    if len(parameters) > 1:
        raise SlamError('parts sweep different parameters: '
                        f'{", ".join(sorted(p or "none" for p in parameters))}')
    first: dict[str, tuple[Drive, Path]] = {}
    for one, source in found:
        drive = one.drive
        if drive.duration_s != drive.duration_s:
            continue        # a CSV that does not say what was asked for
        other, where = first.setdefault(drive.scenario, (drive, source))
        for name, mine, theirs in (('lasts', f'{drive.duration_s:g} s', f'{other.duration_s:g} s'),
                                   ('has settings', _settings(drive), _settings(other))):
            if mine != theirs:
                raise SlamError(f'{one.text} in {source} {name} {mine}, {other.name} in {where} '
                                f'{theirs}: these are no parts of one benchmark')


def is_of_drive(setting: str) -> bool:
    """Return whether drives of one benchmark may differ in a setting: in the way they follow."""
    return setting.startswith(_WAY)


def _settings(drive: Drive) -> str:
    own = sorted(text for text in drive.overrides
                 if not text.startswith(_RECORDER) and not is_of_drive(text))
    return ', '.join(own) or 'none'


def _place(value: str) -> tuple[float, str]:
    """Return what values of a sweep are sorted by: numbers by size, then texts."""
    try:
        return float(value or 0.0), ''
    except ValueError:
        return float('inf'), value
