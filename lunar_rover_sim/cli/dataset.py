"""`lunar_rover_sim dataset`: look at, verify, describe and shard a data set."""

from __future__ import annotations

import argparse
from pathlib import Path

from lunar_rover_sim.campaign.card import write_card
from lunar_rover_sim.campaign.sharding import TEST, VALIDATION, write_shards
from lunar_rover_sim.campaign.verification import status, verify
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_json, Progress, say
from lunar_rover_sim.products.sequences.shards import DEFAULT_SIZE


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the commands."""
    datasets = parser.add_subparsers(metavar='WHAT', required=True)
    for name, run, text in (
            ('status', _status, 'how many episodes are finished, failed and missing'),
            ('verify', _verify, 'compare the episodes with the plan, and every file with the '
                                'manifests; exits with 1 if anything was changed, deleted, added '
                                'or renamed'),
            ('shards', _shards, 'WebDataset shards of all drives, split by world'),
            ('card', _card, 'write the data card anew: README.md, card.json, '
                            'episodes.csv, croissant.json')):
        command = options.add_action(datasets, name, text, run)
        command.add_argument('dataset', type=Path, metavar='DIR', help='folder of the data set')
        if name == 'status':
            options.add_json(command)
        if name == 'shards':
            _add_shards(command)


def _add_shards(command: argparse.ArgumentParser) -> None:
    options.add_new_folder(command, 'folder of the shards')
    command.add_argument('--shard-size', type=int, default=DEFAULT_SIZE, metavar='N',
                         help='samples per shard (default: %(default)s)')
    for split, meaning in ((VALIDATION, 'validation'), (TEST, 'test')):
        command.add_argument(f'--{split}', type=float, default=0.0, metavar='SHARE',
                             help=f'share of the worlds of each scenario that are for {meaning} '
                                  '(default: 0)')


def _status(args: argparse.Namespace) -> int:
    found = status(args.dataset)
    if args.json:
        print_json(found)
        return 0
    say(f'{found["campaign"]}: {len(found["finished"])} of {found["planned"]} episodes finished, '
        f'{len(found["failed"])} failed, {len(found["missing"])} missing')
    for name, error in found['failed'].items():
        say(f'{name} failed: {error}')
    return 0


def _verify(args: argparse.Namespace) -> int:
    with Progress('verifying') as progress:
        found = verify(args.dataset, progress.named)
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


def _shards(args: argparse.Namespace) -> int:
    shares = {split: getattr(args, split) for split in (VALIDATION, TEST)}
    with Progress('writing') as progress:
        notes = write_shards(args.dataset, args.output, args.shard_size, shares, progress.named)
    for note in notes:
        print(note)
    return 0


def _card(args: argparse.Namespace) -> int:
    write_card(args.dataset)
    print(args.dataset / 'README.md')
    return 0
