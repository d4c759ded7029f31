"""Services for the page of the live view, besides topics: the map, and who drives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import json
from typing import Any

import numpy as np

from lunar_rover_sim.files.images import png_bytes
from lunar_rover_sim.run.live_page import Extra
from lunar_rover_sim.world.model import World

_MAP_PX = 1000
_ROCKS = 2000       # the largest ones are on the map


def map_pages(world: World | None, drivers: Callable[[], Sequence[str]]) -> Extra:
    """Return the paths that the page asks for.

    Args:
        world: Of the map; None: there is none.
        drivers: Returns who drives, so that the page must not.
    """
    facts = {} if world is None else _facts_of(world)
    picture = None if world is None else png_bytes(world.relief_picture(_MAP_PX))
    return {'/live.json': lambda: json.dumps({**facts, 'drivers': list(drivers())}).encode(),
            '/map.png': lambda: picture}


def _facts_of(world: World) -> dict[str, Any]:
    """Return the width of the map and (x, y, radius) of rocks [m]."""
    rocks = world.rocks
    radius_m = 0.5 * rocks.size_classes_m[rocks.size]
    largest = np.argsort(-radius_m, kind='stable')[:_ROCKS]
    shown = np.column_stack([rocks.position_m[largest, :2], radius_m[largest]])
    return {'half_extent_m': world.ground.half_extent_m, 'rocks': shown.round(3).tolist()}
