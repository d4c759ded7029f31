"""CPU time and real-time factor of the graph, the share of each node, and messages lost.

    python test/benchmarks/bench_graph.py [--duration S] [--keep DIR]

Runs the default graph, that with all images at 10 Hz, and the one without cameras, one after the
other, and checks the bag of the default one. CPU time is that of all processes, with start and
end, over the simulated time.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import re
import resource
import shutil
import subprocess
import sys
import tempfile

BLIND = 'run.nodes=[physics_node, gait_controller_node, drive_node, recorder_node]'
KINDS = {'default': (), 'at_10_hz': ('--set', 'render_node.frame_rate_hz=10', '--set',
                                     'render_node.depth_every=1'), 'blind': ('--set', BLIND)}


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command of the package."""
    return subprocess.run([sys.executable, '-m', 'lunar_rover_sim.cli.main', *arguments],
                          capture_output=True, text=True)


def main() -> int:
    """Print one block of lines per kind of graph."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--duration', default='60', help='simulated time [s]')
    parser.add_argument('--scenario', default='baseline')
    parser.add_argument('--keep', type=Path, help='folder for the runs; by default none is kept')
    parser.add_argument('--json', type=Path, help='file of the CPU times')
    args = parser.parse_args()
    folder = args.keep or Path(tempfile.mkdtemp())
    failed, cpu = 0, {}
    for kind, arguments in KINDS.items():
        run, before = folder / kind, resource.getrusage(resource.RUSAGE_CHILDREN)
        finished = command('run', args.scenario, '--duration', args.duration, '-o', str(run),
                           *arguments)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu[kind] = round((after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
                          / float(args.duration), 2)
        print(f'{kind}, {args.duration} s of {args.scenario}, {cpu[kind]} s of CPU per second')
        for line in re.split(r'[\n\r]', finished.stdout):
            if 'RTF' in line or 'processor' in line:
                print('  ' + line.strip())
        checked = command('bag', 'check', str(run / 'bag'))
        if kind == 'default':
            failed += checked.returncode != 0
            print('  ' + '\n  '.join(line for line in checked.stdout.splitlines()
                                     if 'count' in line or 'passed' in line or 'fail' in line))
        if finished.returncode:
            print('  ' + finished.stderr.strip())
            failed += 1
    if args.json:
        args.json.write_text(json.dumps(cpu))
    if args.keep is None:
        shutil.rmtree(folder)
    return min(failed, 1)


if __name__ == '__main__':
    raise SystemExit(main())
