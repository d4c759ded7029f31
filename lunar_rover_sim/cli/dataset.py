"""`lunar_rover_sim dataset`: look at, verify, describe and shard a data set."""

from __future__ import annotations

from pathlib import Path

import click

from lunar_rover_sim.campaign.card import write_card
from lunar_rover_sim.campaign.sharding import TEST, VALIDATION, write_shards
from lunar_rover_sim.campaign.verification import status as status_of
from lunar_rover_sim.campaign.verification import verify as verify_files
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_json, Progress, say
from lunar_rover_sim.products.sequences.webdataset import DEFAULT_SIZE

_folder = options.argument('dataset', 'folder of the data set', type=options.PATH, metavar='DIR')


@options.command()
@_folder
@options.as_json
def status(dataset: Path, as_json: bool) -> int:
    """Print how many episodes are finished, failed and missing."""
    found = status_of(dataset)
    if as_json:
        print_json(found)
        return 0
    say(f'{found["campaign"]}: {len(found["finished"])} of {found["planned"]} episodes finished, '
        f'{len(found["failed"])} failed, {len(found["missing"])} missing')
    for name, error in found['failed'].items():
        say(f'{name} failed: {error}')
    return 0


@options.command()
@_folder
def verify(dataset: Path) -> int:
    """Compare the episodes with the plan, and every file with the manifests.

    Exits with 1 if anything was changed, deleted, added or renamed.
    """
    with Progress('verifying') as progress:
        found = verify_files(dataset, progress.named)
    for name, reason in found.problems.items():
        say(f'{name}: {reason}')
    if found.problems:
        say(f'{len(found.problems)} differences from the plan of {found.planned} '
            'episodes and their manifests')
        return 1
    failed = f', {len(found.failed)} failed' if found.failed else ''
    say(f'{found.planned - len(found.failed)} of {found.planned} episodes are as they '
        f'were made{failed}')
    return 0


def _share(split: str, meaning: str) -> options.Decorator:
    return click.option(f'--{split}', type=float, default=0.0, metavar='SHARE',
                        help=f'share of the worlds of each scenario that are for {meaning}')


@options.command()
@_folder
@options.new_folder('folder of the shards')
@click.option('--shard-size', type=int, default=DEFAULT_SIZE, metavar='N',
              help='samples per shard')
@_share(VALIDATION, 'validation')
@_share(TEST, 'test')
def shards(dataset: Path, output: Path, shard_size: int, **shares: float) -> int:
    """Write WebDataset shards of all drives, split by world."""
    with Progress('writing') as progress:
        notes = write_shards(dataset, output, shard_size, shares, progress.named)
    for note in notes:
        print(note)
    return 0


@options.command()
@_folder
def card(dataset: Path) -> int:
    """Write the data card anew: README.md, card.json, episodes.csv, croissant.json."""
    write_card(dataset)
    print(dataset / 'README.md')
    return 0
