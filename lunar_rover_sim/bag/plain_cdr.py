"""CDR messages without what a middleware left in their padding, mostly without decoding them.

Decoding and serialising again does it, and takes most of the time of a hash. But the messages of a
topic are laid out alike: what lies where follows from the lengths of strings and sequences. Where
these are those of a message that was looked at, the padding is where it was.
"""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import struct
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde.utils import SIZEMAP
from rosbags.typesys.store import Typestore

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
