"""A hash of the content of a bag, independent of order, storage and compression.

Each topic has a SHA-256 over (stamp, payload) of its messages. The hash of the bag is one over the
names, types and hashes of all topics, sorted by name. The order between topics, which differs
between two runs, does not count. Neither does the bag time of messages without a stamp, only their
order. Messages of one topic with one stamp (of several publishers) count in any order.

The payload is the message deserialised and serialised again. CDR aligns numbers with padding
bytes, which a middleware may leave as its buffer held them before; and either byte order gives
one hash. That takes most of the time of a hash. But the messages of a topic are laid out alike:
what lies where follows from the lengths of strings and sequences. Where these are those of a
message that was looked at, the padding is where it was, and nothing is decoded (`PlainCdr`).

Topics that depend on wall time or on the process are skipped, see `SKIPPED`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
import dataclasses
import hashlib
from pathlib import Path
import struct
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde.utils import SIZEMAP
from rosbags.typesys.base import TypesysError
from rosbags.typesys.store import Typestore

from lunar_rover_sim.bag.reader import Bag, open_bag, RawMessage
from lunar_rover_sim.bag.totals import AT_WALL_TIME, is_one_of
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.base.topics import RECORDED

SKIPPED: Mapping[str, str] = {**AT_WALL_TIME, RECORDED.name: 'progress of the recorder'}

_STAMP = struct.Struct('<q')
_NO_STAMP = b'no stamp'


class _TopicHash:
    """The hash of one topic; messages of equal stamps are put into a fixed order."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self._stamp_ns: int | None = None
        self._group: list[bytes] = []

    def add(self, stamp_ns: int | None, payload: bytes | bytearray | memoryview) -> None:
        digest = hashlib.sha256(payload).digest()
        if stamp_ns is None:
            self._hash.update(_NO_STAMP + digest)
            return
        if stamp_ns != self._stamp_ns:
            self._fold()
            self._stamp_ns = stamp_ns
        self._group.append(digest)

    def hexdigest(self) -> str:
        self._fold()
        return self._hash.hexdigest()

    def _fold(self) -> None:
        if self._stamp_ns is not None:
            self._hash.update(_STAMP.pack(self._stamp_ns) + b''.join(sorted(self._group)))
        self._stamp_ns = None
        self._group.clear()


def is_skipped(topic: str) -> bool:
    """Return whether a topic, under any namespace, does not count."""
    return is_one_of(topic, SKIPPED)


class ContentHash:
    """The hashes of the topics of an open bag, from its messages one by one.

    Attributes:
        topics: Those that count, all but `SKIPPED`, or those of `only`; each of their messages is
            to be added.
    """

    def __init__(self, bag: Bag, only: Collection[str] = ()) -> None:
        self._bag = bag
        self.topics = [topic for topic in only or bag.types if not is_skipped(topic)]
        self._states = {topic: _TopicHash() for topic in self.topics}
        self._cdr = PlainCdr(bag.typestore, bag.decode)

    def add(self, message: RawMessage, decoded: Any = None) -> None:
        """Take the next message, and the same decoded, where that was done already.

        Raises:
            BagError: If it cannot be decoded or serialised again.
        """
        try:
            payload = self._cdr.of(message.topic, message.msgtype, message.data, decoded)
        except (TypesysError, struct.error) as error:
            raise BagError(f'{self._bag.path}: a {message.msgtype} cannot be hashed: '
                           f'{error}') from None
        self._states[message.topic].add(self._bag.stamp_ns(message), payload)

    def by_topic(self) -> dict[str, str]:
        """Return topic → hexadecimal hash."""
        return {topic: state.hexdigest() for topic, state in self._states.items()}

    def of_bag(self) -> str:
        """Return the hexadecimal hash of the bag."""
        return combine(self.by_topic(), self._bag.types)


def topic_hashes(path: Path | str, progress: Callable[[], None] | None = None,
                 only: Collection[str] = ()) -> dict[str, str]:
    """Return topic → hexadecimal hash; `progress` is called once per message.

    Args:
        only: Topics, by their full names; none: all.

    Raises:
        BagError: If the bag cannot be read.
    """
    with open_bag(path) as bag:
        return _read(bag, progress, only).by_topic()


def bag_hash(path: Path | str) -> str:
    """Return the hexadecimal hash of a bag; of an incomplete one that of its messages.

    Raises:
        BagError: If the bag cannot be read.
    """
    with open_bag(path) as bag:
        return _read(bag, None, ()).of_bag()


def combine(hashes: Mapping[str, str], types: Mapping[str, str]) -> str:
    """Return the hash of a bag from those of its topics and their types."""
    lines = [f'{topic} {types[topic]} {digest}\n' for topic, digest in sorted(hashes.items())]
    return hashlib.sha256(''.join(lines).encode()).hexdigest()


