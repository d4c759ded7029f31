"""Radiance and share of shadow by distance, against images of 4 x 4 times the pixels.

    python test/benchmarks/bench_resolution.py [--scenarios flat baseline] [--elevations 2 6 15]
        [--width 640] [--times 4] [--samples 1] [--directions towards across away] [--places 3]

Prints a table in Markdown; asserts nothing. Each row is a scenario, an elevation of the sun and a
direction of the view from it, over several places. Bands that hold no ground are left empty.

With samples (`detail.supersampling`) the finer images have them, too: `--times 2 --samples 2` has
the same finer images as `--times 4`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from brightness import DIRECTIONS_DEG, views  # noqa: E402
from resolution import against_finer, finer_camera  # noqa: E402

from lunar_rover_sim.run.scenario import Scenario  # noqa: E402

EDGES_M = (0.4, 0.7, 1.2, 2.0, 3.5, 7.0, 20.0)


def renderer_of(name, width, samples):
    """Return a renderer of a scenario."""
    return Scenario.load(name, [
        f'render_node.camera.width={width}', f'render_node.camera.height={width * 3 // 4}',
        f'render_node.detail.supersampling={samples}']).renderer()


def cells(values, digits):
    """Return the cells of a row of a table."""
    return ' | '.join('' if np.isnan(value) else f'{value:{digits}}' for value in values)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--scenarios', nargs='+', default=('flat', 'baseline', 'feature_sparse'))
    parser.add_argument('--elevations', nargs='+', type=float, default=(2.0, 6.0, 15.0))
    parser.add_argument('--width', type=int, default=640, help='of the coarser image [px]')
    parser.add_argument('--times', type=int, default=4, help='pixels along a side for one')
    parser.add_argument('--samples', type=int, default=1, help='along a side of a pixel')
    parser.add_argument('--directions', nargs='+', default=tuple(DIRECTIONS_DEG),
                        choices=tuple(DIRECTIONS_DEG))
    parser.add_argument('--places', type=int, default=3)
    args = parser.parse_args()
    bands = [f'{a:g} to {b:g} m' for a, b in zip(EDGES_M, EDGES_M[1:])]
    print('| scenario | sun | view | ' + ' | '.join(bands) + ' | ' + ' | '.join(bands) + ' |')
    print('|---' * (3 + 2 * len(bands)) + '|')
    for name in args.scenarios:
        with renderer_of(name, args.width, args.samples) as renderer:
            finer = finer_camera(renderer, args.times)
            for elevation in args.elevations:
                renderer.set_sun(renderer.config.sun.azimuth_deg, elevation)
                for direction in args.directions:
                    curve = against_finer(renderer, finer,
                                          views(renderer, direction, args.places), EDGES_M)
                    print(f'| {name} | {elevation:g}° | {direction} | {cells(curve.ratio, ".2f")}'
                          f' | {cells(100 * curve.shadow_difference, "+.1f")} |', flush=True)


if __name__ == '__main__':
    main()
