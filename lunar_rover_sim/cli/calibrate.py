"""`lunar_rover_sim calibrate gait`: measure the map from velocity to gait."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.outputs import check_file
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.studies import gait_measurement


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Walks the rover of a scenario over flat ground, with its gravity, contact and'
        ' gait, at many phase rates and turns, and writes the table that'
        ' gait_controller_node follows commands by (parameter calibration).')
    parser.add_argument('scenario', nargs='?', default='flat',
                        help='scenario that names rover, gravity, contact and gait (default: '
                             '%(default)s)')
    parser.add_argument('--set', action='append', default=[], metavar='NODE.PARAM=VALUE',
                        dest='overrides', help='override one parameter; may be repeated')
    parser.add_argument('-o', '--output', type=Path, default=Path('gait_calibration.yaml'),
                        metavar='FILE', help='table to write (default: %(default)s)')
    parser.add_argument('--force', action='store_true', help='overwrite an existing table')
    parser.add_argument('--coarse', action='store_true',
                        help='a table of 54 instead of 165 strides')
    parser.add_argument('--measure', type=float, default=20.0, metavar='S',
                        help='time that each walk is measured for [s]; fast turns scatter, and'
                             ' longer walks average it out (default: %(default)s)')
    parser.add_argument('--workers', type=int, default=os.cpu_count() or 1, metavar='N',
                        help='processes that share the work (default: one per core)')
    parser.set_defaults(run=run, check_output=check_file)


def run(args: argparse.Namespace) -> int:
    """Measure, write the table, say what it reaches."""
    if args.output.exists() and not args.force:
        raise ConfigError(f'--output: {args.output} exists; give another name, or --force')
    if args.workers < 1:
        raise ConfigError(f'--workers: {args.workers} is not valid; valid is >= 1')
    if not 1.0 <= args.measure <= gait_measurement.MAX_MEASURE_S:
        raise ConfigError(f'--measure: {args.measure:g} is not valid; valid is 1 to '
                          f'{gait_measurement.MAX_MEASURE_S:g} [s]')
    scenario = Scenario.load(args.scenario, args.overrides)
    settings = gait_measurement.MeasurementSettings(scenario.rover, scenario.physics_node,
                                                    scenario.gait_controller_node, args.measure)
    rates, turns = gait_measurement.COARSE if args.coarse else gait_measurement.FINE
    console = Console()
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task('walking')
        table = gait_measurement.measure(
            settings, rates, turns, args.workers,
            lambda done, total: bar.update(task, completed=done, total=total))
    table.save(args.output)
    ahead, spot = [row[0] for row in table.forward_mps], [row[-1] for row in table.yaw_rate_radps]
    console.print(f'{args.output}: {len(rates)} phase rates, {len(turns)} turns; straight on'
                  f' {ahead[0]:.3f} to {ahead[-1]:.3f} m/s, on the spot {spot[0]:.3f} to'
                  f' {spot[-1]:.3f} rad/s', soft_wrap=True, highlight=False)
    console.print(f'use it: --set gait_controller_node.calibration={args.output.resolve()}',
                  soft_wrap=True, highlight=False)
    return 0
