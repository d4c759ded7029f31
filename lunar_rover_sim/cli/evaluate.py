"""`lunar_rover_sim evaluate`: an estimated trajectory, a drive, its maps, and sets of images."""

from __future__ import annotations

from pathlib import Path

import click
from rich.text import Text

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.results import json_text
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_json, print_table, Progress, say
from lunar_rover_sim.judge.evaluation.drive_evaluation import evaluate_drive
from lunar_rover_sim.judge.evaluation.image_comparison import (compare_images, DISTANCE,
                                                               ImageComparison, MOST_IMAGES,
                                                               save_comparison)
from lunar_rover_sim.judge.evaluation.image_statistics import MEASURES
from lunar_rover_sim.judge.evaluation.map_evaluation import CELL_M, evaluate_maps, NEAR_M, Rates
from lunar_rover_sim.judge.evaluation.registration import (DEFAULT_TOLERANCE_S, MODES,
                                                           MOST_TOLERANCE_S)
from lunar_rover_sim.judge.evaluation.statistics import Difference, SeriesMean
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate, Evaluation
from lunar_rover_sim.judge.evaluation.trajectory_files import bag_of, load, write_tum_covariance
from lunar_rover_sim.judge.evaluation.trajectory_plots import save_plots
from lunar_rover_sim.run.recorded_run import FRAMES

TOLD = 'estimate_covariance.txt'
_ODD_SCALE = 0.1     # of a metric estimate that is no failure, the scale is nearer to 1


def bounds(function: options.Function) -> options.Function:
    """Declare --max-ate and --min-tracked; see `check_bounds`."""
    for option in (
            options.bounded('--min-tracked', 0.0, 1.0, metavar='SHARE',
                            help='exit with 1 if a smaller share of the drive is tracked'),
            options.bounded('--max-ate', 0.0, above=True, unit='m', metavar='M',
                            help='exit with 1 if the ATE is larger')):
        function = option(function)
    return function


def check_bounds(ate_m: float, tracked_share: float, max_ate: float | None,
                 min_tracked: float | None) -> None:
    """Raise EvaluationError if a result is worse than a bound; None is no bound."""
    if max_ate is not None and not ate_m <= max_ate:
        raise EvaluationError(f'ATE is {ate_m:.4f} m; --max-ate asks for at most {max_ate:g} m')
    if min_tracked is not None and not tracked_share >= min_tracked:
        raise EvaluationError(f'tracked is {tracked_share:.3f} of the drive; --min-tracked asks '
                              f'for at least {min_tracked:g}')


@options.command()
@options.argument('truth', 'file, BAG or BAG:TOPIC', metavar='GROUND_TRUTH')
@options.argument('estimate', 'file or BAG:TOPIC', metavar='ESTIMATE')
@click.option('--align', type=options.Choice(MODES), default='se3',
              help='how the estimate is brought onto the truth')
@click.option('--truth-frame', type=options.Choice(tuple(FRAMES)), default='base',
              help='the frame of the rover that the truth is of')
@click.option('--estimate-frame', type=options.Choice(tuple(FRAMES)), default='base',
              help='the frame of the rover that the estimate is of; that of ORB-SLAM3 is left, '
              'with an IMU imu')
@options.bounded('--tolerance', 0.0, MOST_TOLERANCE_S, unit='s', default=DEFAULT_TOLERANCE_S,
                 metavar='S', help='largest distance in time between an estimated and a true pose')
@options.bounded('--distance', 0.0, above=True, unit='m', default=1.0, metavar='M',
                 help='distance between the poses of a pair for RPE')
@options.bounded('--time', 0.0, above=True, unit='s', default=1.0, metavar='S',
                 help='time between the poses of a pair for RPE')
@click.option('--times', type=options.PATH, metavar='FILE',
              help='stamps of KITTI files, one a line')
