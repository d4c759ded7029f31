"""`lunar_rover_sim world export`: a world as a mesh file, an OpenUSD stage or maps from orbit."""

from __future__ import annotations

import dataclasses
from pathlib import Path
import re

import click
from click.core import ParameterSource

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.paths import check_file, check_folder, check_path
from lunar_rover_sim.base.files.yaml_text import parse_yaml
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import Progress, say
from lunar_rover_sim.ground.regolith.patch import changed_patch, save_patch
from lunar_rover_sim.ground.world.export import write as write_mesh
from lunar_rover_sim.ground.world.orbital_making import orbital_map
from lunar_rover_sim.ground.world.orbital_map import OrbitalConfig
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.products.usd.names import is_stage, stage_bytes
from lunar_rover_sim.run.node_config import PhysicsNodeConfig, RenderNodeConfig
from lunar_rover_sim.run.recorded_run import RecordedRun
from lunar_rover_sim.run.scenario import Scenario

_PLACE = re.compile(r'[-+.\deE]+,[-+.\deE]+')
_ORBITAL = 'orbital.'
_OF_MAPS = '.tif', '.tiff', '.geojson'
_OF_ORBITAL = ('folder', 'output', 'overwrite', 'orbital', 'overrides', 'sun')


@options.command()
@options.argument('folder', 'world folder (default with --at: the world of the recording)',
                  required=False, type=options.PATH, metavar='[FOLDER]')
@options.output(check_path, 'PATH', 'file whose suffix says the format: .glb, .obj, .ply; .usd, '
                '.usda, .usdc, .usdz; with --at BAG .npz, the tracks; with --orbital a folder')
@options.overwrite()
@click.option('--orbital', is_flag=True, help='all that an orbiter knows, with its errors: '
              'heights.tif, photo.tif under --sun, craters.geojson, orbital.json')
@options.overrides('orbital.PARAM=VALUE', help='with --orbital: its extent, pixels and errors, '
                   'for example orbital.pixel_m=5')
@click.option('--stride', type=int, default=0, metavar='N', show_default=False, help='mesh file: '
              'keep every N-th sample of the ground (default: 513 along a side)')
@click.option('--no-rocks', is_flag=True, help='mesh file: leave the rocks out')
@click.option('--surroundings', is_flag=True, help='mesh file: add the coarse levels')
@click.option('--at', metavar='X,Y|BAG', help='the window of the site around a place [m]; or, of '
              'a recording, the one in which the rover was, with its tracks in a mesh file')
@click.option('--time', type=float, metavar='S', help='mesh file: simulated time of these tracks '
              '[s] (default: the end)')
@options.scenario_option('stage: where sun, reflectance, gravity and friction are from (default: '
                         'their defaults)')
@options.sun('stage, --orbital: ')
@click.option('--name', metavar='NAME', help='stage: of the default prim (default: World)')
@click.option('--no-surroundings', is_flag=True,
              help='stage: leave the coarse levels and distant rocks out')
def export(folder: Path | None, output: Path, overwrite: bool, orbital: bool,
           overrides: list[str], stride: int, no_rocks: bool, surroundings: bool,
           at: str | None, time: float | None, scenario: str | None,
           sun: tuple[float, float] | None, name: str | None, no_surroundings: bool) -> int:
    """Write a mesh file (GLB, OBJ, PLY) or an OpenUSD stage.

    Or the tracks of a recording (mesh or NPZ), or with --orbital a folder of maps.
    """
    if orbital:
        _check_orbital(folder, output)
        assert folder is not None
        check_folder(output)
        options.refuse_existing(output, overwrite)
        _export_orbital(folder, output, overrides, sun)
        return 0
    if overrides:
        raise ConfigError('--set: is for --orbital, which is not given')
    check_file(output)
    bag = place = None
    if at is not None and _PLACE.fullmatch(at):
        place = options.place(at, '--at')
    elif at is not None:
        bag = Path(at)
    if output.suffix.lower() in _OF_MAPS:
        raise ConfigError(f'--output: {output} is not valid; valid is a folder, with --orbital, '
                          'for maps')
    of_stage = {'--scenario': scenario, '--sun': sun, '--name': name,
                '--no-surroundings': no_surroundings}
    of_mesh = {'--stride': stride, '--no-rocks': no_rocks, '--surroundings': surroundings}
    foreign = of_mesh if is_stage(output) else of_stage
    for option, value in foreign.items():
        if value:
            kind = 'mesh files' if foreign is of_mesh else 'stages'
            raise ConfigError(f'{option}: is for {kind}, and {output} is none')
    if bag is not None and is_stage(output):
        raise ConfigError(f'--at BAG: is for mesh files and .npz, and {output} is none')
    if bag is None and (folder is None or time is not None or output.suffix.lower() == '.npz'):
        raise ConfigError('export: give the folder of a world, or --at BAG; --time and .npz need '
                          '--at')
    if folder is not None and is_stage(output):
        _export_stage(folder, place, output, scenario, sun, name, not no_surroundings, overwrite)
    else:
        options.refuse_existing(output, overwrite)
        patch = None
        if bag is not None:
            with open_bag(bag) as opened:
                world, overlay = RecordedRun(opened).ground(time, folder)
            patch = changed_patch(world.ground, overlay)
        else:
            assert folder is not None
            world = options.window_of(folder, place)
        if patch is not None and output.suffix.lower() == '.npz':
            save_patch(patch, output)
        else:
            write_mesh(world.local(), output, stride, not no_rocks, surroundings,
                       None if patch is None else patch.around(world.ground.middle_m))
    say(f'{output}: {stage_bytes(output) / 1e6:.1f} MB')
    return 0


