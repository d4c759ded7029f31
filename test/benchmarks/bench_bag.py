"""How fast bags are written, checked, hashed and exported; run by hand.

    python test/benchmarks/bench_bag.py [--seconds 60] [--storage mcap] [--keep DIR]

Makes a bag of the default rates (200 Hz states, 640x480 stereo at 10 Hz with depth and disparity)
from twenty stereo sets that repeat, and prints wall times and the peak memory of each step.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import multiprocessing
from pathlib import Path
import resource
import shutil
import sys
import tempfile
import time

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np  # noqa: E402
import synthetic_bag as synthetic  # noqa: E402

from lunar_rover_sim.bag.content_hash import bag_hash  # noqa: E402
from lunar_rover_sim.bag.stamps import stamp_ns  # noqa: E402
from lunar_rover_sim.bag.writer import BagWriter  # noqa: E402
from lunar_rover_sim.inspection.check import check  # noqa: E402
from lunar_rover_sim.sequences.export import export  # noqa: E402

STEP_NS, FRAME_NS, SETS = 5_000_000, 100_000_000, 20


def make(path: Path, seconds: float, storage: str, compression: str) -> tuple[float, int, int]:
    """Write the bag; return the time spent in the writer [s], messages and bytes."""
    synthetic.WIDTH, synthetic.HEIGHT, synthetic.FOCAL_PX = 640, 480, 457.0
    scene, rng = synthetic.Scene(), np.random.default_rng(0)
    frames = [synthetic.frame_items(k * FRAME_NS, scene) for k in range(1, SETS + 1)]
    spent, messages, size = 0.0, 0, 0
    with BagWriter(path, storage, compression) as writer:
        for ns in range(0, round(seconds * 1e9) + 1, STEP_NS):
            items = synthetic.latched_items() if ns == 0 else \
                synthetic.state_items(ns, STEP_NS, rng)
            if ns and ns % FRAME_NS == 0:
                for item in frames[ns // FRAME_NS % SETS]:
                    item.message.header.stamp = synthetic.time(ns)
                    if item.topic == 'stereo/disparity':
                        item.message.image.header.stamp = synthetic.time(ns)
                    items.append(item)
            raws = [synthetic.serialise(item) for item in items]
            start = time.perf_counter()
            for item, raw in zip(items, raws):
                writer.write('/' + item.topic, item.msgtype, raw, 0)
            spent += time.perf_counter() - start
            messages += len(raws)
            size += sum(map(len, raws))
        start = time.perf_counter()
    return spent + time.perf_counter() - start, messages, size


def measured(name: str, call: Callable[[], object]) -> None:
    """Run a step in a process of its own; print wall time and peak memory."""
    def child(queue: object) -> None:
        start = time.perf_counter()
        call()
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        queue.put((time.perf_counter() - start, peak))

    context = multiprocessing.get_context('fork')
    queue = context.Queue()
    process = context.Process(target=child, args=(queue,))
    process.start()
    wall_s, peak = queue.get()
    process.join()
    print(f'{name:24} {wall_s:7.2f} s {peak:7.0f} MiB peak')


def main() -> None:
    """Measure everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=60.0)
    parser.add_argument('--storage', default='mcap', choices=('mcap', 'sqlite3'))
    parser.add_argument('--compression', default='none', choices=('none', 'zstd'))
    parser.add_argument('--keep', type=Path)
    args = parser.parse_args()
    folder = args.keep or Path(tempfile.mkdtemp(prefix='bench_bag_'))
    try:
        raw = bytes(synthetic.serialise(synthetic.state_items(
            STEP_NS, STEP_NS, np.random.default_rng(0))[1]))
        start = time.perf_counter()
        for _ in range(100_000):
            stamp_ns('nav_msgs/msg/Odometry', raw)
        print(f'stamp_ns                 {(time.perf_counter() - start) * 10:7.2f} us')
        wall_s, messages, size = make(folder / 'bag', args.seconds, args.storage,
                                      args.compression)
        print(f'write                    {wall_s:7.2f} s {size / wall_s / 1e6:7.0f} MB/s, '
              f'{messages} messages, {size / 1e6:.0f} MB')
        measured('check', lambda: check(folder / 'bag'))
        measured('hash', lambda: bag_hash(folder / 'bag'))
        for kind in ('euroc', 'tum', 'kitti'):
            measured(f'export {kind}', lambda: export(folder / 'bag', folder / kind, kind))
    finally:
        if args.keep is None:
            shutil.rmtree(folder)


if __name__ == '__main__':
    main()