@options.folder('folder for evaluation.json, plots and, of an estimate with covariances, '
                f'{TOLD} (TUM and 21 columns)', required=False)
@bounds
@options.as_json
def trajectory(truth: str, estimate: str, align: str, truth_frame: str, estimate_frame: str,
               tolerance: float, distance: float, time: float, times: Path | None,
               output: Path | None, max_ate: float | None, min_tracked: float | None,
               as_json: bool) -> int:
    """Judge an estimated trajectory against the truth.

    Prints ATE, RPE, drift, scale, tracked share and consistency (NEES). Inputs are files of TUM,
    EuRoC or KITTI, a bag, or BAG:TOPIC.
    """
    result = evaluate(truth, estimate, align=align, truth_frame=truth_frame,
                      estimate_frame=estimate_frame, tolerance_s=tolerance, distance_m=distance,
                      time_s=time, times=times)
    written: tuple[Path, ...] = ()
    if output is not None:
        json_path = output / 'evaluation.json'
        paths = save_plots(result, output, bag_of(truth))
        atomic_write(json_path, json_text(result.to_mapping()) + '\n', EvaluationError)
        written = (json_path, *paths)
        told = load(estimate, times)
        if told.covariances is not None:
            write_tum_covariance(output / TOLD, told)
            written = (*written, output / TOLD)
    if as_json:
        print_json(result.to_mapping())
        check_bounds(result.ate_m.rmse, result.tracked_share, max_ate, min_tracked)
        return 0
    errors = {f'ATE [m], {align}': result.ate_m, 'ATE [deg]': result.ate_deg,
              f'RPE over {distance:g} m [m]': result.rpe_distance_m,
              f'RPE over {distance:g} m [deg]': result.rpe_distance_deg,
              f'RPE over {time:g} s [m]': result.rpe_time_m,
              f'RPE over {time:g} s [deg]': result.rpe_time_deg}
    print_table(('', 'rmse', 'mean', 'median', 'max', 'n'), 1, (
        (Text(name), *(_number(v, 5) for v in (s.rmse, s.mean, s.median, s.max)), str(s.count))
        for name, s in errors.items()), box=None, pad_edge=False)
    say(f'scale {_number(result.scale, 5)}, drift {_number(result.drift_percent, 2)} % '
        f'of distance (at the end {_number(result.end_drift_percent, 2)} %), '
        f'{result.length_m:.2f} m, tracked {100 * result.tracked_share:.1f} %, '
        f'{len(result.estimate)} poses, {result.unmatched} without truth')
    _say_more(result)
    if jumps := result.jumps:
        stamp_s, size_m = max(jumps, key=lambda jump: jump[1])
        count = 'once,' if len(jumps) == 1 else f'{len(jumps)} times, most'
        say(f'note: the estimate jumps {count} at {stamp_s:.2f} s by {size_m:.2f} m: a map '
            'that was moved, or another one; the errors take all of it as one')
    elif result.turned_deg is not None:
        say(f'note: all orientations are off by the same {result.turned_deg:.0f} deg; '
            'is --estimate-frame (or --truth-frame) right?')
    if align != 'sim3' and abs(result.scale - 1.0) > _ODD_SCALE:
        say('note: the estimate has another scale than the truth; for the estimate of one camera '
            'alone, which knows no scale, --align sim3 takes it out')
    for path in written:
        say(path)
    check_bounds(result.ate_m.rmse, result.tracked_share, max_ate, min_tracked)
    return 0


