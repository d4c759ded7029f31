"""Finishing a bag whose recording was cut off."""

from __future__ import annotations

from pathlib import Path
import sqlite3
from typing import Any

from rosbags.rosbag2 import (CompressionFormat, CompressionMode, ReaderError, StoragePlugin,
                             Writer, WriterError)

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.mcap_storage import DurableMcapWriter
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.sqlite_storage import DurableSqlite3Writer
from lunar_rover_sim.errors import BagError

METADATA_VERSION: Any = 9  # as ROS 2 Jazzy writes it
PLUGINS = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
DISK_ERRORS = (OSError, sqlite3.Error)


class DurableWriter(Writer):
    """rosbags' writer over storages that can be flushed and resumed."""

    STORAGE_PLUGINS = {StoragePlugin.MCAP: DurableMcapWriter,
                       StoragePlugin.SQLITE3: DurableSqlite3Writer}


def recover(path: Path) -> int:
    """Write what a cut-off bag lacks, its index and metadata; return its number of messages.

    What lies behind the last complete chunk (MCAP) or the last commit (SQLite) is dropped. The
    bag stays marked incomplete, since its recording was not finished, but every tool can read
    it. Raises BagError where there is nothing to read or nothing to mend.
    """
    path = Path(path)
    if not path.is_dir():
        raise BagError(f'{path}: is not a bag folder')
    reason = marker.why_incomplete(path)
    if reason is None:
        raise BagError(f'{path}: is complete; there is nothing to recover')
    if (path / marker.METADATA_NAME).is_file():
        with open_bag(path) as bag:  # already finished as far as it goes
            return bag.message_count
    with open_bag(path) as bag:
        storage_path, start_ns, end_ns = bag.storage_path, bag.start_ns, bag.end_ns
        connections = [c._replace(digest=bag.typestore.hash_rihs01(c.msgtype))
                       for c in bag.connections]
    writer = DurableWriter(path / 'unused', version=METADATA_VERSION,
                           storage_plugin=PLUGINS[STORAGE_OF[storage_path.suffix]])
    writer.path, writer.metapath = path, path / marker.METADATA_NAME
    writer.connections = connections
    writer.counts = {c.id: c.msgcount for c in connections}
    writer.min_timestamp, writer.max_timestamp = start_ns, end_ns
    writer.set_custom_data('incomplete', reason)
    try:
        marker.mark(path, reason)
        storage: Any
        if storage_path.suffix == '.mcap':
            storage = DurableMcapWriter.resume(storage_path)
        else:
            storage = DurableSqlite3Writer.resume(storage_path)
            if storage.holds_compressed():
                writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
        writer.storage = storage
        writer.close()
    except (*DISK_ERRORS, ReaderError, WriterError) as error:
        raise BagError(f'{path}: cannot be recovered: {in_words(error)}') from None
    return sum(c.msgcount for c in connections)


STORAGE_OF = {'.mcap': 'mcap', '.db3': 'sqlite3'}


def in_words(error: BaseException) -> str:
    """Return the error on one line, without a path that the caller names anyway."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return ' '.join(str(error).split()) or type(error).__name__
