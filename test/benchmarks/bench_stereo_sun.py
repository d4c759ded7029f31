"""Errors of stereo matching by angle to the sun, and the share of sky with a disparity.

    python test/benchmarks/bench_stereo_sun.py [--scenarios baseline feature_sparse] [--seed 11]
        [--elevation 6]

Prints a table in Markdown, a row a view: two places, each towards the sun, across and away from
it. The matcher was tuned on seed 1. It asserts nothing.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from brightness import DIRECTIONS_DEG  # noqa: E402

from lunar_rover_sim.image.rendering.snapshot import settle, standing  # noqa: E402
from lunar_rover_sim.image.stereo.depth import disparity_from_depth  # noqa: E402
from lunar_rover_sim.image.stereo.error import stereo_errors  # noqa: E402
from lunar_rover_sim.rover.pose import RoverPose  # noqa: E402
from lunar_rover_sim.run.scenario import Scenario  # noqa: E402

_PLACES_M = (1.5, -1.0), (-2.0, 2.5)


def show(name: str, seed: int, elevation_deg: float) -> None:
    """Print the rows of a scenario."""
    scenario = Scenario.load(name, [f'render_node.sun.elevation_deg={elevation_deg}'], seed=seed)
    world, matcher = scenario.load_world(), scenario.matcher()
    with scenario.renderer(world) as renderer:
        for direction, turn_deg in DIRECTIONS_DEG.items():
            for number, (x, y) in enumerate(_PLACES_M):
                state = RoverPose(standing(world, x, y,
                                           scenario.render_node.sun.azimuth_deg + turn_deg))
                settle(renderer, state)
                frame = renderer.render(state, number, ('left', 'right', 'depth'))
                assert frame.left is not None and frame.depth_m is not None
                disparity = matcher.match(frame.picture('left'), frame.picture('right'))
                truth_px = disparity_from_depth(frame.depth_m, renderer.rig.focal_px,
                                                renderer.rig.baseline_m)
                found = stereo_errors(disparity, truth_px, None, frame.left).summary()
                sky = disparity.valid[~np.isfinite(frame.depth_m)]
                print(f'| {name} | {direction} | {100 * found["density"]:.1f} % '
                      f'| {100 * found["bad-1"]:.1f} % | {100 * sky.mean():.2f} % |', flush=True)


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--scenarios', nargs='+', default=['baseline', 'feature_sparse'])
    parser.add_argument('--seed', type=int, default=11)
    parser.add_argument('--elevation', type=float, default=6.0)
    args = parser.parse_args()
    print('| scenario | direction to the sun | density | bad-1 | sky matched |')
    print('|---|---|---|---|---|')
    for name in args.scenarios:
        show(name, args.seed, args.elevation)


if __name__ == '__main__':
    main()
