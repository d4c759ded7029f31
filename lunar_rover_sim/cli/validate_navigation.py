"""`lunar_rover_sim validate navigation`: goals by what the rover sees."""

from __future__ import annotations

import argparse
import re

from lunar_rover_sim.autonomy.navigation.config import SLAM, TRUTH, WHEELS
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_markdown, Progress, say
from lunar_rover_sim.judge.studies import navigation
from lunar_rover_sim.judge.studies.navigation_drives import DRIVERS
from lunar_rover_sim.judge.studies.navigation_poses import REFERENCE
from lunar_rover_sim.run.scenario import Scenario, scenario_names


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Drives to a goal on the world of each seed: by what the rover sees, by the true map'
        ' (the bound), and straight ahead, blindly. Depth is that of rays with the errors of the'
        ' matcher and the shadows of the sun; no ROS and no images are needed. Writes'
        ' navigation.md, navigation.csv, navigation.png and, of estimates, navigation_poses.png.')
    parser.add_argument('scenarios', nargs='*', default=['baseline'], metavar='SCENARIO',
                        help=f'of {", ".join(scenario_names())} (default: baseline)')
    options.add_overrides(parser)
    options.add_number(parser, '--seeds', 1, kind=int, default=30, help='number of worlds')
    options.add_number(parser, '--first-seed', 0, kind=int, default=1,
                       help='seed of the first world')
    options.add_number(parser, '--distance', 1.0, unit='m', default=10.0, metavar='M',
                       help='distance of the goal')
    options.add_number(parser, '--limit', 10.0, unit='s', default=400.0, metavar='S',
                       help='simulated time after which a drive ends')
    parser.add_argument('--sun', type=options.number('--sun', 0.1, 90.0, 'deg'), default=[6.0],
                        nargs='+', metavar='ELEVATION',
                        help='elevations of the sun [deg] (default: 6)')
    parser.add_argument('--drivers', nargs='+', choices=DRIVERS, default=list(DRIVERS),
                        help='who drives (default: all)')
    parser.add_argument('--poses', nargs='+', default=[TRUTH], metavar='POSE',
                        help='by which pose the rover that sees maps and drives: truth; wheels;'
                             ' drift=SHARE, the truth that walks off by so much of the way;'
                             ' reference, the built-in odometry; or slam, the program of'
                             ' slam_node.command; the last two see rendered images (default:'
                             ' truth)')
    options.add_workers(parser, 'processes that share the drives', None)
    options.add_folder(parser, 'folder to write to', 'navigation')
    parser.add_argument('--resume', action='store_true',
                        help='go on with an interrupted study: finished drives are kept')


def run(args: argparse.Namespace) -> int:
    """Drive and write the report."""
    for pose in args.poses:
        if pose not in (TRUTH, WHEELS, REFERENCE, SLAM) \
                and not re.fullmatch(r'drift=0?\.\d+', pose):
            raise ConfigError(f'--poses: {pose!r} is not valid; valid are truth, wheels, '
                              'reference, slam, drift=SHARE, for example drift=0.02')
    # Before the folder is made: what is wrong with a scenario leaves none.
    scenarios = [Scenario.load(name, args.overrides) for name in args.scenarios]
    if SLAM in args.poses and not scenarios[0].slam_node.command:
        raise ConfigError('--poses slam: needs the program, --set slam_node.command="PROGRAM '
                          'ARGUMENTS"')
    settings = (f'{args.distance:g} m, {args.limit:g} s\n' + '\n'.join(args.overrides) + '\n')
    store = navigation.DriveStore(args.output, settings, args.resume)
    todo = navigation.cases(args.scenarios, args.sun, args.drivers, args.poses,
                            range(args.first_seed, args.first_seed + args.seeds))
    with Progress('driving', len(todo)) as progress:
        drives = navigation.study(
            todo, store, args.distance, args.limit, args.overrides, args.workers,
            lambda case, drive, done: progress(
                done, note=f'{case.scenario} {case.seed} {case.driver}: {drive.outcome}'))
    print_markdown(navigation.write_all(drives, args.distance, args.output))
    say(args.output)
    return 0
