"""`lunar_rover_sim validate learning`: policies against the packaged gait on hidden seeds."""

from __future__ import annotations

import argparse

from lunar_rover_sim.autonomy.learning.policy_file import Policy, policy_names, policy_path
from lunar_rover_sim.autonomy.learning.task import GROUNDS as ALL_GROUNDS
from lunar_rover_sim.base.errors import ConfigError, StudyError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_markdown, Progress, say
from lunar_rover_sim.judge.studies.learning import (Case, GROUNDS, HIDDEN_SEEDS, PACKAGED,
                                                    report_text, SETTINGS, SLOPES_DEG, study,
                                                    WalkStore, write_walks)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = ('Walk with the packaged gait and with policies over the same worlds,'
                          ' which no training saw, and compare them in pairs.')
    parser.add_argument('policies', nargs='*', metavar='POLICY',
                        help='packaged policies or files; by default all packaged ones')
    parser.add_argument('--against', metavar='WALKER', default=PACKAGED,
                        help='what the others are compared with: packaged, or one of the policies'
                             ' (default: packaged)')
    options.add_folder(parser, 'folder for learning.md, learning.csv and the finished walks')
    parser.add_argument('--resume', action='store_true',
                        help='go on with a folder: finished walks are kept')
    parser.add_argument('--grounds', nargs='+', choices=ALL_GROUNDS, default=list(GROUNDS),
                        metavar='GROUND', help=f'(default: {" ".join(GROUNDS)})')
    parser.add_argument('--slopes', nargs='+', type=options.number('--slopes', 0.0, 30.0, 'deg'),
                        default=list(SLOPES_DEG), metavar='DEG',
                        help=f'uphill [deg] (default: {" ".join(f"{s:g}" for s in SLOPES_DEG)})')
    options.add_number(parser, '--seeds', 1, len(HIDDEN_SEEDS), kind=int,
                       default=len(HIDDEN_SEEDS), help='number of worlds')
    parser.add_argument('--rover', default='quad', metavar='NAME_OR_PATH',
                        help='a packaged rover or a rover file (default: quad)')
    options.add_workers(parser, 'processes that walk')


def run(args: argparse.Namespace) -> int:
    """Walk, compare and print."""
    policies = args.policies or policy_names()
    for policy in policies:
        Policy(policy)
    if args.against not in (PACKAGED, *policies):
        raise ConfigError(f'--against: {args.against} is not valid; valid are '
                          f'{", ".join((PACKAGED, *policies))}')
    walker_of = {PACKAGED: PACKAGED, **{
        name: name if name in policy_names() else str(policy_path(name).resolve())
        for name in policies}}
    cases = [Case(walker, ground, slope, seed, args.rover)
             for slope in args.slopes for ground in args.grounds
             for seed in HIDDEN_SEEDS[:args.seeds] for walker in walker_of.values()]
    store = WalkStore(args.output, SETTINGS, args.resume)
    with Progress('walking', len(cases)) as progress:
        walks = study(cases, store, args.workers, progress)
    write_walks(args.output / 'learning.csv', walks)
    text = report_text(walks, walker_of[args.against])
    atomic_write(args.output / 'learning.md', text, StudyError)
    print_markdown(text)
    say(f'{args.output}: {len(walks)} walks')
    return 0
