"""Topics whose messages bear wall time by their nature."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

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
