"""`lunar_rover_sim bag video`: a film of a recorded drive."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import dataclasses
from pathlib import Path

from lunar_rover_sim.camera.chase import ChaseConfig, HEADING, SAMPLES, SUN, TRIPOD, tripod_problem
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.options import numbers
from lunar_rover_sim.cli.terminal import Progress, say
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.film_file import check_suffix, SUFFIXES, U8, write_film
from lunar_rover_sim.files.paths import check_path
from lunar_rover_sim.inspection.film import Film, FilmOptions

_QUALITY = 70


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    options.add_output(parser, _check_output, 'FILE',
                       f'the film: {", ".join(SUFFIXES)}; must not exist')
    parser.add_argument('--width', type=int, default=1280, metavar='PX', help='of the film, a '
                        'multiple of 32; it is 4:3, and 16:9 with --bare (default: 1280)')
    parser.add_argument('--fps', type=float, default=20.0, metavar='HZ',
                        help='frames per second of the film (default: 20)')
    parser.add_argument('--speed', type=float, default=1.0, metavar='FACTOR',
                        help='simulated seconds per second of the film (default: 1)')
    parser.add_argument('--start', type=float, metavar='S', help='first simulated time')
    parser.add_argument('--end', type=float, metavar='S', help='last simulated time')
    parser.add_argument('--bare', action='store_true',
                        help='only the view from outside, without images and plots')
    parser.add_argument('--samples', type=int, default=SAMPLES, metavar='N', help='along a side '
                        'of a pixel of the view from outside, 1 to 4; 1 is three times as fast, '
                        f'and thin parts of the rover look dashed (default: {SAMPLES})')
    parser.add_argument('--behind', action='store_true', help='from behind the rover; by default '
                        'from where the sun lights it from the side')
    parser.add_argument('--from', metavar='DISTANCE,AZIMUTH,ELEVATION', dest='place',
                        type=numbers(3), help='where the camera is [m, deg, deg], by default '
                        '1.5,-112,17; the azimuth counts from the sun, with --behind from the '
                        'heading')
    parser.add_argument('--tripod', metavar='X,Y,HEIGHT', type=numbers(3),
                        help='the camera stands there and turns after the rover [m]')
    options.add_number(parser, '--quality', 1, 100, kind=int,
                       help=f'of a .webp, 1 to 100 (default: {_QUALITY})')
    options.add_recorded_world(parser)


def _check_output(path: Path) -> None:
    check_suffix(path)
    check_path(path)
    options.refuse_existing(path, option=False)


def run(args: argparse.Namespace) -> int:
    """Draw and write the film."""
    quality = _QUALITY if args.quality is None else args.quality
    if args.quality is not None and args.output.suffix != '.webp':
        raise ConfigError(f'--quality: has no effect on a {args.output.suffix}; valid is a .webp')
    for option, given in (('--behind', args.behind), ('--from', args.place is not None)):
        if args.tripod is not None and given:
            raise ConfigError(f'{option}: has no effect beside --tripod; leave one of them out')
    options = FilmOptions(args.width, args.fps, args.speed, args.start, args.end, args.bare,
                          args.samples)
    with Progress('reading the drive') as progress:
        film = Film(args.bag, options, args.world)
        film.chase = _camera(film, args)
        progress.start('drawing', len(film.times_ns), 'frames')
        args.output.parent.mkdir(parents=True, exist_ok=True)

        def drawn() -> Iterator[U8]:
            for frame in film.frames():
                yield frame
                progress.advance()

        count = write_film(args.output, drawn(), args.fps, quality)
    say(f'{args.output}: {count} frames, {count / args.fps:.1f} s, '
        f'{args.output.stat().st_size / 1e6:.2f} MB')
    return 0


def _camera(film: Film, args: argparse.Namespace) -> ChaseConfig:
    """Return the chase camera that is asked for. Raises ConfigError where it cannot be."""
    chase = film.chase
    if args.behind:
        chase = dataclasses.replace(chase, reference=HEADING, azimuth_deg=180.0)
    if args.place is not None:
        distance_m, azimuth_deg, elevation_deg = args.place
        try:
            chase = dataclasses.replace(chase, distance_m=distance_m, azimuth_deg=azimuth_deg,
                                        elevation_deg=elevation_deg,
                                        reference=HEADING if args.behind else SUN)
        except ConfigError as error:
            raise ConfigError(f'--from: {error}') from None
    if args.tripod is not None:
        try:
            chase = dataclasses.replace(chase, mode=TRIPOD, position_m=args.tripod)
        except ConfigError as error:
            raise ConfigError(f'--tripod: {str(error).removeprefix("position_m: ")}') from None
        problem = tripod_problem(args.tripod, film.world)
        if problem:
            raise ConfigError(f'--tripod: {problem}')
    return chase
