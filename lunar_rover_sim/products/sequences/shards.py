"""Shards: tar files of samples, as WebDataset reads them.

A sample is a row of files that follow each other in a tar and share their name up to the first
dot, its key; what comes after the dot tells what they hold (Aizman, Maltby and Breuel, High
Performance I/O For Large Scale Deep Learning, IEEE Big Data 2019). Tars have no times and no
owners: the same samples give the same bytes.
"""

from __future__ import annotations

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

from lunar_rover_sim.base.errors import SequenceError
from lunar_rover_sim.base.files.paths import file_hash

DEFAULT_SIZE = 256      # samples per shard
LARGEST_SIZE = 100_000
PLAIN = 'shard'         # of the names of shards that belong to no split

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
    """Writes samples into tars NAME-000000.tar, ... of a folder. Context manager.

    Attributes:
        shards: Those that are finished; all of them after `close`.
    """

    def __init__(self, folder: Path, size: int = DEFAULT_SIZE, name: str = PLAIN) -> None:
        """size: samples per shard; raises SequenceError where it is not valid."""
        check_size(size)
        self._folder, self._size, self._name = folder, size, name
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
            self._path = self._folder / shard_name(self._name, len(self.shards))
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


def npy_bytes(values: NDArray[Any]) -> bytes:
    """Return an array as a NPY file."""
    stream = io.BytesIO()
    np.save(stream, values, allow_pickle=False)
    return stream.getvalue()
