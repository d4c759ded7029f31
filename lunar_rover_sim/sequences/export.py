"""Sequences for SLAM programs from bags: EuRoC, TUM RGB-D, KITTI odometry, TartanAir.

The bag is read once, in the order of time; images are compressed by a few threads with a bounded
queue, so that memory does not grow with the bag. The sequence appears under its name only when it
is complete.
"""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import shutil
from typing import Any

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.series import header_ns, picture
from lunar_rover_sim.errors import BagError
from lunar_rover_sim.parameters import nearest
from lunar_rover_sim.sequences.euroc import EurocSequence
from lunar_rover_sim.sequences.kitti import KittiSequence
from lunar_rover_sim.sequences.sensor_yaml import CALIBRATION_FILE, calibration_yaml
from lunar_rover_sim.sequences.sequence import PngWriter, Sequence
from lunar_rover_sim.sequences.tartanair import TartanAirSequence
from lunar_rover_sim.sequences.tum import TumSequence

FORMATS: dict[str, type[Sequence]] = {'euroc': EurocSequence, 'tum': TumSequence,
                                      'kitti': KittiSequence, 'tartanair': TartanAirSequence}
_IMAGES = (topics.LEFT_IMAGE.name, topics.RIGHT_IMAGE.name, topics.TRUE_DEPTH.name,
           topics.DEPTH.name)
_DATA = (topics.IMU_RAW.name, topics.IMU_BIAS.name, topics.ODOM.name)


def export(path: Path | str, output: Path | str, kind: str = 'euroc',
           progress: Callable[[], None] | None = None) -> list[str]:
    """Write a sequence into the new folder `output`; return what is worth knowing, in sentences.

    kind: euroc, tum, kitti or tartanair; progress is called once a message.
    Images that no IMU sample encloses are left out where there is an IMU: ORB-SLAM3 reads past
    its samples otherwise.
    Raises BagError where the bag lacks what the format needs, or the folder cannot be written.
    """
    if kind not in FORMATS:
        raise BagError(f'format: {kind!r} is not valid; {nearest(kind, FORMATS)}')
    output = Path(output)
    if output.exists():
        raise BagError(f'{output}: exists already and is not overwritten; name another folder')
    partial = output.with_name(f'.{output.name}.{os.getpid()}.partial')
    try:
        with open_bag(path) as bag:
            partial.mkdir(parents=True)
            with PngWriter() as images, FORMATS[kind](bag, partial, images) as sequence:
                notes = _stream(bag, sequence, progress)
                (partial / CALIBRATION_FILE).write_text(
                    calibration_yaml(sequence.suite, kind), encoding='utf-8')
            partial.rename(output)
    except OSError as error:
        raise BagError(f'{output}: cannot be written: {error.strerror or error}') from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return [f'{output}: {notes[0]}', *notes[1:]]


def _stream(bag: Bag, sequence: Sequence, progress: Callable[[], None] | None) -> list[str]:
    wanted = [name for name in (*_IMAGES, *_DATA)
              if name in sequence.needs + sequence.uses and bag.has(name)]
    names = {bag.resolve(name): name for name in wanted}
    waits = topics.IMU_RAW.name in wanted
    sets = _Sets(bag, sequence, [n for n in wanted if n in _IMAGES], waits)
    for message in bag.raw(names):
        if progress is not None:
            progress()
        name = names[message.topic]
        decoded = bag.decode(message.data, message.msgtype)
        if name in _IMAGES:
            sets.take(name, decoded)
            continue
        sequence.data(name, header_ns(decoded), decoded)
        if name == topics.IMU_RAW.name:
            sets.imu(header_ns(decoded))
    return sets.finish()


class _Sets:
    """Puts images of one stamp together and holds them until an IMU sample follows."""

    def __init__(self, bag: Bag, sequence: Sequence, names: list[str],
                 waits_for_imu: bool) -> None:
        self._bag = bag
        self._sequence = sequence
        self._names = set(names)
        self._waits = waits_for_imu
        self._first_imu_ns: int | None = None
        self._open: dict[int, dict[str, Any]] = {}
        self._held: list[tuple[int, dict[str, Any]]] = []
        self._written = self._before = self._incomplete = 0

    def take(self, name: str, message: Any) -> None:
        stamp_ns = header_ns(message)
        entry = self._open.setdefault(stamp_ns, {})
        entry[name] = picture(self._bag, message).pixels
        if set(entry) == self._names:
            self._incomplete += sum(ns < stamp_ns for ns in self._open)
            self._open = {ns: e for ns, e in self._open.items() if ns > stamp_ns}
            if not self._waits:
                self._write(stamp_ns, entry)
            elif self._first_imu_ns is None or stamp_ns < self._first_imu_ns:
                self._before += 1
            else:
                self._held.append((stamp_ns, entry))

    def imu(self, stamp_ns: int) -> None:
        if self._first_imu_ns is None:
            self._first_imu_ns = stamp_ns
        while self._held and self._held[0][0] < stamp_ns:
            self._write(*self._held.pop(0))

    def _write(self, stamp_ns: int, entry: dict[str, Any]) -> None:
        self._sequence.images(stamp_ns, entry)
        self._written += 1

    def finish(self) -> list[str]:
        if not self._written:
            raise BagError(f'{self._bag.path}: holds no complete set of '
                           f'{", ".join(sorted(self._names))}; there is nothing to export')
        notes = [f'{self._written} image sets']
        trimmed = self._before + len(self._held)
        if trimmed:
            notes.append(f'{trimmed} image sets left out ({self._before} at the begin, '
                         f'{len(self._held)} at the end): no IMU sample before or after them')
        incomplete = self._incomplete + len(self._open)
        if incomplete:
            notes.append(f'{incomplete} incomplete image sets left out')
        return notes + self._sequence.notes()