def _check_orbital(folder: Path | None, output: Path) -> None:
    """Raise ConfigError where an option is given that is not for --orbital, or a file."""
    context = click.get_current_context()
    for param in context.command.params:
        given = context.get_parameter_source(param.name or '') is ParameterSource.COMMANDLINE
        if given and param.name not in _OF_ORBITAL:
            raise ConfigError(f'{param.opts[0]}: is not for --orbital; valid is --set '
                              f'{_ORBITAL}PARAM=VALUE')
    if folder is None:
        raise ConfigError('export: --orbital needs the folder of a world')
    if output.suffix.lower() in _OF_MAPS:
        raise ConfigError(f'--output: {output} is not valid with --orbital, which writes a '
                          'folder; valid is a name without such a suffix')


def _export_orbital(folder: Path, output: Path, overrides: list[str],
                    sun: tuple[float, float] | None) -> None:
    """Write the folder of maps from orbit."""
    values = {}
    if sun is not None:
        values['sun_azimuth_deg'], values['sun_elevation_deg'] = options.checked_sun(sun)
    for text in overrides:
        name, _, value = text.partition('=')
        if not name.startswith(_ORBITAL):
            raise ConfigError(f'--set {text}: valid is {_ORBITAL}PARAM=VALUE')
        values[name.removeprefix(_ORBITAL)] = parse_yaml(value, f'--set {text}')
    config = OrbitalConfig.from_mapping(values, _ORBITAL.rstrip('.'))
    with Progress('maps from orbit', 1.0, '%') as progress:
        made = orbital_map(load_world(folder), config, progress.named)
        made.save(output)
    west, south, east, north = made.bounds_m
    photo = f', photo at {config.photo_pixel_m:g} m' if config.photo_pixel_m else ''
    say(f'{output}: x {west:g} to {east:g} m, y {south:g} to {north:g} m; heights at '
        f'{made.pixel_m:g} m{photo}, {len(made.craters)} craters')


def _export_stage(folder: Path, at: tuple[float, float] | None, output: Path,
                  scenario: str | None, sun: tuple[float, float] | None, name: str | None,
                  surroundings: bool, overwrite: bool) -> None:
    # Here, because OpenUSD is an optional dependency.
    from lunar_rover_sim.products.usd.drive_stage import settings_of
    from lunar_rover_sim.products.usd.stage import check_output, check_prim_name
    from lunar_rover_sim.products.usd.world_stage import write_world
    check_output(output, overwrite)
    prim = check_prim_name('World' if name is None else name)
    chosen = Scenario.load(scenario) if scenario else None
    settings = settings_of(chosen.physics_node if chosen else PhysicsNodeConfig(),
                           chosen.render_node if chosen else RenderNodeConfig())
    if sun is not None:
        azimuth, elevation = options.checked_sun(sun)
        settings = dataclasses.replace(settings, sun=dataclasses.replace(
            settings.sun, azimuth_deg=azimuth, elevation_deg=elevation))
    with Progress('writing the stage'):
        write_world(options.window_of(folder, at), output, settings, name=prim,
                    surroundings=surroundings, overwrite=overwrite)
