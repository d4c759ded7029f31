"""The distance that a rover drove: the one definition behind every path length that is reported.

It is the length of the horizontal path through the first position in every 0.1 s, and the last
one. The gait rocks the body a few times a second; summed at 200 Hz, that motion would count as
distance.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
import math
from typing import TypeVar

STEP_NS = 100_000_000

T = TypeVar('T')


def every_step(stamped: Iterable[tuple[int, T]]) -> Iterator[tuple[int, T]]:
    """Yield the first (stamp [ns], item) of every 0.1 s since the first stamp, and the last one.

    What it yields is what it yields of its own result.
    """
    first_ns = step = None
    last: tuple[int, T] | None = None
    for entry in stamped:
        if first_ns is None:
            first_ns = entry[0]
        number = (entry[0] - first_ns) // STEP_NS
        last = entry if number == step else None
        if number != step:
            step = number
            yield entry
    if last is not None:
        yield last


def driven_distance_m(positions_m: Iterable[tuple[int, Sequence[float]]]) -> float:
    """Return the distance driven [m] through (stamp [ns], (x, y, ...)) in the order of time."""
    total = 0.0
    before: Sequence[float] | None = None
    for _, position in every_step(positions_m):
        if before is not None:
            total += math.hypot(position[0] - before[0], position[1] - before[1])
        before = position
    return total
