"""`lunar_rover_sim benchmark`: scenarios, sensors and seeds, recorded, estimated, evaluated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import dataclasses
from pathlib import Path
import signal

import click
from click.core import ParameterSource

from lunar_rover_sim.base.errors import ConfigError, SlamError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import find_file
from lunar_rover_sim.base.files.results import json_text
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.slam import paper_of, paper_option, system_options
from lunar_rover_sim.cli.terminal import print_markdown, Progress, say
from lunar_rover_sim.judge.slam.benchmark import Cell, plan
from lunar_rover_sim.judge.slam.benchmark import run as run_cells
from lunar_rover_sim.judge.slam.benchmark import scenario_of, Step
from lunar_rover_sim.judge.slam.benchmark_report import write_report
from lunar_rover_sim.judge.slam.drives import csv_of_drives, Judged, seeds_of
from lunar_rover_sim.judge.slam.estimators import ANCHORED, Estimator, stock_program
from lunar_rover_sim.judge.slam.seal import read_seal, scores, Seal
from lunar_rover_sim.judge.slam.traverse import conditions, DARK, Named
from lunar_rover_sim.judge.slam.traverse import run as run_condition
from lunar_rover_sim.judge.slam.traverse import SCENARIO, table, way_of
from lunar_rover_sim.judge.slam.ways import sealed_ways
from lunar_rover_sim.products.sequences.orbslam3_settings import SENSORS
from lunar_rover_sim.run.scenario import Scenario


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
@click.option('--sealed', default='', show_default=False, metavar='NAME_OR_PATH',
              help='the drives of a packaged seal, or of a file that `slam seal` wrote; '
              'recordings are compared with it, scores are in score.json')
@system_options
def drives(output: Path, scenarios: Sequence[str], sensors: Sequence[str], seeds: str,
           duration: float, sweep: str, overrides: list[str], paper: Path | None, retry: bool,
           workers: int, sealed: str, estimator: Callable[[str], Estimator]) -> int:
    """Record drives, run an estimator on each, and make a table.

    Writes SYSTEM.md, .csv, .tex, .html and SYSTEM_drives.csv; of a sweep SYSTEM.png. The same call
    goes on; `slam table` joins parts. With --sealed it exits with 1 if a recording is not the
    sealed one.
    """
    seal = _seal(find_file('seal', sealed)) if sealed else None
    parameter, _, values = sweep.partition('=')
    published = paper_of(paper, parameter)
    estimators = [estimator(sensor) for sensor in sensors]
    if seal is None:
        cells = plan(scenarios, estimators, seeds_of(seeds), duration, parameter,
                     [v for v in values.split(',') if v], overrides)
    else:
        cells = [dataclasses.replace(cell, drive=seal.drive(cell.drive.scenario, cell.drive.seed))
                 for cell in plan(seal.scenarios, estimators, seal.seeds, seal.duration_s)]
    # Errors in any scenario are reported now, not after hours.
    for drive in dict.fromkeys(cell.drive for cell in cells):
        scenario_of(drive)
    # SIGTERM stops a benchmark as Ctrl-C does: nodes in order, finished cells stay.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with Progress('benchmark', len(cells)) as progress:
        done = run_cells(cells, output, _step(progress, len(cells)), retry, workers)
    judged = [cell.judged(output) for cell in done]
    text, lines = write_report(judged, output, cells[0].estimator.system, published)
    print(text)
    for line in lines:
        say(line)
    return 0 if seal is None else _score(seal, judged, output)


@options.command()
@options.folder('folder of the benchmark; may hold part of it')
@options.several('--distances', type=options.number('--distances', 1.0, unit='m'),
                 default=(300.0, 1000.0), metavar='M...', help='of the goals')
@options.several('--sites', type=options.number('--sites', 1, kind=int), default=(10, 3),
                 metavar='N...', help='number of sites for each distance')
@options.bounded('--first-seed', 1, kind=int, default=1001, help='seed of the first site')
@options.several('--rates', type=options.number('--rates', 0.1, 200.0, 'Hz'), default=(0.5, 2.0),
                 metavar='HZ...', help='of the images [Hz]')
@options.several('--suns', default=('3', '6', '15', DARK), metavar='ELEVATION...',
                 help=f'elevations of the sun [deg], or {DARK}: by the lamp of the rover')
@click.option('--along', default='', show_default=False, metavar='NAME_OR_PATH',
              help='follow the ways of a seal, not those that are planned here')
@click.option('--executable', type=options.PATH, metavar='PATH', help='of ORB-SLAM3, which runs '
              'too then: its example programs, or a Python that has the wheel pyorbslam3')
@click.option('--vocabulary', type=options.PATH, metavar='PATH', help='of ORB-SLAM3')
@options.overrides()
@click.option('--retry', is_flag=True, help='repeat what failed')
@options.workers('drives at the same time; each keeps one to two cores busy')
def traverse(output: Path, distances: Sequence[float], sites: Sequence[int], first_seed: int,
             rates: Sequence[float], suns: Sequence[str], along: str, executable: Path | None,
             vocabulary: Path | None, overrides: list[str], retry: bool, workers: int) -> int:
    """Drive far over sites on planned ways; judge wheels, odometries and the anchored graph.

    All of it are 48 km; the same call goes on. Writes traverse.md, a CSV and a folder a condition.
    """
    if len(sites) != len(distances):
        raise ConfigError(f'--sites: {len(sites)} numbers are not valid with {len(distances)} '
                          'distances; valid is one for each')
    systems = ('wheels', 'reference', 'graph', ANCHORED)
    estimators = [Estimator(system) for system in systems]
    if executable is not None or vocabulary is not None:
        estimators.append(Estimator('orbslam3', program=stock_program(executable, 'stereo'),
                                    vocabulary=vocabulary))
    seeds = {}
    for distance, count in zip(distances, sites):
        seeds[distance] = range(first_seed, first_seed + count)
        first_seed += count
    found = conditions(distances, rates, suns)
    for one in found:       # an error in a setting is reported now
        Scenario.load(SCENARIO, one.settings(overrides))
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if along:
        ways = {distance: sealed_ways(find_file('seal', along), several, SCENARIO)
                for distance, several in seeds.items()}
    else:
        ways = _planned(seeds, output / 'ways', overrides)
    todo = {condition: condition.cells(estimators, ways[condition.distance_m], overrides)
            for condition in found}
    judged: list[Named] = []
    total = sum(map(len, todo.values()))
    with Progress('traverses', total) as progress:
        for condition, cells in todo.items():
            step = _step(progress, total, len(judged), condition.name + ' ')
            judged += run_condition(condition, cells, output, output / 'maps', step, retry,
                                    workers, run_cells)
    text = table(judged)
    for name, content in (('traverse.md', text),
                          ('traverse_drives.csv', csv_of_drives(one for _, one in judged))):
        atomic_write(output / name, content, SlamError)
    print_markdown(text)
    say(output / 'traverse.md')
    return 0


def _step(progress: Progress, total: int, finished: int = 0, of: str = '') -> Step:
    """Return what says how far cells are, of `total` in all; of: what is said before a name."""
    def step(cell: Cell, text: str) -> None:
        nonlocal finished
        if text in ('done', 'kept'):
            finished += 1
            say(f'{finished}/{total} {of}{_describe(cell)}')
        progress(finished, note=f'{of}{cell.name}: {text}')
    return step


def _planned(seeds: Mapping[float, Sequence[int]], folder: Path,
             overrides: Sequence[str]) -> dict[float, dict[int, Array]]:
    """Return distance → seed → waypoints over the true ground."""
    ways: dict[float, dict[int, Array]] = {}
    with Progress('planning ways', sum(map(len, seeds.values()))) as progress:
        for distance, several in seeds.items():
            ways[distance] = {}
            for seed in several:
                progress(sum(map(len, ways.values())), note=f'site {seed}, {distance:g} m')
                ways[distance][seed] = way_of(distance, seed, folder, overrides)
    return ways


def _seal(path: Path) -> Seal:
    """Return a seal; refuse options that it answers itself."""
    context = click.get_current_context()
    for option in ('scenarios', 'seeds', 'duration', 'sweep', 'overrides', 'rover'):
        if context.get_parameter_source(option) is ParameterSource.COMMANDLINE:
            raise click.UsageError(f'--{"set" if option == "overrides" else option}: comes from '
                                   'the seal with --sealed')
    return read_seal(path)


def _score(seal: Seal, judged: Sequence[Judged], folder: Path) -> int:
    """Compare recordings with the seal, and write and say the scores; return the exit status."""
    with Progress('comparing with the seal', len(seal.drives)) as progress:
        problems = seal.problems(folder, lambda name: progress.advance())
    rows = scores(judged)
    path = folder / 'score.json'
    atomic_write(path, json_text({
        'benchmark': seal.name, 'version': seal.version, 'is_sealed': not problems,
        'problems': problems, 'scores': rows, 'sealed_scores': list(seal.results)}) + '\n',
        SlamError)
    for row in (*rows, *({**row, 'system': f'{row["system"]} (sealed)'} for row in seal.results)):
        error = row['ate_percent']
        say(f'{row["scenario"]} {row["sensor"]} {row["system"]}: {row["successes"]} of '
            f'{row["drives"]}, ' + ('too many failures for a median' if error is None
                                    else f'median ATE {error:.3g} % of the distance'))
    for problem in problems:
        say(problem)
    say(f'{seal.name}, version {seal.version}: '
        + (f'{len(problems)} differences from the seal: the scores do not count' if problems
           else f'all {len(seal.drives)} recordings are the sealed ones') + f'; {path}')
    return 1 if problems else 0


def _describe(cell: Cell) -> str:
    """Return name and result of a cell in one line."""
    result = cell.result
    assert result is not None
    what = 'failed' if cell.failed else (
        f'ATE {result.ate_m:.4f} m, scale {result.scale:.4f}, tracked '
        f'{100 * result.tracked_share:.0f} %')
    return f'{cell.name}: {what}' + (f'; {result.reason}' if result.reason else '')
