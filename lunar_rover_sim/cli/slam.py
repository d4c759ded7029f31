"""`lunar_rover_sim slam`: what SLAM programs need, and running them."""

from __future__ import annotations

import argparse
from contextlib import suppress
import math
from pathlib import Path

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import check_file, config_path, make_new_folder
from lunar_rover_sim.base.files.results import json_text
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_json, Progress, say
from lunar_rover_sim.judge.evaluation.trajectory_plots import TOP_VIEW
from lunar_rover_sim.judge.slam.benchmark_report import write_report
from lunar_rover_sim.judge.slam.drives import join
from lunar_rover_sim.judge.slam.estimators import Estimator, stock_program, SYSTEMS
from lunar_rover_sim.judge.slam.run_on_bag import ESTIMATE, run_on_bag
from lunar_rover_sim.judge.slam.table import Paper, read_paper
from lunar_rover_sim.judge.slam.vocabulary import descriptors, open_sets, train
from lunar_rover_sim.products.sequences.orbslam3_settings import SENSORS, settings
from lunar_rover_sim.products.sequences.sensors import described_sensors, recorded_sensors
from lunar_rover_sim.run.scenario import Scenario

_DESCRIPTORS_PER_WORD = 3      # fewer, and most leaves of the tree hold one


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the commands."""
    group = parser.add_subparsers(metavar='WHAT', required=True)
    command = options.add_action(
        group, 'settings', 'write the settings file of ORB-SLAM3 for a bag or a scenario',
        _settings)
    command.add_argument('source', metavar='BAG|SCENARIO', help='a bag, or a scenario by name or '
                                                                'file')
    options.add_output(command, check_file, 'FILE', 'YAML file to write; must not exist')
    _add_sensor(command)
    command.add_argument('--features', type=int, default=2000, metavar='N',
                         help='keypoints per image (default: %(default)s)')
    command.add_argument('--legacy', action='store_true',
                         help='the layout before File.version 1.0')
    command = options.add_action(
        group, 'run', 'run a SLAM program on a bag and evaluate its result', _run)
    options.add_bag(command)
    options.add_new_folder(command, 'folder for settings, log and results')
    _add_sensor(command)
    command.add_argument('--keep-sequence', action='store_true', help='keep the exported images')
    command.add_argument('--quiet', action='store_true', help='do not show the log of the program')
    options.add_json(command)
    add_system_arguments(command)
    text = 'train the vocabulary of ORB-SLAM2 and ORB-SLAM3 on images'
    command = options.add_action(group, 'train-vocabulary', text, _train, (
        'Train a vocabulary of ORB descriptors in the text format of DBoW2, as ORB-SLAM2 and '
        'ORB-SLAM3 read it, on the left images of bags, sequences, or folders of pictures.'))
    command.add_argument('images', type=Path, nargs='+', metavar='IMAGES',
                         help='a bag, a run, a sequence, or a folder of pictures')
    options.add_output(command, check_file, 'FILE', 'text file to write; must not exist')
    command.add_argument('--branching', type=int, default=10, metavar='K',
                         help='clusters of a node, 2 to 20 (default: %(default)s)')
    command.add_argument('--levels', type=int, default=6, metavar='L',
                         help='how often clusters are divided, 1 to 10; ORB-SLAM compares '
                              'features within clusters of level L - 4 (default: %(default)s)')
    command.add_argument('--features', type=int, default=1000, metavar='N',
                         help='keypoints per image (default: %(default)s)')
    command.add_argument('--frames', type=int, default=500, metavar='N',
                         help='most images of each of IMAGES, evenly over it (default: '
                              '%(default)s)')
    options.add_seed(command, 1, 'seed of the clusters')
    text = 'one table of the parts of a benchmark that ran on several machines'
    command = options.add_action(group, 'table', text, _table, (
        'Join the results of benchmarks, finished or not, and write table.md, .csv, .tex and '
        '.html, the findings, and table_drives.csv, every drive; of a sweep also table.png, its '
        'curves. Parts of several systems stand beside each other.'))
    command.add_argument('sources', type=Path, nargs='+', metavar='PART',
                         help='the folder of a benchmark, or a CSV of drives (SYSTEM_drives.csv)')
    options.add_folder(command, 'folder for the table; an older one in it is replaced')
    add_paper_argument(command)


def _add_sensor(command: argparse.ArgumentParser) -> None:
    command.add_argument('--sensor', choices=SENSORS, default='stereo',
                         help='input of the program (default: %(default)s)')


def add_paper_argument(parser: argparse.ArgumentParser) -> None:
    """Declare the argument that names published numbers; see `paper_of`."""
    parser.add_argument('--paper', type=Path, metavar='FILE',
                        help='published numbers for comparison, YAML: scenario: {sensor: {ate_m: '
                             'number, scale: number}} (default: those of the three scenarios in '
                             'config/published_slam.yaml; in a sweep, none)')


def paper_of(path: Path | None, parameter: str) -> Paper | None:
    """Return the published numbers of a file, or of the packaged one unless it is a sweep."""
    if path is None and not parameter:
        path = config_path('published_slam.yaml')
    return read_paper(path) if path is not None else None


def add_system_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments that choose an estimator and its options."""
    parser.add_argument('--system', choices=SYSTEMS, default='reference',
                        help='estimator (default: %(default)s)')
    parser.add_argument('--executable', type=Path, metavar='PATH',
                        help='of ORB-SLAM3: stereo_euroc, mono_euroc, rgbd_tum, ..., or their '
                             'folder; or a Python that has the wheel pyorbslam3')
    parser.add_argument('--vocabulary', type=Path, metavar='PATH', help='of ORB-SLAM3')
    parser.add_argument('--run', default='', metavar='COMMAND', dest='command',
                        help='of the system `command`: with {sequence} (EuRoC), {settings}, '
                             '{times}, {sensor} and {out}, the TUM file to write')
    parser.add_argument('--estimate-frame', choices=('base', 'imu', 'left', 'right'), default='',
                        help='frame of the rover whose poses are estimated (default: left; imu '
                             'for stereo-inertial)')
    parser.add_argument('--features', type=int, default=2000, metavar='N',
                        help='keypoints per image of ORB-SLAM3 (default: %(default)s)')
    parser.add_argument('--timeout', type=float, default=0.0, metavar='S',
                        help='longest time of a run [s] (default: ten times the sequence and 2 '
                             'min)')


