"""Recorded sensors that an export has no place for, a line for each reason."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.sensors.registry import SENSORS
from lunar_rover_sim.sequences.sequence import Sequence

# Beside hazard cameras, whose topics bear their names.
OF_SENSORS = (topics.LEFT_IMAGE, topics.RIGHT_IMAGE, *topics.OF_LIDAR,
              *(topic for sensor in SENSORS for topic in sensor.published))
NO_PLACE = 'this format has no place for them'


def left_out(bag: Bag, sequence: Sequence) -> list[str]:
    """Return notes on the sensors of a bag that a sequence does not hold."""
    return [*sensors_left_out(bag, sequence.needs + sequence.uses, sequence.lacks),
            *hazards_left_out(bag, [camera.name for camera in sequence.further],
                              sequence.further_needs or NO_PLACE)]


def sensors_left_out(bag: Bag, taken: Collection[str],
                     lacks: Mapping[str, str] = {}) -> list[str]:
    """Return a note for each reason why topics with messages are left out.

    Args:
        taken: Topics that are not.
        lacks: Topic → the reason, NO_PLACE where it names none.
    """
    named: dict[str, list[str]] = defaultdict(list)
    for topic in topics.of_legs(OF_SENSORS, topics.legs_of(bag.types)):
        if topic.name not in taken and bag.count(topic.name):
            named[lacks.get(topic.name, NO_PLACE)].append(topic.name)
    return [f'left out: {", ".join(names)}; {reason}' for reason, names in named.items()]


def hazards_left_out(bag: Bag, taken: Collection[str], reason: str = NO_PLACE) -> list[str]:
    """Return a note on the hazard cameras of a bag that are not taken."""
    there = {camera for full in bag.types if (camera := _hazard_of(bag, full)) is not None}
    lacking = sorted(there.difference(taken))
    return [f'left out: hazard cameras {", ".join(lacking)}; {reason}'] if lacking else []


def _hazard_of(bag: Bag, full: str) -> str | None:
    """Return the hazard camera that a topic is an image of."""
    known = topics.of_hazard(full.removeprefix(bag.namespace + '/'))
    return known[1] if known is not None and known[0] is topics.HAZARD_IMAGE else None
