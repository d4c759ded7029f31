"""Recording to rosbag2 with message stamps as bag time.

A bag is a folder `NAME` with `NAME.mcap` (or `NAME.db3`), `metadata.yaml` and, until its clean
end, `incomplete.yaml`. A recording that is killed has neither index nor `metadata.yaml`;
`recovery.recover` makes it readable. What a kill loses:

- MCAP: what rosbags holds in memory, that is at most the last chunk (1 MiB before compression),
  and the chunk before it where its last bytes were still in the buffer of the file;
- SQLite: what was written since the last commit, at most one second ago.
"""

from __future__ import annotations

from contextlib import suppress
import os
from pathlib import Path
import sqlite3
import time
from types import TracebackType
from typing import Any, BinaryIO

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.typesys import get_typestore, Stores

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.checksums import write_checksums
from lunar_rover_sim.bag.definitions import learn
from lunar_rover_sim.bag.qos import as_recorded, contract_qos
from lunar_rover_sim.bag.recording_pace import REAL_TIME_FACTOR
from lunar_rover_sim.bag.stamps import StampTable
from lunar_rover_sim.errors import BagError, one_line
from lunar_rover_sim.files.atomic import atomic_write, sync_folder
from lunar_rover_sim.seconds import NS_PER_S

STORAGES = ('mcap', 'sqlite3')
COMPRESSIONS = ('none', 'zstd')
DISK_ERRORS = (OSError, sqlite3.Error)

VERSION: Any = 9  # of the metadata, as ROS 2 Jazzy writes it
_PLUGINS = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
_SUFFIXES = {'mcap': '.mcap', 'sqlite3': '.db3'}
_MODES = {'mcap': CompressionMode.STORAGE, 'sqlite3': CompressionMode.MESSAGE}
_COMMIT_PERIOD_NS = NS_PER_S


