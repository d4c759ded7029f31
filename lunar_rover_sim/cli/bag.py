"""`lunar_rover_sim bag`: look into, check, hash, recover and export recordings."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
import contextlib
import dataclasses
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from rich.text import Text

from lunar_rover_sim.bag.content_hash import combine, topic_hashes
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.recovery import recover
from lunar_rover_sim.bag.totals import recorded_factor, simulated_end_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, ConfigError
from lunar_rover_sim.base.files.film_file import check_suffix, SUFFIXES, U8, write_film
from lunar_rover_sim.base.files.paths import check_path
from lunar_rover_sim.base.seconds import EPOCH_NS, NS_PER_S
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.options import numbers
from lunar_rover_sim.cli.terminal import print_json, print_table, Progress, say
from lunar_rover_sim.image.camera.chase import ChaseConfig, HEADING, SUN, TRIPOD, tripod_problem
from lunar_rover_sim.products.inspection.bag_pictures import preview
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.products.inspection.film import Film, FilmOptions
from lunar_rover_sim.products.inspection.replay import replay
from lunar_rover_sim.products.inspection.report import Status
from lunar_rover_sim.products.inspection.summary import missing_tf
from lunar_rover_sim.products.sequences.export import (export, FORMATS, hazards_left_out,
                                                       sensors_left_out, WEBDATASET)
from lunar_rover_sim.products.sequences.shards import DEFAULT_SIZE
from lunar_rover_sim.products.sequences.webdataset import ShardOptions
from lunar_rover_sim.products.usd.names import stage_bytes
from lunar_rover_sim.run.companion_config import VIEW_PORT
from lunar_rover_sim.run.live_page import Access

_USD = 'usd'
_DATED = tuple(name for name, kind in FORMATS.items() if kind.is_dated)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the commands."""
    actions = parser.add_subparsers(metavar='WHAT', required=True)

    def add(name: str, text: str, run: options.Run) -> argparse.ArgumentParser:
        command = options.add_action(actions, name, text, run)
        options.add_bag(command)
        return command

    options.add_json(add('info', 'topics, types, counts and times', _info))
    options.add_json(add('check', 'whether a bag can be trusted; exits with 1 if not', _check))
    command = add('hash', 'a hash of what the bag says, whatever its storage', _hash)
    command.add_argument('--topics', action='store_true', help='also one hash per topic')
    command = add('preview', 'PNG pictures: cameras, their truth, LiDAR, heading, power, '
                  'trajectory, attitude, IMU', _preview)
    options.add_folder(command, 'folder of the pictures; by default BAG_preview beside the bag',
                       required=False)
    options.add_recorded_world(command)
    _add_video(add('video', 'a film of the drive: the rover from outside, left image, disparity, '
                   'pitch and slip', _video))
    command = add('view', 'play the bag in a browser, without ROS, until Ctrl-C', _view)
    options.add_number(command, '--port', 1024, 65535, kind=int, default=VIEW_PORT,
                       metavar='PORT', help='of this machine')
    options.add_number(command, '--speed', 0.0, 100.0, above=True, default=1.0,
                       metavar='FACTOR', help='simulated seconds per second')
    options.add_allowed_origins(command)
    options.add_recorded_world(command)
    command = add('recover', 'make a bag readable whose recording was cut off', _recover)
    options.add_new_folder(command, 'write the readable bag there, for instance where the disk of '
                           'the other one is full; by default it takes its place', required=False)
    command = add('export', 'write the sequence for SLAM programs or trainers, or the drive as an '
                  'OpenUSD stage', _export)
    options.add_output(command, check_path, 'PATH', 'folder of the sequence, or file of the stage '
                       '(.usd, .usda, .usdc, .usdz); must not exist')
    command.add_argument('--format', choices=(*FORMATS, _USD), default='euroc',
                         help=f'format of the sequence, or {_USD} for a stage (default: '
                              '%(default)s)')
    command.add_argument('--shard-size', type=int, metavar='N',
                         help=f'with --format {WEBDATASET}: samples per shard (default: '
                              f'{DEFAULT_SIZE})')
    command.add_argument('--epoch', type=_epoch_ns, metavar='DATE',
                         help=f'with --format {" or ".join(_DATED)}: the date, UTC, at which '
                              'simulated time is 0 (default: 2024-01-01T00:00:00)')
    stage = command.add_argument_group(f'--format {_USD}')
    options.add_recorded_world(stage)
    stage.add_argument('--world-stage', type=Path, metavar='FILE',
                       help='a stage of that world to refer to; by default one is written')
    options.add_overwrite(stage, 'an existing stage')


def _info(args: argparse.Namespace) -> int:
    with open_bag(args.bag) as bag:
        end_ns = bag.end_ns
        with contextlib.suppress(BagError):     # counts are told of a damaged bag too
            end_ns = simulated_end_ns(bag) or end_ns
        start_s, end_s = bag.start_ns * 1e-9, end_ns * 1e-9
        topics_found: list[dict[str, Any]] = [
            {'topic': topic, 'type': msgtype, 'messages': bag.counts[topic],
             'rate_hz': bag.counts[topic] / (end_s - start_s)
             if bag.counts[topic] > 2 and end_s > start_s else None}
            for topic, msgtype in sorted(bag.types.items())]
        found: dict[str, Any] = {
            'messages': bag.message_count, 'start_s': start_s, 'end_s': end_s,
            'size_bytes': bag.size_bytes, 'storage': bag.storage_path.suffix.lstrip('.'),
            'real_time_factor': recorded_factor(bag), 'incomplete': bag.incomplete or None,
            'topics': topics_found}
        notes = missing_tf(bag)
    if args.json:
        print_json(found)
        return 0
    print_table(('topic', 'type', 'messages', 'rate'), 2, (
        (one['topic'], one['type'], str(one['messages']),
         '' if one['rate_hz'] is None else f'{one["rate_hz"]:.1f} Hz') for one in topics_found),
        box=None, pad_edge=False)
    factor = found['real_time_factor']
    say(f'{found["messages"]} messages, {start_s:.3f} s to {end_s:.3f} s, '
        f'{found["size_bytes"] / 1e6:.1f} MB, {found["storage"]}'
        + ('' if factor is None else f', real-time factor {factor:.3g}'))
    for note in notes:
        say(note)
    if found['incomplete']:
        say(f'INCOMPLETE: {found["incomplete"]}')
    return 0


