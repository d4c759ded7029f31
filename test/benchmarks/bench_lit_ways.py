"""Whether goals of a navigation study that were missed can be reached over lit ground at all.

    python test/benchmarks/bench_lit_ways.py DIR/navigation.csv rough

and with --seeds 302 305, also of those that were reached.

Costs are those of the true map; what the sun does not light is unknown, and closed where too much
of it is under the rover, as it is for the navigator after a look.
"""

import argparse
import csv
import dataclasses
from pathlib import Path

import cv2
import numpy as np

from lunar_rover_sim.autonomy.navigation.planner import Disc, Ground, Planner
from lunar_rover_sim.autonomy.navigation.traversability import (Limits, traversability,
                                                                Traversability, UNKNOWN)
from lunar_rover_sim.base.frames import Array, sun_direction
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.lidar.ray_arrays import HeightPyramid, RockHulls
from lunar_rover_sim.image.lidar.ray_caster import RayCaster
from lunar_rover_sim.judge.evaluation.map_evaluation import TrueSurface
from lunar_rover_sim.judge.studies.navigation import ARRIVED, start_of
from lunar_rover_sim.run.scenario import Scenario

SIZE_M = 26.0           # of the map around the start
SHADOW_M = 12.0         # how far away what casts a shadow may be: 1.2 m high at 6 degrees
ABOVE_M = 0.02          # from here the sun is looked for: facets of the ground are not


def lit_costs(scenario: Scenario, world: World, sun_deg: float) -> Traversability:
    """Return what the rover can cross, unknown where the sun does not shine."""
    limits, cell = Limits.of(scenario.rover, scenario.mapping_node.limits), 0.05
    elevation = TrueSurface(world).elevation(start_of(scenario), SIZE_M, cell, samples=1)
    costs = traversability(elevation, limits)
    x, y = np.meshgrid(*(centres[::2] for centres in elevation.centres_m))
    start = np.stack([x, y, elevation.height_m[::2, ::2] + ABOVE_M], axis=-1).reshape(-1, 3)
    hulls = RockHulls(world.rocks, world.rock_shapes)
    caster = RayCaster([HeightPyramid(world.ground, hulls)], hulls)
    sun = sun_direction(scenario.render_node.sun.azimuth_deg, sun_deg)
    hits = caster.cast(start, np.tile(sun, (len(start), 1)), SHADOW_M, from_one_place=False)
    lit = ~(hits.distance_m < SHADOW_M).reshape(x.shape)
    lit = np.kron(lit, np.ones((2, 2), bool))
    square = np.ones((2 * scenario.mapping_node.limits.fill_cells + 1,) * 2, np.uint8)
    lit = cv2.erode(cv2.dilate(lit.astype(np.uint8), square), square) > 0    # as maps are filled
    return dataclasses.replace(costs, cost=np.where(lit, costs.cost, np.int8(UNKNOWN)))


def way_m(scenario: Scenario, costs: Traversability, goal_m: Array) -> float | None:
    """Return the length of the way over lit ground to within the tolerance of a goal."""
    nav, start = scenario.navigator_node, start_of(scenario)
    limits = Limits.of(scenario.rover, scenario.mapping_node.limits)
    looked_at = Disc(*start, 2.0 * SIZE_M, Ground.SHADOW)
    stood = Disc(*start, nav.plan.start_m, Ground.STOOD)
    plan = Planner(costs, nav.plan, limits.radius_m, start, (stood, looked_at)).plan(goal_m)
    if plan is None or np.linalg.norm(plan.points_m[-1] - goal_m) > nav.goal_tolerance_m:
        return None
    return plan.length_m


def main() -> None:
    """Print a line for each drive."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('table', type=Path, help='navigation.csv of a study')
    parser.add_argument('scenario')
    parser.add_argument('--seeds', type=int, nargs='*', default=(),
                        help='default: all that did not arrive')
    options = parser.parse_args()
    with options.table.open(newline='') as file:
        rows = [row for row in csv.DictReader(file) if row['scenario'] == options.scenario
                and row['driver'] == 'seen' and (
                    int(row['seed']) in options.seeds if options.seeds
                    else row['outcome'] != ARRIVED)]
    print('seed  outcome    lit [%]  way over lit ground [m]')
    for row in rows:
        seed, sun_deg = int(row['seed']), float(row['sun_deg'])
        goal = np.array([float(part) for part in row['goal_m'].strip('()').split(';')])
        scenario = Scenario.load(options.scenario, seed=seed)
        costs = lit_costs(scenario, scenario.load_world(), sun_deg)
        way = way_m(scenario, costs, goal)
        print(f'{seed:4}  {row["outcome"]:9}  {100.0 * np.mean(costs.cost != UNKNOWN):7.0f}  '
              f'{"none" if way is None else f"{way:.1f}"}', flush=True)


if __name__ == '__main__':
    main()
