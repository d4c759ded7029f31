"""WebDataset shards: images, truth and poses of a drive as samples in tar files.

A sample is what one stamp shows: pictures as PNG, numbers of pixels as NPY, the rest as JSON. Its
key is the name of the drive and a number. index.json lists the shards, label_info.json is the
vocabulary of the labels.
"""

from __future__ import annotations

from collections import deque
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.files.images import png_bytes
from lunar_rover_sim.frames import Array
from lunar_rover_sim.sequences.instances import check_pinhole
from lunar_rover_sim.sequences.posed import PosedSequence
from lunar_rover_sim.sequences.sequence import PngWriter
from lunar_rover_sim.sequences.shards import (DEFAULT_SIZE, index_text, key_part, npy_bytes,
                                              ShardWriter)

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
    topics.SCENE_FLOW.name: 'scene_flow.npy'}
_NEEDED = (topics.LEFT_IMAGE.name, topics.LEFT_INFO.name)
_OF_PINHOLE = tuple(topic.name for topic in (
    topics.LABELS, topics.CRATERS, topics.SHADOW, topics.NORMALS, topics.OPTICAL_FLOW,
    topics.SCENE_FLOW))


@dataclasses.dataclass(frozen=True)
class ShardOptions:
    """How shards are made.

    drive: name of the drive, with which keys begin; '' for that of the folder of the bag
    size: samples a shard
    """

    drive: str = ''
    size: int = DEFAULT_SIZE


class WebDatasetSequence(PosedSequence):
    """Writes the shards of a drive. Without odometry its samples have no poses."""

    POSES = METADATA
    needs = _NEEDED
    uses = (*(name for name in EXTENSIONS if name not in _NEEDED), topics.ODOM.name)
    depth = {'depth.npy': {'npy_unit': 'm', 'along': 'optical axis', 'sky_m': float('inf')}}

    def __init__(self, bag: Bag, folder: Path, png: PngWriter,
                 options: ShardOptions = ShardOptions()) -> None:
        super().__init__(bag, folder, png)
        if any(bag.has(name) for name in _OF_PINHOLE):
            check_pinhole(self.suite, str(bag.path))
        self._drive = key_part(options.drive or drive_name(bag.path))
        self._shards = ShardWriter(folder, options.size)
        self._held: deque[tuple[int, dict[str, bytes]]] = deque()
        self._mounts = {'left': self.suite.T_base_imu @ self.suite.T_imu_left,
                        'right': self.suite.T_base_imu @ self.suite.T_imu_right}
        self._written = 0
        self._world = (str(bag.first(topics.WORLD_HASH.name).data)
                       if bag.has(topics.WORLD_HASH.name) else '')
        if bag.has(topics.LABEL_INFO.name):
            (folder / VOCABULARY_FILE).write_text(bag.first(topics.LABEL_INFO.name).data,
                                                  encoding='utf-8')

    def images(self, stamp_ns: int, pixels: dict[str, NDArray[Any]]) -> None:
        """Encode a sample, and write it as soon as its pose is known."""
        self._held.append((stamp_ns, {
            EXTENSIONS[name]: png_bytes(image, _COMPRESSION) if EXTENSIONS[name].endswith('.png')
            else npy_bytes(image) for name, image in pixels.items()}))
        self.taken(stamp_ns)
        if not self.has_truth:
            self._write({})

    def write_pose(self, T_odom_base: Array) -> None:
        """Write the next sample with the poses of its cameras."""
        self._write({f'T_odom_{side}': np.round(T_odom_base @ T, _DIGITS).tolist()
                     for side, T in self._mounts.items()})

    def notes(self) -> list[str]:
        """Finish the shards and write their index; return how many there are."""
        notes = super().notes()
        self._shards.close()
        shards = self._shards.shards
        (self.folder / INDEX_FILE).write_text(index_text(self._drive, shards, {
            'drive': self._drive, 'world': self._world}), encoding='ascii')
        return [f'{len(shards)} shards of {sum(s.size_bytes for s in shards) / 1e6:.1f} MB',
                *notes]

    def close(self) -> None:
        """Close the shard that an error has left open."""
        self._shards.close()
        super().close()

    def _write(self, poses: dict[str, Any]) -> None:
        stamp_ns, files = self._held.popleft()
        suite = self.suite
        metadata = {'drive': self._drive, 'world': self._world, 'stamp_ns': stamp_ns,
                    'fx_fy_cx_cy_px': [*map(float, suite.focal_px), *map(float, suite.centre_px)],
                    'baseline_m': round(suite.baseline_m, _DIGITS), **poses}
        files[METADATA] = json.dumps(metadata).encode()
        self._shards.write(f'{self._drive}-{self._written:06d}', files)
        self._written += 1


def drive_name(bag: Path) -> str:
    """Return the name of the drive of a bag: that of its folder, or of the one above `bag`."""
    path = bag.resolve()
    return path.parent.name if path.stem == 'bag' else path.stem
