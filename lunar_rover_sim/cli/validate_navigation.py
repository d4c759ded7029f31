"""`lunar_rover_sim validate navigation`: goals by what the rover sees."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import re

from lunar_rover_sim.autonomy.navigation.config import SLAM, TRUTH, WHEELS
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_markdown, Progress, say
from lunar_rover_sim.judge.studies import navigation as study
from lunar_rover_sim.judge.studies.navigation_drives import DRIVERS
from lunar_rover_sim.judge.studies.navigation_poses import REFERENCE
from lunar_rover_sim.run.scenario import Scenario


@options.command()
@options.scenario('baseline', many=True)
@options.overrides()
@options.bounded('--seeds', 1, kind=int, default=30, help='number of worlds')
@options.bounded('--first-seed', 0, kind=int, default=1, help='seed of the first world')
@options.bounded('--distance', 1.0, unit='m', default=10.0, metavar='M',
                 help='distance of the goal')
@options.bounded('--limit', 10.0, unit='s', default=400.0, metavar='S',
                 help='simulated time after which a drive ends')
@options.several('--sun', type=options.number('--sun', 0.1, 90.0, 'deg'), default=(6.0,),
                 metavar='ELEVATION...', help='elevations of the sun [deg]')
@options.several('--drivers', type=options.Choice(DRIVERS), default=DRIVERS,
                 metavar='DRIVER...', help=f'who drives: {", ".join(DRIVERS)}')
@options.several('--poses', default=(TRUTH,), metavar='POSE...', help='by which pose the rover '
                 'that sees maps and drives: truth; wheels; drift=SHARE, the truth that walks off '
                 'by so much of the way; reference, the built-in odometry; or slam, the program '
                 'of slam_node.command; the last two see rendered images')
@options.workers('processes that share the drives', None)
@options.folder('folder to write to', 'navigation')
@options.resume('drives')
def navigation(scenarios: Sequence[str], overrides: list[str], seeds: int, first_seed: int,
               distance: float, limit: float, sun: Sequence[float], drivers: Sequence[str],
               poses: Sequence[str], workers: int, output: Path, resume: bool) -> int:
    """Drive to a goal on the world of each seed.

    By what the rover sees, by the true map (the bound), and straight ahead, blindly. Depth is that
    of rays with the errors of the matcher and the shadows of the sun; no ROS and no images are
    needed. Writes navigation.md, navigation.csv, navigation.png and, of estimates,
    navigation_poses.png.
    """
    scenarios = scenarios or ('baseline',)
    for pose in poses:
        if pose not in (TRUTH, WHEELS, REFERENCE, SLAM) \
                and not re.fullmatch(r'drift=0?\.\d+', pose):
            raise ConfigError(f'--poses: {pose!r} is not valid; valid are truth, wheels, '
                              'reference, slam, drift=SHARE, for example drift=0.02')
    # Before the folder is made: what is wrong with a scenario leaves none.
    loaded = [Scenario.load(name, overrides) for name in scenarios]
    if SLAM in poses and not loaded[0].slam_node.command:
        raise ConfigError('--poses slam: needs the program, --set slam_node.command="PROGRAM '
                          'ARGUMENTS"')
    settings = (f'{distance:g} m, {limit:g} s\n' + '\n'.join(overrides) + '\n')
    store = study.DriveStore(output, settings, resume)
    todo = study.cases(scenarios, sun, drivers, poses, range(first_seed, first_seed + seeds))
    with Progress('driving', len(todo)) as progress:
        drives = study.study(
            todo, store, distance, limit, overrides, workers,
            lambda case, drive, done: progress(
                done, note=f'{case.scenario} {case.seed} {case.driver}: {drive.outcome}'))
    print_markdown(study.write_all(drives, distance, output))
    say(output)
    return 0
