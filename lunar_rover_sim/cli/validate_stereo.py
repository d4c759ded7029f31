"""`lunar_rover_sim validate stereo`: SGM on rendered pairs, against true depth."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from rich.progress import Progress

from lunar_rover_sim.cli.terminal import console, table
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.atomic import atomic_write
from lunar_rover_sim.files.outputs import check_new_folder, make_new_folder
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.studies.stereo import study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Draw stereo pairs along a loop through each scenario, match them, and say '
        'how dense and how right the disparity is: a table, and figures with left image, true '
        'depth, SGM depth and error.')
    parser.add_argument('scenarios', nargs='+', metavar='SCENARIO',
                        help='names of packaged scenarios, or YAML files')
    parser.add_argument('-n', '--frames', type=int, default=12, help='pairs per scenario')
    parser.add_argument('-o', '--output', required=True, type=Path, metavar='DIR',
                        help='folder for table and figures; must not exist')
    parser.add_argument('--seed', type=int, metavar='N', help='seed of everything random')
    parser.add_argument('--set', action='append', default=[], metavar='NODE.PARAM=VALUE',
                        dest='overrides', help='override one parameter; may be repeated')
    parser.set_defaults(run=run, check_output=check_new_folder)


def run(args: argparse.Namespace) -> int:
    """Match the pairs of each scenario, print the table, save it."""
    if args.frames < 1:
        raise ConfigError(f'frames: {args.frames} is not valid; valid is >= 1')
    scenarios = [Scenario.load(name, args.overrides, seed=args.seed) for name in args.scenarios]
    make_new_folder(args.output)
    out = console()
    results: dict[str, dict[str, float]] = {}
    for scenario in scenarios:
        with Progress(console=out) as bar:
            task = bar.add_task(scenario.name)
            errors = study(scenario, args.frames, args.output,
                           lambda done, total: bar.update(task, completed=done, total=total))
        results[scenario.name] = errors.summary()
    rows = table(('', *results), 1, title='SGM against true depth')
    for row in next(iter(results.values())):
        values = [results[name][row] for name in results]
        rows.add_row(row, *(_formatted(row, v) for v in values))
    out.print(rows)
    atomic_write(args.output / 'stereo.json', json.dumps(results, indent=1) + '\n', ConfigError)
    out.print(f'written to {args.output}', highlight=False, markup=False, soft_wrap=True)
    return 0


def _formatted(row: str, value: float) -> str:
    """Return a figure as the table shows it: shares in per cent, errors in px, some signed."""
    if not row.endswith('[px]'):
        return f'{100 * value:.1f} %'
    return f'{value:+.3f}' if 'signed' in row else f'{value:.3f}'
