"""`lunar_rover_sim validate locomotion`: the pitch of the walk, and commands followed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from lunar_rover_sim.base.files.paths import make_new_folder
from lunar_rover_sim.base.gravity import EARTH_MPS2, MOON_MPS2
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_markdown, Progress, say
from lunar_rover_sim.judge.studies import locomotion as pitch
from lunar_rover_sim.judge.studies import terramechanics
from lunar_rover_sim.judge.studies.gait_measurement import (COMMANDS, CommandTracking,
                                                            measure_commands, MeasurementSettings)
from lunar_rover_sim.judge.studies.locomotion import STEADY_FROM_S
from lunar_rover_sim.judge.studies.terramechanics import Ground, WalkSettings
from lunar_rover_sim.judge.studies.walking import WalkerSettings
from lunar_rover_sim.rover.gait.calibration import GaitCalibration
from lunar_rover_sim.run.scenario import Scenario

GROUNDS = ('rigid', 'highland', 'highland_loose')


@options.command(scenarios=True)
@options.scenario('flat')
@options.overrides()
@options.new_folder('folder to write to', 'locomotion')
@options.several('--speeds', type=options.number('--speeds', 0.0, above=True),
                 default=(0.06, 0.12, 0.2), metavar='V...', help='forward speeds [m/s]')
@options.several('--gravities', type=options.number('--gravities', 0.0, above=True),
                 default=(MOON_MPS2, EARTH_MPS2), metavar='G...', help='gravities [m/s²]')
@options.bounded('--duration', STEADY_FROM_S + 2.0, unit='s', above=True, default=30.0,
                 metavar='S', help='length of each walk')
@click.option('--no-commands', is_flag=True, help='leave out the grid of velocity commands')
@options.several('--grounds', default=GROUNDS, none=True, metavar='NAME...', help='grounds to '
                 'compare with the first one, by straight walks over the relief of regolith: '
                 'rigid, or presets; none to leave them out')
@options.bounded('--seeds', 1, kind=int, default=8, help='number of such worlds')
@options.workers('processes that share the grid of commands', None)
def locomotion(scenario: str, overrides: list[str], output: Path, speeds: Sequence[float],
               gravities: Sequence[float], duration: float, no_commands: bool,
               grounds: Sequence[str], seeds: int, workers: int) -> int:
    """Measure the pitch of the walk, and how well commands are followed.

    Against a velocity interface, and on several grounds. Writes reports, CSV and figures. Exits
    with 1 if a command was not followed.
    """
    for name in grounds:
        Ground(name).config()   # raises ConfigError for one that does not exist
    loaded = Scenario.load(scenario, overrides)
    gait, physics = loaded.gait_controller_node, loaded.physics_node
    table = GaitCalibration.of(gait, physics.ground.name, loaded.rover.name)
    make_new_folder(output)

    tracking: list[CommandTracking] = []
    with Progress('walking') as progress:
        cases = pitch.study(
            table, WalkerSettings(loaded.rover, physics, gait), sorted(set(speeds)),
            sorted(set(gravities)), duration, loaded.render_node.camera, progress)
        if not no_commands:
            progress.start('following commands')
            tracking = measure_commands(
                COMMANDS, table, MeasurementSettings(loaded.rover, physics, gait), workers,
                progress)
        walks: terramechanics.Walks = {}
        if grounds:
            progress.start('walking on soft ground')
            walks = terramechanics.walk_study(
                WalkSettings(loaded.rover, physics, gait), grounds, sorted(set(speeds)),
                range(1, seeds + 1), workers, progress)
    text = pitch.write_all(cases, tracking, output)
    if walks:
        text += '\n' + terramechanics.write_walks(walks, output)
    print_markdown(text)
    say(f'written: {output}')
    return 0 if all(each.followed for each in tracking) else 1
