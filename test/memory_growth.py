"""Measures whether the processes of a long recording grow; run on demand, not a test of pytest.

    python test/memory_growth.py -o FOLDER [--duration 3600] [--state-rate 200] [--keep-bag]

Records a scenario with small images, samples the resident memory of every process,
writes memory.csv, memory.png and memory.json into FOLDER and exits with 1 if a process
has ever held more than LIMIT_MIB above what it held at the end of the warm-up.
"""

import argparse
from contextlib import suppress
import csv
import json
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time
from typing import TextIO

from matplotlib.figure import Figure
import numpy as np
import psutil

from lunar_rover_sim.base.files.paths import BAG_FOLDER
from lunar_rover_sim.nodes.clock_monitor import ClockMonitor
from lunar_rover_sim.run.plan import LOG_FOLDER, STOP_ORDER
from lunar_rover_sim.run.ros_domain import OwnDomain

LIMIT_MIB = 50.0
WARM_UP_S = 60.0
PERIOD_S = 2.0
SETTINGS = ('world.size_m=12.8', 'world.surroundings.samples=257',
            'render_node.sgm.num_disparities=32', 'drive_node.shape=circle',
            'drive_node.shape_size_m=4.0', 'drive_node.laps=1000', 'drive_node.stuck_time_s=0.0',
            'physics_node.wait.silence_s=60.0', 'physics_node.wait.start_s=300.0')


def main() -> int:
    """Record, sample, judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('-o', '--output', type=Path, required=True)
    parser.add_argument('--duration', type=float, default=3600.0, help='simulated time [s]')
    parser.add_argument('--state-rate', type=int, default=200, help='of physics messages [Hz]')
    parser.add_argument('--width', type=int, default=128, help='of the images [px]')
    parser.add_argument('--scenario', default='feature_sparse')
    parser.add_argument('--keep-bag', action='store_true')
    args = parser.parse_args()
    args.output.mkdir(parents=True)
    rows: list[dict[str, object]] = []
    # SIGTERM ends the recording, as Ctrl-C does; what was measured up to there is judged.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with open(args.output / 'memory.csv', 'w', newline='', encoding='utf-8') as file:
        with suppress(KeyboardInterrupt):
            record(args, rows, file)
    return judge(rows, args)


def record(args: argparse.Namespace, rows: list[dict[str, object]], file: TextIO) -> None:
    """Add one row per sample and process, to the file at once; interrupted, they stay."""
    writer = csv.DictWriter(file, ['simulated_s', 'wall_s', 'process', 'rss_mib'])
    writer.writeheader()
    with OwnDomain() as own:
        domain = own.id
    os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
    folder = args.output / 'run'
    settings = [*SETTINGS, f'physics_node.state_rate_hz={args.state_rate}',
                f'render_node.camera.width={args.width}',
                f'render_node.camera.height={args.width * 3 // 4}']
    run = subprocess.Popen(
        [sys.executable, '-m', 'lunar_rover_sim.cli.main', 'run', args.scenario, '-o', str(folder),
         '--duration', str(args.duration), '--domain', str(domain),
         *(word for s in settings for word in ('--set', s))], stdout=subprocess.DEVNULL)
    start = time.monotonic()
    try:
        with ClockMonitor() as clock:
            while run.poll() is None:
                for name, pid in processes(run.pid).items():
                    rss = resident_mib(pid)
                    if rss is not None:
                        rows.append({'simulated_s': clock.now_ns() / 1e9,
                                     'wall_s': round(time.monotonic() - start, 1),
                                     'process': name, 'rss_mib': rss})
                        writer.writerow(rows[-1])
                file.flush()
                time.sleep(PERIOD_S)
    finally:
        if run.poll() is None:
            # Not SIGINT: a process started in the background of a shell ignores it.
            run.terminate()
            run.wait()
        if not args.keep_bag:
            shutil.rmtree(folder / BAG_FOLDER, ignore_errors=True)
    print(f'run ended with status {run.returncode}; logs: {folder / LOG_FOLDER}')


def processes(runner: int) -> dict[str, int]:
    """Return name → process id of the runner and its nodes."""
    found = {'runner': runner}
    for child in psutil.Process(runner).children():
        with suppress(psutil.Error):    # it has ended
            words = child.cmdline()
            found.update({name: child.pid for name in STOP_ORDER if name in words})
    return found


def resident_mib(pid: int) -> float | None:
    """Return the resident memory [MiB]; None if the process has ended."""
    try:
        return float(psutil.Process(pid).memory_info().rss) / 2.0**20
    except psutil.Error:
        return None


def judge(rows: list[dict[str, object]], args: argparse.Namespace) -> int:
    """Write figure and numbers; return 1 where a process has grown too much."""
    figure = Figure(figsize=(8.0, 4.5), layout='constrained')
    axes = figure.subplots()
    result: dict[str, dict[str, float]] = {}
    for name in ('runner', *STOP_ORDER):
        t, rss = (np.array([row[key] for row in rows if row['process'] == name], dtype=float)
                  for key in ('simulated_s', 'rss_mib'))
        if not (t > WARM_UP_S).any():
            continue
        late = rss[t > WARM_UP_S]
        # What it held when warm: the median of a few samples, since memory breathes.
        warm = float(np.median(late[:10]))
        result[name] = {'warm_mib': round(warm, 1), 'end_mib': round(float(late[-1]), 1),
                        'growth_mib': round(float(late.max()) - warm, 1)}
        axes.plot(t / 60.0, rss, lw=1.0,
                  label=f'{name}: {result[name]["growth_mib"]:+.1f} MiB')
    simulated_s = max((float(str(row['simulated_s'])) for row in rows), default=0.0)
    axes.axvline(WARM_UP_S / 60.0, color='0.6', lw=0.8, ls='--')
    axes.set(xlabel='simulated time [min]', ylabel='resident memory [MiB]',
             title=f'{simulated_s:.0f} s recorded; most above the end of the warm-up (dashed)')
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(args.output / 'memory.png', dpi=100)
    summary = {'simulated_s': simulated_s, 'state_rate_hz': args.state_rate,
               'limit_mib': LIMIT_MIB, 'processes': result}
    (args.output / 'memory.json').write_text(json.dumps(summary, indent=2) + '\n')
    print(json.dumps(summary, indent=2))
    if len(result) < 1 + len(STOP_ORDER) or simulated_s < args.duration - 1.0:
        print('the recording did not come to its end')
        return 1
    return int(any(r['growth_mib'] > LIMIT_MIB for r in result.values()))


if __name__ == '__main__':
    raise SystemExit(main())
