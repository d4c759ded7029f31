"""WebDataset shards: images, truth and poses of a drive as samples in tar files.

A sample is what one stamp shows: pictures as PNG, numbers of pixels as NPY, the rest as JSON; and
what LiDAR, heading sensors and power monitors measured last, at or before it. Its key is the name
of the drive and a number. index.json lists the shards, label_info.json is the vocabulary of the
labels.

In a shard, a tar, the files of a sample follow each other and share their name up to the first
dot, the key; what comes after the dot tells what they hold (Aizman, Maltby and Breuel, High
Performance I/O For Large Scale Deep Learning, IEEE Big Data 2019). Tars have no times and no
owners: the same samples give the same bytes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
import dataclasses
import io
import json
from pathlib import Path
import re
import tarfile
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import SequenceError
from lunar_rover_sim.base.files.arrays import npy_bytes
from lunar_rover_sim.base.files.images import png_bytes
from lunar_rover_sim.base.files.paths import counted, file_hash
from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.products.sequences.labelled import check_pinhole
from lunar_rover_sim.products.sequences.sensor_samples import (carried, CARRIED, KEPT_NS, LATE_NS,
                                                               SensorSamples)
from lunar_rover_sim.products.sequences.sensors import RecordedCamera
from lunar_rover_sim.products.sequences.sequence import PngWriter, PosedSequence

DEFAULT_SIZE = 256      # samples per shard
LARGEST_SIZE = 100_000

_KEY = re.compile(r'[A-Za-z0-9_-]+')
_EXTENSION = re.compile(r'[a-z0-9_.]+')
_MOST_NAME = 40


@dataclasses.dataclass(frozen=True)
class Shard:
    """A finished tar file: its name, how many samples and bytes it has, and its SHA-256."""

    name: str
    samples: int
    size_bytes: int
    sha256: str


class ShardWriter:
    """Writes samples into tars shard-000000.tar, ... of a folder. Context manager.

    Attributes:
        shards: Those that are finished; all of them after `close`.
    """

    def __init__(self, folder: Path, size: int = DEFAULT_SIZE) -> None:
        """size: samples per shard; raises SequenceError where it is not valid."""
        check_size(size)
        self._folder, self._size = folder, size
        self._tar: tarfile.TarFile | None = None
        self._path = folder
        self._count = 0
        self.shards: list[Shard] = []

    def write(self, key: str, files: Mapping[str, bytes]) -> None:
        """Append a sample; files: extension without its dot → content."""
        if not _KEY.fullmatch(key):
            raise SequenceError(f'key of a sample: {key!r} is not valid; valid are letters, '
                                'digits, _ and -')
        if self._tar is None:
            self._path = self._folder / shard_name('shard', len(self.shards))
            self._tar = tarfile.open(self._path, 'w', format=tarfile.USTAR_FORMAT)
        for extension in sorted(files):
            if not _EXTENSION.fullmatch(extension):
                raise SequenceError(f'extension of a sample: {extension!r} is not valid; '
                                    'valid are small letters, digits, _ and .')
            member = tarfile.TarInfo(f'{key}.{extension}')  # its time and owner are 0
            member.size = len(files[extension])
            self._tar.addfile(member, io.BytesIO(files[extension]))
        self._count += 1
        if self._count == self._size:
            self._finish()

    def close(self) -> None:
        """Finish the last shard."""
        if self._tar is not None:
            self._finish()

    def _finish(self) -> None:
        assert self._tar is not None
        self._tar.close()
        self._tar = None
        self.shards.append(described(self._path, self._count))
        self._count = 0

    def __enter__(self) -> ShardWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if error is None:
            self.close()
        elif self._tar is not None:
            self._tar.close()


def check_size(size: int) -> None:
    """Raise SequenceError unless so many samples fit into a shard."""
    if not 1 <= size <= LARGEST_SIZE:
        raise SequenceError(f'--shard-size: {size} is not valid; valid is 1 to {LARGEST_SIZE} '
                            'samples per shard')


def shard_name(name: str, index: int) -> str:
    """Return the file name of a shard."""
    return f'{name}-{index:06d}.tar'


def described(path: Path, samples: int) -> Shard:
    """Return what is known of a finished shard; samples: how many it has."""
    return Shard(path.name, samples, path.stat().st_size, file_hash(path))


def index_text(name: str, shards: Iterable[Shard], more: Mapping[str, Any]) -> str:
    """Return a list of shards as JSON, in the layout of the indices of WebDataset (`wids`).

    Args:
        name: Of the data set.
        more: Further entries.
    """
    return json.dumps({
        '__kind__': 'wids-shard-index-v1', 'wids_version': 1, 'name': name,
        'shardlist': [{'url': shard.name, 'nsamples': shard.samples, 'filesize': shard.size_bytes,
                       'sha256': shard.sha256} for shard in shards],
        **more}, indent=1) + '\n'


def key_part(name: str) -> str:
    """Return a name as part of a key: other characters than letters, digits and - become _."""
    return re.sub(r'[^A-Za-z0-9-]', '_', name)[:_MOST_NAME] or '_'


INDEX_FILE = 'index.json'
VOCABULARY_FILE = 'label_info.json'
METADATA = 'json'       # extension
_COMPRESSION = 1        # of 9, as in other formats
_DIGITS = 9
# Topic → extension. Numbers are no PNG: decoders of WebDataset squeeze pictures to 8 bits.
EXTENSIONS = {
    topics.LEFT_IMAGE.name: 'left.png', topics.RIGHT_IMAGE.name: 'right.png',
    topics.TRUE_DEPTH.name: 'depth.npy', topics.LABELS.name: 'labels.npy',
    topics.CRATERS.name: 'craters.npy', topics.SHADOW.name: 'shadow.png',
    topics.NORMALS.name: 'normals.npy', topics.OPTICAL_FLOW.name: 'optical_flow.npy',
    topics.SCENE_FLOW.name: 'scene_flow.npy', topics.RIGHT_TRUE_DEPTH.name: 'right_depth.npy',
    topics.RIGHT_LABELS.name: 'right_labels.npy', topics.RIGHT_CRATERS.name: 'right_craters.npy',
    topics.RIGHT_SHADOW.name: 'right_shadow.png', topics.RIGHT_NORMALS.name: 'right_normals.npy'}
# Of hazard cameras: what follows the camera in the extension.
_FURTHER = {topics.HAZARD_IMAGE: '.png', topics.HAZARD_LABELS: '_labels.npy',
            topics.HAZARD_CRATERS: '_craters.npy', topics.HAZARD_DEPTH: '_depth.npy'}
_NEEDED = (topics.LEFT_IMAGE.name, topics.LEFT_INFO.name)
_OF_PINHOLE = tuple(topic.name for topic in (
    topics.LABELS, topics.CRATERS, topics.SHADOW, topics.NORMALS, topics.OPTICAL_FLOW,
    topics.SCENE_FLOW, *topics.OF_RIGHT))


@dataclasses.dataclass(frozen=True)
class ShardOptions:
    """How shards are made.

    Attributes:
        drive: Name of the drive, with which keys begin; '' for that of the folder of the bag.
        size: Samples a shard.
    """

    drive: str = ''
    size: int = DEFAULT_SIZE


@dataclasses.dataclass
class _Sample:
    """A sample that is not written yet.

    Attributes:
        poses: None until they are known.
        measured: By other sensors, None until it is looked up.
    """

    stamp_ns: int
    files: dict[str, bytes]
    poses: dict[str, Any] | None
    measured: dict[str, Any] | None = None


class WebDatasetSequence(PosedSequence):
    """Writes the shards of a drive. Without odometry its samples have no poses."""

    POSES = METADATA
    poses_of = ('T_odom_left, T_odom_right in the JSON of a sample: true poses of each camera '
                '(its optical frame) in odom')
    layout = ('WebDataset: tar shards of PNG, NPY and JSON, index.json, label_info.json; with '
              'LiDAR, its scans as NPY; with heading sensors and power, their values in JSON')
    needs = _NEEDED
    of_further = tuple(_FURTHER)
    further_needs = ('they need their camera_info in the bag; labels do not fit a pinhole with '
                     'distortion')
    uses = (*(name for name in EXTENSIONS if name not in _NEEDED), topics.ODOM.name, *CARRIED)

    def __init__(self, bag: Bag, folder: Path, png: PngWriter,
                 options: ShardOptions = ShardOptions()) -> None:
        self._carried = carried(bag)
        self.uses = (*(name for name in type(self).uses if name not in CARRIED), *self._carried)
        super().__init__(bag, folder, png)
        if any(bag.has(name) for name in _OF_PINHOLE):
            check_pinhole(self.suite, str(bag.path))
        along = {EXTENSIONS[topic.name]: 'optical axis'
                 for topic in (topics.TRUE_DEPTH, topics.RIGHT_TRUE_DEPTH) if bag.has(topic.name)}
        along.update({camera.word + _FURTHER[topics.HAZARD_DEPTH]:
                      'ray' if camera.is_fisheye else 'optical axis'
                      for camera in self.further if topics.HAZARD_DEPTH in camera.topics})
        self.depth = {name: {'npy_unit': 'm', 'along': axis, 'sky_m': float('inf')}
                      for name, axis in along.items()}
        self._drive = key_part(options.drive or drive_name(bag.path))
        self._shards = ShardWriter(folder, options.size)
        self._held: deque[_Sample] = deque()
        self._further: dict[int, dict[str, bytes]] = {}     # stamp [ns] → files
        self._lost = 0
        self._mounts = {**self.suite.mounts,
                        **{camera.word: camera.T_base_camera for camera in self.further}}
        self._sensors = SensorSamples(bag)
        self._late_ns = LATE_NS if self._sensors.recorded else 0
        self._extrinsics = {} if self.T_base_lidar is None else {
            'T_left_lidar': np.round(inverse(self._mounts['left']) @ self.T_base_lidar,
                                     _DIGITS).tolist()}
        self._written = 0
        self._world = (str(bag.first(topics.WORLD_HASH.name).data)
                       if bag.has(topics.WORLD_HASH.name) else '')
        if bag.has(topics.LABEL_INFO.name):
            (folder / VOCABULARY_FILE).write_text(bag.first(topics.LABEL_INFO.name).data,
                                                  encoding='utf-8')

    def has_place_for(self, camera: RecordedCamera) -> bool:
        """Return whether its truth fits its images, where it has any."""
        return camera.fits_truth or topics.HAZARD_LABELS not in camera.topics

    def images(self, stamp_ns: int, pixels: dict[str, NDArray[Any]]) -> None:
        """Encode a sample, and write it as soon as all of it is known."""
        self._write_all(stamp_ns - self._late_ns)
        self._held.append(_Sample(stamp_ns, {
            EXTENSIONS[name]: _encoded(EXTENSIONS[name], image)
            for name, image in pixels.items()}, None if self.has_truth else {}))
        self.taken(stamp_ns)

    def data(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Keep poses and what sensors measure until their image comes."""
        if topic not in self._carried:
            super().data(topic, stamp_ns, message)
            return
        for sample in self._held:
            if sample.measured is None and sample.stamp_ns < stamp_ns - KEPT_NS:
                self._measure(sample)
        self._sensors.add(topic, stamp_ns, message)

    def further_images(self, camera: RecordedCamera, stamp_ns: int,
                       pixels: dict[str, NDArray[Any]]) -> None:
        """Keep the images of a hazard camera for the sample of their stamp."""
        names = {name: camera.word + _FURTHER[topic] for topic, name in camera.topics.items()
                 if topic in _FURTHER}
        self._further.setdefault(stamp_ns, {}).update(
            {names[name]: _encoded(names[name], image) for name, image in pixels.items()})

    def write_pose(self, T_odom_base: Array) -> None:
        """Take the poses of the cameras of the next sample."""
        next(s for s in self._held if s.poses is None).poses = {
            f'T_odom_{side}': np.round(T_odom_base @ T, _DIGITS).tolist()
            for side, T in self._mounts.items()}

    def notes(self) -> list[str]:
        """Finish the shards and write their index; return how many there are."""
        notes = super().notes()
        self._write_all(None)
        if self._lost:
            notes.append(f'{counted(self._lost, "set")} of hazard cameras left out: no sample has '
                         'their stamp')
        self._shards.close()
        shards = self._shards.shards
        (self.folder / INDEX_FILE).write_text(index_text(self._drive, shards, {
            'drive': self._drive, 'world': self._world}), encoding='ascii')
        size_bytes = sum(shard.size_bytes for shard in shards)
        return [f'{counted(len(shards), "shard")} of {size_bytes / 1e6:.1f} MB', *notes]

    def close(self) -> None:
        """Close the shard that an error has left open."""
        self._shards.close()
        super().close()

    def _write_all(self, before_ns: int | None) -> None:
        """Write the samples of earlier stamps whose poses are known; None: all."""
        while self._held:
            sample = self._held[0]
            if sample.poses is None or (before_ns is not None and sample.stamp_ns >= before_ns):
                break
            self._held.popleft()
            for ns in [ns for ns in self._further if ns < sample.stamp_ns]:
                del self._further[ns]
                self._lost += 1
            sample.files.update(self._further.pop(sample.stamp_ns, {}))
            if sample.measured is None:
                self._measure(sample)
            self._write(sample)
        if before_ns is None:
            self._lost += len(self._further)

    def _measure(self, sample: _Sample) -> None:
        files, sample.measured = self._sensors.at(sample.stamp_ns)
        sample.files.update({name: npy_bytes(rows) for name, rows in files.items()})

    def _write(self, sample: _Sample) -> None:
        suite = self.suite
        metadata = {'drive': self._drive, 'world': self._world, 'stamp_ns': sample.stamp_ns,
                    'fx_fy_cx_cy_px': [*map(float, suite.focal_px), *map(float, suite.centre_px)],
                    'baseline_m': round(suite.baseline_m, _DIGITS), **(sample.poses or {}),
                    **self._extrinsics, **(sample.measured or {})}
        sample.files[METADATA] = json.dumps(metadata).encode()
        self._shards.write(f'{self._drive}-{self._written:06d}', sample.files)
        self._written += 1


def _encoded(extension: str, image: NDArray[Any]) -> bytes:
    return png_bytes(image, _COMPRESSION) if extension.endswith('.png') else npy_bytes(image)


def drive_name(bag: Path) -> str:
    """Return the name of the drive of a bag: that of its folder, or of the one above `bag`."""
    path = bag.resolve()
    return path.parent.name if path.stem == 'bag' else path.stem
