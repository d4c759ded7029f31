"""`lunar_rover_sim validate traverse`: minutes of waypoints over rough worlds."""

from __future__ import annotations

import argparse
import dataclasses

from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_markdown, Progress, say
from lunar_rover_sim.judge.studies import traverse_report
from lunar_rover_sim.judge.studies.terramechanics import Ground
from lunar_rover_sim.judge.studies.traverse import study, Traverse, TraverseSettings, TraverseStore
from lunar_rover_sim.run.scenario import Scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Builds the world of a scenario for a number of seeds and drives random'
        ' waypoints over each, around the larger rocks. Writes traverse.md,'
        ' traverse.csv and traverse.png. With --grounds it drives the same worlds on several'
        ' grounds and compares them: grounds.md, grounds.png, and a folder for each.')
    options.add_scenario(parser, 'baseline')
    options.add_overrides(parser)
    options.add_number(parser, '--seeds', 1, kind=int, default=20, help='number of worlds')
    options.add_number(parser, '--first-seed', 0, kind=int, default=1,
                       help='seed of the first world')
    options.add_number(parser, '--duration', 10.0, unit='s', default=600.0, metavar='S',
                       help='simulated time of each drive')
    options.add_workers(parser, 'processes that share the drives', None)
    parser.add_argument('--grounds', nargs='+', default=[], metavar='NAME',
                        help='grounds to compare, the first one with the others: rigid, or presets'
                             ' (default: that of the scenario)')
    options.add_folder(parser, 'folder to write to', 'traverse')
    parser.add_argument('--resume', action='store_true',
                        help='go on with an interrupted study: finished drives are kept')


def run(args: argparse.Namespace) -> int:
    """Drive, write the report; return 1 if more than one drive in twenty was lost."""
    scenario = Scenario.load(args.scenario, args.overrides)
    physics = scenario.physics_node
    settings = TraverseSettings(scenario.rover, physics, scenario.gait_controller_node,
                                scenario.drive_node, args.duration)
    grounds = {name: Ground(name).config(physics.ground) for name in args.grounds} or {
        physics.ground.name: physics.ground}
    store = TraverseStore(args.output, f'# {args.duration:g} s\n{scenario.to_yaml()}', args.resume)

    seeds = range(args.first_seed, args.first_seed + args.seeds)
    results: dict[str, list[Traverse]] = {}
    for name, ground in grounds.items():
        kept = [store.load(name, seed) for seed in seeds]
        done = results[name] = [result for result in kept if result is not None]
        left = [seed for seed in seeds if seed not in {result.seed for result in done}]
        with Progress(f'driving on {name}', len(left), 'worlds') as progress:

            def show(result: Traverse, count: int, _: int) -> None:
                progress(count)
                store.save(name, result)
                done.append(result)
                say(f'{name}, seed {result.seed}: {result.outcome}, {result.distance_m:.1f} m, '
                    f'{result.stuck} times stuck, tilted up to {result.tilt_max_deg:.0f} deg')

            study(scenario.world, left, dataclasses.replace(
                settings, physics=dataclasses.replace(physics, ground=ground)), args.workers, show)
        done.sort(key=lambda result: result.seed)
    if args.grounds:
        text = traverse_report.write_grounds(results, scenario.name, args.output)
    else:
        text = traverse_report.write_all(next(iter(results.values())), scenario.name, args.output)
    print_markdown(text)
    say(f'written: {args.output}')
    return 0 if all(map(traverse_report.acceptable, results.values())) else 1
