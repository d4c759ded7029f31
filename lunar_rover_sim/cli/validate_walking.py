"""`lunar_rover_sim validate locomotion` and `terramechanics`: walks."""

from __future__ import annotations

from collections.abc import Sequence
import functools
from pathlib import Path

import click

from lunar_rover_sim.base.files.paths import make_new_folder
from lunar_rover_sim.base.gravity import EARTH_MPS2, MOON_MPS2
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_markdown, Progress, say
from lunar_rover_sim.judge.studies import locomotion as pitch
from lunar_rover_sim.judge.studies import terramechanics as walks
from lunar_rover_sim.judge.studies.gait_measurement import (COMMANDS, CommandTracking,
                                                            measure_commands)
from lunar_rover_sim.judge.studies.study_folder import map_in_processes
from lunar_rover_sim.judge.studies.walking import on_ground
from lunar_rover_sim.run.scenario import Scenario


def _load(name: str, overrides: list[str], grounds: Sequence[str]) -> Scenario:
    """Return a scenario; raise ConfigError where its gait or a ground is not valid."""
    loaded = Scenario.load(name, overrides)
    loaded.gait_controller_node.for_rover(loaded.rover)
    for ground in grounds:
        on_ground(loaded, ground)
    return loaded


@options.command(scenarios=True)
@options.scenario('flat')
@options.overrides()
@options.new_folder('folder to write to', 'locomotion')
@options.several('--speeds', type=options.number('--speeds', 0.0, above=True),
                 default=(0.06, 0.12, 0.2), metavar='V...', help='forward speeds [m/s]')
@options.several('--gravities', type=options.number('--gravities', 0.0, above=True),
                 default=(MOON_MPS2, EARTH_MPS2), metavar='G...', help='gravities [m/s²]')
@options.bounded('--duration', pitch.STEADY_FROM_S + 2.0, unit='s', above=True, default=30.0,
                 metavar='S', help='length of each walk')
@click.option('--no-commands', is_flag=True, help='leave out the grid of velocity commands')
@options.several('--grounds', default=('rigid', 'highland', 'highland_loose'), none=True,
                 metavar='NAME...', help='grounds to compare with the first one, by straight '
                 'walks over the relief of regolith: rigid, or presets; none to leave them out')
@options.bounded('--seeds', 1, kind=int, default=8, help='number of such worlds')
@options.workers('processes that share the grid of commands', None)
def locomotion(scenario: str, overrides: list[str], output: Path, speeds: Sequence[float],
               gravities: Sequence[float], duration: float, no_commands: bool,
               grounds: Sequence[str], seeds: int, workers: int) -> int:
    """Measure the pitch of the walk, and how well commands are followed.

    Against a velocity interface, and on several grounds. Writes reports, CSV and figures. Exits
    with 1 if a command was not followed.
    """
    loaded, speeds = _load(scenario, overrides, grounds), sorted(set(speeds))
    loaded.gait_controller()    # raises ConfigError for a calibration that cannot be read
    make_new_folder(output)
    tracking: list[CommandTracking] = []
    compared: walks.Walks = {}
    with Progress('walking') as progress:
        cases = pitch.study(loaded, speeds, sorted(set(gravities)), duration, progress)
        if not no_commands:
            progress.start('following commands')
            tracking = measure_commands(loaded, COMMANDS, workers=workers, progress=progress)
        if grounds:
            progress.start('walking on soft ground')
            compared = walks.walk_study(loaded, grounds, speeds, range(1, seeds + 1),
                                        workers=workers, progress=progress)
    text = pitch.write_all(cases, tracking, output)
    if compared:
        text += '\n' + walks.write_walks(compared, output)
    print_markdown(text)
    say(f'written: {output}')
    return 0 if all(each.followed for each in tracking) else 1


@options.command(scenarios=True)
@options.scenario('flat')
@options.overrides()
@options.several('--grounds', default=walks.GROUNDS, metavar='NAME...',
                 help='grounds to walk on: rigid, or presets of soil')
@options.bounded('--speed', 0.0, unit='m/s', above=True, default=walks.SPEED_MPS, metavar='V',
                 help='commanded speed')
@options.bounded('--duration', walks.SKIP_S, unit='s', above=True, default=walks.DURATION_S,
                 metavar='S', help='length of each walk')
@options.workers('processes that share the walks', None)
@options.new_folder('folder to write to', 'terramechanics')
def terramechanics(scenario: str, overrides: list[str], grounds: Sequence[str], speed: float,
                   duration: float, workers: int, output: Path) -> int:
    """Walk on several grounds.

    On the level, up slopes of 0 to 30 degrees, and against a pull. Writes terramechanics.md,
    terramechanics.csv and terramechanics.png.
    """
    loaded = _load(scenario, overrides, grounds)
    make_new_folder(output)
    with Progress('walking') as progress:
        walked = map_in_processes(
            functools.partial(walks.measure, loaded, speed_mps=speed, duration_s=duration),
            walks.cases(grounds), workers, progress)
    print_markdown(walks.write_all(walked, output))
    say(f'written: {output}')
    return 0
