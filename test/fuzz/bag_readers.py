"""Readers of bags; see `readers.py`."""

import functools
from pathlib import Path
import random

from claims import claim, one_line

from lunar_rover_sim.bag.content_hash import topic_hashes
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario
from lunar_rover_sim.bag.recovery import recover
from lunar_rover_sim.bag.series import picture, read_calibration, read_imu, read_odometry
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import LunarRoverSimError
from lunar_rover_sim.judge.evaluation.trajectory_files import load
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.products.inspection.report import Status


@functools.lru_cache(maxsize=8)
def _hashes_of(bag: Path) -> dict[str, str]:
    return topic_hashes(bag)


def _use(bag: Bag) -> None:
    """What the programs behind read from a bag; each part may be refused."""
    for part in (lambda: list(bag.messages()), lambda: recorded_scenario(bag),
                 lambda: read_odometry(bag), lambda: read_imu(bag),
                 lambda: read_calibration(bag, topics.LEFT_INFO.name),
                 lambda: picture(bag, bag.first(topics.LEFT_IMAGE.name)),
                 lambda: load(bag.path)):
        try:
            part()
        except LunarRoverSimError as error:
            one_line(error)


def read_bag(folder: Path, valid: Path, _file: Path, _rng: random.Random) -> None:
    """What the bag check passes, its checksums fitting, has the content of the valid bag."""
    with open_bag(folder / 'bag') as bag:
        _use(bag)
    report = check(folder / 'bag')
    sealed = any(f.check == 'checksums' and f.status == Status.PASS for f in report.findings)
    if report.ok and sealed:
        claim(topic_hashes(folder / 'bag') == _hashes_of(valid / 'bag'),
              'the bag check passes another content')


def read_cut_end(folder: Path, valid: Path, _file: Path, _rng: random.Random) -> None:
    """A cut bag is recovered, or holds no complete chunk; it is never taken for complete."""
    path = folder / 'bag'
    try:
        with open_bag(path) as bag:
            claim(bag.incomplete, 'a bag without its end is taken for complete')
    except LunarRoverSimError as error:
        one_line(error)
    count = recover(path)
    with open_bag(path) as bag:
        claim(bag.incomplete, 'a recovered bag is not marked')
        read = [(m.topic, m.time_ns, m.data) for m in bag.raw()]
    claim(len(read) == count, f'{count} messages are told, {len(read)} are read')
    claim(set(read) <= _messages_of(valid / 'bag'), 'a message was not there')
    claim(not check(path).ok, 'the bag check passes a recovered bag')


@functools.lru_cache(maxsize=2)
def _messages_of(path: Path) -> frozenset[tuple[str, int, bytes]]:
    with open_bag(path) as bag:
        return frozenset((m.topic, m.time_ns, m.data) for m in bag.raw())


def read_cut_bag(folder: Path, valid: Path, _file: Path, _rng: random.Random) -> None:
    """What is recovered can be read, stays marked, and has no message that was not there."""
    path = folder / 'bag'
    recover(path)
    with open_bag(path) as bag:
        claim(bag.incomplete, 'a recovered bag is not marked')
        _use(bag)
    claim(not check(path).ok, 'the bag check passes a recovered bag')