class BagWriter:
    """A bag that is being written.

    path: folder to make; it must not exist, its parents are made.
    storage: 'mcap' or 'sqlite3'; compression: 'none' or 'zstd' (per chunk in MCAP, per message in
        SQLite). distribution: of ROS 2, for the metadata.

    Raises BagError where the folder exists, cannot be made, or the disk is full. After a failed
    write the bag is closed and marked incomplete; `recover` makes it readable.
    """

    def __init__(self, path: Path, storage: str = 'mcap', compression: str = 'none',
                 distribution: str = 'jazzy') -> None:
        if storage not in STORAGES:
            raise BagError(f'storage: {storage!r} is not valid; valid are {", ".join(STORAGES)}')
        if compression not in COMPRESSIONS:
            valid = ', '.join(COMPRESSIONS)
            raise BagError(f'compression: {compression!r} is not valid; valid are {valid}')
        self.path = Path(path)
        self.counts: dict[str, int] = {}
        self._distribution = distribution
        self._file = self.path / (self.path.name + _SUFFIXES[storage])
        self._typestore = get_typestore(Stores.ROS2_JAZZY)
        self._stamps = StampTable(self._typestore)
        self._connections: dict[str, Connection] = {}
        self._newest_ns = 0
        self._failure = ''
        if self.path.exists():
            raise BagError(f'{self.path}: exists already and is not overwritten; name another bag')
        self._writer: Writer | None = None
        try:
            writer = Writer(self.path, version=VERSION, storage_plugin=_PLUGINS[storage])
            if compression == 'zstd':
                writer.set_compression(_MODES[storage], CompressionFormat.ZSTD)
            writer.open()
            marker.mark(self.path)
            self._lock: BinaryIO = marker.lock(self.path)
        except (WriterError, *DISK_ERRORS) as error:
            raise BagError(f'{self.path}: cannot be made: {in_words(error)}') from None
        self._writer = writer
        self._transaction = _Transaction(writer) if storage == 'sqlite3' else None
        self.of_another_clock: set[str] = set()

    @property
    def newest_ns(self) -> int:
        """Newest bag time [ns] written so far."""
        return self._newest_ns

    def add_topic(self, topic: str, msgtype: str, qos: Any = None,
                  definition: str | None = None) -> None:
        """Register a topic before its first message.

        qos: offered profile of rosbags or of rclpy; by default that of the topic contract.
        definition: the `.msg` text of a type that is not part of ROS 2 Jazzy; the types it uses
            follow in sections `===…` + `MSG: package/Type`, as MCAP and `ros2bag` lay it out.

        Raises BagError where the type is unknown and no definition is given, where the definition
        cannot be read, or where the topic is there with another type. Otherwise a repeated call
        does nothing.
        """
        known = self._connections.get(topic)
        if known is not None:
            if known.msgtype != msgtype:
                raise BagError(f'{topic}: has type {known.msgtype} in this bag; {msgtype} cannot '
                               'be recorded on the same topic')
            return
        if msgtype not in self._typestore.fielddefs:
            self._learn(topic, msgtype, definition)
        profile = contract_qos(topic) if qos is None else as_recorded(qos, topic)
        writer = self._open_writer()
        try:
            self._connections[topic] = writer.add_connection(
                topic, msgtype, typestore=self._typestore, offered_qos_profiles=[profile])
        except DISK_ERRORS as error:
            raise self._fail(error) from None
        self.counts[topic] = 0

    def write(self, topic: str, msgtype: str, raw: bytes, fallback_ns: int,
              latest_ns: int | None = None) -> int:
        """Write one message and return its bag time [ns].

        raw: the CDR bytes with their 4 bytes of encapsulation, as a raw subscription gives them.
        fallback_ns: bag time of a message that has no stamp, or the stamp 0, or one after
            latest_ns, whose topic then belongs to `of_another_clock`.
        """
        connection = self._connections.get(topic)
        if connection is None or connection.msgtype != msgtype:
            self.add_topic(topic, msgtype)
        stamp_ns = self._stamps.stamp_ns(msgtype, raw)
        if stamp_ns is not None and latest_ns is not None and stamp_ns > latest_ns:
            self.of_another_clock.add(topic)
            stamp_ns = None
        bag_ns = stamp_ns if stamp_ns is not None and stamp_ns > 0 else max(0, fallback_ns)
        self.write_at(topic, bag_ns, raw)
        return bag_ns

    def write_at(self, topic: str, bag_ns: int, raw: bytes) -> None:
        """Write one message of a registered topic at a bag time [ns], whatever its stamp is."""
        writer = self._open_writer()
        try:
            writer.write(self._connections[topic], bag_ns, raw)
            if self._transaction is not None:
                self._transaction.commit_if_due(bag_ns)
        except DISK_ERRORS as error:
            raise self._fail(error) from None
        self.counts[topic] += 1
        self._newest_ns = max(self._newest_ns, bag_ns)

    def close(self, incomplete: str = '', real_time_factor: float | None = None) -> None:
        """Finish the bag: index, metadata, everything on the disk. Repeating it does nothing.

        incomplete: why the recording is not complete; the bag stays marked with that.
        real_time_factor: of the recording, for the metadata.
        """
        writer = self._writer
        if writer is None:
            return
        try:
            if incomplete:
                marker.mark(self.path, incomplete)
                writer.set_custom_data('incomplete', incomplete)
            if real_time_factor is not None:
                writer.set_custom_data(REAL_TIME_FACTOR, f'{real_time_factor:.3g}')
            writer.close()
            self._name_distribution()
            if self._file.suffix == '.mcap':
                write_checksums(self._file)
            for path in (self._file, self.path / marker.METADATA_NAME):
                _sync(path)
            if not incomplete:
                marker.unmark(self.path)
            sync_folder(self.path)
        except DISK_ERRORS as error:
            raise self._fail(error) from None
        self._writer = None
        self._failure = incomplete
        self._lock.close()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if error is None:
            self.close()
            return
        with suppress(BagError):  # the bag is marked, and `error` goes on
            self.close(incomplete=in_words(error))

    def _name_distribution(self) -> None:
        """Name the ROS distribution in the metadata, where rosbags writes its own name."""
        path = self.path / marker.METADATA_NAME
        text = path.read_text(encoding='utf-8')
        atomic_write(path, text.replace('ros_distro: rosbags',
                                        f'ros_distro: {self._distribution}'))

    def _open_writer(self) -> Writer:
        if self._writer is None:
            reason = f': {self._failure}' if self._failure else ''
            raise BagError(f'{self.path}: the bag is closed{reason}')
        return self._writer

    def _fail(self, error: BaseException) -> BagError:
        """Close the files after a failed write; return the error to raise."""
        self._failure = in_words(error)
        writer, self._writer = self._writer, None
        if writer is not None:
            with suppress(*DISK_ERRORS):  # the disk refused a write already, and is the reason
                writer.abort()
            with suppress(OSError):
                marker.mark(self.path, self._failure)
            self._lock.close()
        return BagError(f'{self.path}: cannot be written: {self._failure}; the bag is marked '
                        'incomplete; make it readable with: lunar_rover_sim bag recover '
                        f'{self.path}')

    def _learn(self, topic: str, msgtype: str, definition: str | None) -> None:
        if definition is None:
            raise BagError(f'{topic}: type {msgtype} is not known and no definition of it is '
                           'given; leave the topic out or give its .msg text')
        try:
            learn(self._typestore, msgtype, definition)
        except BagError as error:
            raise BagError(f'{topic}: {error}') from None
        self._stamps.forget(msgtype)


class _Transaction:
    """Commits what is written to SQLite about once a second, of bag time or of wall time.

    rosbags (0.11.9) commits only at the end, and a kill would lose the whole recording. It has no
    documented way to commit earlier, and no other connection can commit what this one has written:
    hence its `storage.conn`.
    """

    def __init__(self, writer: Writer) -> None:
        self._connection: sqlite3.Connection = writer.storage.conn  # type: ignore[union-attr]
        self._wall_ns = time.monotonic_ns()
        self._bag_ns = -_COMMIT_PERIOD_NS

    def commit_if_due(self, bag_ns: int) -> None:
        now_ns = time.monotonic_ns()
        if bag_ns - self._bag_ns >= _COMMIT_PERIOD_NS or now_ns - self._wall_ns >= \
                _COMMIT_PERIOD_NS:
            self._connection.commit()
            self._wall_ns, self._bag_ns = now_ns, max(bag_ns, self._bag_ns)


def in_words(error: BaseException) -> str:
    """Return the error on one line, without a path that the caller names anyway."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return one_line(error)


def _sync(path: Path) -> None:
    with path.open('rb') as file:
        os.fsync(file.fileno())
