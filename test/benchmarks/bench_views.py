"""What a parameter of the image changes for features, by the angle to the sun.

    python test/benchmarks/bench_views.py [--set render_node.detail.relief_by_view=true]
        [--scenario baseline] [--elevation 6] [--seeds 1 2 3] [--step 0.03] [--pitch 1.0]

Views are those of bench_sampling.py: of each, corners are tracked from an image into one a step
before it, without and with the setting, and compared with the true flow. Printed are medians of
views, by direction and distance: tracked corners, those that are lost, and the median error; ORB
features of the whole image; p of Wilcoxon's test of pairs of views, corrected for the number of
tests (Benjamini and Hochberg). It asserts nothing.
"""

from __future__ import annotations

import argparse

from bench_sampling import klt_errors, views, WILD_PX
from brightness import DIRECTIONS_DEG
import cv2
import numpy as np

from lunar_rover_sim.judge.evaluation.statistics import adjusted, signed_rank_p
from lunar_rover_sim.run.scenario import Scenario

BANDS_M = (1.0, 2.0), (2.0, 4.0), (4.0, 8.0), (8.0, 20.0)


def measured(settings: list[str], seed: int,
             args: argparse.Namespace) -> dict[str, list[np.ndarray]]:
    """Return direction → of each place (bands, 4): corners, share lost, error; ORB features."""
    scenario = Scenario.load(args.scenario, [
        f'render_node.sun.elevation_deg={args.elevation}',
        'render_node.sensor.exposure_mode=sunlit', *settings], seed=seed)
    world, found = scenario.load_world(), {name: [] for name in DIRECTIONS_DEG}
    orb = cv2.ORB_create(5000)
    with scenario.renderer(world) as renderer:
        for _, name, then, now in views(scenario, world, args):
            before = renderer.render(then, 0, ('left',)).picture('left')
            frame = renderer.render(now, 1, ('left', 'optical_flow', 'depth'), then)
            error, depth = klt_errors(frame, frame.picture('left'), before)
            features = len(orb.detect(frame.picture('left')))
            rows = []
            for near, far in BANDS_M:
                own = error[(depth > near) & (depth < far)]
                good = own[own < WILD_PX]
                rows.append((len(good), 1.0 - len(good) / max(len(own), 1),
                             np.median(good) if len(good) else np.nan, features))
            found[name].append(np.array(rows))
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--set', nargs='+', default=['render_node.detail.relief_by_view=true'])
    parser.add_argument('--scenario', default='baseline')
    parser.add_argument('--elevation', type=float, default=6.0)
    parser.add_argument('--seeds', type=int, nargs='+', default=[1, 2, 3])
    parser.add_argument('--step', type=float, default=0.03)
    parser.add_argument('--pitch', type=float, default=1.0)
    args = parser.parse_args()
    both = [[measured(settings, seed, args) for seed in args.seeds] for settings in ([], args.set)]
    cells, p = [], []
    for name in DIRECTIONS_DEG:
        first, second = (np.array([view for world in state for view in world[name]])
                         for state in both)
        for k, (near, far) in enumerate(BANDS_M):
            one, other = first[:, k], second[:, k]
            some = np.isfinite(one[:, 2]) & np.isfinite(other[:, 2])
            p.append(signed_rank_p(other[some, 2] - one[some, 2]))
            middle = [np.median(values[some], axis=0) for values in (one, other)]
            cells.append([name, f'{near:g} to {far:g} m', str(some.sum()), *(
                ', '.join(form.format(value[column]) for value in middle)
                for column, form in enumerate(('{:.0f}', '{:.0%}', '{:.3f}', '{:.0f}')))])
    print('| direction to the sun | distance | views | corners | lost | error [px] '
          '| ORB features | q of the error |')
    print('|---' * 8 + '|')
    for row, q in zip(cells, adjusted(p)):
        print(f'| {" | ".join(row)} | {q:.2g} |')


if __name__ == '__main__':
    main()
