"""Ways over sites that are planned before they are driven, so that estimators alone are judged.

A navigator sees by the cameras, and images differ a little from processor to processor, so it
takes another way on each. Along a given way the motion is the same on all of them, under any sun.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import dataclasses
import json
import math
from pathlib import Path

import cv2
import numpy as np

from lunar_rover_sim.autonomy.navigation.planner import Planner
from lunar_rover_sim.autonomy.navigation.traversability import Limits, traversability
from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.frames import Array, distance_along
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.judge.evaluation.map_evaluation import TrueSurface
from lunar_rover_sim.judge.slam.seal import read_seal
from lunar_rover_sim.run.scenario import Scenario

_MAP_M, _LEG_M = 24.0, 6.0      # side of the ground that is known; of each plan, what is kept
_MARGIN_M = 0.15                # from obstacles: drive_node cuts corners by some cm
_OFF_M = 0.02                   # of the straight pieces from the plan
_MOST_DETOUR = 3.0              # over the straight line

# Settings of a scenario with which drive_node follows a way, and the run ends at its end.
ALONG = ('run.nodes=[physics_node, gait_controller_node, render_node, recorder_node, drive_node]',
         'drive_node.mode=waypoints', 'drive_node.end_after_s=1', 'drive_node.stuck_time_s=60')


def planned(scenario: Scenario, goal_m: Sequence[float]) -> Array:
    """Return (n, 2) waypoints [m] from the start of a scenario to a goal, to 1 cm.

    They are those of the navigator's planner over the true ground, which it knows around the rover
    only. A goal on an obstacle is replaced as it does.

    Raises:
        SlamError: If it finds no way.
        WorldError: If the ground cannot be made, or ends before the goal.
    """
    start, seed = scenario.physics_node.start, scenario.physics_node.seed
    place, middle, surface = np.array([start.x_m, start.y_m]), None, None
    limits = Limits.of(scenario.rover, scenario.mapping_node.limits)
    config = dataclasses.replace(scenario.navigator_node.plan, margin_m=_MARGIN_M)
    site, legs = Site(scenario.world, seed), [place[None]]
    try:
        for _ in range(math.ceil(_MOST_DETOUR * math.dist(place, goal_m) / _LEG_M)):
            if surface is None or site.middle(place.tolist(), middle) != middle:
                middle = site.middle(place.tolist(), middle)
                surface = TrueSurface(site.window(middle))
            elevation = surface.elevation(place, _MAP_M, scenario.mapping_node.map.cell_m, 1)
            plan = Planner(traversability(elevation, limits), config, limits.radius_m,
                           place).plan(goal_m)
            if plan is None:
                break
            points = plan.points_m[1:]
            way_m = distance_along(plan.points_m)[1:]
            legs.append(points[:np.searchsorted(way_m, _LEG_M) + 1])
            place = legs[-1][-1]
            if len(legs[-1]) == len(points) and (plan.reaches_goal or plan.off_goal_m > 0.0):
                corners = cv2.approxPolyDP(np.vstack(legs).astype(np.float32)[:, None], _OFF_M,
                                           False)
                return np.round(corners[1:, 0].astype(float), 2)
    finally:
        site.close()
    raise SlamError(f'along: no way from ({start.x_m:g}, {start.y_m:g}) to '
                    f'({goal_m[0]:g}, {goal_m[1]:g}) m was found with seed {seed}; it '
                    f'ended at ({place[0]:.1f}, {place[1]:.1f}) m')


def settings_of(way_m: Array) -> tuple[str, str]:
    """Return the settings by which drive_node follows (n, 2) waypoints."""
    x, y = (json.dumps([float(value) for value in axis]) for axis in way_m.T)
    return f'drive_node.waypoints_x_m={x}', f'drive_node.waypoints_y_m={y}'


def sealed_ways(path: Path, seeds: Iterable[int], scenario: str) -> dict[int, Array]:
    """Return seed → (n, 2) waypoints [m] of a seal.

    Raises:
        SlamError: If it holds no way of a seed.
    """
    own, ways = read_seal(path).own, {}
    for seed in seeds:
        name = f'{scenario}-seed{seed}'
        texts = [text.partition('=')[2] for text in own.get(name, ())]
        try:
            ways[seed] = np.array([json.loads(text) for text in texts], float).T
        except ValueError:
            ways[seed] = np.zeros(0)
        if ways[seed].ndim != 2 or ways[seed].shape[1] != 2:
            raise SlamError(f'{path}: holds no way of {name}')
    return ways
