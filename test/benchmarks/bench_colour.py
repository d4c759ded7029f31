"""What colour takes from stereo: the same ten places of `baseline`, both ways.

    python test/benchmarks/bench_colour.py

prints wrong matches and density of SGM, with means of the paired differences, their 95 %
intervals and p of Wilcoxon's test.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from lunar_rover_sim.image.rendering.snapshot import HEIGHT_M, settle, standing
from lunar_rover_sim.image.stereo.depth import disparity_from_depth
from lunar_rover_sim.image.stereo.error import stereo_errors
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

PLACES, SUN_DEG = 10, 10.0
COLUMNS = 'bad-1 [%]', 'density [%]'


def main() -> None:
    """Print the table."""
    found = []
    for encoding in ('mono8', 'rgb8'):
        scenario = Scenario.load('baseline', [f'render_node.sensor.encoding={encoding}',
                                              f'render_node.sun.elevation_deg={SUN_DEG}'])
        world, matcher, rows = scenario.load_world(), scenario.matcher(), []
        with scenario.renderer(world) as renderer:
            for k in range(PLACES):
                state = RoverPose(standing(world, 0.5 * k - 2.0, 0.4 * k - 2.0, 150.0 + 36.0 * k,
                                           HEIGHT_M))
                settle(renderer, state)
                frame = renderer.render(state, k, ('left', 'right', 'depth'))
                left, right = frame.picture('left'), frame.picture('right')
                truth = disparity_from_depth(frame.depth_m, renderer.rig.focal_px,
                                             renderer.rig.baseline_m)
                errors = stereo_errors(matcher.match(left, right), truth, None, left)
                rows.append((100.0 * errors.bad1 / errors.matched,
                             100.0 * errors.matched / errors.ground))
        found.append(np.array(rows, float))
    print('| | mono8 | rgb8 | difference | p |\n|---|---|---|---|---|')
    for name, mono, colour in zip(COLUMNS, found[0].T, found[1].T):
        change = colour - mono
        low, high = stats.t.interval(0.95, PLACES - 1, change.mean(), stats.sem(change))
        print(f'| {name} | {mono.mean():.4g} | {colour.mean():.4g} | {change.mean():+.3g} '
              f'[{low:+.3g}, {high:+.3g}] | {stats.wilcoxon(change).pvalue:.2g} |')


if __name__ == '__main__':
    main()
