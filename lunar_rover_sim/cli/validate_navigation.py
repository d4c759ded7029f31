"""`lunar_rover_sim validate navigation`: goals by what the rover sees."""

from __future__ import annotations

from collections.abc import Sequence
import functools
from pathlib import Path

from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_markdown, Progress, say
from lunar_rover_sim.judge.studies import navigation as study
from lunar_rover_sim.judge.studies.navigation import DRIVERS
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
@options.workers('processes that share the drives', None)
@options.folder('folder to write to', 'navigation')
@options.resume('drives')
def navigation(scenarios: Sequence[str], overrides: list[str], seeds: int, first_seed: int,
               distance: float, limit: float, sun: Sequence[float], drivers: Sequence[str],
               workers: int, output: Path, resume: bool) -> int:
    """Drive to a goal on the world of each seed.

    By what the rover sees, by the true map, and blindly, without ROS. Writes navigation.md,
    navigation.csv and figures.
    """
    scenarios = scenarios or ('baseline',)
    for name in scenarios:      # before the folder is made: what is wrong leaves none
        Scenario.load(name, overrides)
    settings = (f'{distance:g} m, {limit:g} s\n' + '\n'.join(overrides) + '\n')
    store = study.DriveStore(output, settings, resume)
    todo = study.cases(scenarios, sun, drivers, range(first_seed, first_seed + seeds))
    with Progress('driving', len(todo)) as progress:
        drives = store.study(
            functools.partial(study.run_case, distance, limit, tuple(overrides)), todo, workers,
            lambda case, drive, done: progress(
                done, note=f'{case.scenario} {case.seed} {case.driver}: {drive.outcome}'))
    print_markdown(study.write_all(drives, distance, output))
    say(output)
    return 0
