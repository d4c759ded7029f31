"""`lunar_rover_sim benchmark`: scenarios, sensors and seeds, recorded, estimated, evaluated."""

from __future__ import annotations

import argparse
import signal

from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.slam import (add_paper_argument, add_system_arguments, estimator_of,
                                      paper_of)
from lunar_rover_sim.cli.terminal import Progress, say
from lunar_rover_sim.judge.slam import benchmark
from lunar_rover_sim.judge.slam.benchmark_report import write_report
from lunar_rover_sim.judge.slam.drives import seeds_of
from lunar_rover_sim.products.sequences.orbslam3_settings import SENSORS

_SCENARIOS = ('baseline', 'feature_sparse', 'low_albedo')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Simulate and record each scenario with several seeds, run an estimator with '
        'each sensor, and write SYSTEM.md, .csv and .tex, a table with 95 % '
        'intervals, SYSTEM_drives.csv, every drive, SYSTEM.html, a report, and in a sweep '
        'SYSTEM.png, its curves. What is done already is kept: the same call goes on. Parts of a '
        'benchmark that ran on several machines are joined by `slam table`.')
    options.add_folder(parser, 'folder of the benchmark; may hold part of it')
    parser.add_argument('--scenarios', nargs='+', default=list(_SCENARIOS), metavar='SCENARIO',
                        help='packaged names or YAML files (default: '
                             f'{" ".join(_SCENARIOS)})')
    parser.add_argument('--sensors', nargs='+', choices=SENSORS, default=['mono', 'stereo'],
                        metavar='SENSOR', help=f'of {", ".join(SENSORS)} (default: mono stereo)')
    parser.add_argument('--seeds', default='5', metavar='SEEDS',
                        help='drives of each scenario: N for seeds 1 to N, FROM-TO, or several of '
                             'these with commas (default: %(default)s)')
    parser.add_argument('--duration', type=float, default=40.0, metavar='S',
                        help='simulated time of a drive [s] (default: %(default)s)')
    parser.add_argument('--sweep', default='', metavar='NODE.PARAM=V1,V2,...',
                        help='drive each scenario with several values of a parameter')
    options.add_overrides(parser)
    add_paper_argument(parser)
    parser.add_argument('--retry', action='store_true', help='repeat cells that failed')
    options.add_workers(parser, 'drives at the same time; each keeps one to two cores busy')
    add_system_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Do what is missing, then write table and report."""
    parameter, _, values = args.sweep.partition('=')
    paper = paper_of(args.paper, parameter)
    cells = benchmark.plan(args.scenarios, [estimator_of(args, s) for s in args.sensors],
                           seeds_of(args.seeds), args.duration, parameter,
                           [v for v in values.split(',') if v], args.overrides)
    # Errors in any scenario are reported now, not after hours.
    for drive in dict.fromkeys(cell.drive for cell in cells):
        benchmark.scenario_of(drive)
    # SIGTERM stops a benchmark as Ctrl-C does: nodes in order, finished cells stay.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with Progress('benchmark', len(cells)) as progress:
        finished = 0

        def step(cell: benchmark.Cell, text: str) -> None:
            nonlocal finished
            if text in ('done', 'kept'):
                finished += 1
                say(f'{finished}/{len(cells)} {_describe(cell)}')
            progress(finished, note=f'{cell.name}: {text}')

        done = benchmark.run(cells, args.output, step, args.retry, args.workers)
    report = write_report([cell.judged(args.output) for cell in done], args.output, args.system,
                          paper)
    for line in (report.table, *report.findings, *map(str, report.files)):
        say(line)
    return 0


def _describe(cell: benchmark.Cell) -> str:
    """Return name and result of a cell in one line."""
    result = cell.result
    assert result is not None
    what = 'failed' if cell.failed else (
        f'ATE {result.ate_m:.4f} m, scale {result.scale:.4f}, tracked '
        f'{100 * result.tracked_share:.0f} %')
    return f'{cell.name}: {what}' + (f'; {result.reason}' if result.reason else '')
