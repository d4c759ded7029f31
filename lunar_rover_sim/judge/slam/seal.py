"""A sealed benchmark: which drives count, and by what their recordings are known again.

A seal is a YAML file: scenarios, seeds, duration, sensors and settings, and of each drive the hash
of its world, the hash of its motion, mean grey levels of a few of its images, and the settings
that are its own, such as the way that it follows. World and motion are
equal bit by bit on all x86-64 processors with FMA. Images are drawn by other code on other
processors, so that single pixels differ; the means of blocks of thousands of pixels may differ by
IMAGE_TOLERANCE. A seal also holds what a packaged estimator made of the drives, to compare with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from lunar_rover_sim.bag.content_hash import topic_hashes
from lunar_rover_sim.bag.message_validity import image_problem, pixels
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import brief, SlamError
from lunar_rover_sim.base.files.paths import BAG_FOLDER
from lunar_rover_sim.base.files.results import plain
from lunar_rover_sim.base.files.yaml_text import read_yaml, yaml_of
from lunar_rover_sim.judge.slam.drives import Drive, is_of_drive, Judged, read_folder
from lunar_rover_sim.judge.slam.table import is_success, tipped_over
from lunar_rover_sim.products.sequences.orbslam3_settings import SENSORS

RECORDINGS = 'recordings'   # in the folder of a benchmark: a folder for each drive
IMAGE_TOLERANCE = 1.0       # of a mean grey level, of 255
_MOTION = (topics.ODOM, topics.IMU_RAW)
_IMAGES = (topics.LEFT_IMAGE, topics.RIGHT_IMAGE)
_ROWS, _COLUMNS = 3, 4      # blocks of an image
_MAX_BYTES = 1 << 22
_FIELDS = ('name', 'version', 'scenarios', 'seeds', 'duration_s', 'sensors', 'settings', 'drives',
           'results')
_SCORES = ('scenario', 'system', 'sensor', 'drives', 'successes', 'ate_percent')


@dataclasses.dataclass(frozen=True)
class Fingerprint:
    """What a recording is known by.

    Attributes:
        world: Hash of the terrain.
        motion: Hash of poses, velocities and IMU.
        images: Mean grey levels [of 255], row by row, of the blocks of the first, the middle and
            the last image, left ones first.
    """

    world: str
    motion: str
    images: tuple[tuple[float, ...], ...]

    def differences(self, other: Fingerprint) -> list[str]:
        """Return what is not alike, in words."""
        found = [f'its {name} is {mine[:12]}…, sealed is {theirs[:12]}…'
                 for name, mine, theirs in (('world', self.world, other.world),
                                            ('motion', self.motion, other.motion))
                 if mine != theirs]
        mine, theirs = np.array(self.images), np.array(other.images)
        if mine.shape != theirs.shape:
            found.append('it has images of another kind')
        elif mine.size and np.abs(mine - theirs).max() > IMAGE_TOLERANCE:
            found.append(f'grey levels of its images differ by up to '
                         f'{np.abs(mine - theirs).max():.1f} of 255, valid is up to '
                         f'{IMAGE_TOLERANCE:g}')
        return found


@dataclasses.dataclass(frozen=True)
class Seal:
    """The drives of a benchmark that counts.

    Attributes:
        settings: Overrides of the scenarios, NODE.PARAM=VALUE.
        drives: Name of a drive → its fingerprint.
        own: Name of a drive → overrides that other drives do not have.
        results: Of the estimator that sealed it: plain values of `scores`.
    """

    name: str
    version: int
    scenarios: tuple[str, ...]
    seeds: tuple[int, ...]
    duration_s: float
    sensors: tuple[str, ...]
    settings: tuple[str, ...]
    drives: Mapping[str, Fingerprint]
    own: Mapping[str, tuple[str, ...]]
    results: Sequence[Mapping[str, Any]] = ()

    def drive(self, scenario: str, seed: int) -> Drive:
        """Return one of the drives."""
        plain = Drive(scenario, seed, self.duration_s)
        return dataclasses.replace(plain, overrides=self.settings + self.own[plain.name])

    def problems(self, folder: Path,
                 progress: Callable[[str], None] = lambda _name: None) -> list[str]:
        """Return why the recordings in the folder of a benchmark are not the sealed ones.

        Args:
            progress: Called with the name of each drive.

        Raises:
            BagError: If a recording cannot be read.
        """
        found = []
        for name, sealed in self.drives.items():
            progress(name)
            bag = folder / RECORDINGS / name / BAG_FOLDER
            if not bag.is_dir():
                found.append(f'{name}: is not recorded')
                continue
            found += [f'{name}: {what}' for what in fingerprint(bag).differences(sealed)]
        return found


def fingerprint(path: Path) -> Fingerprint:
    """Return the fingerprint of a recording.

    Raises:
        BagError: If it cannot be read, or lacks one of the topics.
        SlamError: If an image is not valid.
    """
    with open_bag(path) as bag:
        world = str(bag.first(topics.WORLD_HASH.name).data)
        hashes = topic_hashes(path, only=[bag.resolve(topic.name) for topic in _MOTION])
        motion = hashlib.sha256(''.join(
            hashes[bag.resolve(topic.name)] for topic in _MOTION).encode()).hexdigest()
        return Fingerprint(world, motion, tuple(
            levels for topic in _IMAGES for levels in _levels(bag, topic.name)))


def _levels(bag: Bag, topic: str) -> list[tuple[float, ...]]:
    """Return the mean grey levels of blocks of three images of a topic."""
    last = bag.count(topic) - 1
    found = []
    for k, message in enumerate(bag.raw([topic])):
        if k not in (0, last // 2, last):
            continue
        image = bag.decode(message.data, message.msgtype)
        if problem := image_problem(image):
            raise SlamError(f'{bag.path}: {topic}: {problem}')
        grey = np.asarray(pixels(image), float)
        grey *= 255.0 / (65535.0 if image.encoding.endswith('16') else 255.0)
        found.append(tuple(round(float(block.mean()), 1)
                           for row in np.array_split(grey, _ROWS)
                           for block in np.array_split(row, _COLUMNS, axis=1)))
    return found


def scores(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return what counts, by scenario, system and sensor.

    `drives` on which the rover stayed upright, `successes` among them (90 % of the frames tracked,
    in one map), and the median of the error [% of the distance] over all of them, a failure
    counting as worse than any; None where half of them or more are failures.
    """
    groups: dict[tuple[str, str, str], list[Judged]] = {}
    for one in judged:
        if not tipped_over(one):
            key = (one.drive.scenario, one.result.system, one.result.sensor)
            groups.setdefault(key, []).append(one)
    return [{'scenario': scenario, 'system': system, 'sensor': sensor, 'drives': len(group),
             'successes': sum(map(is_success, group)),
             'ate_percent': plain(_median([one.result.ate_percent if is_success(one)
                                           else float('inf') for one in group]))}
            for (scenario, system, sensor), group in groups.items()]


