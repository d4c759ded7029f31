"""Radiance and share of shadow by distance, against images of 4 x 4 times the pixels.

    python test/benchmarks/bench_resolution.py [--scenarios flat baseline] [--elevations 2 6 15]
        [--width 640] [--times 4] [--samples 1] [--directions towards across away] [--places 3]

Prints a table in Markdown; asserts nothing. Each row is a scenario and an elevation of the sun:
the range over directions of the view from it, with several places each, and over bands of
distance, of the mean over that of the finer image, and of the share of dark pixels less that of
it, in points.

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
NEAR = 4                # bands to 3.5 m


def renderer_of(name, width, samples):
    """Return a renderer of a scenario."""
    return Scenario.load(name, [
        f'render_node.camera.width={width}', f'render_node.camera.height={width * 3 // 4}',
        f'render_node.detail.supersampling={samples}']).renderer()


def cells(values, digits):
    """Return the cells of values (directions, bands): their ranges in near and in far bands."""
    return ' | '.join(
        f'{np.nanmin(part):{digits}} to {np.nanmax(part):{digits}}'
        if np.isfinite(part).any() else 'all dark'
        for part in (values[:, :NEAR], values[:, NEAR:]))


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
    print(f'| scenario | sun | mean over finer, to {EDGES_M[NEAR]:g} m | beyond '
          '| dark share less finer, near | beyond |')
    print('|---' * 6 + '|')
    for name in args.scenarios:
        with renderer_of(name, args.width, args.samples) as renderer:
            finer = finer_camera(renderer, args.times)
            for elevation in args.elevations:
                renderer.set_sun(renderer.config.sun.azimuth_deg, elevation)
                curves = [against_finer(renderer, finer, views(renderer, direction, args.places),
                                        EDGES_M) for direction in args.directions]
                ratios = np.array([curve.ratio for curve in curves])
                shares = np.array([100 * curve.shadow_difference for curve in curves])
                print(f'| {name} | {elevation:g}° | {cells(ratios, ".2f")} '
                      f'| {cells(shares, "+.1f")} |', flush=True)


if __name__ == '__main__':
    main()
