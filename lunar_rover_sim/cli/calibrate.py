"""`lunar_rover_sim calibrate gait`: measure the map from velocity to gait."""

from __future__ import annotations

import argparse

from lunar_rover_sim.base.files.paths import check_file
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import Progress, say
from lunar_rover_sim.judge.studies import gait_measurement
from lunar_rover_sim.run.scenario import Scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Walks the rover of a scenario over flat ground, with its gravity, contact and'
        ' gait, at many phase rates and turns, and writes the table that'
        ' gait_controller_node follows commands by (parameter calibration).')
    options.add_scenario(parser, 'flat')
    options.add_overrides(parser)
    options.add_output(parser, check_file, 'FILE', 'table to write', 'gait_calibration.yaml')
    options.add_overwrite(parser, 'an existing table')
    parser.add_argument('--coarse', action='store_true',
                        help='a table of 54 instead of 165 strides')
    options.add_number(parser, '--measure', 1.0, gait_measurement.MAX_MEASURE_S, unit='s',
                       default=20.0, metavar='S', help='time that each walk is measured for; fast '
                       'turns scatter, and longer walks average it out')
    options.add_workers(parser, 'processes that share the work', None)


def run(args: argparse.Namespace) -> int:
    """Measure, write the table, say what it reaches."""
    options.refuse_existing(args.output, args.overwrite)
    scenario = Scenario.load(args.scenario, args.overrides)
    settings = gait_measurement.MeasurementSettings(scenario.rover, scenario.physics_node,
                                                    scenario.gait_controller_node, args.measure)
    rates, turns = gait_measurement.COARSE if args.coarse else gait_measurement.FINE
    with Progress('walking') as progress:
        table = gait_measurement.measure(settings, rates, turns, args.workers, progress)
    table.save(args.output)
    made = len(table.phase_rates_hz)
    if made < len(rates):
        say(f'phase rates from {rates[made]:g} Hz on are left out: the rover tips over')
    ahead, spot = [row[0] for row in table.forward_mps], [row[-1] for row in table.yaw_rate_radps]
    say(f'{args.output}: {made} phase rates, {len(turns)} turns; straight on'
        f' {ahead[0]:.3f} to {ahead[-1]:.3f} m/s, on the spot {spot[0]:.3f} to'
        f' {spot[-1]:.3f} rad/s')
    say(f'use it: --set gait_controller_node.calibration={args.output.resolve()}')
    return 0
