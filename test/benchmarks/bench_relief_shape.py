"""What relief below the grid costs stereo and tracking where it has shape, over paired drives.

    python test/benchmarks/bench_relief_shape.py -o FILE.csv [--seeds 1 2 3 4 5 6] [--shape 2.5]
        [--samples 2]

A drive is 5 s at 0.12 m/s on `baseline`, in a world and a direction of its own (10 pairs of
640 x 480 px). Each state is drawn twice, with `detail.relief_shape_m` of 0 and of `--shape`, by
turns first; depth, truth and what is tracked are each picture's own. Pairs are matched, and
corners of the left image are tracked into the one before it. A row of the file is a drive; rows
are written as they come, and a run that is started again goes on. It prints means, the mean of the
paired differences with its 95 % interval, and q: p of Wilcoxon's test, corrected for the number of
tests (Benjamini and Hochberg), in Markdown; it asserts nothing.
"""

from __future__ import annotations

import argparse
from contextlib import ExitStack
import csv
from pathlib import Path

from bench_sampling import klt_errors, WILD_PX
import numpy as np
from scipy import stats

from lunar_rover_sim.image.stereo.depth import disparity_from_depth
from lunar_rover_sim.image.stereo.error import stereo_errors, StereoErrors
from lunar_rover_sim.judge.evaluation.statistics import adjusted, signed_rank_p
from lunar_rover_sim.run.scenario import Scenario

DURATION_S, STATE_HZ, FRAME_HZ, JUDGED = 5.0, 200, 20, 10
NEAR_M = 2.0            # up to here all of the relief has shape
MEASURES = {
    'bad_1': 'SGM to 2 m: bad-1 [%]', 'density': 'SGM to 2 m: density on lit ground [%]',
    'median_px': 'SGM to 2 m: median signed error [px]', 'all_bad_1': 'SGM: bad-1 [%]',
    'all_density': 'SGM: density on lit ground [%]', 'klt_px': 'KLT to 2 m: median error [px]',
    'klt_lost': 'KLT to 2 m: wrong by more than 3 px [%]'}


class Picture:
    """Pairs of one kind of relief, and what stereo and KLT make of them."""

    def __init__(self, scenario, world, simulation, owned):
        """Make its renderer, which follows the tracks of the simulation."""
        self.renderer = owned.enter_context(scenario.renderer(world))
        self.renderer.follow(simulation.overlay)
        self.matcher = scenario.matcher()
        self.errors = {'': StereoErrors(), 'all_': StereoErrors()}
        self.drawn, self.last, self.points_px = 0, None, []

    def draw(self, state, before):
        """Draw a state; judge it if one before it is given."""
        frame = self.renderer.render(state, self.drawn, ('left', 'right'))
        if before is not None:
            truth = self.renderer.render(state, 0, ('depth', 'optical_flow'), before)
            self._match(frame, truth.depth_m)
            error_px, depth_m = klt_errors(truth, frame.left, self.last)
            self.points_px.append(error_px[depth_m < NEAR_M])
        self.drawn, self.last = self.drawn + 1, frame.left

    def _match(self, frame, depth_m):
        found, rig = self.matcher.match(frame.left, frame.right), self.renderer.rig
        for name, far_m in (('', NEAR_M), ('all_', np.inf)):
            there = np.where(depth_m < far_m, depth_m, np.inf)
            self.errors[name] += stereo_errors(found, disparity_from_depth(
                there, rig.focal_px, rig.baseline_m), None, frame.left)

    def measures(self):
        """Return the errors so far, by name."""
        points = np.concatenate(self.points_px)
        result = {'klt_px': np.median(points[points < WILD_PX]),
                  'klt_lost': 100.0 * np.mean(points >= WILD_PX)}
        for name, errors in self.errors.items():
            found = errors.summary()
            result |= {f'{name}bad_1': 100.0 * found['bad-1'],
                       f'{name}density': 100.0 * found['density on lit ground']}
        return result | {'median_px': self.errors[''].median_px}


def drive(seed, shapes_m, samples):
    """Return the measures of a drive by each kind of relief."""
    with ExitStack() as owned:
        options = ('render_node.camera.width=640', 'render_node.camera.height=480',
                   f'physics_node.start.yaw_deg={60 * seed}',
                   f'render_node.detail.supersampling={samples}')
        scenarios = [Scenario.load('baseline', (
            *options, f'render_node.detail.relief_shape_m={m}'), seed=seed) for m in shapes_m]
        plain, world = scenarios[0], scenarios[0].load_world()
        simulation = owned.enter_context(plain.simulation(world))
        pictures = [Picture(scenario, world, simulation, owned) for scenario in scenarios]
        gait = plain.gait_controller()
        gait.set_velocity(0.12, 0.0)
        state, before = simulation.state, None
        for k in range(1, round(DURATION_S * STATE_HZ) + 1):
            legs = gait.update(state.stamp_ns, state.joint_angle_rad, state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            state = simulation.advance(1000 // STATE_HZ)
            number, rest = divmod(k, STATE_HZ // FRAME_HZ)
            if rest == 0 and number % JUDGED in (0, JUDGED - 1):
                for picture in pictures[::1 if number % 2 else -1]:
                    picture.draw(state, before if number % JUDGED == 0 else None)
                before = state
    return [picture.measures() for picture in pictures]


def main() -> None:
    """Drive what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('-o', '--output', type=Path, required=True)
    parser.add_argument('--seeds', type=int, nargs='+', default=list(range(1, 7)))
    parser.add_argument('--shape', type=float, default=2.5)
    parser.add_argument('--samples', type=int, default=2, help='along a side of a pixel')
    args = parser.parse_args()
    head = ('seed', 'samples', 'shape_m', *MEASURES)
    if not args.output.exists():
        args.output.write_text(','.join(head) + '\n', 'utf-8')
    with args.output.open(encoding='utf-8', newline='') as file:
        done = {(int(row['seed']), int(row['samples'])) for row in csv.DictReader(file)}
    for seed in args.seeds:
        if (seed, args.samples) not in done:
            shapes = (0.0, args.shape)
            results = drive(seed, shapes, args.samples)
            with args.output.open('a', encoding='utf-8', newline='') as file:
                for shape, result in zip(shapes, results):
                    csv.DictWriter(file, head).writerow({
                        'seed': seed, 'samples': args.samples, 'shape_m': shape,
                        **{name: f'{value:.5g}' for name, value in result.items()}})
    with args.output.open(encoding='utf-8', newline='') as file:
        rows = [row for row in csv.DictReader(file) if int(row['samples']) == args.samples]
    lines, p = [], []
    for name, words in MEASURES.items():
        light, shape = (np.array([float(row[name]) for row in rows
                                  if (float(row['shape_m']) > 0.0) == kind])
                        for kind in (False, True))
        change = shape - light
        low, high = stats.t.interval(0.95, len(change) - 1, change.mean(), stats.sem(change))
        lines.append(f'| {words} | {light.mean():.3g} | {shape.mean():.3g} | {change.mean():+.2g} '
                     f'[{low:+.2g}, {high:+.2g}] |')
        p.append(signed_rank_p(change))
    print('| | light only | shape | difference | q |\n|---|---|---|---|---|')
    for line, q in zip(lines, adjusted(p)):
        print(f'{line} {q:.2g} |')


if __name__ == '__main__':
    main()
