"""Messages of a fixed layout, serialised once and filled in for every state.

Making and serialising two thousand messages a second in Python is a good part of what a run costs.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.nodes.conversions import NS

_STAMP = struct.Struct('<iI')
_STAMP_AT = 4           # after the encapsulation: headers, and Clock, begin with the stamp
AFTER_STAMP = _STAMP_AT + _STAMP.size


class MessageTemplate:
    """A message in little-endian CDR whose stamp and last fields, all float64, are filled in.

    numbers: (n,) view of those fields, in the order of the message definition; of a sequence's
        head, its length, where sequences are among them, one number stands for it
    """

    def __init__(self, raw: bytes, numbers: int, rest: int = 0) -> None:
        """Take all other fields from a serialised message; numbers: n; rest: bytes behind them."""
        self._raw = bytearray(raw)
        self.numbers: NDArray[np.float64] = np.frombuffer(
            self._raw, '<f8', numbers, len(self._raw) - rest - 8 * numbers)

    def stamped(self, stamp_ns: int) -> bytes:
        """Return the serialised message with a stamp."""
        _STAMP.pack_into(self._raw, _STAMP_AT, stamp_ns // NS, stamp_ns % NS)
        return bytes(self._raw)
