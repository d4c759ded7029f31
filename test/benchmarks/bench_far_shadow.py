"""Shadow on plans over maps from orbit: by the heights alone, and by a photo under the same sun.

    python test/benchmarks/bench_far_shadow.py

Plans of about 180 m on sites of `expedition`. What is in shadow is told by the ground on cells of
0.2 m; a shadow counts if a square of 1.4 m fits into it.
"""

import argparse
import math

import numpy as np
import scipy.ndimage

from lunar_rover_sim import Scenario
from lunar_rover_sim.autonomy.navigation.global_plan import GlobalPlan, GroundCosts
from lunar_rover_sim.base.errors import NavigationError
from lunar_rover_sim.base.files.results import markdown_table
from lunar_rover_sim.ground.world.build import Builder
from lunar_rover_sim.ground.world.orbital_making import orbital_map
from lunar_rover_sim.ground.world.orbital_map import OrbitalConfig
from lunar_rover_sim.ground.world.shade import shadow
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.judge.evaluation.statistics import Median, signed_rank_p

SUN_DEG = 60.0, 6.0
HALF_M, LEVEL = 190.0, 1
GOALS_M = (130.0, 100.0), (-140.0, 90.0), (120.0, -120.0)
STEP_M, ROOM_CELLS = 0.2, 3
KINDS = 'heights', 'photo'


def costs(site: Site, seed: int, kind: str) -> GroundCosts:
    """Return what ground costs by a map from orbit."""
    config = OrbitalConfig(extent_m=2.0 * HALF_M, photo_pixel_m=1.0 if kind == 'photo' else 0.0,
                           error_seed=seed, sun_azimuth_deg=SUN_DEG[0],
                           sun_elevation_deg=SUN_DEG[1])
    return GroundCosts.of(orbital_map(site, config, coarse=True), sun_deg=SUN_DEG)


def plans(seed: int) -> list[list[tuple[float, float]]]:
    """Return length and way in shadow [m] of each kind of plan, for each goal that has one."""
    world = Scenario.load('expedition').world.with_seed(seed)
    builder = Builder(world)
    cell = builder.cells[LEVEL]
    half = math.ceil(HALF_M / cell)
    ground = builder.heights(LEVEL, (-half, -half), (2 * half + 1, 2 * half + 1))
    dark = scipy.ndimage.binary_opening(shadow(ground.astype(np.float32), cell, *SUN_DEG),
                                        iterations=ROOM_CELLS)
    known = [costs(Site(world), seed, kind) for kind in KINDS]
    found = []
    for goal in GOALS_M:
        try:
            made = [GlobalPlan(of, (0.0, 0.0), [goal]) for of in known]
        except NavigationError:
            continue            # the goal is on a slope
        row = []
        for plan in made:
            way = np.array([plan.ahead((0.0, 0.0), s)
                            for s in np.arange(0.0, plan.length_m, STEP_M)])
            column, line = np.clip(np.rint(way / cell).astype(int) + half, 0, 2 * half).T
            row.append((plan.length_m, STEP_M * int(dark[line, column].sum())))
        found.append(row)
    return found


def main() -> None:
    """Print one line a kind of map."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', type=int, default=10)
    parser.add_argument('--first-seed', type=int, default=401)
    given = parser.parse_args()
    found = np.array([row for seed in range(given.first_seed, given.first_seed + given.seeds)
                      for row in plans(seed)])
    print(*markdown_table(
        ['shadows by', 'plans', 'length [m]', 'way in shadow [m]'],
        [[kind, str(len(found)), Median.of(found[:, k, 0]).text(0),
          Median.of(found[:, k, 1]).text(1)] for k, kind in enumerate(KINDS)]), sep='\n')
    less = found[:, 0, 1] - found[:, 1, 1]
    print(f'p of no difference in shadow {signed_rank_p(less):.2g}')


if __name__ == '__main__':
    main()
