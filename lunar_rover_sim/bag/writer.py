"""Recording to rosbag2 with message stamps as bag time.

A bag is a folder `NAME` with `NAME.mcap` (or `NAME.db3`), `metadata.yaml` and, until its clean
end, `incomplete.yaml`. Whatever ends the process, everything up to the last flush, at most one
second ago, can be read.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
import time
from types import TracebackType
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, WriterError
from rosbags.typesys import get_types_from_msg, get_typestore, Stores, TypesysError

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.qos import as_recorded, contract_qos
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.recovery import (DISK_ERRORS, DurableWriter, in_words, METADATA_VERSION,
                                          PLUGINS, recover)
from lunar_rover_sim.bag.stamps import NS_PER_S, StampTable
from lunar_rover_sim.errors import BagError

STORAGES = ('mcap', 'sqlite3')
COMPRESSIONS = ('none', 'zstd')

_MODES = {'mcap': CompressionMode.STORAGE, 'sqlite3': CompressionMode.MESSAGE}


class BagWriter:
    """A bag that is being written.

    path: folder to make; it must not exist, its parents are made.
    storage: 'mcap' or 'sqlite3'; compression: 'none' or 'zstd' (per chunk in MCAP, per message in
        SQLite).
    flush_period_s: the most time, wall clock or stamps, that may be lost if the process is killed.

    Raises BagError where the folder exists, cannot be made, or the disk is full; after a failed
    write the bag is closed, marked incomplete, and readable up to there.
    """

    def __init__(self, path: Path, storage: str = 'mcap', compression: str = 'none',
                 flush_period_s: float = 1.0) -> None:
        if storage not in STORAGES:
            raise BagError(f'storage: {storage!r} is not valid; valid are {", ".join(STORAGES)}')
        if compression not in COMPRESSIONS:
            valid = ', '.join(COMPRESSIONS)
            raise BagError(f'compression: {compression!r} is not valid; valid are {valid}')
        self.path = Path(path)
        self.counts: dict[str, int] = {}
        self._storage_name = storage
        self._typestore = get_typestore(Stores.ROS2_JAZZY)
        self._stamps = StampTable(self._typestore)
        self._connections: dict[str, Connection] = {}
        self._types: dict[str, str] = {}
        self._flush_period_ns = int(flush_period_s * NS_PER_S)
        self._flushed_wall_ns = time.monotonic_ns()
        self._flushed_bag_ns = -self._flush_period_ns
        self._newest_ns = 0
        self._failure = ''
        if self.path.exists():
            raise BagError(f'{self.path}: exists already and is not overwritten; name another bag')
        self._writer: DurableWriter | None = None
        try:
            self._writer = DurableWriter(self.path, version=METADATA_VERSION,
                                         storage_plugin=PLUGINS[storage])
            if compression == 'zstd':
                self._writer.set_compression(_MODES[storage], CompressionFormat.ZSTD)
            self._writer.open()
            marker.mark(self.path)
        except (WriterError, *DISK_ERRORS) as error:
            raise BagError(f'{self.path}: cannot be made: {in_words(error)}') from None

    @property
    def newest_ns(self) -> int:
        """Newest bag time [ns] written so far."""
        return self._newest_ns

    def add_topic(self, topic: str, msgtype: str, qos: Any = None,
                  definition: str | None = None) -> None:
        """Register a topic before its first message.

        qos: offered profile of rosbags or of rclpy; by default that of the topic contract.
        definition: the `.msg` text of a type that ROS 2 Jazzy does not bring along; the types it
            uses follow in sections `===…` + `MSG: package/Type`, as MCAP and `ros2bag` lay it out.

        Raises BagError where the type is unknown and no definition is given, where the definition
        cannot be read, or where the topic is there with another type. Otherwise repeating is free.
        """
        known = self._types.get(topic)
        if known is not None:
            if known != msgtype:
                raise BagError(f'{topic}: has type {known} in this bag; {msgtype} cannot be '
                               'recorded on the same topic')
            return
        if msgtype not in self._typestore.fielddefs:
            self._learn(topic, msgtype, definition)
        profile = contract_qos(topic) if qos is None else as_recorded(qos, topic)
        writer = self._open_writer()
        try:
            connection = writer.add_connection(topic, msgtype, typestore=self._typestore,
                                               offered_qos_profiles=[profile])
        except DISK_ERRORS as error:
            raise self._fail(error) from None
        self._connections[topic] = connection
        self._types[topic] = msgtype
        self.counts[topic] = 0

    def write(self, topic: str, msgtype: str, raw: bytes, fallback_ns: int) -> int:
        """Write one message and return its bag time [ns].

        raw: the CDR bytes with their 4 bytes of encapsulation, as a raw subscription gives them.
        fallback_ns: bag time of a message that has no stamp, or the stamp 0.
        """
        if self._types.get(topic) != msgtype:
            self.add_topic(topic, msgtype)
        stamp_ns = self._stamps.stamp_ns(msgtype, raw)
        bag_ns = stamp_ns if stamp_ns is not None and stamp_ns > 0 else max(0, fallback_ns)
        writer = self._open_writer()
        try:
            writer.write(self._connections[topic], bag_ns, raw)
            self.counts[topic] += 1
            self._newest_ns = max(self._newest_ns, bag_ns)
            if (self._newest_ns - self._flushed_bag_ns >= self._flush_period_ns
                    or time.monotonic_ns() - self._flushed_wall_ns >= self._flush_period_ns):
                self._flush()
        except DISK_ERRORS as error:
            raise self._fail(error) from None
        return bag_ns

    def flush(self) -> None:
        """Hand everything written so far to the operating system: a kill no longer harms it."""
        self._open_writer()
        try:
            self._flush()
        except DISK_ERRORS as error:
            raise self._fail(error) from None

    def close(self) -> None:
        """Finish the bag: index, metadata, on the disk. Repeating it does nothing."""
        writer = self._writer
        if writer is None:
            return
        try:
            writer.close()
            marker.unmark(self.path)
        except DISK_ERRORS as error:
            raise self._fail(error) from None
        self._writer = None

    def abort(self, reason: str) -> None:
        """Finish the bag as far as that goes and leave it marked incomplete, saying why."""
        writer, self._writer = self._writer, None
        if writer is None:
            return
        self._failure = reason
        with suppress(OSError):
            marker.mark(self.path, reason)
        try:
            writer.set_custom_data('incomplete', reason)
            writer.close()
        except DISK_ERRORS:
            with suppress(*DISK_ERRORS):
                writer.abort()
            with suppress(BagError):
                recover(self.path)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if error is None:
            self.close()
        else:
            self.abort(in_words(error))

    def _open_writer(self) -> DurableWriter:
        if self._writer is None:
            reason = f': {self._failure}' if self._failure else ''
            raise BagError(f'{self.path}: the bag is closed{reason}')
        return self._writer

    def _flush(self) -> None:
        assert self._writer is not None
        storage: Any = self._writer.storage
        storage.flush()
        self._flushed_wall_ns = time.monotonic_ns()
        self._flushed_bag_ns = self._newest_ns

    def _fail(self, error: BaseException) -> BagError:
        """Close what is left of the bag after a failed write; return the error to raise."""
        reason = in_words(error)
        writer, self._writer = self._writer, None
        self._failure = reason
        if writer is not None:
            with suppress(*DISK_ERRORS):
                writer.abort()
            with suppress(OSError):
                marker.mark(self.path, reason)
            with suppress(BagError):
                recover(self.path)
        end = ''
        with suppress(BagError), open_bag(self.path) as bag:
            end = f' ends at {bag.end_ns / NS_PER_S:.3f} s and'
        return BagError(f'{self.path}: cannot be written: {reason}; the bag{end} is marked '
                        'incomplete')

    def _learn(self, topic: str, msgtype: str, definition: str | None) -> None:
        if definition is None:
            raise BagError(f'{topic}: type {msgtype} is not known and no definition of it is '
                           'given; leave the topic out or give its .msg text')
        known = self._typestore.fielddefs
        try:
            types = {name: fields for name, fields
                     in get_types_from_msg(definition, msgtype).items() if name not in known}
            trial = get_typestore(Stores.EMPTY)
            trial.register({**known, **types})
            trial.hash_rihs01(msgtype)
        except (TypesysError, KeyError) as error:
            raise BagError(f'{topic}: the definition of {msgtype} cannot be read: '
                           f'{in_words(error)}') from None
        self._typestore.register(types)
        self._stamps.forget(msgtype)
