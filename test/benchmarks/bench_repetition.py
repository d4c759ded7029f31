"""Whether relief repeats: ORB inliers of distant views of one world, and of two worlds.

    python test/benchmarks/bench_repetition.py [--scenarios flat feature_sparse] [--pairs 200]
        [--most 50] [--depth 1.5]

Each pair of views stands 1 to 50 m apart, the logarithms of the distances evenly spread, in any
direction, under one sun and with one heading, as a repetition would show best. Only ground nearer
than `--depth` counts, or than the distance between views that stand closer: none of it is in both.
The rover's shadow does not count, and the sensor has no fixed pattern: they are in all images.
A third view has the place of the second in a world of another seed. Prints a table in Markdown:
inliers of one homography, of the same world and of two, their mean difference with its 95 %
interval (bootstrap over pairs), p of Wilcoxon's signed-rank test for more inliers in the same
world, and for comparison the inliers of two views 0.1 m apart.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

import cv2
import numpy as np
from scipy import stats

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from repetition import features, inliers  # noqa: E402

from lunar_rover_sim.image.rendering.snapshot import settle, standing  # noqa: E402
from lunar_rover_sim.rover.pose import RoverPose  # noqa: E402
from lunar_rover_sim.run.scenario import Scenario  # noqa: E402

_LEAST_M = 1.0
_NEAREST_M = 0.25       # no ground in the image is nearer
_WORLDS = (1, 2)        # seeds
# The fixed pattern of a sensor is the same in all its images, whatever they show.
_NO_PATTERN = ['render_node.sensor.fixed_pattern=false']


def seen(x, y, yaw, depth_m, tangent):
    """Return the corners of the level ground that a view shows nearer than a depth, (4, 2)."""
    ahead, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    return np.array([np.array([x, y]) + d * ahead + s * d * tangent * left
                     for d, s in ((_NEAREST_M, -1), (depth_m, -1), (depth_m, 1), (_NEAREST_M, 1))],
                    np.float32)


def places(count, half_m, most_m, depth_m, tangent, rng):
    """Return two places x, y, yaw and a depth [m] for each pair; ground up to it is in one only.
    """
    result = []
    while len(result) < count:
        # A new place until both lie in the world, with the same distance: all occur as often.
        away = _LEAST_M * (most_m / _LEAST_M)**((len(result) + 0.5) / count)
        depth = min(depth_m, _NEAREST_M + 0.8 * away)
        x, y = rng.uniform(-half_m, half_m, 2)
        angle, yaw = rng.uniform(-np.pi, np.pi, 2)
        other = np.array([x + away * np.cos(angle), y + away * np.sin(angle)])
        if np.abs(other).max() > half_m:
            continue
        area = cv2.intersectConvexConvex(seen(x, y, yaw, depth, tangent),
                                         seen(*other, yaw, depth, tangent))[0]
        if area == 0.0:
            result.append((np.array([x, y, yaw]), np.array([*other, yaw]), depth))
    return result


def view(renderer, place, number, depth_m):
    """Return the features of the ground nearer than a depth in the left image of a place.

    Not those of the rover's shadow: it is where it was in all images with one heading.
    """
    state = RoverPose(standing(renderer.world, *place[:2], float(np.degrees(place[2]))))
    settle(renderer, state)
    frame = renderer.render(state, number, ('left', 'depth', 'shadow'))
    rover = cv2.dilate((frame.shadow[..., 1] > 0).astype(np.uint8), np.ones((25, 25)))
    return features(frame.left, (frame.depth_m < depth_m) & (rover == 0))


def row(name, count, most_m, depth_m):
    """Return the cells of the table for a scenario."""
    one, two = (scenario.renderer(scenario.load_world()) for scenario in
                (Scenario.load(name, _NO_PATTERN, seed=seed) for seed in _WORLDS))
    with one, two:
        tangent = 0.5 * one.rig.width / one.rig.focal_px
        half_m = one.world.ground.half_extent_m - 2.0
        rng = np.random.default_rng(1)
        same, other, near, points = [], [], [], []
        for k, (a, b, depth) in enumerate(places(count, half_m, most_m, depth_m, tangent, rng)):
            first = view(one, a, 2 * k, depth)
            points.append(len(first[0]))
            same.append(inliers(first, view(one, b, 2 * k + 1, depth)))
            other.append(inliers(first, view(two, b, 2 * k + 1, depth)))
            if k < 10:
                beside = a + [0.1 * np.cos(a[2]), 0.1 * np.sin(a[2]), 0.0]
                near.append(inliers(first, view(one, beside, 2 * k + 1, depth)))
    same, other = np.array(same), np.array(other)
    difference = same - other
    means = difference[rng.integers(0, count, (4000, count))].mean(axis=1)
    p = stats.wilcoxon(same, other, alternative='greater').pvalue if np.any(difference) else 1.0
    return (name, f'{count}', f'{np.median(points):.0f}', f'{same.mean():.2f}',
            f'{other.mean():.2f}', f'{difference.mean():+.2f} '
            f'[{np.percentile(means, 2.5):+.2f}, {np.percentile(means, 97.5):+.2f}]', f'{p:.2f}',
            f'{np.percentile(same, 99):.0f}, {same.max()}',
            f'{np.percentile(other, 99):.0f}, {other.max()}', f'{np.median(near):.0f}')


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--scenarios', nargs='+', default=('flat', 'feature_sparse'))
    parser.add_argument('--pairs', type=int, default=200)
    parser.add_argument('--most', type=float, default=50.0, help='largest distance [m]')
    parser.add_argument('--depth', type=float, default=1.5, help='of ground that counts [m]')
    args = parser.parse_args()
    titles = ('scenario', 'pairs', 'key points', 'same world', 'two worlds', 'difference', 'p',
              'same: 99 %, most', 'two: 99 %, most', '0.1 m apart')
    print('| ' + ' | '.join(titles) + ' |')
    print('|---' * len(titles) + '|')
    for name in args.scenarios:
        print('| ' + ' | '.join(row(name, args.pairs, args.most, args.depth)) + ' |', flush=True)


if __name__ == '__main__':
    main()