def _read(bag: Bag, progress: Callable[[], None] | None, only: Collection[str]) -> ContentHash:
    hashes = ContentHash(bag, only)
    for message in bag.raw(hashes.topics) if hashes.topics else ():
        hashes.add(message)
        if progress is not None:
            progress()
    return hashes


_HEADER = b'\x00\x01\x00\x00'   # little endian, no options
_MOST_UNLIKE = 20               # messages unlike the one before, after which a topic is given up
_LENGTH = struct.Struct('<I')


@dataclasses.dataclass(frozen=True)
class _Layout:
    """Where what lies in the messages of a topic.

    Attributes:
        size: Bytes, with the encapsulation.
        fixed: Begin, end and bytes of lengths, strings and flags.
        padding: Begin and end.
    """

    size: int
    fixed: tuple[tuple[int, int, bytes], ...]
    padding: tuple[tuple[int, int], ...]

    def fits(self, data: bytes) -> bool:
        """Return whether a message is laid out so."""
        if not self.size <= len(data) <= self.size + 3 or data[:2] != _HEADER[:2]:
            return False
        for begin, end, expected in self.fixed:
            if data[begin:end] != expected:
                return False
        return True

    def plain(self, data: bytes) -> bytes | bytearray:
        """Return a message that fits, with padding of zeros."""
        found = bytearray(data[:self.size])
        found[:4] = _HEADER
        for begin, end in self.padding:
            found[begin:end] = bytes(end - begin)
        return found


class PlainCdr:
    """Makes messages of many topics plain: as they are when they are serialised again."""

    def __init__(self, typestore: Typestore, decode: Callable[[bytes, str], Any]) -> None:
        """Begin; decode: returns the message of bytes and a type."""
        self._typestore, self._decode = typestore, decode
        self._layouts: dict[str, _Layout] = {}
        self._unlike: dict[str, int] = {}

    def of(self, topic: str, msgtype: str, data: bytes, decoded: Any = None) -> Any:
        """Return the bytes of a message, little endian, with padding of zeros.

        Args:
            decoded: The same message; None: it is decoded where that is needed.

        Raises:
            TypesysError, struct.error: If it cannot be serialised again.
        """
        layout = self._layouts.get(topic)
        if layout is not None and layout.fits(data):
            return layout.plain(data)
        if decoded is None:
            decoded = self._decode(data, msgtype)
        plain = self._typestore.serialize_cdr(decoded, msgtype, little_endian=True)
        if self._unlike.get(topic, 0) < _MOST_UNLIKE:
            self._unlike[topic] = self._unlike.get(topic, 0) + 1
            found = _Walk(self._typestore, data).layout(msgtype)
            # The layout is kept only if it gives the same bytes as `rosbags`.
            if found is not None and found.fits(data) and found.plain(data) == plain:
                self._layouts[topic] = found
        return plain


class _Walk:
    """Goes through a message by its definition."""

    def __init__(self, typestore: Typestore, data: bytes) -> None:
        self._typestore, self._data = typestore, data
        self._at = 4
        self._fixed: list[tuple[int, int, bytes]] = []
        self._padding: list[tuple[int, int]] = []

    def layout(self, msgtype: str) -> _Layout | None:
        """Return the layout of the message; None where it has what is not known here."""
        try:
            self._message(msgtype)
        except (KeyError, struct.error):
            return None
        return _Layout(self._at, tuple(self._fixed), tuple(self._padding))

    def _message(self, msgtype: str) -> None:
        for _, field in self._typestore.fielddefs[msgtype][1]:
            self._field(field)

    def _field(self, field: Any) -> None:
        kind, content = field
        if kind == Nodetype.NAME:
            self._message(content)
        elif kind == Nodetype.BASE:
            self._values(content[0], 1)
        else:
            of, count = content
            if kind == Nodetype.SEQUENCE:
                count = self._length()
            if of[0] == Nodetype.BASE:
                self._values(of[1][0], count)
            else:
                for _ in range(count):
                    self._field(of)

    def _values(self, name: str, count: int) -> None:
        if name == 'string':
            for _ in range(count):
                self._keep(self._length())
        elif count:
            size = SIZEMAP[name]    # type: ignore[index]
            self._align(size)
            if name == 'bool':
                self._keep(count)
            else:
                self._at += size * count

    def _length(self) -> int:
        self._align(4)
        length: int = _LENGTH.unpack_from(self._data, self._at)[0]
        self._keep(4)
        return length

    def _keep(self, size: int) -> None:
        """Go on over bytes that must be the same in another message."""
        end = self._at + size
        self._fixed.append((self._at, end, bytes(self._data[self._at:end])))
        self._at = end

    def _align(self, size: int) -> None:
        end = self._at + (4 - self._at) % size      # the encapsulation does not count
        if end > self._at:
            self._padding.append((self._at, end))
            self._at = end