def _check(args: argparse.Namespace) -> int:
    with _counting(args.bag, 'checking') as progress:
        report = check(args.bag, progress)
    if args.json:
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
    say(f'{args.bag}: ' + (f'{failed} of {len(report.findings)} checks failed'
                           if failed else 'passed'))
    return 0 if report.ok else 1


def _hash(args: argparse.Namespace) -> int:
    with open_bag(args.bag) as bag:
        types = bag.types
    with _counting(args.bag, 'hashing') as progress:
        hashes = topic_hashes(args.bag, progress)
    if args.topics:
        for topic, digest in sorted(hashes.items()):
            print(f'{digest}  {topic}')
    print(combine(hashes, types))
    return 0


def _preview(args: argparse.Namespace) -> int:
    folder = args.bag.resolve()
    output = args.output or folder.with_name(f'{folder.stem}_preview')
    if output.resolve() == folder:
        raise ConfigError(f'--output: {output} is the bag itself; name another folder')
    for path in preview(args.bag, output, args.world):
        print(path)
    return 0


def _view(args: argparse.Namespace) -> int:
    def start(access: Access) -> None:
        say(access.url)
        say(f'in Foxglove or Lichtblick: {access.websocket_url}')
        say('Ctrl-C ends it')

    with Progress('waiting for a browser') as progress:
        progress.start('playing', None, 's')
        replay(args.bag, args.port, args.speed, args.world,
               on_time=lambda now_s: progress.named(f'at {now_s:.1f} s'), on_start=start,
               origins=args.allow_origin)
    return 0


def _recover(args: argparse.Namespace) -> int:
    count = recover(args.bag, args.output)
    print(f'{args.output or args.bag}: {count} messages; every tool can read it now, and it stays '
          'marked incomplete')
    return 0


def _export(args: argparse.Namespace) -> int:
    if args.shard_size is not None and args.format != WEBDATASET:
        raise ConfigError(f'--shard-size: is for --format {WEBDATASET}, not for {args.format}')
    if args.epoch is not None and args.format not in _DATED:
        raise ConfigError(f'--epoch: is for --format {" or ".join(_DATED)}, not for {args.format}')
    if args.format == _USD:
        return _export_stage(args)
    for name, value in (('--world', args.world), ('--world-stage', args.world_stage),
                        ('--overwrite', args.overwrite)):
        if value:
            raise ConfigError(f'{name}: is for --format {_USD}, not for {args.format}')
    with _counting(args.bag, 'exporting') as progress:
        size = DEFAULT_SIZE if args.shard_size is None else args.shard_size
        notes = export(args.bag, args.output, args.format, progress, ShardOptions(size=size),
                       EPOCH_NS if args.epoch is None else args.epoch)
    for note in notes:
        print(note)
    return 0


def _epoch_ns(text: str) -> int:
    """Return the Unix time [ns] of a date in UTC, for argparse."""
    try:
        date = datetime.fromisoformat(text.strip().removesuffix('Z'))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f'{text!r} is not a date; valid is YYYY-MM-DD or YYYY-MM-DDTHH:MM:SS, UTC') from None
    return int(date.replace(tzinfo=date.tzinfo or timezone.utc).timestamp()) * NS_PER_S


def _export_stage(args: argparse.Namespace) -> int:
    if args.world is not None and args.world_stage is not None:
        raise ConfigError('--world, --world-stage: both are given; valid is one of them')
    # Here, because OpenUSD is an optional dependency.
    from lunar_rover_sim.products.usd.drive_stage import write_drive
    with Progress('writing the stage'):
        write_drive(args.bag, args.output, world=args.world, world_stage=args.world_stage,
                    overwrite=args.overwrite)
    print(f'{args.output}: {stage_bytes(args.output) / 1e6:.1f} MB')
    with open_bag(args.bag) as bag:
        for note in (*sensors_left_out(bag, [topics.IMU_RAW.name]), *hazards_left_out(bag, ())):
            print(note)
    return 0


@contextlib.contextmanager
def _counting(path: Path, text: str) -> Iterator[Callable[[], None]]:
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


_QUALITY = 70


def _add_video(parser: argparse.ArgumentParser) -> None:
    """Declare what `bag video` takes."""
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
    parser.add_argument('--samples', type=int, default=1, metavar='N', help='along a side of a '
                        'pixel of the view from outside, 1 to 4; with 2 thin parts of the rover '
                        'are not dashed, in three times the time (default: 1)')
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


def _video(args: argparse.Namespace) -> int:
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
    """Return the chase camera that is asked for.

    Raises:
        ConfigError: Where it cannot be.
    """
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
