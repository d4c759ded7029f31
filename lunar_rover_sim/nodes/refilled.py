"""Messages that are sent again and again: numbers are written where they stand in CDR.

To fill the fields of such a message and to serialise it takes many times as long.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import functools
import struct
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message

from lunar_rover_sim.base.frames import Array, se3, wxyz_from_matrix
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.run.transforms import tf_message

_STAMP, _NUMBER = struct.Struct('<iI'), struct.Struct('<d')
# What no message holds otherwise: so its place is found.
_MARKED_NS = 1_734_829_105_456_789_123
_MARKS = -7.1e15    # the first of several, each greater by one


class Refilled:
    """A message in CDR: its stamps change, and runs of numbers (float64) that follow each other.

    Args:
        data: Holds, besides all that stays, `_MARKED_NS` for each stamp, and the next mark as the
            first number of each run.
        lengths: Numbers of each run.
    """

    def __init__(self, data: bytes, lengths: Sequence[int]) -> None:
        self._data = bytearray(data)
        stamp = _STAMP.pack(*divmod(_MARKED_NS, NS_PER_S))
        self._stamps = [at for at in range(len(data)) if data.startswith(stamp, at)]
        self._runs = [(struct.Struct(f'<{length}d').pack_into,
                       data.index(_NUMBER.pack(_MARKS + k))) for k, length in enumerate(lengths)]

    @classmethod
    def of(cls, message: Any, *runs: str) -> Refilled:
        """Return a message of ROS, refilled.

        Args:
            message: With all that stays; it is written to. Its stamp is `header.stamp`, or `clock`
                where it has no header.
            runs: Names of what changes, in the order of the message: messages of numbers, as
                'pose.pose', and arrays of numbers, of the length that they have.
        """
        stamp = message.header.stamp if hasattr(message, 'header') else message.clock
        stamp.sec, stamp.nanosec = divmod(_MARKED_NS, NS_PER_S)
        lengths = [_mark(message, run, _MARKS + k) for k, run in enumerate(runs)]
        return cls(serialize_message(message), lengths)

    def filled(self, stamp_ns: int, *runs: Iterable[float]) -> bytes:
        """Return the message with a stamp [ns] and the numbers of each run."""
        data, stamp = self._data, divmod(stamp_ns, NS_PER_S)
        for at in self._stamps:
            _STAMP.pack_into(data, at, *stamp)
        for (pack, at), numbers in zip(self._runs, runs, strict=True):
            pack(data, at, *numbers)
        return bytes(data)


class RefilledTransforms:
    """A TFMessage of frames that stay the same."""

    def __init__(self, pairs: Sequence[tuple[str, str]]) -> None:
        """Take (parent, child) of each transform."""
        marked = [(*pair, se3(np.eye(3), (_MARKS + k, 0.0, 0.0))) for k, pair in enumerate(pairs)]
        self._message = Refilled(tf_message(marked, _MARKED_NS), [7] * len(marked))

    def filled(self, stamp_ns: int, poses: Iterable[Array]) -> bytes:
        """Return the message with a stamp [ns] and (4, 4) T_parent_child of each."""
        return self._message.filled(stamp_ns, *(
            (*T[:3, 3].tolist(), *xyzw(wxyz_from_matrix(T[:3, :3]))) for T in poses))


def xyzw(quat_wxyz: Array) -> tuple[float, float, float, float]:
    """Return the numbers of a quaternion in the order of geometry_msgs."""
    w, x, y, z = quat_wxyz.tolist()
    return x, y, z, w


def _mark(message: Any, name: str, mark: float) -> int:
    """Write a mark as the first number of what is named; return how many numbers it has."""
    *parents, field = name.split('.')
    owner = functools.reduce(getattr, parents, message)
    value = getattr(owner, field)
    if isinstance(value, float):
        setattr(owner, field, mark)
        return 1
    if hasattr(value, 'get_fields_and_field_types'):
        parts = list(value.get_fields_and_field_types())
        return sum(_mark(value, part, mark if part == parts[0] else 0.0) for part in parts)
    value[0] = mark
    return len(value)
