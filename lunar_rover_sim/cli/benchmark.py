"""`lunar_rover_sim benchmark`: scenarios, sensors and seeds, recorded, estimated, evaluated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
import signal

import click

from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.slam import paper_of, paper_option, system_options
from lunar_rover_sim.cli.terminal import Progress, say
from lunar_rover_sim.judge.slam.benchmark import Cell, plan
from lunar_rover_sim.judge.slam.benchmark import run as run_cells
from lunar_rover_sim.judge.slam.benchmark import scenario_of
from lunar_rover_sim.judge.slam.benchmark_report import write_report
from lunar_rover_sim.judge.slam.drives import seeds_of
from lunar_rover_sim.judge.slam.estimators import Estimator
from lunar_rover_sim.products.sequences.orbslam3_settings import SENSORS


@options.command()
@options.folder('folder of the benchmark; may hold part of it')
@options.several('--scenarios', default=('baseline', 'feature_sparse', 'low_albedo'),
                 metavar='SCENARIO...', help='packaged names or YAML files')
@options.several('--sensors', type=options.Choice(SENSORS), default=('mono', 'stereo'),
                 metavar='SENSOR...', help=f'of {", ".join(SENSORS)}')
@click.option('--seeds', default='5', metavar='SEEDS', help='drives of each scenario: N for seeds '
              '1 to N, FROM-TO, or several of these with commas')
@click.option('--duration', type=float, default=40.0, metavar='S',
              help='simulated time of a drive [s]')
@click.option('--sweep', default='', show_default=False, metavar='NODE.PARAM=V1,V2,...',
              help='drive each scenario with several values of a parameter')
@options.overrides()
@paper_option
@click.option('--retry', is_flag=True, help='repeat cells that failed')
@options.workers('drives at the same time; each keeps one to two cores busy')
@system_options
def benchmark(output: Path, scenarios: Sequence[str], sensors: Sequence[str], seeds: str,
              duration: float, sweep: str, overrides: list[str], paper: Path | None, retry: bool,
              workers: int, estimator: Callable[[str], Estimator]) -> int:
    """Record drives, run an estimator on each, and make a table.

    Writes SYSTEM.md, .csv, .tex, .html and SYSTEM_drives.csv; of a sweep SYSTEM.png. The same call
    goes on; `slam table` joins parts.
    """
    parameter, _, values = sweep.partition('=')
    published = paper_of(paper, parameter)
    cells = plan(scenarios, [estimator(sensor) for sensor in sensors], seeds_of(seeds),
                 duration, parameter, [v for v in values.split(',') if v], overrides)
    # Errors in any scenario are reported now, not after hours.
    for drive in dict.fromkeys(cell.drive for cell in cells):
        scenario_of(drive)
    # SIGTERM stops a benchmark as Ctrl-C does: nodes in order, finished cells stay.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with Progress('benchmark', len(cells)) as progress:
        finished = 0

        def step(cell: Cell, text: str) -> None:
            nonlocal finished
            if text in ('done', 'kept'):
                finished += 1
                say(f'{finished}/{len(cells)} {_describe(cell)}')
            progress(finished, note=f'{cell.name}: {text}')

        done = run_cells(cells, output, step, retry, workers)
    report = write_report([cell.judged(output) for cell in done], output,
                          cells[0].estimator.system, published)
    print(report.table)
    for line in (*report.findings, *report.files):
        say(line)
    return 0


def _describe(cell: Cell) -> str:
    """Return name and result of a cell in one line."""
    result = cell.result
    assert result is not None
    what = 'failed' if cell.failed else (
        f'ATE {result.ate_m:.4f} m, scale {result.scale:.4f}, tracked '
        f'{100 * result.tracked_share:.0f} %')
    return f'{cell.name}: {what}' + (f'; {result.reason}' if result.reason else '')
