"""How much still ground changes from frame to frame of a walk, beside images of 4 x 4 samples.

    python test/benchmarks/bench_temporal.py [--scenario baseline] [--frames 200] [--samples 1 4]

Points of the ground of the first left image are looked up in all that follow, 0.01 s apart, where
nothing hides them: radiance, before lens and sensor. It prints, by their distance in the first
image and the samples along a side of a pixel, the RMS of the change of a point and the greatest
change of the mean of all points, both over that mean. It asserts nothing.
"""

from __future__ import annotations

import argparse
import itertools

from bench_render import walk
import cv2
import numpy as np

from lunar_rover_sim.run.scenario import Scenario

EDGES_M = (0.5, 0.8, 1.3, 2.5, 5.0, 12.0)
MOST_POINTS = 4000      # of a band
_HIDDEN = 0.03          # of the distance, by which what hides a point is nearer


def points_of(depth_m, K, T_world_camera):
    """Return (n, 3) points of the ground of an image, world frame, for each band."""
    rows, columns = np.nonzero(np.isfinite(depth_m) & (depth_m > 0.0))
    far = depth_m[rows, columns]
    optical = np.stack([(columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1],
                        np.ones(len(far))], axis=-1) * far[:, None]
    points = optical @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
    bands = [points[(far >= low) & (far < high)] for low, high in itertools.pairwise(EDGES_M)]
    return [band[::max(1, len(band) // MOST_POINTS)] for band in bands]


def seen(image, depth_m, points, K, T_world_camera):
    """Return (n,) radiance of points in an image, NaN where they are hidden or outside of it."""
    optical = (points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    places = (optical @ K.T)[:, :2] / optical[:, 2:]
    maps = [np.ascontiguousarray(places[None, :, axis], np.float32) for axis in range(2)]
    outside = {'borderMode': cv2.BORDER_CONSTANT, 'borderValue': float('nan')}
    light = cv2.remap(image, *maps, cv2.INTER_LINEAR, **outside)[0]
    depth = cv2.remap(depth_m, *maps, cv2.INTER_NEAREST, **outside)[0]
    return np.where(np.abs(depth - optical[:, 2]) < _HIDDEN * optical[:, 2], light, np.nan)


def changes(scenario, states, samples):
    """Return (bands, 2) RMS change of points and greatest change of their mean, over that."""
    found = []
    with Scenario.load(scenario, (f'render_node.detail.supersampling={samples}',
                                  )).renderer() as renderer:
        rig, points = renderer.rig, []
        for number, state in enumerate(states):
            frame = renderer.render(state, number, ('radiance', 'depth'))
            pose = state.T_world_base @ rig.T_base_left
            points = points or points_of(frame.depth_m, rig.K, pose)
            found.append([seen(frame.radiance, frame.depth_m.astype(np.float32), band, rig.K, pose)
                          for band in points])
    result = []
    for light in (np.array(band, float) for band in zip(*found)):
        mean = np.nanmean(light)
        result.append((np.sqrt(np.nanmean(np.diff(light, axis=0)**2)) / mean,
                       np.abs(np.diff(np.nanmean(light, axis=1))).max() / mean))
    return np.array(result)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--scenario', default='baseline')
    parser.add_argument('--frames', type=int, default=200)
    parser.add_argument('--samples', type=int, nargs='+', default=[1, 4])
    args = parser.parse_args()
    states = walk(Scenario.load(args.scenario), args.frames, 0.01)
    bands = [f'{a:g} to {b:g} m' for a, b in itertools.pairwise(EDGES_M)]
    print(f'| change | samples | {" | ".join(bands)} |\n|---|---|{"---|" * len(bands)}')
    table = {samples: changes(args.scenario, states, samples) for samples in args.samples}
    for k, what in enumerate(('of a point', 'of the mean')):
        for samples, values in table.items():
            print(f'| {what} | {samples} × {samples} | '
                  + ' | '.join(f'{value:.3f}' for value in values[:, k]) + ' |')


if __name__ == '__main__':
    main()
