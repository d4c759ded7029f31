"""`lunar_rover_sim bag`: look into, check, hash, recover, picture, film, play, export."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import contextlib
import dataclasses
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import click
from rich.text import Text

from lunar_rover_sim.bag.content_hash import combine, topic_hashes
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.recovery import recover as recover_bag
from lunar_rover_sim.bag.totals import recorded_factor, resumed_ns, simulated_end_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, ConfigError
from lunar_rover_sim.base.files.film_file import check_rate, check_suffix, SUFFIXES, U8, write_film
from lunar_rover_sim.base.files.paths import check_path
from lunar_rover_sim.base.seconds import EPOCH_NS, NS_PER_S
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_json, print_table, Progress, say
from lunar_rover_sim.ground.world.orbital_map import OrbitalMap
from lunar_rover_sim.image.camera.chase import ChaseConfig, HEADING, SUN, TRIPOD, tripod_problem
from lunar_rover_sim.products.inspection import check as bag_check
from lunar_rover_sim.products.inspection.bag_pictures import preview as draw_preview
from lunar_rover_sim.products.inspection.film import Film, FilmOptions
from lunar_rover_sim.products.inspection.replay import replay
from lunar_rover_sim.products.inspection.report import Status
from lunar_rover_sim.products.inspection.summary import notes_on
from lunar_rover_sim.products.sequences.export import export as write
from lunar_rover_sim.products.sequences.export import (FORMATS, hazards_left_out, sensors_left_out,
                                                       WEBDATASET)
from lunar_rover_sim.products.sequences.webdataset import DEFAULT_SIZE, ShardOptions
from lunar_rover_sim.products.usd.names import is_stage, stage_bytes
from lunar_rover_sim.run.live_page import Access
from lunar_rover_sim.run.node_config import VIEW_PORT


@contextlib.contextmanager
def counting(path: Path, text: str) -> Iterator[Callable[[], None]]:
    """Show a progress bar over the messages of a bag; yields what to call for each."""
    with open_bag(path) as bag:
        total = bag.message_count
    with Progress(text, total, 'messages') as progress:
        pending = 0

        def count() -> None:
            nonlocal pending
            pending += 1
            if pending == 200:
                progress.advance(pending)
                pending = 0

        yield count


@options.command()
@options.bag()
@options.as_json
def info(bag: Path, as_json: bool) -> int:
    """Print the topics of a bag, their types, counts and rates, and its times."""
    with open_bag(bag) as opened:
        end_ns = opened.end_ns
        with contextlib.suppress(BagError):     # counts are told of a damaged bag too
            end_ns = simulated_end_ns(opened) or end_ns
        start_s, end_s = opened.start_ns * 1e-9, end_ns * 1e-9
        topics_found: list[dict[str, Any]] = [
            {'topic': topic, 'type': msgtype, 'messages': opened.counts[topic],
             'rate_hz': opened.counts[topic] / (end_s - start_s)
             if opened.counts[topic] > 2 and end_s > start_s else None}
            for topic, msgtype in sorted(opened.types.items())]
        found: dict[str, Any] = {
            'messages': opened.message_count, 'start_s': start_s, 'end_s': end_s,
            'size_bytes': opened.size_bytes, 'files': len(opened.file_counts),
            'storage': opened.storage,
            'real_time_factor': recorded_factor(opened),
            'resumed_s': [ns * 1e-9 for ns in resumed_ns(opened)],
            'incomplete': opened.incomplete or None, 'topics': topics_found}
        notes = notes_on(opened)
    if as_json:
        print_json(found)
        return 0
    print_table(('topic', 'type', 'messages', 'rate'), 2, (
        (one['topic'], one['type'], str(one['messages']),
         '' if one['rate_hz'] is None else f'{one["rate_hz"]:.1f} Hz') for one in topics_found),
        box=None, pad_edge=False)
    factor = found['real_time_factor']
    say(f'{found["messages"]} messages, {start_s:.3f} s to {end_s:.3f} s, '
        f'{found["size_bytes"] / 1e6:.1f} MB, {found["storage"]}'
        + (f' in {found["files"]} files' if found['files'] > 1 else '')
        + ('' if factor is None else f', real-time factor {factor:.3g}'))
    for note in notes:
        say(note)
    if found['incomplete']:
        say(f'INCOMPLETE: {found["incomplete"]}')
    return 0


@options.command()
@options.bag()
@options.as_json
def check(bag: Path, as_json: bool) -> int:
    """Say whether a bag can be trusted; exits with 1 if not."""
    with counting(bag, 'checking') as progress:
        report = bag_check.check(bag, progress)
    if as_json:
        print_json({'ok': report.ok, 'findings': [
            {'check': finding.check, 'status': finding.status.value, 'detail': finding.detail}
            for finding in report.findings]})
        return 0 if report.ok else 1
    styles = {Status.PASS: 'green', Status.WARN: 'yellow', Status.FAIL: 'bold red',
              Status.SKIP: 'dim'}
    print_table(('check', '', 'found'), 3, (
        (finding.check, Text(finding.status.value, styles[finding.status]), Text(finding.detail))
        for finding in report.findings), box=None, pad_edge=False)
    failed = len(report.failed)
    say(f'{bag}: ' + (f'{failed} of {len(report.findings)} checks failed' if failed
                      else 'passed'))
    return 0 if report.ok else 1


@options.command()
@options.bag()
@click.option('--topics', is_flag=True, help='also one hash per topic')
def hash_(bag: Path, topics: bool) -> int:
    """Print a hash of what a bag says, whatever its storage."""
    with open_bag(bag) as opened:
        types = opened.types
    with counting(bag, 'hashing') as progress:
        hashes = topic_hashes(bag, progress)
    if topics:
        for topic, digest in sorted(hashes.items()):
            print(f'{digest}  {topic}')
    print(combine(hashes, types))
    return 0


@options.command()
@options.bag()
@options.folder('folder of the pictures; by default BAG_preview beside the bag', required=False)
@options.recorded_world()
@click.option('--maps', type=options.PATH, metavar='DIR', help='folder of `world export '
              '--orbital`: draw the way over the photo, too, as overview.png')
def preview(bag: Path, output: Path | None, world: Path | None, maps: Path | None) -> int:
    """Draw pictures of a bag: cameras, their truth, LiDAR, trajectory, attitude, IMU."""
    folder = bag.resolve()
    output = output or folder.with_name(f'{folder.stem}_preview')
    if output.resolve() == folder:
        raise ConfigError(f'--output: {output} is the bag itself; name another folder')
    of_site = None if maps is None else OrbitalMap.load(maps)
    for path in draw_preview(bag, output, world, maps=of_site):
        print(path)
    return 0


@options.command()
@options.bag()
@options.bounded('--port', 1024, 65535, kind=int, default=VIEW_PORT, metavar='PORT',
                 help='of this machine')
@options.bounded('--speed', 0.0, 100.0, above=True, default=1.0, metavar='FACTOR',
                 help='simulated seconds per second')
@options.allowed_origins
@options.recorded_world()
def view(bag: Path, port: int, speed: float, allow_origin: Sequence[str],
         world: Path | None) -> int:
    """Play a bag in a browser, without ROS, until Ctrl-C."""
    def start(access: Access) -> None:
        say(access.url)
        say(f'in Foxglove or Lichtblick: {access.websocket_url}')
        say('Ctrl-C ends it')

    with Progress('waiting for a browser') as progress:
        progress.start('playing', None, 's')
        replay(bag, port, speed, world,
               on_time=lambda now_s: progress.named(f'at {now_s:.1f} s'), on_start=start,
               origins=allow_origin)
    return 0


@options.command()
@options.bag()
@options.new_folder('write the readable bag there; by default it takes the place of the other',
                    required=False)
def recover(bag: Path, output: Path | None) -> int:
    """Make a bag readable whose recording was cut off."""
    count = recover_bag(bag, output)
    print(f'{output or bag}: {count} messages; every tool can read it now, and it stays '
          'marked incomplete')
    return 0


_USD = 'usd'
_DATED = tuple(name for name, kind in FORMATS.items() if kind.is_dated)


def _epoch_ns(text: str) -> int:
    """Return the Unix time [ns] of a date in UTC."""
    try:
        date = datetime.fromisoformat(text.strip().removesuffix('Z'))
    except ValueError:
        raise click.BadParameter(
            f'{text!r} is not a date; valid is YYYY-MM-DD or YYYY-MM-DDTHH:MM:SS, UTC') from None
    return int(date.replace(tzinfo=date.tzinfo or timezone.utc).timestamp()) * NS_PER_S


@options.command()
@options.bag()
@options.output(check_path, 'PATH', 'folder of the sequence, or file of the stage (.usd, .usda, '
                '.usdc, .usdz); must not exist')
@click.option('--format', 'format_', type=options.Choice((*FORMATS, _USD)), default='euroc',
              help=f'format of the sequence, or {_USD} for a stage')
@click.option('--shard-size', type=int, metavar='N',
              help=f'with --format {WEBDATASET}: samples per shard (default: {DEFAULT_SIZE})')
@click.option('--epoch', type=_epoch_ns, metavar='DATE',
              help=f'with --format {" or ".join(_DATED)}: the date, UTC, at which simulated time '
                   'is 0 (default: 2024-01-01T00:00:00)')
@options.recorded_world('with --format usd: ')
@click.option('--world-stage', type=options.PATH, metavar='FILE', help='with --format usd: a '
              'stage of that world to refer to; by default one is written')
@options.overwrite('an existing stage')
def export(bag: Path, output: Path, format_: str, shard_size: int | None, epoch: int | None,
           world: Path | None, world_stage: Path | None, overwrite: bool) -> int:
    """Write the sequence for SLAM programs or trainers, or the drive as an OpenUSD stage."""
    if shard_size is not None and format_ != WEBDATASET:
        raise ConfigError(f'--shard-size: is for --format {WEBDATASET}, not for {format_}')
    if epoch is not None and format_ not in _DATED:
        raise ConfigError(f'--epoch: is for --format {" or ".join(_DATED)}, not for {format_}')
    if format_ == _USD:
        return _export_stage(bag, output, world, world_stage, overwrite)
    if is_stage(output):
        raise ConfigError(f'--output: {output} is the name of a stage, and {format_} is a folder; '
                          f'a stage needs --format {_USD}')
    for name, value in (('--world', world), ('--world-stage', world_stage),
                        ('--overwrite', overwrite)):
        if value:
            raise ConfigError(f'{name}: is for --format {_USD}, not for {format_}')
    with counting(bag, 'exporting') as progress:
        size = DEFAULT_SIZE if shard_size is None else shard_size
        notes = write(bag, output, format_, progress, ShardOptions(size=size),
                      EPOCH_NS if epoch is None else epoch)
    for note in notes:
        print(note)
    return 0


def _export_stage(bag: Path, output: Path, world: Path | None, world_stage: Path | None,
                  overwrite: bool) -> int:
    if world is not None and world_stage is not None:
        raise ConfigError('--world, --world-stage: both are given; valid is one of them')
    # Here, because OpenUSD is an optional dependency.
    from lunar_rover_sim.products.usd.drive_stage import write_drive
    with Progress('writing the stage'):
        write_drive(bag, output, world=world, world_stage=world_stage, overwrite=overwrite)
    print(f'{output}: {stage_bytes(output) / 1e6:.1f} MB')
    with open_bag(bag) as opened:
        for note in (*sensors_left_out(opened, [topics.IMU_RAW.name]),
                     *hazards_left_out(opened, ())):
            print(note)
    return 0


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
