"""Reading bags, MCAP and SQLite, recorded by this package or by other tools."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
import functools
import heapq
from operator import itemgetter
from pathlib import Path
import sys
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.typesys import (get_types_from_idl, get_types_from_msg, get_typestore, Stores,
                             TypesysError)
from rosbags.typesys.store import Typestore

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.message_validity import image_problem, pixels
from lunar_rover_sim.bag.messages import header_ns, pose_matrix
from lunar_rover_sim.bag.metadata import (check_files, check_stored_profiles, check_told_profiles,
                                          COMPRESSED, file_counts, information, is_count,
                                          storage_files)
from lunar_rover_sim.bag.stamps import StampTable
from lunar_rover_sim.base import topics as contract
from lunar_rover_sim.base.closing import Closing
from lunar_rover_sim.base.errors import BagError, brief, check_path, one_line
from lunar_rover_sim.base.files.paths import recorded_bag
from lunar_rover_sim.base.parameters import nearest

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_ZSTD = b'\x28\xb5\x2f\xfd'     # begins a frame (RFC 8878); CDR begins with a byte 0
_LATE_NS = 500_000_000   # bags of other recorders hold messages by the time of their arrival


class RawMessage(NamedTuple):
    """A serialised message; `time_ns` is the bag time, `data` CDR with its encapsulation."""

    topic: str
    msgtype: str
    time_ns: int
    data: bytes


class Frame(NamedTuple):
    """What one stereo stamp shows.

    Attributes:
        stamp_ns: Of the images [ns].
        left: (h, w) or (h, w, 3) pixels as they were recorded.
        right: The same of the right camera; None without it.
        depth_m: (h, w) float32, true depth of the left image along its optical axis [m], +inf for
            the sky; None without it, by default in every second frame.
        pose: (4, 4) true pose of base_link in odom; None without odometry of that stamp.
    """

    stamp_ns: int
    left: NDArray[Any]
    right: NDArray[Any] | None
    depth_m: NDArray[Any] | None
    pose: NDArray[np.float64] | None


class Bag(Closing):
    """An open bag; use as a context manager, or call `close`.

    Topic arguments are names as in the bag, or names of the topic contract without namespace.

    Args:
        path: What was opened.

    Attributes:
        incomplete: Why the recording is not complete, or None.
        file_counts: Storage file → messages in it by metadata.yaml, None where it does not say.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._reader: Reader | None = None
        self._parts: list[Reader] = []      # each file, where there are several
        if not self.path.exists():
            raise BagError(f'{self.path}: there is no such bag')
        check_files(self.path)
        self.incomplete = (marker.why_incomplete(self.path) if self.path.is_dir() else None)
        self.storage_path = self.path if self.path.is_file() else storage_files(self.path)[0]
        if self.path.is_dir() and not (self.path / marker.METADATA_NAME).is_file():
            raise BagError(f'{self.path}: {self.incomplete}; make it readable with: '
                           f'lunar_rover_sim bag recover {self.path}')
        self.file_counts: dict[Path, int | None] = {self.path: None}
        if self.path.is_dir():
            told = information(self.path)
            self.file_counts = {self.path / name: count
                                for name, count in file_counts(self.path, told).items()}
            check_told_profiles(self.path, told)
        for file in self.file_counts:
            check_stored_profiles(file)
        try:
            self._reader = Reader(self.path)
            self._reader.open()
            self._typestore = typestore_of(self._reader.connections)
            if len(self.file_counts) > 1 and self._reader.compression_mode != 'file':
                for file in self.file_counts:
                    self._parts.append(Reader(file))
                    self._parts[-1].open()
        except Exception as error:  # whatever the parsers make of a file that is no bag
            self.close()
            cut = self._files_without_end()
            raise BagError(f'{self.path}: {cut[0]} has no end; make it readable with: '
                           f'lunar_rover_sim bag recover {self.path}' if cut else
                           f'{self.path}: cannot be read as a bag: {_words(error)}') from None
        try:
            self._check_counts()
        except BagError:
            self.close()
            raise
        for file in self.file_counts:
            if self.incomplete is None and file.suffix == '.mcap' and not marker.has_end(file):
                self.incomplete = f'{file.name} has no end'

    def __repr__(self) -> str:
        if self._reader is None:
            return f'Bag({str(self.path)!r}, closed)'
        return (f'Bag({str(self.path)!r}, {len(self.types)} topics, {self.message_count} '
                f'messages, {(self.end_ns - self.start_ns) * 1e-9:.1f} s)')

    def _repr_html_(self) -> str:
        """Return the first left image, for a notebook."""
        # Here, because pictures need more than a reader does.
        from lunar_rover_sim.bag.series import picture
        from lunar_rover_sim.base.files.images import notebook_html
        pixels = None
        if self._reader is not None and self.count(contract.LEFT_IMAGE.name):
            pixels = picture(self, self.first(contract.LEFT_IMAGE.name)).pixels
        return notebook_html(repr(self), pixels)

    def _files_without_end(self) -> list[str]:
        """Return the MCAP files of the folder that are cut short but begin as MCAP files do."""
        files = sorted(self.path.glob('*.mcap')) if self.path.is_dir() else ()
        return [file.name for file in files
                if marker.has_beginning(file) and not marker.has_end(file)]

    def _check_counts(self) -> None:
        """Raise BagError if a count, time or name is not one; rosbags takes them all."""
        reader = self.reader
        for name in (name for c in reader.connections for name in (c.topic, c.msgtype)):
            if not isinstance(name, str):
                raise BagError(f'{self.path}: {marker.METADATA_NAME}: {brief(name)} is not the '
                               'name of a topic or type')
        values: dict[str, Any] = {f'messages on {c.topic}': c.msgcount for c in reader.connections}
        try:
            values['messages'] = reader.message_count
            if reader.message_count:
                values.update({'start [ns]': reader.start_time, 'end [ns]': reader.end_time})
        except TypeError:
            values['message_count'] = 'not a number'
        for name, value in values.items():
            if not is_count(value):
                raise BagError(f'{self.path}: {marker.METADATA_NAME}: {name}: {brief(value)} is '
                               'not valid; valid is a whole number >= 0 of 64 bits')

    @property
    def reader(self) -> Reader:
        """The reader of rosbags."""
        if self._reader is None:
            raise BagError(f'{self.path}: the bag is closed')
        return self._reader

    @property
    def storage(self) -> str:
        """Name of the storage: `mcap` or `db3`, also where its files are compressed."""
        return Path(self.storage_path.name.removesuffix(COMPRESSED)).suffix.lstrip('.')

    @property
    def typestore(self) -> Typestore:
        """The message types of this bag."""
        return self._typestore

    @property
    def connections(self) -> list[Connection]:
        """rosbags' connections: topic, type, offered QoS, count."""
        return list(self.reader.connections)

    @functools.cached_property
    def types(self) -> dict[str, str]:
        """Topic → message type."""
        return {c.topic: c.msgtype for c in self.reader.connections}

    @functools.cached_property
    def counts(self) -> dict[str, int]:
        """Topic → number of messages."""
        counts = dict.fromkeys(self.types, 0)
        for connection in self.reader.connections:
            counts[connection.topic] += connection.msgcount
        return counts

    @property
    def message_count(self) -> int:
        """Messages of all topics."""
        return self.reader.message_count

    @property
    def start_ns(self) -> int:
        """Bag time of the first message [ns]; 0 in an empty bag."""
        return self.reader.start_time if self.message_count else 0

    @property
    def end_ns(self) -> int:
        """Bag time of the last message [ns]; 0 in an empty bag."""
        return self.reader.end_time - 1 if self.message_count else 0

    @property
    def size_bytes(self) -> int:
        """Bytes on the disk."""
        if self.path.is_file():
            return self.path.stat().st_size
        return sum(f.stat().st_size for f in self.path.iterdir() if f.is_file())

    @functools.cached_property
    def namespaces(self) -> tuple[str, ...]:
        """Namespaces ('' for none) under which the contract's odometry or left image is found.

        Where one has images or joints too, one with nothing but odometry is an estimator's.
        """
        names = contract.TRUE_ODOM.name, contract.ODOM.name, contract.LEFT_IMAGE.name
        found = set()
        for topic in self.types:
            # The first that fits: `ground_truth/odom` ends with `odom`.
            name = next((name for name in names if topic.endswith('/' + name)), None)
            if name is not None:
                found.add(topic[:-len(name) - 1])
        whole = {namespace for namespace in found
                 if any(f'{namespace}/{topic.name}' in self.types
                        for topic in (contract.LEFT_IMAGE, contract.JOINT_STATES))}
        return tuple(sorted(whole or found))

    @property
    def namespace(self) -> str:
        """The one namespace of this bag; BagError where there are several."""
        if len(self.namespaces) > 1:
            raise BagError(f'{self.path}: holds several rovers ({", ".join(self.namespaces)}); '
                           'name topics in full')
        return self.namespaces[0] if self.namespaces else ''

    @property
    def truth(self) -> str:
        """The contract's name of the true odometry: its own topic where the run had one."""
        true = contract.TRUE_ODOM.name
        return true if self.has(true) else contract.ODOM.name

    def has(self, topic: str) -> bool:
        """Return whether the topic (full name, or name in the contract) is there."""
        with suppress(BagError):        # of several rovers, none of which is named
            return self._found(topic) is not None
        return False

    def count(self, topic: str) -> int:
        """Return the number of messages of a topic as in `has`; 0 where it is not there."""
        return self.counts[self.resolve(topic)] if self.has(topic) else 0

    def resolve(self, topic: str) -> str:
        """Return the full name of a topic given in full or as in the contract.

        Raises:
            BagError: Offering the nearest names, where there is none.
        """
        found = self._found(topic)
        if found is None:
            raise BagError(f'{self.path}: has no topic {topic}; {nearest(topic, self.types)}')
        return found

    def _found(self, topic: str) -> str | None:
        if topic in self.types:
            return topic
        name = topic.lstrip('/')
        for candidate in (f'{self.namespace}/{name}', f'/{name}'):
            if candidate in self.types:
                return candidate
        return None

    def raw(self, topics: Iterable[str] = (), start_ns: int | None = None,
            stop_ns: int | None = None) -> Iterator[RawMessage]:
        """Yield serialised messages of the topics (all by default), by bag time.

        start_ns inclusive, stop_ns exclusive. Messages that are compressed one by one are
        uncompressed, also those of a bare file, which does not say that they are.

        Raises:
            BagError: If the file is damaged.
        """
        wanted = [topics] if isinstance(topics, str) else topics
        names, reader = {self.resolve(topic) for topic in wanted}, self.reader
        try:
            for c, time_ns, data in self._merged(reader, names, start_ns, stop_ns):
                yield RawMessage(c.topic, c.msgtype, time_ns, uncompressed(data))
        except Exception as error:  # whatever the parsers make of damaged bytes
            raise BagError(f'{self.path}: is damaged: {_words(error)}') from None

    def _merged(self, whole: Reader, names: Collection[str], start_ns: int | None,
                stop_ns: int | None) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield the messages of all files by bag time: a file ends later than the next begins.

        A file is read from its first message on, so that few are read at once.
        """
        def messages(reader: Reader) -> Iterator[tuple[Connection, int, bytes]]:
            chosen = [c for c in reader.connections if not names or c.topic in names]
            return iter(reader.messages(chosen, start_ns, stop_ns) if chosen else ())

        if not self._parts:
            yield from messages(whole)
            return
        waiting = sorted(((part.start_time, k, part) for k, part in enumerate(self._parts)
                          if part.message_count), key=itemgetter(0, 1), reverse=True)
        heap: list[tuple[int, int, tuple[Connection, int, bytes]]] = []
        streams: dict[int, Iterator[tuple[Connection, int, bytes]]] = {}

        def advance(k: int) -> None:
            found = next(streams[k], None)
            if found is not None:
                heapq.heappush(heap, (found[1], k, found))

        while heap or waiting:
            while waiting and (not heap or waiting[-1][0] <= heap[0][0]):
                _, k, part = waiting.pop()
                streams[k] = messages(part)
                advance(k)
            if heap:
                _, k, found = heapq.heappop(heap)
                yield found
                advance(k)

    def messages(self, topics: Iterable[str] = (), start_ns: int | None = None,
                 stop_ns: int | None = None) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, bag time [ns], message), messages as `rosbags` makes them."""
        for topic, msgtype, time_ns, data in self.raw(topics, start_ns, stop_ns):
            yield topic, time_ns, self.decode(data, msgtype)

    def decode(self, data: bytes, msgtype: str) -> Any:
        """Return the message of CDR bytes."""
        try:
            return self.typestore.deserialize_cdr(data, msgtype)
        except Exception as error:  # whatever the parsers make of damaged bytes
            raise BagError(f'{self.path}: a {msgtype} cannot be decoded: '
                           f'{_words(error)}') from None

    def frames(self) -> Iterator[Frame]:
        """Yield the stereo frames in order, one at a time: images, true depth and true pose.

        Raises:
            BagError: The bag has no left images, or is damaged.
        """
        fields = {self.resolve(contract.LEFT_IMAGE.name): 'left'}
        fields.update({self.resolve(topic): field for topic, field in (
            (contract.RIGHT_IMAGE.name, 'right'), (contract.TRUE_DEPTH.name, 'depth_m'),
            (self.truth, 'pose')) if self.has(topic)})
        parts: dict[int, dict[str, Any]] = {}      # of stamps [ns] that may not be complete yet
        for topic, time_ns, message in self.messages(fields):
            stamp_ns, field = header_ns(message), fields[topic]
            if field == 'pose':
                value = pose_matrix(message)
            elif problem := image_problem(message):
                raise BagError(f'{self.path}: {topic} at {stamp_ns * 1e-9:.3f} s: {problem}')
            else:
                value = pixels(message)
            parts.setdefault(stamp_ns, {})[field] = value
            if field == 'left':
                yield from self._complete(parts, time_ns - _LATE_NS)
        yield from self._complete(parts, None)

    @staticmethod
    def _complete(parts: dict[int, dict[str, Any]], before_ns: int | None) -> Iterator[Frame]:
        """Take the frames of earlier stamps out of `parts`; None: all."""
        for stamp_ns in sorted(ns for ns in parts if before_ns is None or ns < before_ns):
            found = parts.pop(stamp_ns)
            if 'left' in found:
                yield Frame(stamp_ns, found['left'], found.get('right'), found.get('depth_m'),
                            found.get('pose'))

    def first(self, topic: str) -> Any:
        """Return the first message of a topic; BagError where there is none."""
        for _, _, message in self.messages([topic]):
            return message
        raise BagError(f'{self.path}: topic {topic} holds no message')

    @functools.cached_property
    def _stamp_table(self) -> StampTable:
        return StampTable(self.typestore)

    def stamp_ns(self, message: RawMessage) -> int | None:
        """Return the stamp inside a serialised message [ns]; None where its type has none."""
        return self._stamp_table.stamp_ns(message.msgtype, message.data)

    def close(self) -> None:
        """Close the files."""
        reader, self._reader = self._reader, None
        while self._parts:
            with suppress(Exception):       # one that could not be opened
                self._parts.pop().close()
        if reader is not None and reader.is_open:
            # rosbags empties the list `files` of metadata.yaml, which may be no list.
            with suppress(AttributeError):
                reader.close()


