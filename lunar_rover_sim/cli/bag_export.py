"""`lunar_rover_sim bag export`: a sequence for SLAM programs or trainers, or a stage."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

import click

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.paths import check_path
from lunar_rover_sim.base.seconds import EPOCH_NS, NS_PER_S
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.bag import counting
from lunar_rover_sim.cli.terminal import Progress
from lunar_rover_sim.products.sequences.export import export as write
from lunar_rover_sim.products.sequences.export import (FORMATS, hazards_left_out, sensors_left_out,
                                                       WEBDATASET)
from lunar_rover_sim.products.sequences.webdataset import DEFAULT_SIZE, ShardOptions
from lunar_rover_sim.products.usd.names import stage_bytes

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
