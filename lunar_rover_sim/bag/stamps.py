"""The stamp of a serialised message, without deserialising the message.

In CDR a message whose first member is a `std_msgs/Header` or a `builtin_interfaces/Time` has its
stamp right behind the 4 bytes of encapsulation: int32 seconds, uint32 nanoseconds. Where the
first member is a sequence (TFMessage), its length comes first and the stamp is that of the first
element. The message definitions decide which of these a type has.
"""

from __future__ import annotations

import functools
import struct
from typing import Any, cast

from rosbags.interfaces import Nodetype
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore

from lunar_rover_sim.base.seconds import NS_PER_S

_TIME = 'builtin_interfaces/msg/Time'
_LITTLE = struct.Struct('<iI')
_BIG = struct.Struct('>iI')
_NO_STAMP = 0
_AT_START = 4      # behind the encapsulation
_IN_SEQUENCE = 8   # behind encapsulation and length


class StampTable:
    """Position of the stamp in each message type, from the definitions of a typestore."""

    def __init__(self, typestore: Typestore) -> None:
        self.typestore = typestore
        self._offsets: dict[str, int] = {}

    def stamp_ns(self, msgtype: str, raw: bytes | memoryview) -> int | None:
        """Return the stamp [ns] of a CDR message (4 bytes of encapsulation first).

        None where the type has no stamp at its start, is not known, or the message is too short
        to hold one (an empty TFMessage).
        """
        offset = self._offsets.get(msgtype)
        if offset is None:
            offset = self._offsets[msgtype] = self._locate(msgtype)
        if offset == _NO_STAMP or len(raw) < offset + 8:
            return None
        if offset == _IN_SEQUENCE and not any(raw[4:8]):
            return None
        sec, nanosec = (_LITTLE if raw[1] & 1 else _BIG).unpack_from(raw, offset)
        return int(sec) * NS_PER_S + int(nanosec)

    def forget(self, msgtype: str) -> None:
        """Look `msgtype` up again: its definition has become known."""
        self._offsets.pop(msgtype, None)

    def _locate(self, msgtype: str) -> int:
        offset = _AT_START
        while msgtype != _TIME:
            definition = self.typestore.fielddefs.get(msgtype)
            if definition is None or not definition[1]:
                return _NO_STAMP
            kind, detail = cast('tuple[int, Any]', definition[1][0][1])
            if kind == Nodetype.SEQUENCE:
                if offset == _IN_SEQUENCE:
                    return _NO_STAMP
                offset = _IN_SEQUENCE
                kind, detail = detail[0]
            elif kind == Nodetype.ARRAY:
                kind, detail = detail[0]
            if kind != Nodetype.NAME:
                return _NO_STAMP
            msgtype = detail
        return offset


@functools.lru_cache(maxsize=1)
def _jazzy() -> StampTable:
    return StampTable(get_typestore(Stores.ROS2_JAZZY))


def stamp_ns(msgtype: str, raw: bytes | memoryview) -> int | None:
    """Return the stamp [ns] of a CDR message of a type that ROS 2 Jazzy knows, else None.

    Header first, Time first, rosgraph Clock, or the first transform of a TFMessage; both byte
    orders. `msgtype` as ROS 2 writes it, `nav_msgs/msg/Odometry`.
    """
    return _jazzy().stamp_ns(msgtype, raw)


def message_of(msgtype: str, raw: bytes) -> Any:
    """Return a CDR message of a type that ROS 2 Jazzy knows, as rosbags deserialises it.

    That takes a fifth to two thirds of the time of rclpy, which makes objects of all that a
    message holds. Valid is to read attributes only.
    """
    return _jazzy().typestore.deserialize_cdr(raw, msgtype)
