"""When a recording ends in simulated time, and which topics bear wall time by their nature.

The bag time of the last message is not that: /diagnostics, log lines and programs without
use_sim_time stamp with wall time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.topics import DEPTH_FRAME, FRAME, STATE

_NEAR_NS = 5_000_000_000    # a bag at one clock has a state so near its end


def simulated_end_ns(bag: Bag) -> int:
    """Return the bag time of the last state [ns], else that of the last frame.

    Where a bag holds neither, it is that of the last message which does not bear wall time by its
    nature; 0 where there is none. The states are those of all rovers in the bag. Only the end of
    the bag is read, all of it where the last message is of another clock. Raises BagError where
    the bag is damaged.
    """
    for names in _by_preference(bag):
        for start_ns in (max(0, bag.end_ns - _NEAR_NS), None) if names else ():
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
