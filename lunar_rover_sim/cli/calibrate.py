"""`lunar_rover_sim calibrate gait`: measure the map from velocity to gait."""

from __future__ import annotations

from pathlib import Path

import click

from lunar_rover_sim.base.files.paths import check_file
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import Progress, say
from lunar_rover_sim.judge.studies import gait_measurement
from lunar_rover_sim.run.scenario import Scenario


@options.command(scenarios=True)
@options.scenario('flat')
@options.overrides()
@options.output(check_file, 'FILE', 'table to write', 'gait_calibration.yaml')
@options.overwrite('an existing table')
@click.option('--coarse', is_flag=True, help='a table of 54 instead of 165 strides')
@options.bounded('--measure', 1.0, gait_measurement.MAX_MEASURE_S, unit='s', default=20.0,
                 metavar='S', help='time that each walk is measured for; fast turns scatter')
@options.workers('processes that share the work', None)
def gait(scenario: str, overrides: list[str], output: Path, overwrite: bool, coarse: bool,
         measure: float, workers: int) -> int:
    """Measure the map from velocity to gait.

    Walks over flat ground at many phase rates and turns; gait_controller_node.calibration takes
    the table.
    """
    options.refuse_existing(output, overwrite)
    loaded = Scenario.load(scenario, overrides)
    rates, turns = gait_measurement.COARSE if coarse else gait_measurement.FINE
    with Progress('walking') as progress:
        table = gait_measurement.measure(loaded, rates, turns, measure, workers, progress)
    table.save(output)
    made = len(table.phase_rates_hz)
    if made < len(rates):
        say(f'phase rates from {rates[made]:g} Hz on are left out: the rover tips over')
    ahead, spot = [row[0] for row in table.forward_mps], [row[-1] for row in table.yaw_rate_radps]
    say(f'{output}: {made} phase rates, {len(turns)} turns; straight on'
        f' {ahead[0]:.3f} to {ahead[-1]:.3f} m/s, on the spot {spot[0]:.3f} to'
        f' {spot[-1]:.3f} rad/s')
    say(f'use it: --set gait_controller_node.calibration={output.resolve()}')
    return 0
