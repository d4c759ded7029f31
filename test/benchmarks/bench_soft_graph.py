"""CPU per frame of the default graph on soft ground over that on rigid ground.

    python test/benchmarks/bench_soft_graph.py [--pairs 4] [--preset highland]

Each value is the difference of a long and a short run over the frames in between, so that the
start of the nodes is not in it. Both grounds follow each other in turn. Two drives: straight on,
where the rover never sees its tracks, and one that turns back over them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import math
from pathlib import Path
import tempfile

import numpy as np
from scipy import stats

from lunar_rover_sim import record, Scenario

SHORT_S, LONG_S = 5.0, 17.0
DRIVES = {
    'straight on': ('drive_node.profile_forward_mps=[0.12]', ),
    'back over its tracks': ('drive_node.profile_times_s=[0.0, 5.0]',
                             'drive_node.profile_forward_mps=[0.12, 0.03]',
                             'drive_node.profile_yaw_rate_radps=[0.0, 0.3]')}


def cpu_s(settings: Sequence[str], duration_s: float) -> tuple[float, int]:
    """Return CPU time of all nodes of a run [s], and its number of stereo pairs."""
    with tempfile.TemporaryDirectory() as folder:
        done = record(Scenario.load('baseline', ['drive_node.mode=profile', *settings], seed=3,
                                    duration_s=duration_s), Path(folder) / 'run')
        return sum(done.cpu_s.values()), done.counts['/stereo/left/image_raw']


def per_frame_ms(settings: Sequence[str]) -> float:
    """Return CPU time per frame between a short and a long run [ms]."""
    (short, few), (long, many) = (cpu_s(settings, duration) for duration in (SHORT_S, LONG_S))
    return 1e3 * (long - short) / (many - few)


def main() -> int:
    """Print each pair, and the geometric mean of the ratios with its 95 % interval."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--pairs', type=int, default=4)
    parser.add_argument('--preset', default='highland')
    args = parser.parse_args()
    rigid = ('physics_node.ground.model=rigid',)
    soft = ('physics_node.ground.model=regolith', f'physics_node.ground.preset={args.preset}')
    for name, drive in DRIVES.items():
        logs = []
        for _ in range(args.pairs):
            rigid_ms, soft_ms = (per_frame_ms([*drive, *ground]) for ground in (rigid, soft))
            logs.append(math.log(soft_ms / rigid_ms))
            print(f'{name}: rigid {rigid_ms:.1f} ms, {args.preset} {soft_ms:.1f} ms a frame, '
                  f'ratio {soft_ms / rigid_ms:.3f}', flush=True)
        half = stats.t.ppf(0.975, len(logs) - 1) * np.std(logs, ddof=1) / math.sqrt(len(logs))
        mean = float(np.mean(logs))
        print(f'{name}: geometric mean {math.exp(mean):.3f} '
              f'({math.exp(mean - half):.3f} to {math.exp(mean + half):.3f})', flush=True)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
