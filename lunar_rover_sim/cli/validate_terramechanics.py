"""`lunar_rover_sim validate terramechanics`: what soft ground is held to, and what it changes."""

from __future__ import annotations

import argparse
import functools
import os
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from lunar_rover_sim.cli.terminal import print_markdown
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.outputs import check_new_folder, make_new_folder
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.studies import terramechanics_anchors, terramechanics_report
from lunar_rover_sim.studies.parallel import map_in_processes
from lunar_rover_sim.studies.terramechanics import (Ground, GROUNDS, GroundWalk, measure, PULLS,
                                                    SKIP_S, SLOPES_DEG, WalkSettings)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Holds soft ground to published numbers, closed forms and scaling laws, and walks on it:'
        ' on the level, up slopes of 0 to 30 degrees, and against a pull. Writes'
        ' terramechanics.md, terramechanics.csv, terramechanics.png and sandbot.png.')
    parser.add_argument('scenario', nargs='?', default='flat',
                        help='scenario that names rover, physics and gait (flat)')
    parser.add_argument('--set', action='append', default=[], metavar='NODE.PARAM=VALUE',
                        dest='overrides', help='override one parameter; may be repeated')
    parser.add_argument('--grounds', nargs='+', default=list(GROUNDS), metavar='NAME',
                        help='grounds to walk on: rigid, or presets (rigid and the highlands)')
    parser.add_argument('--speed', type=float, default=0.12, metavar='V',
                        help='commanded speed [m/s]')
    parser.add_argument('--duration', type=float, default=13.0, metavar='S',
                        help='length of each walk [s]')
    parser.add_argument('--workers', type=int, default=os.cpu_count() or 1, metavar='N',
                        help='processes that share the walks (one per core)')
    parser.add_argument('-o', '--output', type=Path, default=Path('terramechanics'),
                        metavar='DIR', help='folder to write to (terramechanics)')
    parser.set_defaults(run=run, check_output=check_new_folder)


def run(args: argparse.Namespace) -> int:
    """Measure, write the report; return 1 if an anchor of the model does not hold."""
    for name, value, low in (('--speed', args.speed, 0.0), ('--duration', args.duration, SKIP_S),
                             ('--workers', args.workers, 0.5)):
        if not low < value < 1e4:
            raise ConfigError(f'{name}: {value:g} is not valid; valid is > {low:g}')
    for name in args.grounds:
        Ground(name).config()   # raises ConfigError for one that does not exist
    scenario = Scenario.load(args.scenario, args.overrides)
    gait = scenario.gait_controller_node
    settings = WalkSettings(scenario.rover, scenario.physics_node, gait, args.speed, args.duration)
    make_new_folder(args.output)

    console = Console()
    grounds = [Ground(name, slope) for name in args.grounds for slope in SLOPES_DEG]
    grounds += [Ground(name, 0.0, pull) for name in args.grounds for pull in PULLS[1:]]
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task('walking')

        def show(_: GroundWalk, done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        walks = map_in_processes(functools.partial(measure, settings), grounds, args.workers, show)
        bar.add_task('holding to numbers', total=None)
        anchors = (terramechanics_anchors.plates() + terramechanics_anchors.simulated(settings)
                   + terramechanics_anchors.compared(walks))
    text = terramechanics_report.write_all(anchors, walks, args.output)
    print_markdown(console, text)
    console.print(f'written: {args.output}', highlight=False, soft_wrap=True)
    return 0 if all(anchor.holds for anchor in anchors if anchor.held) else 1
