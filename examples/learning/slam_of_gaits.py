"""What a gait does to visual odometry: walkers over the worlds of the learning study, with images.

    python examples/learning/slam_of_gaits.py slam.csv packaged smooth feedback --seeds 10
        [--slam "~/orbslam3/bin/python {wheel} lunar_voc.txt {settings} stereo"]

Each walks 5 s at 0.12 m/s on `highland`; images of 320 x 240 px at 20 Hz, drawn as render_node
draws them, go to the reference odometry, or to a program that speaks the protocol of
docs/reference/slam_protocol.md. Drives that the CSV has are not made again. It prints medians, and
the paired test of each walker against the first.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
from pathlib import Path
import sys

import numpy as np

from lunar_rover_sim import evaluate, Renderer, Simulation, Trajectory
from lunar_rover_sim.autonomy.learning.senses import Sample
from lunar_rover_sim.autonomy.learning.task import physics_of, STATE_HZ, terrain
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.judge.evaluation.statistics import Comparison, Median
from lunar_rover_sim.judge.slam.program import Tracker
from lunar_rover_sim.judge.slam.protocol import FrameSet, TRACKING
from lunar_rover_sim.judge.studies.learning import answer_of, Case, HIDDEN_SEEDS
from lunar_rover_sim.products.sequences.sensors import described_sensors
from lunar_rover_sim.rover.rover_file import load_rover
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoise

GROUND, DURATION_S, FRAME_HZ, SIZE_PX = 'highland', 5.0, 20, (320, 240)
REFERENCE = f'{sys.executable} -m lunar_rover_sim.judge.slam.client'
FIELDS = 'walker', 'seed', 'frames', 'tracked', 'ate_percent', 'rpe_mm'


def drive(walker: str, seed: int, slam: str) -> tuple[int, float, float, float]:
    """Return frames, share of them that is located, and two errors; inf if lost.

    The errors are the RMS error of positions [% of the way], and that of motions over 1 s [mm].
    """
    rover, world = load_rover(), terrain(seed, 12.8, False)
    config = RenderConfig()
    config = dataclasses.replace(config, camera=dataclasses.replace(
        config.camera, width=SIZE_PX[0], height=SIZE_PX[1]))
    answer = answer_of(Case(walker, GROUND, 0.0, seed), rover)
    noise = ImuNoise(ImuConfig(), STATE_HZ, np.random.default_rng(seed))
    suite = described_sensors(rover, config.camera, ImuConfig(), FRAME_HZ, STATE_HZ,
                              physics_of(GROUND).gravity_mps2)
    states, frames = [], 0
    with Simulation(world, rover, physics_of(GROUND)) as simulation, \
            Renderer(world, rover, config, seed) as renderer, \
            Tracker(slam, suite, 'stereo', 60.0, 60.0) as tracker:
        renderer.follow(simulation.overlay)
        stamps, poses, state = [], [], simulation.state
        steps = 1_000_000_000 // STATE_HZ // simulation.config.step_ns
        for k in range(1, round(DURATION_S * STATE_HZ) + 1):
            simulation.command(answer(Sample.of(state, noise)).velocity_radps)
            state = simulation.advance(steps)
            states.append(state)
            if k % (STATE_HZ // FRAME_HZ) == 0:
                frame = renderer.render(state, frames, ('left', 'right'))
                pose = tracker.track(FrameSet(state.stamp_ns, (frame.left, frame.right)))
                if pose.state == TRACKING:
                    stamps.append(state.stamp_ns)
                    poses.append((*pose.position_m, *pose.wxyz))
                frames += 1
    if len(stamps) < 3:
        return frames, len(stamps) / frames, np.inf, np.inf
    truth, found = Trajectory.of_states(states), np.array(poses)
    estimate = Trajectory(np.array(stamps), found[:, :3], found[:, 3:])
    judged = evaluate(truth, estimate, estimate_frame='left')
    return (frames, len(estimate) / frames, 100.0 * judged.ate_m.rmse / truth.length_m,
            1e3 * judged.rpe_time_m.rmse)


def main() -> None:
    """Drive what is missing, and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('table', type=Path)
    parser.add_argument('walkers', nargs='+', help='packaged, or policies')
    parser.add_argument('--seeds', type=int, default=10)
    parser.add_argument('--slam', default=REFERENCE, help='program; default: the reference')
    args = parser.parse_args()
    found = {}
    if args.table.exists():
        with args.table.open(encoding='utf-8', newline='') as file:
            found = {(row['walker'], int(row['seed'])): row for row in csv.DictReader(file)}
    else:
        args.table.write_text(','.join(FIELDS) + '\n', 'utf-8')
    for seed in HIDDEN_SEEDS[:args.seeds]:
        for walker in args.walkers:
            name = Path(walker).stem
            if (name, seed) in found:
                continue
            row = dict(zip(FIELDS, (name, seed, *(f'{v:.6g}' for v in drive(
                walker, seed, args.slam)))))
            found[name, seed] = row
            with args.table.open('a', encoding='utf-8', newline='') as file:
                csv.DictWriter(file, FIELDS).writerow(row)
            print(', '.join(f'{key} {value}' for key, value in row.items()), flush=True)
    for column in FIELDS[-2:]:
        columns = [[float(found[Path(walker).stem, seed][column])
                    for seed in HIDDEN_SEEDS[:args.seeds]] for walker in args.walkers]
        for walker, values in zip(args.walkers, columns):
            words = '' if values is columns[0] else (
                f'; {Comparison.of(values, columns[0]).text()}')
            print(f'{column} {Path(walker).stem}: {Median.of(values).text(3)}{words}')


if __name__ == '__main__':
    main()