def _say_more(result: Evaluation) -> None:
    """Print errors over distance, and, of an estimate with covariances, its consistency."""
    if result.over_distance:
        print_table(('over', 'error [m]', '[%]', '[deg]', 'pairs'), 1, (
            (Text(f'{e.distance_m:g} m'), _number(e.error_m, 5), _number(e.error_percent, 2),
             _number(e.error_deg, 3), str(e.pairs)) for e in result.over_distance),
            box=None, pad_edge=False)
    if (told := result.consistency) is not None:
        for name, nees in (('position', told.position), ('orientation', told.orientation)):
            say(f'NEES per degree of freedom, {name}: {_number(nees.per_dof, 2)}; consistent is '
                f'{nees.low:.2f} to {nees.high:.2f} for one drive, '
                f'{100 * nees.share_inside:.0f} % of {nees.poses} poses are in it')
        say(f'the first pose is exact in {told.frame}')
    if (found := result.fixes) is not None:
        say(f'first fix after {_number(found.first_s, 1)} s and {_number(found.first_m, 1)} m; '
            f'{found.count} fixes, {found.false} of them false; horizontal error from then on '
            f'{_number(found.error_median_m, 2)} m in the median, '
            f'{_number(found.error_p95_m, 2)} m at p95')


def _number(value: float, digits: int) -> str:
    return f'{value:.{digits}f}' if value == value else '-'


@options.command()
@options.bag('recording with true odometry')
@options.world('of the drive, where it is not beside the bag or in the cache', 'FOLDER')
@options.as_json
def drive(bag: Path, world: Path | None, as_json: bool) -> int:
    """Judge how a rover drove: incidents a kilometre, unknown ground, stops.

    Incidents are tilts beyond 45 deg, roll-overs, and contacts of the body.
    """
    result = evaluate_drive(bag, world)
    if as_json:
        print_json(result.to_mapping())
        return 0
    print_table(('incident', 'times', 'a kilometre'), 1,
                ((kind, str(count), f'{result.per_km(kind):.1f}')
                 for kind, count in result.incidents.items()))
    unknown = '' if result.unknown_m != result.unknown_m else \
        f', {result.unknown_m:.2f} m of it over ground that its map did not know'
    say(f'{result.distance_m:.1f} m in {result.duration_s:.0f} s{unknown}')
    if result.seen_m < 0.99 * result.distance_m:
        say(f'note: contacts are known of {result.seen_m:.1f} m, where the world is found')
    if result.end:
        stops = ', '.join(f'{count} x {kind}' for kind, count in result.stops.items())
        plans = f'; plans over the map from orbit: {result.plans}' if result.plans else ''
        say(f'stops: {stops}; stood for {result.standing_s:.0f} s{plans}')
        say(f'end: {result.end}')
    return 0


@options.command(help=f"""Judge the maps of a recorded drive against its world.

    Prints errors of elevation and of flags of rocks, in cells of {100 * CELL_M:g} cm, by distance
    from the rover.""")
@options.bag('recording with map/elevation')
@options.world('of the drive, where it is not beside the bag or in the cache', 'FOLDER')
@options.bounded('--maps', 1, kind=int, default=40,
                 help='maps that are judged, spread over the drive')
@options.folder('folder for map_evaluation.json and a picture', required=False)
@options.as_json
def map_(bag: Path, world: Path | None, maps: int, output: Path | None, as_json: bool) -> int:
    """Judge, print a table, write results."""
    picture = None if output is None else output / 'map_evaluation.png'
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
    result = evaluate_maps(bag, world, maps, picture)
    if output is not None:
        atomic_write(output / 'map_evaluation.json',
                     json_text(result.to_mapping()) + '\n', EvaluationError)
    if as_json:
        print_json(result.to_mapping())
        return 0
    print_table(('distance [m]', 'cells', 'RMS [m]', 'median [m]', 'precision', 'recall',
                 'beyond 3 σ [%]'), 1, map(_row, (*result.by_distance, result.near)))
    say(f'{result.maps} maps, sun at {result.sun_deg:g} deg; the last row is all within '
        f'{NEAR_M:g} m; rocks count from {result.rock_m:.3f} m on; median error '
        f'{result.offset_m:+.4f} m; '
        f'{100.0 * result.beyond_3_sigma:.1f} % of the cells are off by more than 3 of their '
        'stated deviations')
    if picture is not None:
        say(picture)
    return 0


