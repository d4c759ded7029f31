"""Configuration of a recording."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.parameters import param, Parameters

ALL = 'all'


@dataclasses.dataclass(frozen=True)
class RecorderConfig(Parameters):
    """Parameters of a recording."""

    output: str = param('', 'folder of the bag; it must not exist')
    topics: tuple[str, ...] = param((ALL,), 'topics to record; all: every topic but those on '
                                    'request, which may be named beside it')
    exclude: tuple[str, ...] = param((), 'topics that all leaves out, too')
    storage: str = param('mcap', 'file format; bags of SQLite are read only', choices=('mcap',))
    compression: str = param('zstd', 'compression of the storage, without loss',
                             choices=('none', 'zstd'))
