"""CPU time of a new plan over the distance of its goal: the local one, and that from orbit.

    python test/benchmarks/bench_far_plan.py

On `baseline`, by the true map of 12.8 m around the rover, after a way of 40 m whose ground is
known, and by the heights of its levels at 2 m as from orbit, with their errors. The first plan
from orbit looks at the whole map; each further one is made where the way ahead is blocked.
"""

from __future__ import annotations

from collections.abc import Callable
import math
import statistics
import time

import numpy as np

from lunar_rover_sim import Scenario
from lunar_rover_sim.autonomy.navigation.config import GlobalPlanConfig
from lunar_rover_sim.autonomy.navigation.global_plan import GlobalPlan, GroundCosts
from lunar_rover_sim.autonomy.navigation.overview import Overview
from lunar_rover_sim.autonomy.navigation.planner import Planner
from lunar_rover_sim.autonomy.navigation.traversability import Limits, traversability
from lunar_rover_sim.ground.world.orbital_making import orbital_map
from lunar_rover_sim.ground.world.orbital_map import OrbitalConfig
from lunar_rover_sim.judge.evaluation.map_evaluation import TrueSurface

DISTANCES_M = (10.0, 100.0, 400.0, 1000.0)
WAY_M, TIMES = 40, 9
HEADING_RAD = 0.3


def ms(step: Callable[[], object], times: int = TIMES) -> float:
    """Return the median CPU time of a call [ms]."""
    found = []
    for _ in range(times):
        begin = time.process_time()
        step()
        found.append(time.process_time() - begin)
    return 1e3 * statistics.median(found)


def main() -> int:
    """Print one line a distance."""
    scenario = Scenario.load('baseline', seed=1)
    world, limits = scenario.load_world(), Limits.of(scenario.rover, scenario.mapping_node.limits)
    whole = TrueSurface(world).elevation((0.0, 0.0), 12.8, 0.05, samples=1)
    grid, config = traversability(whole, limits), scenario.navigator_node.plan
    known = Overview(grid.cell_m, 1.0 + config.unknown_cost)
    planner = Planner(grid, config, limits.radius_m, (0.0, 0.0))
    for x in range(-WAY_M, 1):
        known.add(grid.origin_m + (x, 0.0), planner.blocked, planner.unknown, planner.room_m)
    costs = GroundCosts.of(orbital_map(world, OrbitalConfig(photo_pixel_m=0.0), coarse=True))
    far = GlobalPlanConfig()
    GlobalPlan(costs, (0.0, 0.0), [(20.0, 0.0)]).replan((0.0, 0.0))     # compiles
    for distance in DISTANCES_M:
        goal = distance * np.array([math.cos(HEADING_RAD), math.sin(HEADING_RAD)])

        def local() -> None:
            made = Planner(grid, config, limits.radius_m, (0.0, 0.0), overview=known)
            known.add(grid.origin_m, made.blocked, made.unknown, made.room_m)
            made.plan(goal)

        plans = [GlobalPlan(costs, (0.0, 0.0), [goal])]
        first = ms(lambda: plans.append(GlobalPlan(costs, (0.0, 0.0), [goal])), 3)
        plan = plans[0]
        new = []
        for _ in range(TIMES):
            ahead = [plan.ahead((0.0, 0.0), s) for s in np.arange(0.0, far.ahead_m + 1.0)]
            new.append(ms(lambda: plan.report_blocked(ahead, (0.0, 0.0)), 1))
        print(f'{distance:5g} m: local {ms(local):.1f} ms; from orbit the first {first:.0f} ms, '
              f'a further one {statistics.median(new):.2f} ms, at most {max(new):.2f} ms')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
