"""A bag of a rover that stands still, with the map of what is around it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import synthetic_bag
from synthetic_bag import cloud, header, item, msg, odometry, quaternion, text

from lunar_rover_sim.autonomy.navigation.config import TraversabilityConfig
from lunar_rover_sim.autonomy.navigation.traversability import LETHAL, Limits
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import ODOM_FRAME
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.judge.evaluation.map_evaluation import TrueSurface
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.run.scenario import Scenario

CELL_M, SIZE_M, STAMP_NS = 0.05, 6.0, 100_000_000


def write(path: Path, world: World, error_m: float = 0.0, flag_rocks: bool = True,
          edit: Callable[[Any, Any], object] = lambda cloud, grid: None) -> Path:
    """Write a bag whose map has the true heights of a world plus an error.

    edit: changes the two messages of the map.
    """
    surface = TrueSurface(world)
    elevation = surface.elevation((0.0, 0.0), SIZE_M, CELL_M)
    n = elevation.height_m.shape[0]
    axis = elevation.origin_m[0] + (np.arange(n) + 0.5) * CELL_M
    x, y = np.meshgrid(axis, axis)
    points = np.zeros(n * n, [(name, '<f4') for name in ('x', 'y', 'z', 'stddev')])
    points['x'], points['y'], points['stddev'] = x.ravel(), y.ravel(), 0.01
    points['z'] = elevation.height_m.ravel() + error_m
    limit = Limits.of(RoverDescription(), TraversabilityConfig()).step_m
    # Rocks as they are judged: where they are highest in a cell.
    inside = (np.arange(3) + 0.5) / 3.0 * CELL_M - 0.5 * CELL_M
    du, dv = np.meshgrid(inside, inside)
    places = np.stack([x[..., None] + du.ravel(), y[..., None] + dv.ravel()], axis=-1)
    rocks = surface.heights(places)[1].max(axis=-1) > limit
    cost = np.where(rocks & flag_rocks, LETHAL, 0).astype(np.int8)
    origin = msg('geometry_msgs/Pose', position=msg(
        'geometry_msgs/Point', x=float(elevation.origin_m[0]), y=float(elevation.origin_m[1]),
        z=0.0), orientation=quaternion((1.0, 0.0, 0.0, 0.0)))
    info = msg('nav_msgs/MapMetaData', map_load_time=synthetic_bag.time(0), resolution=CELL_M,
               width=n, height=n, origin=origin)
    grid = msg('nav_msgs/OccupancyGrid', header=header(STAMP_NS, ODOM_FRAME), info=info,
               data=cost.ravel())
    items = [text(topics.SCENARIO, Scenario.load('flat').to_yaml())]
    items += [item(topics.ODOM, odometry(ns, ODOM_FRAME, np.eye(4)))
              for ns in (STAMP_NS - 5_000_000, STAMP_NS)]
    items += [cloud(topics.ELEVATION, STAMP_NS, ODOM_FRAME, points),
              item(topics.TRAVERSABILITY, grid)]
    edit(items[-2].message, items[-1].message)
    return synthetic_bag.write(path, items)
