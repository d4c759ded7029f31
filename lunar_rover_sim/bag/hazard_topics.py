"""Which topics of hazard cameras a bag holds."""

from __future__ import annotations

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import Bag


def hazard_topics(bag: Bag) -> dict[str, dict[topics.Topic, str]]:
    """Return camera → the contract's topics of hazard cameras → their names in the bag.

    Cameras are named as below `hazard/`, one of a pair with /left or /right, in the order of their
    names. Topics without messages are left out.
    """
    found: dict[str, dict[topics.Topic, str]] = {}
    for full in bag.types:
        name = full.removeprefix(bag.namespace + '/')
        known = topics.of_hazard(name)
        if known is not None and bag.counts[full]:
            found.setdefault(known[1], {})[known[0]] = name
    return dict(sorted(found.items()))