def estimator_of(args: argparse.Namespace, sensor: str) -> Estimator:
    """Return the estimator that the arguments ask for."""
    return Estimator(args.system, sensor, stock_program(args.executable, sensor), args.vocabulary,
                     args.command, args.estimate_frame, args.features, args.timeout)


def _run(args: argparse.Namespace) -> int:
    estimator = estimator_of(args, args.sensor)
    make_new_folder(args.output)
    try:
        with Progress('reading the bag') as progress:
            result = run_on_bag(
                args.bag, estimator, args.output, None if args.quiet or args.json else say,
                progress.start, progress.advance,
                args.output / 'sequence' if args.keep_sequence else None, plots=True)
    finally:
        with suppress(OSError):
            args.output.rmdir()   # if it is empty
    mapping = {**result.to_mapping(), 'estimate_frame': estimator.poses_of}
    atomic_write(args.output / 'result.json', json_text(mapping) + '\n', SlamError)
    judged = not math.isnan(result.ate_m)
    if args.json:
        print_json(mapping)
        return 0 if judged else 1
    if result.reason:
        say(result.reason)
    say(f'{result.system} {result.sensor}: tracked {100 * result.tracked_share:.1f} % of '
        f'{result.frames} frames, ' + (f'scale {result.scale:.4f}, ' if judged else '')
        + f'{result.wall_s:.1f} s')
    if (args.output / ESTIMATE).is_file():
        say(f'{args.output / ESTIMATE} (TUM) has the poses of the frame {estimator.poses_of}; '
            'result.json beside it')
    if not judged:
        raise SlamError(f'no trajectory to judge; the log is in {args.output}')
    say(f'done: ATE {result.ate_m:.4f} m, {result.ate_percent:.2f} % of '
        f'{result.distance_m:.2f} m; figure: {args.output / TOP_VIEW}')
    return 0


def _train(args: argparse.Namespace) -> int:
    sets = open_sets(args.images, args.frames)
    with Progress('reading images', sum(found.total for found in sets), 'images') as progress:
        images = []
        for one in descriptors(sets, args.features):
            images.append(one)
            progress.advance()
        progress.start('clustering', 1.0, '%')
        vocabulary = train(images, args.branching, args.levels, args.seed, progress)
    options.refuse_existing(args.output, option=False)
    atomic_write(args.output, vocabulary.text(), SlamError)
    words, count = int(vocabulary.is_word.sum()), sum(map(len, images))
    say(f'{args.output}: {words} words of {count} descriptors of {len(images)} images')
    if count < _DESCRIPTORS_PER_WORD * words:
        say('note: a word needs a few descriptors to mean something; give more images, or fewer '
            f'--levels than {args.levels}')
    return 0


def _table(args: argparse.Namespace) -> int:
    judged = join(args.sources)
    paper = paper_of(args.paper, judged[0].drive.parameter)
    args.output.mkdir(parents=True, exist_ok=True)
    report = write_report(judged, args.output, 'table', paper)
    for line in (report.table, *report.findings, *map(str, report.files)):
        say(line)
    return 0


def _settings(args: argparse.Namespace) -> int:
    source, has_depth = Path(args.source), args.sensor == 'rgbd'
    if source.is_dir() or source.suffix in ('.mcap', '.db3'):
        with open_bag(source) as bag:
            suite = recorded_sensors(bag, (topics.TRUE_DEPTH.name,) if has_depth else ())
    else:
        scenario = Scenario.load(args.source)
        render = scenario.render_node
        suite = described_sensors(
            scenario.rover, render.camera, scenario.physics_node.imu,
            render.frame_rate_hz / (render.depth_every if has_depth else 1),
            scenario.physics_node.state_rate_hz, scenario.physics_node.gravity_mps2)
    text = settings(suite, args.sensor, args.legacy, args.features)
    options.refuse_existing(args.output, option=False)
    atomic_write(args.output, text, SlamError)
    say(args.output)
    return 0
