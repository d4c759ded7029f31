"""`lunar_rover_sim dataset`: look at, verify, describe and shard a data set."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from lunar_rover_sim.campaign.card import make_card, write_card
from lunar_rover_sim.campaign.page import write_page
from lunar_rover_sim.campaign.sharding import TEST, VALIDATION, write_shards
from lunar_rover_sim.campaign.verification import verify
from lunar_rover_sim.files.outputs import check_file, check_new_folder
from lunar_rover_sim.sequences.shards import DEFAULT_SIZE

_PLAIN: dict[str, Any] = {'highlight': False, 'markup': False, 'soft_wrap': True}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the commands."""
    datasets = parser.add_subparsers(metavar='WHAT', required=True)
    for name, run, text in (
            ('show', _show, 'one HTML page: pictures, paths on the ground, statistics'),
            ('verify', _verify, 'compare the episodes with the plan, and every file with the '
                                'manifests; exits with 1 if anything was changed, deleted, added '
                                'or renamed'),
            ('card', _card, 'write the data card anew: README.md and card.json')):
        command = datasets.add_parser(name, help=text, description=text)
        command.add_argument('dataset', type=Path, metavar='DIR', help='folder of the data set')
        command.set_defaults(run=run)
        if name == 'show':
            command.add_argument('-o', '--output', type=Path, metavar='FILE',
                                 help='the page; by default DIR/index.html')
            command.set_defaults(check_output=check_file)
            command.add_argument('--most', type=int, default=100, metavar='N',
                                 help='episodes shown with pictures (default: %(default)s)')
    _add_shards(datasets.add_parser)


def _add_shards(add_parser: Callable[..., argparse.ArgumentParser]) -> None:
    text = 'WebDataset shards of all drives, split by world'
    command = add_parser('shards', help=text, description=text)
    command.add_argument('dataset', type=Path, metavar='DIR', help='folder of the data set')
    command.add_argument('-o', '--output', type=Path, metavar='DIR', required=True,
                         help='folder of the shards; must not exist')
    command.add_argument('--shard-size', type=int, default=DEFAULT_SIZE, metavar='N',
                         help='samples a shard (default: %(default)s)')
    for split, meaning in ((VALIDATION, 'validation'), (TEST, 'test')):
        command.add_argument(f'--{split}', type=float, default=0.0, metavar='SHARE',
                             help=f'share of the worlds of each scenario that are for {meaning} '
                                  '(default: 0)')
    command.set_defaults(run=_shards, check_output=check_new_folder)


def _show(args: argparse.Namespace) -> int:
    console = Console()
    card = make_card(args.dataset)
    output = args.output or args.dataset / 'index.html'
    with console.status('') as status:
        write_page(args.dataset, card, output, max(0, args.most),
                   lambda name: status.update(f'drawing {name}'))
    console.print(str(output), **_PLAIN)
    return 0


def _verify(args: argparse.Namespace) -> int:
    console = Console()
    with console.status('') as status:
        found = verify(args.dataset, lambda name: status.update(f'verifying {name}'))
    for name, reason in found.problems.items():
        console.print(f'{name}: {reason}', **_PLAIN)
    if found.problems:
        console.print(f'{len(found.problems)} differences from the plan of {found.planned} '
                      'episodes and their manifests', **_PLAIN)
        return 1
    failed = f', {len(found.failed)} failed' if found.failed else ''
    console.print(f'{found.planned - len(found.failed)} of {found.planned} episodes are as they '
                  f'were made{failed}', **_PLAIN)
    return 0


def _shards(args: argparse.Namespace) -> int:
    shares = {split: getattr(args, split) for split in (VALIDATION, TEST)}
    with Console(stderr=True).status('') as status:
        notes = write_shards(args.dataset, args.output, args.shard_size, shares,
                             lambda name: status.update(f'writing {name}'))
    for note in notes:
        print(note)
    return 0


def _card(args: argparse.Namespace) -> int:
    write_card(args.dataset)
    print(args.dataset / 'README.md')
    return 0
