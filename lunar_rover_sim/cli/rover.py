"""`lunar_rover_sim rover`: take the rover elsewhere."""

from __future__ import annotations

import argparse
from pathlib import Path

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import check_file
from lunar_rover_sim.cli import options
from lunar_rover_sim.products.usd.names import is_stage, stage_bytes, SUFFIXES
from lunar_rover_sim.rover.rover_file import load_rover
from lunar_rover_sim.rover.urdf import urdf
from lunar_rover_sim.run.node_config import PhysicsNodeConfig, RenderNodeConfig
from lunar_rover_sim.run.scenario import Scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the commands."""
    actions = parser.add_subparsers(metavar='ACTION', required=True)
    export = options.add_action(actions, 'export', 'an OpenUSD stage (articulation, drives, '
                                'cameras) or URDF', run_export)
    export.add_argument('rover', nargs='?', type=Path, metavar='ROVER',
                        help='rover description, YAML (default: that of the scenario, else the '
                             'packaged one)')
    options.add_output(export, check_file, 'FILE', 'file to write; its suffix says the format: '
                       '.usd, .usda, .usdc, .usdz or .urdf')
    options.add_scenario_option(export, 'where rover, cameras and friction are from (default: '
                                'their defaults)')
    export.add_argument('--name', metavar='NAME', help='of the default prim (default: Rover)')
    options.add_overwrite(export)


def run_export(args: argparse.Namespace) -> int:
    """Write the rover."""
    scenario = Scenario.load(args.scenario) if args.scenario else None
    rover = scenario.rover if scenario and args.rover is None else load_rover(args.rover)
    output = args.output
    if is_stage(output):
        # Here, because OpenUSD is an optional dependency.
        from lunar_rover_sim.products.usd.rover_stage import write_rover
        render = scenario.render_node if scenario else RenderNodeConfig()
        physics = scenario.physics_node if scenario else PhysicsNodeConfig()
        write_rover(rover, output, camera=render.camera, sensor=render.sensor,
                    friction=physics.contact.sliding_friction,
                    name=args.name if args.name is not None else 'Rover',
                    overwrite=args.overwrite)
    elif output.suffix.lower() == '.urdf':
        if args.name:
            raise ConfigError(f'--name: is for stages, and {output} is none')
        options.refuse_existing(output, args.overwrite)
        atomic_write(output, urdf(rover), ConfigError)
    else:
        raise ConfigError(f'{output}: {output.suffix or "no suffix"} is not valid; valid are '
                          f'{", ".join(SUFFIXES)} and .urdf')
    print(f'{output}: {rover.total_mass_kg:g} kg, {stage_bytes(output) / 1e3:.0f} kB')
    return 0
