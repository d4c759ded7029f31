"""`lunar_rover_sim rover`: take the rover elsewhere."""

from __future__ import annotations

from pathlib import Path

import click

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import check_file
from lunar_rover_sim.cli import options
from lunar_rover_sim.products.usd.names import is_stage, stage_bytes, SUFFIXES
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.rover.urdf import urdf
from lunar_rover_sim.run.node_config import PhysicsNodeConfig, RenderNodeConfig
from lunar_rover_sim.run.scenario import Scenario


@options.command()
@options.argument('rover', 'rover description, YAML (default: that of the scenario, else the '
                  'packaged one)', required=False, type=options.PATH, metavar='[ROVER]')
@options.output(check_file, 'FILE', 'file to write; its suffix says the format: .usd, .usda, '
                '.usdc, .usdz or .urdf')
@options.scenario_option('where rover, cameras and friction are from (default: their defaults)')
@click.option('--name', metavar='NAME', help='of the default prim (default: Rover)')
@options.overwrite()
def export(rover: Path | None, output: Path, scenario: str | None, name: str | None,
           overwrite: bool) -> int:
    """Write an OpenUSD stage (articulation, drives, cameras) or URDF of the rover."""
    loaded = Scenario.load(scenario) if scenario else None
    made = loaded.rover if loaded and rover is None else load_rover(rover)
    if is_stage(output):
        # Here, because OpenUSD is an optional dependency.
        from lunar_rover_sim.products.usd.rover_stage import write_rover
        render = loaded.render_node if loaded else RenderNodeConfig()
        physics = loaded.physics_node if loaded else PhysicsNodeConfig()
        write_rover(made, output, camera=render.camera, sensor=render.sensor,
                    friction=physics.contact.sliding_friction,
                    name='Rover' if name is None else name, overwrite=overwrite)
    elif output.suffix.lower() == '.urdf':
        if name:
            raise ConfigError(f'--name: is for stages, and {output} is none')
        options.refuse_existing(output, overwrite)
        atomic_write(output, urdf(made), ConfigError)
    else:
        raise ConfigError(f'{output}: {output.suffix or "no suffix"} is not valid; valid are '
                          f'{", ".join(SUFFIXES)} and .urdf')
    print(f'{output}: {made.total_mass_kg:g} kg, {stage_bytes(output) / 1e3:.0f} kB')
    return 0
