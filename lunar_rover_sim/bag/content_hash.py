"""A hash of the content of a bag, independent of order, storage and compression.

Each topic has a SHA-256 over (stamp, payload) of its messages. The hash of the bag is one over the
names, types and hashes of all topics, sorted by name. The order between topics, which differs
between two runs, does not count. Neither does the bag time of messages without a stamp, only their
order. Messages of one topic with one stamp (of several publishers) count in any order.

The payload is the message deserialised and serialised again. CDR aligns numbers with padding
bytes, which a middleware may leave as its buffer held them before; and either byte order gives
one hash.

Topics that depend on wall time or on the process are skipped, see `SKIPPED`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
import hashlib
from pathlib import Path
import struct
from typing import Any

from rosbags.typesys.base import TypesysError

from lunar_rover_sim.bag.plain_cdr import PlainCdr
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
