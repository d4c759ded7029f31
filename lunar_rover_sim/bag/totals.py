"""Totals of a bag: its simulated end, the distance driven, the pace of its recording.

The bag time of the last message is not its end: /diagnostics, log lines and programs without
use_sim_time stamp with wall time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
import json
import math
import time

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.metadata import information
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.topics import DEPTH_FRAME, FRAME, STATE

# How far before its end a bag is searched. Most bags have a state within the first; one whose
# messages all have one clock has one within the second.
_NEAR_NS = 100_000_000, 5_000_000_000


def simulated_end_ns(bag: Bag) -> int:
    """Return the bag time of the last state [ns], else that of the last frame.

    Where a bag holds neither, it is that of the last message on a topic that is not in
    `AT_WALL_TIME`; 0 where there is none. The states are those of all rovers in the bag. Only
    the end of the bag is read, or all of it where the last messages have stamps of another clock.

    Raises:
        BagError: Where the bag is damaged.
    """
    for names in _by_preference(bag):
        for start_ns in (*(max(0, bag.end_ns - near) for near in _NEAR_NS), None) if names else ():
            end_ns = max((message.time_ns for message in bag.raw(names, start_ns)), default=None)
            if end_ns is not None:
                return end_ns
    return 0


def _by_preference(bag: Bag) -> Iterator[list[str]]:
    """Yield the topics from which the end is read, most reliable first."""
    for rates in ((STATE,), (FRAME, DEPTH_FRAME)):
        known = [topic.name for topic in topics.of_legs(topics.CONTRACT, topics.legs_of(bag.types))
                 if topic.rate in rates]
        yield [f'{namespace}/{name}' for namespace in {'', *bag.namespaces} for name in known
               if f'{namespace}/{name}' in bag.types]
    yield [name for name in bag.types if not is_at_wall_time(name)]


AT_WALL_TIME: Mapping[str, str] = {
    'rosout': 'log lines have wall time',
    'parameter_events': 'have wall time',
    'transition_event': 'life cycle of a node, at wall time',
    'diagnostics': 'health of processes, at wall time',
    'statistics': 'wall-time statistics of the middleware',
}


def is_at_wall_time(topic: str) -> bool:
    """Return whether a topic, under any namespace, bears wall time."""
    return is_one_of(topic, AT_WALL_TIME)


def is_one_of(topic: str, names: Iterable[str]) -> bool:
    """Return whether a topic has one of these names, under any namespace."""
    return any(('/' + topic).endswith('/' + name) for name in names)


STEP_NS = 100_000_000


def every_step(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the places of the first of (n,) stamps in every 0.1 s since the first one.

    The place of the last stamp is among them.
    """
    if not len(stamps_ns):
        return np.zeros(0, np.int64)
    steps = (stamps_ns - stamps_ns[0]) // STEP_NS
    return np.union1d(np.flatnonzero(np.diff(steps, prepend=-1)), len(steps) - 1)


def driven_distance_m(stamps_ns: NDArray[np.int64], positions_m: Array) -> float:
    """Return the horizontal distance driven [m] through (n, 2 or more) positions at (n,) stamps.
    """
    total = 0.0
    for x, y in np.diff(positions_m[every_step(stamps_ns), :2], axis=0).tolist():
        total += math.hypot(x, y)
    return total


REAL_TIME_FACTOR = 'real_time_factor'   # key in custom_data of metadata.yaml


def recorded_factor(bag: Bag) -> float | None:
    """Return the real-time factor of a recording; None where its metadata does not say."""
    # A bag may be a single file, and its metadata another tool's.
    with suppress(BagError, LookupError, TypeError, ValueError):
        factor = float(information(bag.path)['custom_data'][REAL_TIME_FACTOR])
        return factor if math.isfinite(factor) and factor > 0.0 else None
    return None


RECORDED_COUNTS = 'recorded_counts'     # key there: JSON of topic → messages


def recorded_counts(bag: Bag) -> dict[str, int]:
    """Return how many messages of each topic were recorded; nothing where metadata lacks it.

    A person who edits a bag rewrites the counts beside each topic with the messages.
    """
    with suppress(BagError, LookupError, TypeError, ValueError, RecursionError, AttributeError):
        told = json.loads(information(bag.path)['custom_data'][RECORDED_COUNTS])
        return {str(topic): int(count) for topic, count in told.items()}
    return {}


RESUMED_NS = 'resumed_ns'       # key there: JSON of the simulated times [ns]


def resumed_ns(bag: Bag) -> tuple[int, ...]:
    """Return the simulated times [ns] at which the recording went on in another process."""
    with suppress(BagError, LookupError, TypeError, ValueError, RecursionError):
        return tuple(int(ns) for ns in json.loads(
            information(bag.path)['custom_data'][RESUMED_NS]))
    return ()


def resumed_line(bag: Bag) -> str:
    """Return a line that says so, for people; '' where it did not."""
    times = ', '.join(f'{ns / 1e9:.3f} s' for ns in resumed_ns(bag))
    return f'resumed at {times}: another process went on from a checkpoint' if times else ''


class RecordingPace:
    """Measures the real-time factor of a recording while it goes on.

    It counts from the moment when bag time first moves on: what nodes do before their first step,
    such as building a world, is not part of it. Where time goes back to 0, it counts on.
    """

    def __init__(self) -> None:
        self._newest_ns = self._advanced_ns = 0
        self._start_s: float | None = None
        self._end_s = 0.0

    def note(self, newest_ns: int) -> None:
        """Take the newest bag time [ns] at this moment."""
        if newest_ns > self._newest_ns:
            self._end_s = time.monotonic()
            if self._start_s is None:
                self._start_s = self._end_s
            else:
                self._advanced_ns += newest_ns - self._newest_ns
        self._newest_ns = newest_ns

    @property
    def real_time_factor(self) -> float | None:
        """Simulated time over wall time so far; None before bag time has moved on twice."""
        if self._start_s is None or self._end_s <= self._start_s:
            return None
        return self._advanced_ns / 1e9 / (self._end_s - self._start_s)
