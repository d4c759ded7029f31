"""Worlds that several tests share; each is built once, for all workers of xdist."""

import functools
import json
from typing import Any

from lunar_rover_sim.base.parameters import merge
from lunar_rover_sim.ground.world.cache import cached
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.world_folder import load_world

SMALL = {'size_m': 12.8, 'surroundings': {'samples': 257}}
BARE = {'relief': {'rms_slope_deg': 0.0, 'far_rms_slope_deg': 0.0}, 'craters': {'density': 0.0},
        'rocks': {'abundance': 0.0}}


@functools.lru_cache(maxsize=8)
def _built(text: str, seed: int) -> World:
    # Tests find the cache of their session here, see `conftest.py`; a test may name another one.
    return load_world(cached(WorldConfig.from_mapping(json.loads(text)), seed), verify=False)


def world(seed: int = 1, **parameters: Any) -> World:
    """Return a world of the default size with these parameters."""
    return _built(json.dumps(parameters, sort_keys=True), seed)


def small(seed: int = 1, **parameters: Any) -> World:
    """Return a world of 12.8 m with coarse levels of 257 samples."""
    return world(seed, **merge(SMALL, parameters))
