"""`lunar_rover_sim validate locomotion`: the pitch of the walk, and commands followed."""

from __future__ import annotations

import argparse
from pathlib import Path

from lunar_rover_sim.base.files.paths import make_new_folder
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_markdown, Progress, say
from lunar_rover_sim.judge.studies import (locomotion, locomotion_grounds, locomotion_report,
                                           terramechanics)
from lunar_rover_sim.judge.studies.gait_measurement import (COMMANDS, CommandTracking,
                                                            measure_commands, MeasurementSettings)
from lunar_rover_sim.judge.studies.locomotion import read_curve, STEADY_FROM_S
from lunar_rover_sim.judge.studies.terramechanics import Ground
from lunar_rover_sim.rover.gait.calibration import GaitCalibration
from lunar_rover_sim.run.scenario import Scenario

GROUNDS = ('rigid', 'highland', 'highland_loose')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Drives the same velocities on flat ground through gait and contact and'
        ' through a velocity interface, compares the pitch of both, says how far a tracker'
        ' mispredicts images of the walk at several frame rates, and measures how'
        ' well velocity commands are followed. Writes locomotion.md, locomotion.png'
        ' and pitch.csv, and compares grounds in grounds.md and grounds_SPEED.png.')
    options.add_scenario(parser, 'flat')
    options.add_overrides(parser)
    options.add_new_folder(parser, 'folder to write to', 'locomotion')
    parser.add_argument('--speeds', type=options.number('--speeds', 0.0, above=True), nargs='+',
                        default=[0.06, 0.12, 0.2], metavar='V', help='forward speeds [m/s]')
    parser.add_argument('--gravities', type=options.number('--gravities', 0.0, above=True),
                        nargs='+', default=[1.62, 9.81], metavar='G', help='gravities [m/s²]')
    options.add_number(parser, '--duration', STEADY_FROM_S + 2.0, unit='s', above=True,
                       default=30.0, metavar='S', help='length of each walk')
    parser.add_argument('--overlay', type=Path, action='append', default=[], metavar='CSV',
                        help='another pitch curve, time [s] and pitch [deg], that starts 1 s'
                             ' before its command; may be repeated')
    parser.add_argument('--no-commands', action='store_true',
                        help='leave out the grid of velocity commands')
    parser.add_argument('--grounds', nargs='*', default=list(GROUNDS), metavar='NAME',
                        help='grounds to compare with the first one, by straight walks over the'
                             ' relief of regolith: rigid, or presets; none to leave them out')
    options.add_number(parser, '--seeds', 1, kind=int, default=8, help='number of such worlds')
    options.add_workers(parser, 'processes that share the grid of commands', None)


def run(args: argparse.Namespace) -> int:
    """Walk, write the report; return 1 if a velocity command was not followed."""
    for name in args.grounds:
        Ground(name).config()   # raises ConfigError for one that does not exist
    scenario = Scenario.load(args.scenario, args.overrides)
    gait, physics = scenario.gait_controller_node, scenario.physics_node
    table = GaitCalibration.of(gait, physics.ground.name, scenario.rover.name)
    overlays = [read_curve(path) for path in args.overlay]
    make_new_folder(args.output)

    tracking: list[CommandTracking] = []
    with Progress('walking') as progress:
        cases = locomotion.study(
            table, scenario.rover, physics, gait, sorted(set(args.speeds)),
            sorted(set(args.gravities)), args.duration, scenario.render_node.camera, progress)
        if not args.no_commands:
            progress.start('following commands')
            tracking = measure_commands(
                COMMANDS, table, MeasurementSettings(scenario.rover, physics, gait), args.workers,
                progress)
        walks: locomotion_grounds.Walks = {}
        if args.grounds:
            progress.start('walking on soft ground')
            walks = locomotion_grounds.study(
                terramechanics.WalkSettings(scenario.rover, physics, gait), args.grounds,
                sorted(set(args.speeds)), range(1, args.seeds + 1), args.workers,
                progress)
    text = locomotion_report.write_all(cases, overlays, tracking, args.output)
    if walks:
        text += '\n' + locomotion_grounds.write_all(walks, args.output)
    print_markdown(text)
    say(f'written: {args.output}')
    return 0 if all(each.followed for each in tracking) else 1