def _row(rates: Rates) -> tuple[str, ...]:
    return (f'{rates.low_m:g} to {rates.high_m:g}', str(rates.cells), _number(rates.rms_m, 4),
            _number(rates.median_m, 4), _number(rates.precision, 2), _number(rates.recall, 2),
            _number(100.0 * rates.beyond_3_sigma, 2))


JSON_FILE, FIGURE_FILE = 'comparison.json', 'comparison.png'


@options.command()
@options.argument('first', 'set of images', metavar='A')
@options.argument('second', 'set of images', metavar='B')
@click.option('--frames', type=int, default=MOST_IMAGES, metavar='N',
              help='images of each set, evenly over it')
@click.option('--width', type=int, metavar='PX',
              help='scale images down to this width (default: that of the narrower set)')
@options.seed(1, 'seed of the resampling')
@options.folder(f'folder for {JSON_FILE} and {FIGURE_FILE}', required=False)
def images(first: str, second: str, frames: int, width: int | None, seed: int,
           output: Path | None) -> int:
    """Compare two sets of images.

    By gradients, spectrum, shadow, ORB and matching, with 95 % intervals. A set is a bag, a
    sequence, LuSNAR, POLAR, or a folder of pictures.
    """
    with Progress('measuring') as progress:
        result = compare_images(first, second, frames=frames, width_px=width,
                                seed=seed, progress=progress.advance)
    _print_images(result)
    if output is not None:
        path = output / JSON_FILE
        save_comparison(result, output / FIGURE_FILE)
        atomic_write(path, json_text(result.to_mapping()) + '\n', EvaluationError)
        for written in (path, output / FIGURE_FILE):
            say(written)
    return 0


def _print_images(result: ImageComparison) -> None:
    for name, one in (('A', result.first), ('B', result.second)):
        say(f'{name}: {one.images.path} ({one.images.layout}, {len(one.values)} of '
            f'{one.images.total})')
    say(f'compared at a width of {result.width_px} px'
        f'{", image by image (the names are the same)" if result.paired else ""}, '
        '95 % intervals; q is p corrected for the number of rows')
    rows = [(Text(row.name), _value(row.first), _value(row.second), _value(row.difference),
             _p(row.difference.p), _p(q), f'{row.first.n}, {row.second.n}')
            for row, q in zip(result.rows, result.q) if row.first.n or row.second.n]
    distance = result.distance
    rows.append((Text(DISTANCE), '', '', _value(distance), _p(distance.p),
                 _p(result.q[-1]), f'{len(result.first.values)}, {len(result.second.values)}'))
    print_table(('', 'A', 'B', 'B - A', 'p', 'q', 'n'), 1, rows, box=None, pad_edge=False)
    if result.chance == result.chance:
        say(f'{DISTANCE}: Wasserstein, in decades; images shuffled between the sets '
            f'reach {result.chance:.3g}')
    if resembling := result.resembling:
        say('neighbouring images resemble each other: intervals and p of '
            f'{", ".join(resembling)} are too small (correlation up to '
            f'{max(resembling.values()):.1f}); compare fewer images by --frames, or more '
            'drives')
    missing = [row.name for row in result.rows if not row.first.n or not row.second.n]
    if missing:
        say(f'not in both sets: {", ".join(missing)} (pairs or truth are missing)')
    for row in result.rows:
        say(f'{row.name}: {MEASURES[row.name]}')


def _value(found: SeriesMean | Difference) -> str:
    if found.value != found.value:
        return '-'
    text = _short(found.value)
    return text if found.low != found.low else (
        f'{text} [{_short(found.low)}, {_short(found.high)}]')


def _short(value: float) -> str:
    return f'{value:.0f}' if abs(value) >= 1000.0 else f'{value:.3g}'


def _p(p: float) -> str:
    return '-' if p != p else '< 0.002' if p < 0.002 else f'{p:.3f}'
