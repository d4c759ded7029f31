"""Recording to rosbag2 with message stamps as bag time.

A bag is a folder `NAME` with `NAME.mcap`, `metadata.yaml` and, until its clean end,
`incomplete.yaml`. One that is split by size has `NAME_0.mcap`, `NAME_1.mcap`, as rosbag2 names
them, each with the topics known at its beginning.

A recording that is killed has neither index nor `metadata.yaml`; `recovery.recover` makes it
readable. A kill loses what is in memory: at most the last chunk (1 MiB before compression), and
the chunk before it where its last bytes were still in the buffer of the file.

MCAP is written by `mcap.writer`, with checksums of chunks, data and summary
(https://mcap.dev/spec), laid out as rosbag2 lays it out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
import dataclasses
import json
import os
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.typesys import get_types_from_msg, get_typestore, Stores, TypesysError
from rosbags.typesys.store import Typestore

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.metadata import (as_recorded, bag_information, contract_qos, StorageFile,
                                          topic_metadata, write_metadata)
from lunar_rover_sim.bag.stamps import StampTable
from lunar_rover_sim.bag.totals import REAL_TIME_FACTOR, RECORDED_COUNTS, RESUMED_NS
from lunar_rover_sim.base.errors import BagError, one_line
from lunar_rover_sim.base.files.atomic import sync_folder
from lunar_rover_sim.base.files.yaml_text import yaml_of

COMPRESSIONS = {'none': CompressionType.NONE, 'zstd': CompressionType.ZSTD}

_SYNC_BYTES = 64 << 20  # written before the disk is asked to begin with them
_LIBRARY = 'lunar_rover_sim'


class BagWriter:
    """A bag that is being written.

    After a failed write the bag is closed and marked incomplete; `recover` makes it readable.

    Args:
        path: Folder to make; it must not exist, its parents are made.
        compression: none, or zstd for each chunk.
        distribution: Of ROS 2, for the metadata.
        max_bytes: A file of this size is ended, and the next message begins another; 0: never.
        splits: Whether `split` will be called: files have numbers then.
        resumed: What `state` has returned in an earlier process, whose bag this one goes on, with
            the simulated time `time_ns` of that; what was written later is removed.

    Attributes:
        counts: Topic → messages written so far.
        of_another_clock: Topics with stamps after the latest valid one.

    Raises:
        BagError: The folder exists, cannot be made, or the disk is full.
    """

    def __init__(self, path: Path, compression: str = 'none',
                 distribution: str = 'jazzy', max_bytes: int = 0, splits: bool = False,
                 resumed: Mapping[str, Any] | None = None) -> None:
        self.path = Path(path)
        self.counts: dict[str, int] = {}
        self.of_another_clock: set[str] = set()
        self._distribution, self._max_bytes = distribution, max_bytes
        self._compression = COMPRESSIONS[compression]
        self._files: list[StorageFile] = []
        self._typestore = get_typestore(Stores.ROS2_JAZZY)
        self._stamps = StampTable(self._typestore)
        self._types: dict[str, str] = {}
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}      # by type
        self._profiles: dict[str, Sequence[Mapping[str, object]]] = {}
        self._newest_ns = 0
        self._definitions: dict[str, str] = {}      # of types that are not of ROS 2
        self._resumed_ns: list[int] = []
        self._unsynced_bytes = self._synced_to = 0
        self._failure = ''
        self._writer: McapWriter | None = None
        self._numbered = splits or max_bytes > 0
        if resumed is not None:
            self._go_on(resumed)
            return
        if self.path.exists():
            raise BagError(f'{self.path}: exists already and is not overwritten; name another bag')
        try:
            self.path.mkdir(parents=True)
            marker.mark(self.path)
            self._lock: BinaryIO = marker.lock(self.path)
            self._begin_file()
        except OSError as error:
            raise BagError(f'{self.path}: cannot be made: {in_words(error)}') from None

    def split(self) -> None:
        """End the present file, which is on the disk then, and begin another; raise BagError."""
        try:
            self._end_file(self._open_writer(), {})
            self._begin_file()
        except OSError as error:
            raise self._fail(error) from None

    def state(self) -> dict[str, Any]:
        """Return what another writer goes on from; call it after `split`."""
        return {'files': [dataclasses.astuple(file) for file in self._files[:-1]],
                'definitions': dict(self._definitions), 'types': dict(self._types),
                'profiles': dict(self._profiles), 'counts': dict(self.counts),
                'newest_ns': self._newest_ns, 'of_another_clock': set(self.of_another_clock),
                'resumed_ns': list(self._resumed_ns)}

    def _go_on(self, state: Mapping[str, Any]) -> None:
        files = [StorageFile(*values) for values in state['files']]
        try:
            for file in files:
                if not marker.has_end(self.path / file.name):
                    raise BagError(f'{self.path / file.name}: is not the file that was recorded')
            marker.mark(self.path)
            self._lock = marker.lock(self.path)
            for path in self.path.glob('*.mcap'):
                if path.name not in [file.name for file in files]:
                    path.unlink()
            (self.path / marker.METADATA_NAME).unlink(missing_ok=True)
        except OSError as error:
            raise BagError(f'{self.path}: cannot be gone on with: {in_words(error)}') from None
        self._files, self._newest_ns = files, state['newest_ns']
        self._types, self.counts = dict(state['types']), dict(state['counts'])
        self.of_another_clock = set(state['of_another_clock'])
        self._profiles = dict(state['profiles'])
        for msgtype, definition in state['definitions'].items():
            self._learn(msgtype, msgtype, definition)
        self._resumed_ns = [*state['resumed_ns'], state['time_ns']]
        try:
            self._begin_file()
        except OSError as error:
            raise BagError(f'{self.path}: cannot be gone on with: {in_words(error)}') from None

    @property
    def newest_ns(self) -> int:
        """Newest bag time [ns] written so far."""
        return self._newest_ns

    def add_topic(self, topic: str, msgtype: str, qos: Any = None,
                  definition: str | None = None) -> None:
        """Register a topic before its first message; a repeated call does nothing.

        Args:
            topic: Its full name.
            msgtype: Its type, `package/msg/Name`.
            qos: Offered profile of rosbags or of rclpy; by default that of the topic contract.
            definition: The `.msg` text of a type that is not part of ROS 2 Jazzy; the types it
                uses follow in sections `===…` + `MSG: package/Type`, as MCAP and `ros2bag` lay it
                out.

        Raises:
            BagError: The type is unknown and no definition is given, the definition cannot be
                read, or the topic is there with another type.
        """
        known = self._types.get(topic)
        if known is not None:
            if known != msgtype:
                raise BagError(f'{topic}: has type {known} in this bag; {msgtype} cannot '
                               'be recorded on the same topic')
            return
        if msgtype not in self._typestore.fielddefs:
            self._learn(topic, msgtype, definition)
        profile: Qos = contract_qos(topic) if qos is None else as_recorded(qos, topic)
        profiles = dump_qos_v9([profile])
        writer = self._open_writer()
        try:
            self._register(writer, topic, msgtype, profiles)
        except OSError as error:
            raise self._fail(error) from None
        self._types[topic], self._profiles[topic], self.counts[topic] = msgtype, profiles, 0

    def _register(self, writer: McapWriter, topic: str, msgtype: str,
                  profiles: Sequence[Mapping[str, object]]) -> None:
        """Register a topic, and its type where that is new, in the present file."""
        if msgtype not in self._schemas:
            text, _ = self._typestore.generate_msgdef(msgtype, ros_version=2)
            self._schemas[msgtype] = writer.register_schema(msgtype, 'ros2msg', text.encode())
        self._channels[topic] = writer.register_channel(
            topic, 'cdr', self._schemas[msgtype],
            {'offered_qos_profiles': yaml_of(profiles).strip()})

    def write(self, topic: str, msgtype: str, raw: bytes, fallback_ns: int,
              latest_ns: int | None = None) -> int:
        """Write one message and return its bag time [ns].

        Args:
            topic: Its full name.
            msgtype: Its type.
            raw: The CDR bytes with their 4 bytes of encapsulation, as a raw subscription gives
                them.
            fallback_ns: Bag time of a message that has no stamp, or the stamp 0, or one after
                latest_ns, whose topic then belongs to `of_another_clock`.
            latest_ns: Latest valid stamp [ns].

        Raises:
            BagError: The topic cannot be added, the disk is full, or the bag is closed.
        """
        if self._types.get(topic) != msgtype:
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
            if self._max_bytes and self._stream.tell() >= self._max_bytes:
                self._end_file(writer, {})
                writer = self._begin_file()
            writer.add_message(self._channels[topic], bag_ns, raw, bag_ns)
            self._unsynced_bytes += len(raw)
            if self._unsynced_bytes > _SYNC_BYTES:
                self._start_sync()
        except OSError as error:
            raise self._fail(error) from None
        self.counts[topic] += 1
        self._files[-1].add(bag_ns)
        self._newest_ns = max(self._newest_ns, bag_ns)

    def close(self, incomplete: str = '', real_time_factor: float | None = None) -> None:
        """Finish the bag: index, metadata, everything on the disk. Repeating it does nothing.

        Args:
            incomplete: Why the recording is not complete; the bag stays marked with that.
            real_time_factor: Of the recording, for the metadata.

        Raises:
            BagError: The disk is full.
        """
        writer = self._writer
        if writer is None:
            return
        custom = {**({'incomplete': incomplete} if incomplete
                     else {RECORDED_COUNTS: json.dumps(self.counts)}),
                  **({} if real_time_factor is None
                     else {REAL_TIME_FACTOR: f'{real_time_factor:.3g}'}),
                  **({RESUMED_NS: json.dumps(self._resumed_ns)} if self._resumed_ns else {})}
        try:
            if incomplete:
                marker.mark(self.path, incomplete)
            self._end_file(writer, custom)
            write_metadata(self.path, self._information(self._files, custom))
            if not incomplete:
                marker.unmark(self.path)
            sync_folder(self.path)
        except OSError as error:
            raise self._fail(error) from None
        self._writer = None
        self._failure = incomplete
        self._lock.close()

    def _begin_file(self) -> McapWriter:
        """Open the next storage file, with all topics known so far; raise OSError."""
        number = f'_{len(self._files)}' if self._numbered else ''
        file = StorageFile(f'{self.path.name}{number}.mcap')
        self._stream: BinaryIO = (self.path / file.name).open('xb')
        self._files.append(file)
        self._unsynced_bytes = self._synced_to = 0
        writer = McapWriter(self._stream, compression=self._compression, enable_crcs=True,
                            enable_data_crcs=True)
        writer.start('ros2', _LIBRARY)
        self._schemas.clear()
        for topic, msgtype in self._types.items():
            self._register(writer, topic, msgtype, self._profiles[topic])
        self._writer = writer
        return writer

    def _end_file(self, writer: McapWriter, custom: dict[str, str]) -> None:
        """Finish the present storage file: its metadata, its index, all on the disk."""
        information = self._information(self._files, custom)
        writer.add_metadata('rosbag2', {'serialized_metadata': yaml_of(information).strip()})
        writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()

    def _information(self, files: Sequence[StorageFile],
                     custom: dict[str, str]) -> dict[str, Any]:
        """Return what metadata.yaml says of the files so far."""
        return bag_information(
            files, custom, self._distribution,
            [(topic_metadata(topic, msgtype, self._profiles[topic],
                             self._typestore.hash_rihs01(msgtype)), self.counts[topic])
             for topic, msgtype in self._types.items()])

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if error is None:
            self.close()
            return
        with suppress(BagError):  # the bag is marked, and `error` goes on
            self.close(incomplete=in_words(error))

    def _start_sync(self) -> None:
        """Have the system begin to write what is new in the file; it does not wait for the disk.

        Otherwise it may hold some GB when the recording ends, which then waits for all of them.
        """
        start, self._synced_to, self._unsynced_bytes = self._synced_to, self._stream.tell(), 0
        if hasattr(os, 'posix_fadvise'):
            os.posix_fadvise(self._stream.fileno(), start, self._synced_to - start,
                             os.POSIX_FADV_DONTNEED)

    def _open_writer(self) -> McapWriter:
        if self._writer is None:
            reason = f': {self._failure}' if self._failure else ''
            raise BagError(f'{self.path}: the bag is closed{reason}')
        return self._writer

    def _fail(self, error: BaseException) -> BagError:
        """Close the file after a failed write; return the error to raise."""
        self._failure = in_words(error)
        self._writer = None
        with suppress(OSError):  # the disk refused a write already, and is the reason
            self._stream.close()
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
            _register(self._typestore, msgtype, definition)
        except (TypesysError, KeyError) as error:
            raise BagError(f'{topic}: the definition of {msgtype} cannot be read: '
                           f'{in_words(error)}') from None
        self._definitions[msgtype] = definition
        self._stamps.forget(msgtype)


def _register(typestore: Typestore, msgtype: str, definition: str) -> None:
    """Register a type and those it is made of; known ones stay as they are.

    Raises:
        TypesysError, KeyError: Where the definition cannot be read.
    """
    known = typestore.fielddefs
    types = {name: fields for name, fields in get_types_from_msg(definition, msgtype).items()
             if name not in known}
    trial = get_typestore(Stores.EMPTY)
    trial.fielddefs.update(known)
    trial.register(types)
    trial.hash_rihs01(msgtype)
    typestore.register(types)


def in_words(error: BaseException) -> str:
    """Return the error on one line, without a path that the caller names anyway."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return one_line(error)
