"""`lunar_rover_sim validate stereo`: SGM on rendered pairs, against true depth."""

from __future__ import annotations

from collections.abc import Sequence
import json
from pathlib import Path

import click

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import make_new_folder
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_table, Progress, say
from lunar_rover_sim.judge.studies.stereo import study
from lunar_rover_sim.run.scenario import Scenario


@options.command(scenarios=True)
@options.scenario(many=True)
@click.option('-n', '--frames', type=options.number('--frames', 1, kind=int), default=12,
              metavar='N', help='pairs per scenario')
@options.new_folder('folder for table and figures')
@options.seed()
@options.overrides()
def stereo(scenarios: Sequence[str], frames: int, output: Path, seed: int | None,
           overrides: list[str]) -> int:
    """Compare semi-global matching with true depth.

    Along a loop through each scenario: a table of density and errors, and figures.
    """
    loaded = [Scenario.load(name, overrides, seed=seed) for name in scenarios]
    make_new_folder(output)
    results: dict[str, dict[str, float]] = {}
    for scenario in loaded:
        with Progress(scenario.name) as progress:
            errors = study(scenario, frames, output, progress)
        results[scenario.name] = errors.summary()
    print_table(('', *results), 1, (
        (row, *(_formatted(row, of[row]) for of in results.values()))
        for row in next(iter(results.values()))), title='SGM against true depth')
    atomic_write(output / 'stereo.json', json.dumps(results, indent=1) + '\n', ConfigError)
    say(f'written to {output}')
    return 0


def _formatted(row: str, value: float) -> str:
    """Return a figure as the table shows it: shares in per cent, errors in px, some signed."""
    if not row.endswith('[px]'):
        return f'{100 * value:.1f} %'
    return f'{value:+.3f}' if 'signed' in row else f'{value:.3f}'
