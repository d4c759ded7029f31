"""`lunar_rover_sim validate traverse`: minutes of waypoints over rough worlds."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown
from rich.progress import Progress

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.folders import make_new
from lunar_rover_sim.gait.calibration import GaitCalibration
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.studies import traverse_report
from lunar_rover_sim.studies.traverse import study, TraverseSettings
from lunar_rover_sim.studies.traverse_result import Traverse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Builds the world of a scenario for a number of seeds and drives random'
        ' waypoints over each, around the larger rocks. Writes traverse.md,'
        ' traverse.csv and traverse.png.')
    parser.add_argument('scenario', nargs='?', default='baseline', help='scenario (baseline)')
    parser.add_argument('--set', action='append', default=[], metavar='NODE.PARAM=VALUE',
                        dest='overrides', help='override one parameter; may be repeated')
    parser.add_argument('--seeds', type=int, default=20, metavar='N', help='number of worlds (20)')
    parser.add_argument('--first-seed', type=int, default=1, metavar='N',
                        help='seed of the first world (1)')
    parser.add_argument('--duration', type=float, default=600.0, metavar='S',
                        help='simulated time of each drive [s]')
    parser.add_argument('--workers', type=int, default=os.cpu_count() or 1, metavar='N',
                        help='processes that share the drives (one per core)')
    parser.add_argument('-o', '--output', type=Path, default=Path('traverse'), metavar='DIR',
                        help='folder to write to (traverse)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Drive, write the report; return 1 if more than one drive in twenty was lost."""
    for name, value, low in (('--seeds', args.seeds, 1), ('--first-seed', args.first_seed, 0),
                             ('--duration', args.duration, 10.0), ('--workers', args.workers, 1)):
        if not low <= value < 1e6:
            raise ConfigError(f'{name}: {value:g} is not valid; valid is >= {low:g}')
    scenario = Scenario.load(args.scenario, args.overrides)
    gait = scenario.gait_controller_node
    table = GaitCalibration.of(gait)
    make_new(args.output)

    console = Console()
    results: list[Traverse] = []
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task(f'driving {args.seeds} worlds', total=args.seeds)

        def show(result: Traverse, done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)
            # The report is kept up to date, in case the study is interrupted.
            results.append(result)
            traverse_report.write_all(results, scenario.name, args.output)
            bar.console.print(f'seed {result.seed}: {result.outcome}, {result.distance_m:.1f} m,'
                              f' {result.stuck} times stuck, tilted up to'
                              f' {result.tilt_max_deg:.0f} deg', highlight=False, soft_wrap=True)

        settings = TraverseSettings(table, scenario.rover, scenario.physics_node, gait,
                                    scenario.drive_node, args.duration)
        study(scenario.world, range(args.first_seed, args.first_seed + args.seeds), settings,
              args.workers, show)
    text = traverse_report.write_all(results, scenario.name, args.output)
    console.print(Markdown(text))
    console.print(f'written: {args.output}/traverse.md, traverse.csv, traverse.png',
                  highlight=False, soft_wrap=True)
    return 0 if traverse_report.acceptable(results) else 1
