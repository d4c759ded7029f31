"""`lunar_rover_sim benchmark`: scenarios, sensors and seeds, simulated, estimated, judged."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from lunar_rover_sim.cli.slam import add_system_arguments, estimator_of, SENSORS

if TYPE_CHECKING:
    from lunar_rover_sim.slam.benchmark import Drive

_SCENARIOS = ('baseline', 'feature_sparse', 'low_albedo')
_SLOWEST = 60.0      # wall time over simulated time
_START_S = 300.0     # world, nodes
_STOP_S = 30.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Simulate and record each scenario with several seeds, run an estimator with '
        'each sensor, and write SYSTEM.md, .csv and .tex, a table with 95 % '
        'intervals, and SYSTEM.html, a report. What is done already is kept: the '
        'same call goes on.')
    parser.add_argument('-o', '--output', type=Path, required=True, metavar='DIR',
                        help='folder of the benchmark; may hold part of it')
    parser.add_argument('--scenarios', nargs='+', default=list(_SCENARIOS), metavar='SCENARIO')
    parser.add_argument('--sensors', nargs='+', choices=SENSORS, default=['mono', 'stereo'],
                        metavar='SENSOR', help=f'of {", ".join(SENSORS)} (default: mono stereo)')
    parser.add_argument('--seeds', type=int, default=5, metavar='N',
                        help='drives of each scenario, seeds 1 to N (default: %(default)s)')
    parser.add_argument('--duration', type=float, default=40.0, metavar='S',
                        help='simulated time of a drive [s] (default: %(default)s)')
    parser.add_argument('--sweep', default='', metavar='NODE.PARAM=V1,V2,...',
                        help='drive each scenario with several values of a parameter')
    parser.add_argument('--set', action='append', default=[], metavar='NODE.PARAM=VALUE',
                        dest='overrides', help='override one parameter; may be repeated')
    parser.add_argument('--paper', type=Path, metavar='FILE',
                        help='published numbers to put beside, YAML: scenario: {sensor: {ate_m: '
                             'number, scale: number}} (default: those of the three scenarios in '
                             'config/published_slam.yaml; in a sweep, none)')
    parser.add_argument('--retry', action='store_true', help='do cells again that failed')
    add_system_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Do what is missing, then write table and report."""
    from rich.console import Console

    from lunar_rover_sim.errors import SlamError
    from lunar_rover_sim.files.resources import config_path
    from lunar_rover_sim.run.scenario import load_scenario
    from lunar_rover_sim.slam import benchmark, table
    from lunar_rover_sim.slam.benchmark_page import html_report

    parameter, _, values = args.sweep.partition('=')
    published = args.paper
    if published is None and not parameter:
        published = config_path('published_slam.yaml')
    paper = table.read_paper(published) if published is not None else None
    cells = benchmark.plan(args.scenarios, [estimator_of(args, s) for s in args.sensors],
                           args.seeds, args.duration, parameter,
                           [v for v in values.split(',') if v], args.overrides)
    for drive in {cell.drive: None for cell in cells}:   # before hours are spent
        scenario = load_scenario(drive.scenario, drive.settings, drive.seed)
    console = Console()

    with console.status('') as status:
        finished = 0

        def step(cell: benchmark.Cell, text: str) -> None:
            nonlocal finished
            if text not in ('done', 'kept'):
                status.update(f'{finished}/{len(cells)} {cell.name}: {text}')
                return
            finished += 1
            result = cell.result
            if result is not None:
                what = (f'ATE {result.ate_m:.4f} m, scale {result.scale:.4f}, tracked '
                        f'{100 * result.tracked_share:.0f} %' if not cell.failed else 'failed')
                reason = f'; {result.reason}' if result.reason else ''
                console.print(f'{finished}/{len(cells)} {cell.name}: {what}{reason}',
                              highlight=False, markup=False, soft_wrap=True)

        done = benchmark.run(cells, args.output, _simulate, step, args.retry)

    rows = table.rows_of(done)
    text = table.markdown(rows, paper, parameter)
    rate = scenario.render_node.frame_rate_hz
    statement = [
        f'{args.seeds} drives of {args.duration:g} s per line, seeds 1 to {args.seeds}, '
        f'{rate:g} frames/s, {scenario.drive_node.speed_mps:g} m/s asked for; system '
        f'{args.system}.',
        'Mean ± 95 % interval over seeds (Student). Mono is aligned by Sim(3), the others by '
        'SE(3); scale is true over estimated size of the path, by Sim(3). Distance is horizontal, '
        'in steps of 0.1 s.']
    said = table.findings(rows, parameter)
    title = 'Benchmark' + (f' over {parameter}' if parameter else '')
    written = {
        f'{args.system}.md': '\n\n'.join([*statement, text, *said]).rstrip() + '\n',
        f'{args.system}.csv': table.csv_text(rows),
        f'{args.system}.tex': table.latex(rows, paper, parameter),
        f'{args.system}.html': html_report(title, statement, rows, done, args.output,
                                           parameter, paper)}
    console.print(text + '\n'.join(['', *said]), highlight=False, markup=False, soft_wrap=True)
    for name, content in written.items():
        try:
            (args.output / name).write_text(content, encoding='utf-8')
        except OSError as error:
            raise SlamError(f'{args.output / name}: cannot be written: '
                            f'{error.strerror}') from None
        console.print(str(args.output / name), highlight=False, markup=False, soft_wrap=True)
    return 0


def _simulate(drive: Drive, folder: Path) -> None:
    """Record a drive in a process of its own, with the topics that estimators need."""
    import sys

    from lunar_rover_sim import topics
    from lunar_rover_sim.errors import SlamError
    from lunar_rover_sim.run.child_process import run_program

    wanted = [t.name for t in (topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.LEFT_INFO,
                               topics.RIGHT_INFO, topics.TRUE_DEPTH, topics.ODOM, topics.IMU_RAW,
                               topics.SCENARIO, topics.WORLD_HASH)]
    settings = [f'recorder_node.topics=[{",".join(wanted)}]', *drive.settings]
    command = [sys.executable, '-m', 'lunar_rover_sim.cli.main', 'run', drive.scenario,
               '-o', str(folder), '--duration', repr(drive.duration_s), '--seed', str(drive.seed)]
    log = folder.with_name(f'{drive.name}.log')
    ended = run_program([*command, *(word for s in settings for word in ('--set', s))],
                        Path.cwd(), log, _START_S + _SLOWEST * drive.duration_s, grace_s=_STOP_S)
    if ended.words:
        said = f': {ended.tail[-1]}' if ended.tail else ''
        raise SlamError(f'{drive.name}: the simulation {ended.words}{said}')
