"""CPU time of lidar_node for a scan: the node in a graph, and `Lidar.scan` alone.

    python test/benchmarks/bench_lidar.py [--runs N] [--scenario NAME]

A VLP-16 at 10 Hz, its cloud and planar scan recorded. Of each pair of runs, 20 s and 4 s, the
difference counts: start and end, which are the same in both, drop out.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import tempfile
import time

from lunar_rover_sim import record, Scenario

NODES = 'physics_node, gait_controller_node, drive_node, recorder_node, lidar_node'
OVERRIDES = (f'run.nodes=[{NODES}]', 'recorder_node.topics=[all, lidar/points, lidar/scan]')
SHORT_S, LONG_S, RATE_HZ = 4.0, 20.0, 10.0


def of_node(name: str) -> tuple[float, float]:
    """Return CPU time [ms] a scan, and the real-time factor of the longer run."""
    cpu_s = []
    for duration_s in (SHORT_S, LONG_S):
        scenario = Scenario.load(name, OVERRIDES, seed=3, duration_s=duration_s)
        with tempfile.TemporaryDirectory() as folder:
            recording = record(scenario, Path(folder) / 'run')
        cpu_s.append(recording.cpu_s['lidar_node'])
    return (1e3 * (cpu_s[1] - cpu_s[0]) / (RATE_HZ * (LONG_S - SHORT_S)),
            recording.real_time_factor)


def alone(name: str, count: int = 100) -> float:
    """Return CPU time [ms] of a scan, one after the other of a rover that stands."""
    scenario = Scenario.load(name, OVERRIDES, seed=3)
    lidar = scenario.lidar()
    with scenario.simulation() as simulation:
        state = simulation.state
    lidar.scan(state)
    begin = time.process_time()
    for index in range(count):
        lidar.scan(state, index)
    return 1e3 * (time.process_time() - begin) / count


def main() -> int:
    """Print one line a pair of runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--runs', type=int, default=3)
    parser.add_argument('--scenario', default='baseline')
    parser.add_argument('--json', type=Path, help='file of the values')
    args = parser.parse_args()
    nodes, scans = [], []
    alone(args.scenario, 1)     # loops are compiled, and kept for the first short run
    for _ in range(args.runs):
        in_graph, factor = of_node(args.scenario)
        nodes.append(in_graph)
        scans.append(alone(args.scenario))
        print(f'lidar_node {in_graph:.1f} ms of CPU a scan ({factor:.2f} times real time); '
              f'Lidar.scan alone {scans[-1]:.1f} ms', flush=True)
    if args.json:
        args.json.write_text(json.dumps({
            'node_ms': f'{min(nodes):.1f} to {max(nodes):.1f}',
            'scan_ms': f'{min(scans):.1f} to {max(scans):.1f}', 'n': args.runs}))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