def open_bag(path: Path | str) -> Bag:
    """Open a bag folder, the folder of a run, or a bare `.mcap` or `.db3` file.

    Raises:
        BagError: If it is missing, no bag, or was cut off and has not been recovered.
    """
    check_path('path', path)
    return Bag(recorded_bag(path))


def is_compressed(data: bytes) -> bool:
    """Return whether a message is compressed, as by `ros2 bag record --compression-mode message`.
    """
    return data[:4] == _ZSTD


def uncompressed(data: bytes) -> bytes:
    """Return the CDR of a message that may be compressed; BagError where it is damaged."""
    if not is_compressed(data):
        return data
    try:
        return zstd.decompress(data)
    except (zstd.ZstdError, MemoryError) as error:
        raise BagError(f'a compressed message cannot be read: {_words(error)}') from None


def _words(error: Exception) -> str:
    if isinstance(error, MemoryError):
        return 'it names a length that no memory holds'
    return one_line(error)


_RULE = '=' * 80 + '\n'     # between the parts of a definition


def typestore_of(connections: Iterable[Connection]) -> Typestore:
    """Return the types that the definitions of connections give.

    They are those of ROS 2 Jazzy where no connection has a definition. Raises rosbags'
    TypesysError where a definition cannot be read, or where its hash (REP 2016) is another than
    the bag states.
    """
    return _typestore(tuple(dict.fromkeys(
        (c.msgtype, c.msgdef, c.digest) for c in connections
        if c.msgdef.format != MessageDefinitionFormat.NONE)))


@functools.lru_cache(maxsize=8)     # 70 ms for those of a drive, and as much when they are used
def _typestore(definitions: tuple[tuple[str, MessageDefinition, str], ...]) -> Typestore:
    if not definitions:
        return get_typestore(Stores.ROS2_JAZZY)
    store = get_typestore(Stores.EMPTY)
    types = {}
    for name, definition, _ in definitions:
        if definition.format == MessageDefinitionFormat.MSG:
            types.update(get_types_from_msg(definition.data, name))
            continue
        for part in filter(None, definition.data.split(_RULE)):
            title, _, rest = part.partition('\n')
            types.update(get_types_from_idl(rest if title.startswith('IDL: ') else part))
    store.register(types)
    for name, _, stated in definitions:
        if stated and stated != (found := store.hash_rihs01(name)):
            raise TypesysError(f'the definition of {name} has the hash {found}; the bag states '
                               f'{stated}')
    return store
