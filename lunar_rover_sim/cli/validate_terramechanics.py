"""`lunar_rover_sim validate terramechanics`: walks on soft ground, slopes and against a pull."""

from __future__ import annotations

import argparse
import functools

from lunar_rover_sim.base.files.paths import make_new_folder
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_markdown, Progress, say
from lunar_rover_sim.judge.studies import terramechanics_report
from lunar_rover_sim.judge.studies.study_folder import map_in_processes
from lunar_rover_sim.judge.studies.terramechanics import (Ground, GROUNDS, measure, PULLS, SKIP_S,
                                                          SLOPES_DEG, WalkSettings)
from lunar_rover_sim.run.scenario import Scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Walks on several grounds: on the level, up slopes of 0 to 30 degrees, and against a'
        ' pull. Writes terramechanics.md, terramechanics.csv and terramechanics.png.')
    options.add_scenario(parser, 'flat')
    options.add_overrides(parser)
    parser.add_argument('--grounds', nargs='+', default=list(GROUNDS), metavar='NAME',
                        help='grounds to walk on: rigid, or presets of soil (default: '
                             f'{" ".join(GROUNDS)})')
    options.add_number(parser, '--speed', 0.0, unit='m/s', above=True, default=0.12, metavar='V',
                       help='commanded speed')
    options.add_number(parser, '--duration', SKIP_S, unit='s', above=True, default=13.0,
                       metavar='S', help='length of each walk')
    options.add_workers(parser, 'processes that share the walks', None)
    options.add_new_folder(parser, 'folder to write to', 'terramechanics')


def run(args: argparse.Namespace) -> int:
    """Measure, write the report."""
    for name in args.grounds:
        Ground(name).config()   # raises ConfigError for one that does not exist
    scenario = Scenario.load(args.scenario, args.overrides)
    gait = scenario.gait_controller_node
    settings = WalkSettings(scenario.rover, scenario.physics_node, gait, args.speed, args.duration)
    make_new_folder(args.output)

    grounds = [Ground(name, slope) for name in args.grounds for slope in SLOPES_DEG]
    grounds += [Ground(name, 0.0, pull) for name in args.grounds for pull in PULLS[1:]]
    with Progress('walking') as progress:
        walks = map_in_processes(functools.partial(measure, settings), grounds, args.workers,
                                 lambda _, done, total: progress(done, total))
    text = terramechanics_report.write_all(walks, args.output)
    print_markdown(text)
    say(f'written: {args.output}')
    return 0
