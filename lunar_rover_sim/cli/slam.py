"""`lunar_rover_sim slam`: what SLAM programs need, and running them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
import functools
import math
from pathlib import Path
from typing import Any

import click

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError, SlamError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import check_file, config_path, make_new_folder
from lunar_rover_sim.base.files.results import json_text
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.evaluate import bounds, check_bounds
from lunar_rover_sim.cli.terminal import print_json, Progress, say
from lunar_rover_sim.ground.world.orbital_map import OrbitalMap
from lunar_rover_sim.judge.evaluation.trajectory_plots import TOP_VIEW
from lunar_rover_sim.judge.slam.benchmark_report import write_report
from lunar_rover_sim.judge.slam.drives import join
from lunar_rover_sim.judge.slam.estimators import Estimator, stock_program, SYSTEMS
from lunar_rover_sim.judge.slam.graph.anchor import Anchor, Doubt
from lunar_rover_sim.judge.slam.run_on_bag import COVARIANCE, ESTIMATE, LIVE, run_on_bag
from lunar_rover_sim.judge.slam.seal import write_seal
from lunar_rover_sim.judge.slam.table import Paper, read_paper
from lunar_rover_sim.products.sequences.orbslam3_settings import SENSORS
from lunar_rover_sim.products.sequences.orbslam3_settings import settings as settings_text
from lunar_rover_sim.products.sequences.sensors import described_sensors, recorded_sensors
from lunar_rover_sim.run.scenario import Scenario

_sensor = click.option('--sensor', type=options.Choice(SENSORS), default='stereo',
                       help='input of the program')
_file = options.output(check_file, 'FILE', 'file to write; must not exist')


def paper_option(function: options.Function) -> options.Function:
    """Declare --paper, published numbers; see `paper_of`."""
    return click.option('--paper', type=options.PATH, metavar='FILE', help='published numbers '
                        'to compare with, laid out as config/published_slam.yaml, the default; in '
                        'a sweep there is none')(function)


def paper_of(path: Path | None, parameter: str) -> Paper | None:
    """Return the published numbers of a file, or of the packaged one unless it is a sweep."""
    if path is None and not parameter:
        path = config_path('published_slam.yaml')
    return read_paper(path) if path is not None else None


def system_options(function: options.Function) -> options.Function:
    """Declare the options that choose an estimator; a function of its sensor: `estimator`."""
    @functools.wraps(function)
    def with_estimator(system: str, executable: Path | None, vocabulary: Path | None,
                       command: str | None, estimate_frame: str | None, features: int,
                       timeout: float, **given: Any) -> Any:
        def estimator(sensor: str) -> Estimator:
            return Estimator(system, sensor, stock_program(executable, sensor), vocabulary,
                             command or '', estimate_frame or '', features, timeout)
        return function(estimator=estimator, **given)

    declared: options.Function = with_estimator
    for option in (
            options.bounded('--timeout', 0.0, default=0.0, unit='s', metavar='S',
                            show_default=False, help='longest time of a run; default: ten times '
                            'the sequence and 2 min'),
            click.option('--features', type=int, default=2000, metavar='N',
                         help='keypoints per image of ORB-SLAM3'),
            click.option('--estimate-frame', type=options.Choice(('base', 'imu', 'left', 'right')),
                         help='frame of the rover whose poses are estimated (default: left; imu '
                         'for stereo-inertial)'),
            click.option('--run', 'command', metavar='COMMAND',
                         help='of the system `command`: with {sequence} (EuRoC), {settings}, '
                         '{times}, {sensor} and {out}, the TUM file to write'),
            click.option('--vocabulary', type=options.PATH, metavar='PATH', help='of ORB-SLAM3'),
            click.option('--executable', type=options.PATH, metavar='PATH', help='of ORB-SLAM3: '
                         'stereo_euroc, mono_euroc, rgbd_tum, ..., or their folder; or a Python '
                         'that has the wheel pyorbslam3'),
            click.option('--system', type=options.Choice(SYSTEMS), default='reference',
                         help='estimator')):
        declared = option(declared)
    return declared


@options.command(scenarios=True)
@options.argument('source', 'a bag, or a scenario by name or file', metavar='BAG|SCENARIO')
@_file
@_sensor
@click.option('--features', type=int, default=2000, metavar='N', help='keypoints per image')
@options.overrides(fast=True)
def settings(source: str, output: Path, sensor: str, features: int,
             overrides: list[str]) -> int:
    """Write the settings file of ORB-SLAM3 for a bag or a scenario.

    --set and --fast are those of the `run` that the file is for; a bag has its own.
    """
    path, has_depth = Path(source), sensor == 'rgbd'
    if path.is_dir() or path.suffix in ('.mcap', '.db3'):
        if overrides:
            raise ConfigError(f'--set, --fast: are for a scenario, and {source} is a recording, '
                              'which has its own')
        with open_bag(path) as bag:
            suite = recorded_sensors(bag, (topics.TRUE_DEPTH.name,) if has_depth else ())
    else:
        scenario = Scenario.load(source, overrides)
        render = scenario.render_node
        suite = described_sensors(
            scenario.rover, render.camera, scenario.physics_node.imu,
            render.frame_rate_hz / (render.depth_every if has_depth else 1),
            scenario.physics_node.state_rate_hz, scenario.physics_node.gravity_mps2)
    text = settings_text(suite, sensor, features)
    options.refuse_existing(output, option=False)
    atomic_write(output, text, SlamError)
    say(output)
    return 0


@options.command()
@options.bag()
@options.new_folder('folder for settings, log and results')
@_sensor
@click.option('--keep-sequence', is_flag=True, help='keep the exported images')
@click.option('--quiet', is_flag=True, help='do not show the log of the program')
@options.on_maps('--system graph')
@bounds
@options.as_json
@system_options
def run(bag: Path, output: Path, sensor: str, keep_sequence: bool, quiet: bool,
        orbital: Path | None, near: tuple[float, float] | None, doubt: float | None,
        max_ate: float | None, min_tracked: float | None, as_json: bool,
        estimator: Callable[[str], Estimator]) -> int:
    """Run a SLAM program on a bag and evaluate its result."""
    system = estimator(sensor)
    anchor = _anchor(system, orbital, near, doubt)
    make_new_folder(output)
    try:
        with Progress('reading the bag') as progress:
            result = run_on_bag(
                bag, system, output, None if quiet or as_json else say,
                progress.start, progress.advance,
                output / 'sequence' if keep_sequence else None, plots=True, anchor=anchor)
    finally:
        with suppress(OSError):
            output.rmdir()   # if it is empty
    mapping = {**result.to_mapping(), 'estimate_frame': system.poses_of}
    atomic_write(output / 'result.json', json_text(mapping) + '\n', SlamError)
    judged = not math.isnan(result.ate_m)
    if as_json:
        print_json(mapping)
        if judged:
            check_bounds(result.ate_m, result.tracked_share, max_ate, min_tracked)
        return 0 if judged else 1
    if result.reason:
        say(result.reason)
    say(f'{result.system} {result.sensor}: tracked {100 * result.tracked_share:.1f} % of '
        f'{result.frames} frames, ' + (f'scale {result.scale:.4f}, ' if judged else '')
        + f'{result.wall_s:.1f} s')
    if result.words:
        say(result.words)
    if result.nees_position == result.nees_position:
        say(f'NEES per degree of freedom: position {result.nees_position:.2f}, orientation '
            f'{result.nees_orientation:.2f}; covariances are in {output / COVARIANCE}')
    if anchor is not None:
        say('no place was found on the map from orbit: the estimate is lost on the site'
            if not result.fixes > 0 else
            f'first fix after {result.first_fix_m:.1f} m; {result.fixes:.0f} fixes, '
            f'{result.false_fixes:.0f} false; horizontal error from then on '
            f'{result.absolute_median_m:.2f} m in the median, {result.absolute_p95_m:.2f} m at '
            f'p95; {output / LIVE} has what was told at the time')
    if (output / ESTIMATE).is_file():
        say(f'{output / ESTIMATE} (TUM) has the poses of the frame {system.poses_of}; '
            'result.json beside it')
    if not judged:
        raise SlamError(f'no trajectory to judge; the log is in {output}')
    say(f'done: ATE {result.ate_m:.4f} m, {result.ate_percent:.2f} % of '
        f'{result.distance_m:.2f} m; figure: {output / TOP_VIEW}')
    check_bounds(result.ate_m, result.tracked_share, max_ate, min_tracked)
    return 0


def _anchor(system: Estimator, orbital: Path | None, near: tuple[float, float] | None,
            doubt_m: float | None) -> Anchor | None:
    radius_m = options.checked_doubt(orbital, near, doubt_m)
    if orbital is None:
        return None
    if system.system != 'graph':
        raise ConfigError(f'--orbital: is for --system graph, and the system is {system.system}')
    if near is None:
        raise ConfigError('--orbital: needs --near X,Y, a place that the start is near to')
    return Anchor(OrbitalMap.load(orbital), Doubt(near, radius_m))


@options.command()
@options.argument('folder', 'the folder of a finished benchmark', type=options.PATH, metavar='DIR')
@_file
@click.option('--name', default='benchmark', metavar='TEXT', help='of the benchmark')
@options.bounded('--version', 1, kind=int, default=1, help='of the benchmark')
def seal(folder: Path, output: Path, name: str, version: int) -> int:
    """Seal a benchmark: `benchmark --sealed FILE` then makes, verifies and scores its drives.

    The seal names scenarios, seeds, duration and settings, and holds hashes of worlds and motion,
    grey levels of images, and the scores of the estimators in the folder.
    """
    options.refuse_existing(output, option=False)
    text = write_seal(folder, name, version)
    atomic_write(output, text, SlamError)
    say(output)
    return 0


@options.command()
@options.argument('sources', 'the folder of a benchmark, or a CSV of drives (SYSTEM_drives.csv)',
                  nargs=-1, required=True, type=options.PATH, metavar='PART...')
@options.folder('folder for the table; an older one in it is replaced')
@paper_option
def table(sources: Sequence[Path], output: Path, paper: Path | None) -> int:
    """Make one table of the parts of a benchmark that ran on several machines.

    Writes table.md, .csv, .tex, .html and table_drives.csv; of a sweep table.png.
    """
    judged = join(sources)
    published = paper_of(paper, judged[0].drive.parameter)
    output.mkdir(parents=True, exist_ok=True)
    text, lines = write_report(judged, output, 'table', published)
    print(text)
    for line in lines:
        say(line)
    return 0
