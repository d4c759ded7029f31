"""Error of tracked points by samples a pixel: what of it is the renderer's.

    python test/benchmarks/bench_sampling.py -o FILE.csv [--scenario baseline] [--elevation 10]
        [--seeds 1 2] [--samples 1 2 4] [--step 0.03] [--pitch 1.0]

Corners of an image are tracked (Lucas and Kanade, pyramidal, 15 px) into the image of a rover that
is a step farther and pitched, and compared with the true optical flow. A row of the file is a
view: seed, direction, samples, band of distance, number of points, median and 90th percentile of
the error [px]; rows are written as they come, and a run that is started again goes on. The table
in Markdown gives medians of the views. It asserts nothing.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import csv
import dataclasses
from pathlib import Path
import sys

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from brightness import DIRECTIONS_DEG  # noqa: E402

from lunar_rover_sim.base.frames import matrix_from_wxyz, se3, wxyz_from_rpy  # noqa: E402
from lunar_rover_sim.ground.world.model import World  # noqa: E402
from lunar_rover_sim.image.camera.config import FurtherCameraConfig  # noqa: E402
from lunar_rover_sim.image.camera.mount import BodyMount  # noqa: E402
from lunar_rover_sim.image.rendering.frame import StereoFrame  # noqa: E402
from lunar_rover_sim.image.rendering.renderer import FurtherCamera  # noqa: E402
from lunar_rover_sim.image.rendering.snapshot import standing  # noqa: E402
from lunar_rover_sim.rover.pose import RoverPose  # noqa: E402
from lunar_rover_sim.run.scenario import Scenario  # noqa: E402

BANDS_M = (1.0, 2.0), (1.5, 4.0), (2.0, 4.0), (8.0, 20.0)
_PLACES_M = (1.5, -1.0), (-2.0, 2.5)
_LK = {'winSize': (15, 15), 'maxLevel': 3,
       'criteria': (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)}
WILD_PX = 3.0          # beyond it a point is lost, not displaced
_HEAD = ('seed', 'place', 'direction', 'samples', 'near_m', 'far_m', 'points', 'median_px',
         'p90_px', 'lost')


def klt_errors(truth: StereoFrame, now: np.ndarray,
               before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Track corners of an image into the one before it.

    Returns:
        Errors against the true flow [px], and depths [m], of those that are found and have a flow.
    """
    assert truth.optical_flow is not None and truth.depth_m is not None
    corners = cv2.goodFeaturesToTrack(now, 2000, 0.005, 5)[:, 0]
    there, found, _ = cv2.calcOpticalFlowPyrLK(now, before, corners[:, None], None, **_LK)
    column, row = np.rint(corners).astype(int).T
    flow = truth.optical_flow[row, column]
    usable = (found[:, 0] == 1) & np.isfinite(flow).all(axis=1)
    error = np.linalg.norm(there[:, 0] - corners - flow, axis=1)
    return error[usable], truth.depth_m[row, column][usable]


def measure(truth: StereoFrame, now: np.ndarray, before: np.ndarray) -> list[tuple[object, ...]]:
    """Return the columns from `near_m` on of one view, a row for each band."""
    error, depth = klt_errors(truth, now, before)
    rows: list[tuple[object, ...]] = []
    for near, far in BANDS_M:
        chosen = error[(depth > near) & (depth < far)]
        kept = chosen[chosen < WILD_PX]
        if len(kept):
            rows.append((near, far, len(kept), round(float(np.median(kept)), 4),
                         round(float(np.percentile(kept, 90)), 4), len(chosen) - len(kept)))
    return rows


def views(scenario: Scenario, world: World,
          args: argparse.Namespace) -> Iterator[tuple[int, str, RoverPose, RoverPose]]:
    """Yield place, direction, and the states before and after a step."""
    pitch = matrix_from_wxyz(wxyz_from_rpy(0.0, np.radians(args.pitch), 0.0))
    for place, (x, y) in enumerate(_PLACES_M):
        for name, turn_deg in DIRECTIONS_DEG.items():
            start = standing(world, x, y, scenario.render_node.sun.azimuth_deg + turn_deg)
            yield (place, name, RoverPose(start),
                   RoverPose(start @ se3(pitch, (args.step, 0.0, 0.0))))


def rows_of(scenario: Scenario, seed: int, args: argparse.Namespace,
            done: set[tuple[str, ...]]) -> None:
    """Append what is missing of a world to the file."""
    node = scenario.render_node
    own = FurtherCameraConfig(node.camera, node.lens, dataclasses.replace(
        node.sensor, exposure_mode='sunlit'))
    world = scenario.load_world()
    with scenario.renderer(world) as renderer:
        mount = BodyMount(renderer.rig)
        cameras: dict[int, FurtherCamera] = {
            samples: renderer.add_camera(own, mount, seed, samples) for samples in args.samples}
        for place, name, then, now in views(scenario, world, args):
            truth = None
            for samples, camera in cameras.items():
                key = (str(seed), str(place), name, str(samples))
                if key in done:
                    continue
                if truth is None:
                    truth = renderer.render(now, 1, ('optical_flow', 'depth'), then)
                left = [camera.render(state, k).left for k, state in enumerate((then, now))]
                with args.output.open('a', newline='') as file:
                    csv.writer(file).writerows(
                        (*key, *row) for row in measure(truth, left[1], left[0]))


def table(path: Path) -> str:
    """Return the table of a file."""
    with path.open(newline='') as file:
        rows = list(csv.DictReader(file))
    lines = ['| distance, direction to the sun | views, points each | '
             + ' | '.join(f'{n} × {n}' for n in sorted({int(r['samples']) for r in rows})) + ' |']
    lines.append('|' + '---|' * (lines[0].count('|') - 1))
    for near, far in BANDS_M:
        for name in DIRECTIONS_DEG:
            cells = []
            for samples in sorted({int(r['samples']) for r in rows}):
                of = [r for r in rows if r['direction'] == name and int(r['samples']) == samples
                      and float(r['near_m']) == near and float(r['far_m']) == far]
                values = [float(r['median_px']) for r in of]
                cells.append(f'{np.median(values):.3f}' if values else '–')
            points = int(np.median([int(r['points']) for r in of])) if of else 0
            lines.append(f'| {near:g} to {far:g} m, {name} | {len(of)}, {points} | '
                         + ' | '.join(cells) + ' |')
    return '\n'.join(lines)


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('-o', '--output', type=Path, required=True)
    parser.add_argument('--scenario', default='baseline')
    parser.add_argument('--elevation', type=float, default=10.0)
    parser.add_argument('--seeds', type=int, nargs='+', default=[1, 2])
    parser.add_argument('--samples', type=int, nargs='+', default=[1, 2, 4])
    parser.add_argument('--step', type=float, default=0.03)
    parser.add_argument('--pitch', type=float, default=1.0)
    args = parser.parse_args()
    if not args.output.exists():
        args.output.write_text(','.join(_HEAD) + '\n')
    with args.output.open(newline='') as file:
        done = {tuple(row[name] for name in _HEAD[:4]) for row in csv.DictReader(file)}
    for seed in args.seeds:
        rows_of(Scenario.load(args.scenario, [
            f'render_node.sun.elevation_deg={args.elevation}'], seed=seed), seed, args, done)
    print(table(args.output))


if __name__ == '__main__':
    main()
