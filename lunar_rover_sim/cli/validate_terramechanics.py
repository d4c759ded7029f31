"""`lunar_rover_sim validate terramechanics`: walks on soft ground, slopes and against a pull."""

from __future__ import annotations

from collections.abc import Sequence
import functools
from pathlib import Path

from lunar_rover_sim.base.files.paths import make_new_folder
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_markdown, Progress, say
from lunar_rover_sim.judge.studies.study_folder import map_in_processes
from lunar_rover_sim.judge.studies.terramechanics import (Ground, GROUNDS, measure, PULLS, SKIP_S,
                                                          SLOPES_DEG, WalkSettings, write_all)
from lunar_rover_sim.run.scenario import Scenario


@options.command(scenarios=True)
@options.scenario('flat')
@options.overrides()
@options.several('--grounds', default=GROUNDS, metavar='NAME...',
                 help='grounds to walk on: rigid, or presets of soil')
@options.bounded('--speed', 0.0, unit='m/s', above=True, default=0.12, metavar='V',
                 help='commanded speed')
@options.bounded('--duration', SKIP_S, unit='s', above=True, default=13.0, metavar='S',
                 help='length of each walk')
@options.workers('processes that share the walks', None)
@options.new_folder('folder to write to', 'terramechanics')
def terramechanics(scenario: str, overrides: list[str], grounds: Sequence[str], speed: float,
                   duration: float, workers: int, output: Path) -> int:
    """Walk on several grounds.

    On the level, up slopes of 0 to 30 degrees, and against a pull. Writes terramechanics.md,
    terramechanics.csv and terramechanics.png.
    """
    for name in grounds:
        Ground(name).config()   # raises ConfigError for one that does not exist
    loaded = Scenario.load(scenario, overrides)
    gait = loaded.gait_controller_node
    settings = WalkSettings(loaded.rover, loaded.physics_node, gait, speed, duration)
    make_new_folder(output)

    cases = [Ground(name, slope) for name in grounds for slope in SLOPES_DEG]
    cases += [Ground(name, 0.0, pull) for name in grounds for pull in PULLS[1:]]
    with Progress('walking') as progress:
        walks = map_in_processes(functools.partial(measure, settings), cases, workers,
                                 lambda _, done, total: progress(done, total))
    text = write_all(walks, output)
    print_markdown(text)
    say(f'written: {output}')
    return 0
