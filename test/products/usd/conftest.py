"""What the tests of stages share."""

import importlib.util
from pathlib import Path

import pytest
from worlds import small

from lunar_rover_sim.ground.world.model import World

# OpenUSD has no wheels for Python 3.10.
collect_ignore_glob = [] if importlib.util.find_spec('pxr') else ['test_*.py']


@pytest.fixture(scope='session')
def moon() -> World:
    """Return a small world."""
    return small()


@pytest.fixture(scope='session')
def world_file(moon: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return its stage."""
    from lunar_rover_sim.products.usd.world_stage import write_world
    return write_world(moon, tmp_path_factory.mktemp('stage') / 'moon.usda')
