"""`lunar_rover_sim validate stereo`: SGM on rendered pairs, against true depth."""

from __future__ import annotations

import argparse
import json

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import make_new_folder
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_table, Progress, say
from lunar_rover_sim.judge.studies.stereo import study
from lunar_rover_sim.run.scenario import Scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Draw stereo pairs along a loop through each scenario, match them, and say '
        'how dense and how right the disparity is: a table, and figures with left image, true '
        'depth, SGM depth and error.')
    options.add_scenario(parser, several=True)
    parser.add_argument('-n', '--frames', type=options.number('--frames', 1, kind=int), default=12,
                        metavar='N', help='pairs per scenario (default: %(default)s)')
    options.add_new_folder(parser, 'folder for table and figures')
    options.add_seed(parser)
    options.add_overrides(parser)


def run(args: argparse.Namespace) -> int:
    """Match the pairs of each scenario, print the table, save it."""
    scenarios = [Scenario.load(name, args.overrides, seed=args.seed) for name in args.scenarios]
    make_new_folder(args.output)
    results: dict[str, dict[str, float]] = {}
    for scenario in scenarios:
        with Progress(scenario.name) as progress:
            errors = study(scenario, args.frames, args.output, progress)
        results[scenario.name] = errors.summary()
    print_table(('', *results), 1, (
        (row, *(_formatted(row, of[row]) for of in results.values()))
        for row in next(iter(results.values()))), title='SGM against true depth')
    atomic_write(args.output / 'stereo.json', json.dumps(results, indent=1) + '\n', ConfigError)
    say(f'written to {args.output}')
    return 0


def _formatted(row: str, value: float) -> str:
    """Return a figure as the table shows it: shares in per cent, errors in px, some signed."""
    if not row.endswith('[px]'):
        return f'{100 * value:.1f} %'
    return f'{value:+.3f}' if 'signed' in row else f'{value:.3f}'
