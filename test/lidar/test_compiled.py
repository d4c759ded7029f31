"""What Numba compiles is compiled once: not for every scan, nor for every kind of world."""

import dataclasses
from typing import Any

import numpy as np
from physics_scene import ROVER
import worlds

from lunar_rover_sim.compiled import compiled
from lunar_rover_sim.lidar import ray_caster, ray_march, returns
from lunar_rover_sim.lidar.config import LidarConfig
from lunar_rover_sim.lidar.lidar import Lidar
from lunar_rover_sim.regolith.overlay import Overlay
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.world.model import World

STATE = RoverPose(np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0],
                            [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]]))


def versions() -> int:
    """Return for how many types of arguments functions are compiled."""
    return sum(len(getattr(function, 'signatures', ()))
               for module in (ray_caster, ray_march, returns)
               for function in vars(module).values())


def in_memory(world: World) -> World:
    """Return a world with arrays of its own, which may be written to."""
    rocks = {field.name: np.array(getattr(world.rocks, field.name))
             for field in dataclasses.fields(world.rocks)}
    levels = tuple(dataclasses.replace(grid, heights_m=np.array(grid.heights_m))
                   for grid in world.levels)
    return dataclasses.replace(world, levels=levels, albedo=np.array(world.albedo),
                               rocks=dataclasses.replace(world.rocks, **rocks))


def test_scans_compile_nothing() -> None:
    """What is compiled is there before the first scan, also for changed ground."""
    lidar, overlay = Lidar(worlds.small(), ROVER, LidarConfig()), Overlay()
    known = versions()
    assert known > 0
    lidar.scan(STATE)
    overlay.put(0, 0, np.full((9, 9), 0.01), np.zeros((9, 9)))
    lidar.follow(overlay)
    lidar.scan(STATE)
    assert versions() == known


def test_worlds_in_memory_and_from_folders_share_what_is_compiled() -> None:
    """Also with and without noise."""
    loaded = worlds.small(rocks={'abundance': 0.1})
    assert not loaded.rocks.position_m.flags.writeable and not loaded.albedo.flags.writeable
    found = [Lidar(loaded, ROVER, LidarConfig()).scan(STATE).returns.range_m]
    known = versions()
    copied = in_memory(loaded)
    assert copied.rocks.position_m.flags.writeable and copied.albedo.flags.writeable
    found.append(Lidar(copied, ROVER, LidarConfig()).scan(STATE).returns.range_m)
    Lidar(copied, ROVER, LidarConfig(noise=False)).scan(STATE)
    np.testing.assert_array_equal(*found)
    assert versions() == known


def test_nowhere_to_keep_what_is_compiled() -> None:
    """Numba finds no folder for a function without a file: it is compiled all the same."""
    names: dict[str, Any] = {}
    exec('def twice(x): return 2 * x', names)
    assert compiled(names['twice'])(4) == 8
