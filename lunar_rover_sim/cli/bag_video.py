"""`lunar_rover_sim bag video`: a film of a recorded drive."""

from __future__ import annotations

from collections.abc import Iterator
import dataclasses
from pathlib import Path

import click

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.film_file import check_rate, check_suffix, SUFFIXES, U8, write_film
from lunar_rover_sim.base.files.paths import check_path
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import Progress, say
from lunar_rover_sim.image.camera.chase import ChaseConfig, HEADING, SUN, TRIPOD, tripod_problem
from lunar_rover_sim.products.inspection.film import Film, FilmOptions

_QUALITY = 70


def _check_output(path: Path) -> None:
    check_suffix(path)
    check_path(path)
    options.refuse_existing(path, option=False)


@options.command()
@options.bag()
@options.output(_check_output, 'FILE', f'the film: {", ".join(SUFFIXES)}; must not exist')
@click.option('--width', type=int, default=1280, metavar='PX', help='of the film, a multiple of '
              '32; it is 4:3, and 16:9 with --bare')
@click.option('--fps', type=float, default=20.0, metavar='HZ',
              help='frames per second of the film')
@click.option('--speed', type=float, default=1.0, metavar='FACTOR',
              help='simulated seconds per second of the film')
@click.option('--start', type=float, metavar='S', help='first simulated time')
@click.option('--end', type=float, metavar='S', help='last simulated time')
@click.option('--bare', is_flag=True, help='only the view from outside, without images and plots')
@click.option('--samples', type=int, default=1, metavar='N', help='along a side of a pixel of the '
              'view from outside, 1 to 4; 2 draws thin parts of the rover whole, in three times '
              'the time')
@click.option('--behind', is_flag=True, help='from behind the rover; by default from where the '
              'sun lights it from the side')
@click.option('--from', 'place', metavar='DISTANCE,AZIMUTH,ELEVATION', type=options.numbers(3),
              help='where the camera is [m, deg, deg], by default 1.5,-112,17; the azimuth counts '
              'from the sun, with --behind from the heading')
@click.option('--tripod', metavar='X,Y,HEIGHT', type=options.numbers(3),
              help='the camera stands there and turns after the rover [m]')
@options.bounded('--quality', 1, 100, kind=int,
                 help=f'of a .webp, 1 to 100 (default: {_QUALITY})')
@options.recorded_world()
def video(bag: Path, output: Path, width: int, fps: float, speed: float, start: float | None,
          end: float | None, bare: bool, samples: int, behind: bool,
          place: tuple[float, ...] | None, tripod: tuple[float, ...] | None, quality: int | None,
          world: Path | None) -> int:
    """Draw a film of the drive."""
    if quality is not None and output.suffix != '.webp':
        raise ConfigError(f'--quality: has no effect on a {output.suffix}; valid is a .webp')
    for option, given in (('--behind', behind), ('--from', place is not None)):
        if tripod is not None and given:
            raise ConfigError(f'{option}: has no effect beside --tripod; leave one of them out')
    settings = FilmOptions(width, fps, speed, start, end, bare, samples)
    check_rate(output, fps)
    with Progress('reading the drive') as progress:
        film = Film(bag, settings, world)
        film.chase = _camera(film, behind, place, tripod)
        progress.start('drawing', len(film.times_ns), 'frames')
        output.parent.mkdir(parents=True, exist_ok=True)

        def drawn() -> Iterator[U8]:
            for frame in film.frames():
                yield frame
                progress.advance()

        count = write_film(output, drawn(), fps, _QUALITY if quality is None else quality)
    say(f'{output}: {count} frames, {count / fps:.1f} s, '
        f'{output.stat().st_size / 1e6:.2f} MB')
    return 0


def _camera(film: Film, behind: bool, place: tuple[float, ...] | None,
            tripod: tuple[float, ...] | None) -> ChaseConfig:
    """Return the chase camera that is asked for.

    Raises:
        ConfigError: Where it cannot be.
    """
    chase = film.chase
    if behind:
        chase = dataclasses.replace(chase, reference=HEADING, azimuth_deg=180.0)
    if place is not None:
        distance_m, azimuth_deg, elevation_deg = place
        try:
            chase = dataclasses.replace(chase, distance_m=distance_m, azimuth_deg=azimuth_deg,
                                        elevation_deg=elevation_deg,
                                        reference=HEADING if behind else SUN)
        except ConfigError as error:
            raise ConfigError(f'--from: {error}') from None
    if tripod is not None:
        try:
            chase = dataclasses.replace(chase, mode=TRIPOD, position_m=tripod)
        except ConfigError as error:
            raise ConfigError(f'--tripod: {str(error).removeprefix("position_m: ")}') from None
        problem = tripod_problem(tripod, film.world)
        if problem:
            raise ConfigError(f'--tripod: {problem}')
    return chase
