"""`lunar_rover_sim validate traverse`: minutes of waypoints over rough worlds."""

from __future__ import annotations

import argparse
import dataclasses
import os
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from lunar_rover_sim.cli.terminal import print_markdown
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.outputs import check_folder
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.studies import traverse_grounds, traverse_report
from lunar_rover_sim.studies.terramechanics import Ground
from lunar_rover_sim.studies.traverse import study, TraverseSettings
from lunar_rover_sim.studies.traverse_result import Traverse
from lunar_rover_sim.studies.traverse_store import TraverseStore


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Builds the world of a scenario for a number of seeds and drives random'
        ' waypoints over each, around the larger rocks. Writes traverse.md,'
        ' traverse.csv and traverse.png. With --grounds it drives the same worlds on several'
        ' grounds and compares them: grounds.md, grounds.png, and a folder for each.')
    parser.add_argument('scenario', nargs='?', default='baseline',
                        help='packaged name or YAML file (default: %(default)s)')
    parser.add_argument('--set', action='append', default=[], metavar='NODE.PARAM=VALUE',
                        dest='overrides', help='override one parameter; may be repeated')
    parser.add_argument('--seeds', type=int, default=20, metavar='N',
                        help='number of worlds (default: %(default)s)')
    parser.add_argument('--first-seed', type=int, default=1, metavar='N',
                        help='seed of the first world (default: %(default)s)')
    parser.add_argument('--duration', type=float, default=600.0, metavar='S',
                        help='simulated time of each drive [s] (default: %(default)s)')
    parser.add_argument('--workers', type=int, default=os.cpu_count() or 1, metavar='N',
                        help='processes that share the drives (default: one per core)')
    parser.add_argument('--grounds', nargs='+', default=[], metavar='NAME',
                        help='grounds to compare, the first one with the others: rigid, or presets'
                             ' (default: that of the scenario)')
    parser.add_argument('-o', '--output', type=Path, default=Path('traverse'), metavar='DIR',
                        help='folder to write to (default: %(default)s)')
    parser.add_argument('--resume', action='store_true',
                        help='go on with an interrupted study: finished drives are kept')
    parser.set_defaults(run=run, check_output=check_folder)


def run(args: argparse.Namespace) -> int:
    """Drive, write the report; return 1 if more than one drive in twenty was lost."""
    for name, value, low in (('--seeds', args.seeds, 1), ('--first-seed', args.first_seed, 0),
                             ('--duration', args.duration, 10.0), ('--workers', args.workers, 1)):
        if not low <= value < 1e6:
            raise ConfigError(f'{name}: {value:g} is not valid; valid is >= {low:g}')
    scenario = Scenario.load(args.scenario, args.overrides)
    physics = scenario.physics_node
    settings = TraverseSettings(scenario.rover, physics, scenario.gait_controller_node,
                                scenario.drive_node, args.duration)
    grounds = {name: Ground(name).config(physics.ground) for name in args.grounds} or {
        physics.ground.name: physics.ground}
    store = TraverseStore(args.output, f'# {args.duration:g} s\n{scenario.to_yaml()}', args.resume)

    console = Console()
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    results: dict[str, list[Traverse]] = {}
    for name, ground in grounds.items():
        kept = [store.load(name, seed) for seed in seeds]
        done = results[name] = [result for result in kept if result is not None]
        left = [seed for seed in seeds if seed not in {result.seed for result in done}]
        with Progress(console=console, transient=True) as bar:
            task = bar.add_task(f'driving {len(left)} worlds on {name}', total=len(left))

            def show(result: Traverse, count: int, _: int) -> None:
                bar.update(task, completed=count)
                store.save(name, result)
                done.append(result)
                bar.console.print(f'{name}, seed {result.seed}: {result.outcome},'
                                  f' {result.distance_m:.1f} m, {result.stuck} times stuck, tilted'
                                  f' up to {result.tilt_max_deg:.0f} deg', highlight=False,
                                  soft_wrap=True)

            study(scenario.world, left, dataclasses.replace(
                settings, physics=dataclasses.replace(physics, ground=ground)), args.workers, show)
        done.sort(key=lambda result: result.seed)
    if args.grounds:
        text = traverse_grounds.write_all(results, scenario.name, args.output)
    else:
        text = traverse_report.write_all(next(iter(results.values())), scenario.name, args.output)
    print_markdown(console, text)
    console.print(f'written: {args.output}', highlight=False, soft_wrap=True)
    return 0 if all(map(traverse_report.acceptable, results.values())) else 1
