"""How long an episode takes to start, and what two side by side give; run on demand.

    python test/benchmarks/bench_campaign.py -o FOLDER [--width 640] [--duration 10] [--rounds 3]
        [--small]

Start: wall time and processor time of all processes from the call of `lunar_rover_sim run` to the
acknowledgement of the first frame by the recorder, the world being in the cache. Throughput:
simulated time per wall time of two episodes with `campaign --jobs 2`, over the sum of two single
ones, in turn, so that a busy machine troubles all alike. A single episode draws and simulates on
all cores, so that on two cores two at once cannot have twice its throughput; beside it stands a
single one that is held to one core, which is what each of two at once has. Prints the load.
"""

from __future__ import annotations

import argparse
from contextlib import suppress
import os
from pathlib import Path
import signal
import statistics
import subprocess
import sys
import time

import psutil
import rclpy
from std_msgs.msg import Header

from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.ground.world.cache import cached
from lunar_rover_sim.run.ros_domain import OwnDomain
from lunar_rover_sim.run.scenario import Scenario

CLI = [sys.executable, '-m', 'lunar_rover_sim.cli.main']
FIRST_FRAME_NS = 100_000_000
SMALL_WORLD = ['world.size_m=12.8', 'world.surroundings.samples=257']
# A machine that is busy with other things is measured too; it must not fail.
PATIENT = ['physics_node.wait.start_s=600.0', 'physics_node.wait.silence_s=60.0']


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('-o', '--output', type=Path, required=True)
    parser.add_argument('--width', type=int, default=640)
    parser.add_argument('--duration', type=float, default=10.0, help='of an episode [s]')
    parser.add_argument('--rounds', type=int, default=3)
    parser.add_argument('--small', action='store_true', help='a world of 12.8 m')
    args = parser.parse_args()
    args.output.mkdir(parents=True)
    world = SMALL_WORLD if args.small else []
    scenario = Scenario.load('baseline', world)
    cached(scenario.world, scenario.shared.seed)
    with OwnDomain() as own:
        domain = own.id
    os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
    camera = [*world, *PATIENT, f'render_node.camera.width={args.width}',
              f'render_node.camera.height={args.width * 3 // 4}']
    starts = [first_frame(args.output / f'start_{k}', domain, camera) for k in range(args.rounds)]
    for wall_s, cpu_s in starts:
        print(f'start to first recorded frame: {wall_s:.1f} s wall, {cpu_s:.1f} s processor',
              flush=True)
    print(f'median: {statistics.median(s[0] for s in starts):.1f} s wall, '
          f'{statistics.median(s[1] for s in starts):.1f} s processor; {load()}', flush=True)
    ratios: dict[str, list[float]] = {'all cores': [], 'one core': []}
    for k in range(args.rounds):
        single_s = {'all cores': campaign(args, f'single_{k}', 1, 1, camera),
                    'one core': campaign(args, f'held_{k}', 1, 1, camera, one_core=True)}
        both_s = campaign(args, f'both_{k}', 2, 2, camera)
        for kind, alone_s in single_s.items():
            ratios[kind].append(alone_s / both_s)
            print(f'single on {kind} {alone_s:.1f} s, two at once {both_s:.1f} s: '
                  f'{ratios[kind][-1]:.2f} of the sum; {load()}', flush=True)
    for kind, values in ratios.items():
        print(f'throughput of --jobs 2 over the sum of two single runs on {kind}: '
              f'{statistics.median(values):.2f}')
    return 0


def first_frame(folder: Path, domain: int, settings: list[str]) -> tuple[float, float]:
    """Return wall and processor time until the recorder has written the first frame [s]."""
    rclpy.init(args=[])
    node = rclpy.create_node('bench_campaign')
    stamps: list[int] = []
    node.create_subscription(Header, topics.RECORDED.name,
                             lambda m: stamps.append(time_ns(m.stamp)), 10)
    start = time.monotonic()
    run = subprocess.Popen(
        [*CLI, 'run', 'baseline', '-o', str(folder), '--duration', '60', '--domain', str(domain),
         *(word for s in settings for word in ('--set', s))], stdout=subprocess.DEVNULL)
    try:
        while not stamps or stamps[-1] < FIRST_FRAME_NS:
            rclpy.spin_once(node, timeout_sec=0.02)
            if run.poll() is not None:
                raise SystemExit('the run ended before its first frame')
        return time.monotonic() - start, processor_s(run.pid)
    finally:
        run.send_signal(signal.SIGINT)
        run.wait()
        node.destroy_node()
        rclpy.shutdown()


def processor_s(pid: int) -> float:
    """Return the processor time of a process and all below it that run [s]."""
    root = psutil.Process(pid)
    total = 0.0
    for process in (root, *root.children(recursive=True)):
        with suppress(psutil.Error):    # it has ended
            times = process.cpu_times()
            total += times.user + times.system
    return total


def campaign(args: argparse.Namespace, name: str, episodes: int, jobs: int,
             settings: list[str], one_core: bool = False) -> float:
    """Return the wall time of a campaign [s], all included."""
    core = {min(os.sched_getaffinity(0))}
    file = args.output / f'{name}.yaml'
    lines = ['world.seed: 1', f'run.duration_s: {args.duration}',
             *(s.replace('=', ': ') for s in settings)]
    file.write_text(f'episodes: {episodes}\nsettings:\n'
                    + ''.join(f'  {line}\n' for line in lines))
    start = time.monotonic()
    subprocess.run([*CLI, 'campaign', str(file), '-o', str(args.output / name), '--jobs',
                    str(jobs)], check=True, stdout=subprocess.DEVNULL,
                   preexec_fn=(lambda: os.sched_setaffinity(0, core)) if one_core else None)
    return time.monotonic() - start


def load() -> str:
    """Return what else the machine is doing."""
    return f'load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores'


if __name__ == '__main__':
    raise SystemExit(main())