def _median(values: list[float]) -> float:
    """Return the lower of the two middle values, so that one failure of two does not count."""
    middle = sorted(values)[(len(values) - 1) // 2]
    return round(middle, 4) if np.isfinite(middle) else float('nan')


def write_seal(folder: Path, name: str, version: int) -> str:
    """Return the seal of a finished benchmark as YAML.

    Raises:
        SlamError: If nothing is there, drives differ in duration, or in settings other than their
            ways, the drives are not the same seeds of each scenario, or it is a sweep.
    """
    judged = read_folder(folder)
    drives = {one.drive.name: one.drive for one in judged}
    first = next(iter(drives.values()))
    scenarios = list(dict.fromkeys(drive.scenario for drive in drives.values()))
    seeds = sorted({drive.seed for drive in drives.values()})
    own = {name: tuple(text for text in drive.overrides if is_of_drive(text))
           for name, drive in drives.items()}
    common = tuple(text for text in first.overrides if not is_of_drive(text))
    expected = {Drive(scenario, seed, first.duration_s)
                for scenario in scenarios for seed in seeds}
    if first.parameter or expected != {
            dataclasses.replace(drive, overrides=()) for drive in drives.values()} or any(
            drive.overrides != common + own[name] for name, drive in drives.items()):
        raise SlamError(f'{folder}: cannot be sealed: valid is each scenario with the same seeds, '
                        'one duration, the same settings, no sweep')
    return yaml_of({
        'name': name, 'version': version, 'scenarios': scenarios,
        'seeds': seeds,
        'duration_s': first.duration_s,
        'sensors': sorted({one.result.sensor for one in judged}),
        'settings': list(common),
        'drives': {name: _plain(fingerprint(folder / RECORDINGS / name / BAG_FOLDER))
                   | ({'settings': list(own[name])} if own[name] else {}) for name in drives},
        'results': scores(judged)}, width=1000)


def _plain(print_: Fingerprint) -> dict[str, Any]:
    return {'world': print_.world, 'motion': print_.motion,
            'images': [' '.join(f'{level:g}' for level in levels) for levels in print_.images]}


def read_seal(path: Path) -> Seal:
    """Return the seal in a file.

    Raises:
        SlamError: If it cannot be read, or is not one.
    """
    content = read_yaml(path, _MAX_BYTES, SlamError)
    if not isinstance(content, dict) or (lacking := [f for f in _FIELDS if f not in content]):
        raise SlamError(f'{path}: is no seal of a benchmark'
                        + (f': it lacks {", ".join(lacking)}' if isinstance(content, dict)
                           else ''))
    try:
        seal = Seal(str(content['name']), int(content['version']),
                    tuple(map(str, content['scenarios'])), tuple(map(int, content['seeds'])),
                    float(content['duration_s']), tuple(map(str, content['sensors'])),
                    tuple(map(str, content['settings'])),
                    {str(name): Fingerprint(str(one['world']), str(one['motion']), tuple(
                        tuple(map(float, levels.split())) for levels in one['images']))
                     for name, one in content['drives'].items()},
                    {str(name): tuple(map(str, one.get('settings', ())))
                     for name, one in content['drives'].items()},
                    [dict(row) for row in content['results']])
    except (TypeError, KeyError, ValueError, OverflowError, AttributeError) as error:
        raise SlamError(f'{path}: is no seal of a benchmark: {brief(str(error))}') from None
    if wrong := [sensor for sensor in seal.sensors if sensor not in SENSORS]:
        raise SlamError(f'{path}: sensors: {brief(wrong[0])} is not valid; valid are '
                        f'{", ".join(SENSORS)}')
    for name, print_ in seal.drives.items():
        levels = [level for block in print_.images for level in block]
        if not levels or not all(0.0 <= level <= 255.0 for level in levels):
            raise SlamError(f'{path}: images of {name}: valid are grey levels of 0 to 255')
    for row in seal.results:
        if lacking := [key for key in _SCORES if key not in row]:
            raise SlamError(f'{path}: results: a row lacks {", ".join(lacking)}')
    names = {Drive(scenario, seed, seal.duration_s).name
             for scenario in seal.scenarios for seed in seal.seeds}
    if names != seal.drives.keys():
        raise SlamError(f'{path}: drives: valid are those of its scenarios and seeds; these are '
                        f'not: {", ".join(sorted(names ^ seal.drives.keys()))}')
    return seal
