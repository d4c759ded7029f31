"""Export of a bag to a sequence that SLAM programs read.

The bag is read once, in the order of time; images are compressed by a few threads with a bounded
queue, so that memory does not grow with the bag. The sequence appears under its name only when it
is complete.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Mapping
from datetime import datetime, timezone
import functools
import math
from pathlib import Path
from typing import Any

from lunar_rover_sim.bag.messages import exposure_s, header_ns
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.series import picture
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import SequenceError
from lunar_rover_sim.base.files.atomic import partial_folder
from lunar_rover_sim.base.files.paths import counted
from lunar_rover_sim.base.parameters import nearest
from lunar_rover_sim.base.seconds import EPOCH_NS, NS_PER_S
from lunar_rover_sim.image.camera.encoding import EIGHT_BITS, has_16_bits
from lunar_rover_sim.products.sequences.euroc import EurocSequence
from lunar_rover_sim.products.sequences.kitti import KittiSequence
from lunar_rover_sim.products.sequences.labelled import CocoSequence, YoloSequence
from lunar_rover_sim.products.sequences.sensors import CALIBRATION_FILE, calibration_yaml
from lunar_rover_sim.products.sequences.sequence import PngWriter, Sequence
from lunar_rover_sim.products.sequences.tartanair import TartanAirSequence
from lunar_rover_sim.products.sequences.tum import TumSequence
from lunar_rover_sim.products.sequences.webdataset import ShardOptions, WebDatasetSequence
from lunar_rover_sim.sensors.registry import SENSORS

_TYPES = {topic.name: topic.type for topic in topics.CONTRACT}
_OF_DEPTH_FRAMES = {topic.name for topic in topics.CONTRACT if topic.rate == topics.DEPTH_FRAME}
_IMAGE = 'sensor_msgs/msg/Image'
_CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
README_FILE = 'README.txt'
EXPOSURE_FILE = 'exposures.csv'
MISCALIBRATION_FILE = 'miscalibration.json'     # truth, which calibration.yaml does not know
_LATEST_EPOCH_NS = 9_000_000_000 * NS_PER_S     # with a drive of years it still is an int64
_EVERY_DEPTH = ' (render_node.depth_every=1 records it with every image)'


def export(path: Path | str, output: Path | str, kind: str = 'euroc',
           progress: Callable[[], None] | None = None,
           shards: ShardOptions = ShardOptions(), epoch_ns: int = EPOCH_NS) -> list[str]:
    """Write a sequence into the new folder `output`; return sentences about it for the user.

    README.txt says what the poses are of.

    Args:
        path: Bag.
        output: Folder to make.
        kind: Name in `FORMATS`.
        progress: Called once per message.
        shards: Of WebDataset; other formats have none.
        epoch_ns: Unix time [ns] at which simulated time is 0, in formats that name files by time
            (EuRoC, TUM). It is >= 0, and stamps have 19 digits with it.

    Raises:
        BagError: The bag cannot be read.
        SequenceError: The bag lacks what the format needs, or the folder cannot be written.
    """
    if not 0 <= epoch_ns < _LATEST_EPOCH_NS:
        raise SequenceError(f'epoch_ns: {epoch_ns} is not valid; valid is 0 (1970) to '
                            f'{_LATEST_EPOCH_NS} (2255) [ns]')
    if kind not in FORMATS:
        raise SequenceError(f'format: {kind!r} is not valid; {nearest(kind, FORMATS)}')
    make: Callable[[Bag, Path, PngWriter], Sequence] = FORMATS[kind]
    if kind == WEBDATASET:
        make = functools.partial(WebDatasetSequence, options=shards)
    output = Path(output)
    if output.exists():
        raise SequenceError(f'{output}: exists already and is not overwritten; name another '
                            'folder')
    with open_bag(path) as bag, partial_folder(output, SequenceError) as partial:
        folder = partial / output.name
        folder.mkdir()
        with PngWriter() as images, make(bag, folder, images) as sequence:
            sequence.epoch_ns = epoch_ns if sequence.is_dated else 0
            notes = _stream(bag, sequence, progress)
            (folder / CALIBRATION_FILE).write_text(
                calibration_yaml(sequence.suite, kind, sequence.depth, sequence.further,
                                 sequence.T_base_lidar),
                encoding='utf-8')
            if bag.count(topics.MISCALIBRATION.name):
                (folder / MISCALIBRATION_FILE).write_text(
                    bag.first(topics.MISCALIBRATION.name).data + '\n', encoding='utf-8')
            (folder / README_FILE).write_text(_readme(bag, sequence, kind), encoding='utf-8')
        folder.rename(output)
    return [f'{output}: {notes[0]}', *notes[1:]]


def _readme(bag: Bag, sequence: Sequence, kind: str) -> str:
    """Return what README.txt says: format, poses, time."""
    lines = [f'A sequence in the format {kind}, exported from a bag by lunar_rover_sim.', '']
    if sequence.poses_of:
        lines.append(f'Poses: {sequence.poses_of}.' if bag.has(bag.truth)
                     else 'Poses: none; the bag has no odometry.')
    if sequence.is_dated:
        date = datetime.fromtimestamp(sequence.epoch_ns // NS_PER_S, timezone.utc)
        lines.append(f'Time: Unix time; simulated time 0 is {date:%Y-%m-%dT%H:%M:%S} UTC '
                     f'({sequence.epoch_ns} ns).')
    else:
        lines.append('Time: simulated, from 0 at the start of the simulation.')
    lines.append(f'Calibration: {CALIBRATION_FILE}.')
    return '\n'.join(lines) + '\n'


def _stream(bag: Bag, sequence: Sequence, progress: Callable[[], None] | None) -> list[str]:
    # The formats know the true odometry by its usual name.
    sources = {name: bag.truth if name == topics.ODOM.name else name
               for name in sequence.needs + sequence.uses}
    wanted = [name for name, source in sources.items()
              if bag.has(source) and _TYPES.get(name) != _CAMERA_INFO]
    names = {bag.resolve(sources[name]): name for name in wanted}
    images = [name for name in wanted if _TYPES.get(name) == _IMAGE]
    sets = _ImageSets(bag, sequence.images, images, sequence.first_ns)
    further: dict[str, _ImageSets] = {}
    for camera in sequence.further:
        own = [camera.topics[topic] for topic in sequence.of_further if topic in camera.topics]
        group = _ImageSets(bag, functools.partial(sequence.further_images, camera), own)
        further.update(dict.fromkeys(own, group))
        names.update({bag.resolve(name): name for name in own})
    exposures_s: dict[int, float] = {}      # by stamp [ns]
    if bag.has(topics.EXPOSURE.name):
        names[bag.resolve(topics.EXPOSURE.name)] = topics.EXPOSURE.name
    for message in bag.raw(names):
        if progress is not None:
            progress()
        name = names[message.topic]
        decoded = bag.decode(message.data, message.msgtype)
        if name in images or name in further:
            (sets if name in images else further[name]).take(name, decoded)
            continue
        if name == topics.EXPOSURE.name:
            exposures_s[header_ns(decoded)] = exposure_s(decoded)
        if name in wanted:
            sequence.data(name, header_ns(decoded), decoded)
    notes = sets.finish()
    if exposures_s:
        sequence.line(EXPOSURE_FILE, '#timestamp [ns],exposure time [s]')
        for stamp_ns in sets.written_ns:
            time_s = exposures_s.get(stamp_ns, math.nan)    # real time may lose a message
            sequence.line(EXPOSURE_FILE, f'{stamp_ns + sequence.epoch_ns},{time_s!r}')
    return [*notes, *(note for group in dict.fromkeys(further.values())
                      for note in group.lacking()),
            *sequence.notes(), *_deep_images(bag, sequence), *left_out(bag, sequence)]


def _deep_images(bag: Bag, sequence: Sequence) -> list[str]:
    """Return a note on cameras whose images have 16 bits."""
    names = [name for name in (topics.LEFT_IMAGE.name, topics.RIGHT_IMAGE.name)
             if name in sequence.needs + sequence.uses]
    names += [camera.topics[topics.HAZARD_IMAGE] for camera in sequence.further]
    deep = [name for name in names if bag.count(name) and has_16_bits(bag.first(name).encoding)]
    return [f'16 bits: {", ".join(deep)}; ORB-SLAM3 cannot read them, and Pillow turns mono16 into'
            f' white RGB; for these record {", ".join(EIGHT_BITS)}'] if deep else []


_MOST_OPEN = 64     # sets of images that are held while they are not complete


class _ImageSets:
    """Puts images of one stamp together."""

    def __init__(self, bag: Bag, take: Callable[[int, dict[str, Any]], None], names: list[str],
                 first_ns: int = 0) -> None:
        """first_ns: sets of earlier stamps are left out, since they have no LiDAR scan."""
        self._bag = bag
        self._first_ns = first_ns
        self._take = take
        self._names = frozenset(names)
        self._open: dict[int, dict[str, Any]] = {}
        self._scanless = 0
        self.written_ns: list[int] = []     # stamps
        # Topics that were missing → sets that were left out without them.
        self._lacking: Counter[frozenset[str]] = Counter()

    def take(self, name: str, message: Any) -> None:
        stamp_ns = header_ns(message)
        entry = self._open.setdefault(stamp_ns, {})
        if len(self._open) > _MOST_OPEN:        # of a stamp that never becomes complete
            self._note(self._open.pop(min(self._open)))
        entry[name] = picture(self._bag, message).pixels
        if set(entry) == self._names:
            for ns in [ns for ns in self._open if ns <= stamp_ns]:
                self._note(self._open.pop(ns))
            if stamp_ns < self._first_ns:
                self._scanless += 1
            else:
                self._take(stamp_ns, entry)
                self.written_ns.append(stamp_ns)

    def finish(self) -> list[str]:
        if not self.written_ns:
            after = ' after the first LiDAR scan' if self._scanless else ''
            raise SequenceError(f'{self._bag.path}: holds no complete set of '
                                f'{", ".join(sorted(self._names))}{after}; there is nothing to '
                                'export')
        notes = [counted(len(self.written_ns), 'image set')]
        if self._scanless:
            notes.append(f'{counted(self._scanless, "image set")} left out at the beginning: no '
                         'LiDAR scan before them')
        return notes + self.lacking()

    def lacking(self) -> list[str]:
        """Return notes on the sets that were left out since an image was missing."""
        for entry in self._open.values():
            self._note(entry)
        notes = []
        for names, count in sorted((sorted(n), c) for n, c in self._lacking.items()):
            hint = _EVERY_DEPTH if _OF_DEPTH_FRAMES.issuperset(names) else ''
            notes.append(f'{counted(count, "image set")} without {", ".join(names)} left out'
                         + hint)
        return notes

    def _note(self, entry: dict[str, Any]) -> None:
        missing = self._names.difference(entry)
        if missing:
            self._lacking[missing] += 1


WEBDATASET = 'webdataset'

FORMATS: Mapping[str, type[Sequence]] = {
    'euroc': EurocSequence,
    'tum': TumSequence,
    'kitti': KittiSequence,
    'tartanair': TartanAirSequence,
    'coco': CocoSequence,
    'yolo': YoloSequence,
    WEBDATASET: WebDatasetSequence,
}


# Beside hazard cameras, whose topics bear their names.
OF_SENSORS = (topics.LEFT_IMAGE, topics.RIGHT_IMAGE, *topics.OF_LIDAR,
              *(topic for sensor in SENSORS for topic in sensor.published))
NO_PLACE = 'this format has no place for them'


def left_out(bag: Bag, sequence: Sequence) -> list[str]:
    """Return notes on the sensors of a bag that a sequence does not hold."""
    return [*sensors_left_out(bag, sequence.needs + sequence.uses, sequence.lacks),
            *hazards_left_out(bag, [camera.name for camera in sequence.further],
                              sequence.further_needs or NO_PLACE)]


def sensors_left_out(bag: Bag, taken: Collection[str],
                     lacks: Mapping[str, str] = {}) -> list[str]:
    """Return a note for each reason why topics with messages are left out.

    Args:
        taken: Topics that are not.
        lacks: Topic → the reason, NO_PLACE where it names none.
    """
    named: dict[str, list[str]] = defaultdict(list)
    for topic in topics.of_legs(OF_SENSORS, topics.legs_of(bag.types)):
        if topic.name not in taken and bag.count(topic.name):
            named[lacks.get(topic.name, NO_PLACE)].append(topic.name)
    return [f'left out: {", ".join(names)}; {reason}' for reason, names in named.items()]


def hazards_left_out(bag: Bag, taken: Collection[str], reason: str = NO_PLACE) -> list[str]:
    """Return a note on the hazard cameras of a bag that are not taken."""
    there = {camera for full in bag.types if (camera := _hazard_of(bag, full)) is not None}
    lacking = sorted(there.difference(taken))
    return [f'left out: hazard cameras {", ".join(lacking)}; {reason}'] if lacking else []


def _hazard_of(bag: Bag, full: str) -> str | None:
    """Return the hazard camera that a topic is an image of."""
    known = topics.of_hazard(full.removeprefix(bag.namespace + '/'))
    return known[1] if known is not None and known[0] is topics.HAZARD_IMAGE else None
