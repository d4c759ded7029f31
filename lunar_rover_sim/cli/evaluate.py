"""`lunar_rover_sim evaluate`: an estimated trajectory against the truth."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.text import Text

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.results import json_text
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_json, print_table, say
from lunar_rover_sim.judge.evaluation.registration import MODES
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.judge.evaluation.trajectory_plots import save_plots
from lunar_rover_sim.judge.evaluation.trajectory_sources import bag_of
from lunar_rover_sim.run.recorded_run import FRAMES

_ODD_SCALE = 0.1     # of a metric estimate that is no failure, the scale is nearer to 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'ATE, RPE, drift, scale and tracked share of an estimated trajectory. Inputs '
        'are TUM, EuRoC or KITTI files, a bag (its odometry), or BAG:TOPIC.')
    parser.add_argument('truth', metavar='GROUND_TRUTH', help='file, BAG or BAG:TOPIC')
    parser.add_argument('estimate', metavar='ESTIMATE', help='file or BAG:TOPIC')
    parser.add_argument('--align', choices=MODES, default='se3',
                        help='how the estimate is brought onto the truth (default: %(default)s)')
    parser.add_argument('--truth-frame', choices=tuple(FRAMES), default='base',
                        help='the frame of the rover that the truth is of (default: '
                             '%(default)s)')
    parser.add_argument('--estimate-frame', choices=tuple(FRAMES), default='base',
                        help='the frame of the rover that the estimate is of; that of ORB-SLAM3 '
                             'is left, with an IMU imu (default: %(default)s)')
    parser.add_argument('--tolerance', type=float, default=0.02, metavar='S',
                        help='largest distance in time between an estimated and a true pose [s] '
                             '(default: %(default)s)')
    parser.add_argument('--distance', type=float, default=1.0, metavar='M',
                        help='distance between the poses of a pair for RPE [m] (default: '
                             '%(default)s)')
    parser.add_argument('--time', type=float, default=1.0, metavar='S',
                        help='time between the poses of a pair for RPE [s] (default: %(default)s)')
    parser.add_argument('--times', type=Path, metavar='FILE',
                        help='stamps of KITTI files, one a line')
    options.add_folder(parser, 'folder for evaluation.json and plots', required=False)
    options.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Evaluate, print a table, write results."""
    result = evaluate(args.truth, args.estimate, align=args.align, truth_frame=args.truth_frame,
                      estimate_frame=args.estimate_frame, tolerance_s=args.tolerance,
                      distance_m=args.distance, time_s=args.time, times=args.times)
    written: tuple[Path, ...] = ()
    if args.output is not None:
        json_path = args.output / 'evaluation.json'
        paths = save_plots(result, args.output, bag_of(args.truth))
        atomic_write(json_path, json_text(result.to_mapping()) + '\n', EvaluationError)
        written = (json_path, *paths)
    if args.json:
        print_json(result.to_mapping())
        return 0
    errors = {f'ATE [m], {args.align}': result.ate_m, 'ATE [deg]': result.ate_deg,
              f'RPE over {args.distance:g} m [m]': result.rpe_distance_m,
              f'RPE over {args.distance:g} m [deg]': result.rpe_distance_deg,
              f'RPE over {args.time:g} s [m]': result.rpe_time_m,
              f'RPE over {args.time:g} s [deg]': result.rpe_time_deg}
    print_table(('', 'rmse', 'mean', 'median', 'max', 'n'), 1, (
        (Text(name), *(_number(v, 5) for v in (s.rmse, s.mean, s.median, s.max)), str(s.count))
        for name, s in errors.items()), box=None, pad_edge=False)
    say(f'scale {_number(result.scale, 5)}, drift {_number(result.drift_percent, 2)} % '
        f'of distance (at the end {_number(result.end_drift_percent, 2)} %), '
        f'{result.length_m:.2f} m, tracked {100 * result.tracked_share:.1f} %, '
        f'{len(result.estimate)} poses, {result.unmatched} without truth')
    if jumps := result.jumps:
        stamp_s, size_m = max(jumps, key=lambda jump: jump[1])
        times = 'once,' if len(jumps) == 1 else f'{len(jumps)} times, most'
        say(f'note: the estimate jumps {times} at {stamp_s:.2f} s by {size_m:.2f} m: a map '
            'that was moved, or another one; the errors take all of it as one')
    elif result.turned_deg is not None:
        say(f'note: all orientations are off by the same {result.turned_deg:.0f} deg; '
            'is --estimate-frame (or --truth-frame) right?')
    if args.align != 'sim3' and abs(result.scale - 1.0) > _ODD_SCALE:
        say('note: the estimate has another scale than the truth; for the estimate of one camera '
            'alone, which knows no scale, --align sim3 takes it out')
    for path in written:
        say(path)
    return 0


def _number(value: float, digits: int) -> str:
    return f'{value:.{digits}f}' if value == value else '-'
