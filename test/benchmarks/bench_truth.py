"""CPU of frames with layers of truth, over that of the same frame without, and over another clone.

    python test/benchmarks/bench_truth.py [--against CLONE] [--rounds 4] [--scenario baseline]

Each frame is a stereo pair of 640 x 480 with true depth, from 12 poses on a circle. Kinds of
frames and clones take turns, frame by frame, since a machine that is busy with other things
changes its speed within seconds. Prints medians of ratios with 95 % intervals by a bootstrap;
asserts nothing. On average is at the default rates, where every second frame has truth.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import subprocess
import sys
import time

import numpy as np

from lunar_rover_sim.image.rendering.frame import FLOWS, RIGHT_TRUTH
from lunar_rover_sim.image.rendering.snapshot import standing
from lunar_rover_sim.judge.evaluation.statistics import Median
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

POSES = 12
PAIR = ('left', 'right', 'depth')
LEFT = (*PAIR, 'label', 'crater', 'shadow', 'normal', *FLOWS)
KINDS = {'pair and depth': PAIR, 'left truth and flows': LEFT,
         'all truth of both and flows': (*LEFT, *RIGHT_TRUTH)}


def serve(scenario):
    """Draw what lines of stdin ask for, kind and pose; print ms of CPU for each."""
    with Scenario.load(scenario).renderer() as renderer:
        def state(k, ahead_rad=0.0):
            angle = 2.0 * np.pi * k / POSES + ahead_rad
            return RoverPose(standing(renderer.world, 3.0 * np.sin(angle),
                                      3.0 - 3.0 * np.cos(angle), float(np.degrees(angle))),
                             np.full(4, 0.1 * k + 5.0 * ahead_rad))

        def draw(kind, k):
            return renderer.render(state(k), k, list(KINDS.values())[kind], state(k, 0.01))
        for kind in range(len(KINDS)):      # programs are compiled
            draw(kind, 0)
            draw(kind, POSES // 2)
        print('ready', flush=True)
        for line in sys.stdin:
            kind, k = map(int, line.split())
            start = time.process_time()
            draw(kind, k)
            print(1e3 * (time.process_time() - start), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--against', type=Path, help='folder of another clone, the one before')
    parser.add_argument('--rounds', type=int, default=4)
    parser.add_argument('--scenario', default='baseline')
    parser.add_argument('--serve', action='store_true', help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.serve:
        serve(args.scenario)
        return
    here = Path(__file__).resolve().parents[2]
    clones = [here] if args.against is None else [args.against.resolve(), here]
    workers = []
    for clone in clones:
        workers.append(subprocess.Popen(
            [sys.executable, __file__, '--serve', '--scenario', args.scenario], text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env={**os.environ, 'PYTHONPATH': str(clone)}))
        if workers[-1].stdout.readline().strip() != 'ready':
            raise SystemExit(f'{clone} draws nothing')
    ms = np.zeros((len(clones), len(KINDS), args.rounds, POSES))
    for r in range(args.rounds):
        for k in range(POSES):
            for kind in range(len(KINDS)):
                for i in sorted(range(len(clones)), reverse=bool((r + k) % 2)):
                    workers[i].stdin.write(f'{kind} {k}\n')
                    workers[i].stdin.flush()
                    ms[i, kind, r, k] = float(workers[i].stdout.readline())
    for worker in workers:
        worker.stdin.close()
        worker.wait()
    print(f'{args.scenario}, n = {args.rounds * POSES}, load {os.getloadavg()[0]:.0f}')
    for i, clone in enumerate(clones):
        if len(clones) > 1:
            print(f'## {clone.name}')
        print('| frame | CPU [ms] | over the pair | on average |\n|---|---|---|---|')
        for kind, name in enumerate(KINDS):
            ratios = (ms[i, kind] / ms[i, 0]).ravel()
            print(f'| {name} | {np.median(ms[i, kind]):.1f} '
                  f'| {Median.of(ratios).text(3)} | {0.5 + 0.5 * np.median(ratios):.3f} |')
    for kind, name in enumerate(KINDS):
        if len(clones) > 1:
            ratios = Median.of((ms[1, kind] / ms[0, kind]).ravel())
            print(f'{name:28s} over the other clone {ratios.text(3)}')


if __name__ == '__main__':
    main()
