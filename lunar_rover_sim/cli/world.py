"""`lunar_rover_sim world`: build a world, look at it, take it elsewhere."""

from __future__ import annotations

import argparse
from collections.abc import Callable
import dataclasses
import json
from pathlib import Path
import time

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from lunar_rover_sim.cli import terminal
from lunar_rover_sim.cli.world_sun import add_sun
from lunar_rover_sim.errors import ConfigError, WorldError
from lunar_rover_sim.files.outputs import check_file, check_folder, check_png
from lunar_rover_sim.regolith.patch import changed_patch, save_patch
from lunar_rover_sim.rendering.snapshot import four_views
from lunar_rover_sim.run.node_config import PhysicsNodeConfig, RenderNodeConfig
from lunar_rover_sim.run.recorded_ground import recorded_ground
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.usd.suffixes import is_stage, stage_bytes
from lunar_rover_sim.world.build import build_world
from lunar_rover_sim.world.export import write as write_mesh
from lunar_rover_sim.world.map_sheet import write as write_sheet
from lunar_rover_sim.world.shade import horizon_deg, rms_slope_deg
from lunar_rover_sim.world.world_folder import load_world, save_world


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the commands."""
    actions = parser.add_subparsers(metavar='ACTION', required=True)
    _add_build(actions.add_parser)
    info = actions.add_parser('info', help='what a world folder holds; checks its hash')
    info.add_argument('folder', help='world folder')
    info.set_defaults(run=run_info)
    preview = actions.add_parser('preview', help='maps, statistics and camera views as a PNG')
    preview.add_argument('folder', help='world folder')
    preview.add_argument('-o', '--output', type=Path, metavar='FILE',
                         help='PNG to write (default: FOLDER.png)')
    preview.add_argument('--sun', nargs=2, type=float, default=(60.0, 6.0),
                         metavar=('AZIMUTH', 'ELEVATION'),
                         help='[deg] from east towards north, above the horizontal')
    preview.add_argument('--no-views', action='store_true',
                         help='leave the camera views out; they need EGL')
    preview.add_argument('--overwrite', action='store_true', help='replace an existing file')
    preview.set_defaults(run=run_preview, check_output=check_png)
    _add_export(actions.add_parser)
    add_sun(actions.add_parser)


def _add_export(add_parser: Callable[..., argparse.ArgumentParser]) -> None:
    export = add_parser('export', help='a mesh file (GLB, OBJ, PLY) or an OpenUSD stage; the '
                        'tracks of a recording in a mesh file, or as heights (NPZ)')
    export.add_argument('folder', nargs='?', help='world folder (default with --at: the world of'
                        ' the recording)')
    export.add_argument('-o', '--output', required=True, type=Path, metavar='FILE',
                        help='file to write; its suffix says the format: .glb, .obj, .ply, or '
                             '.usd, .usda, .usdc, .usdz for a stage; with --at also .npz: x, y, '
                             'height, height change and compaction [m]')
    export.add_argument('--overwrite', action='store_true', help='replace an existing file')
    mesh = export.add_argument_group('mesh files')
    mesh.add_argument('--stride', type=int, default=0, metavar='N',
                      help='keep every N-th sample of the ground (default: 513 along a side)')
    mesh.add_argument('--no-rocks', action='store_true', help='leave the rocks out')
    mesh.add_argument('--surroundings', action='store_true', help='add the coarse levels')
    mesh.add_argument('--at', type=Path, metavar='BAG', help='with the tracks that a recording '
                      'left on soft ground')
    mesh.add_argument('--time', type=float, metavar='S', help='simulated time of these tracks [s]'
                      ' (default: the end)')
    stage = export.add_argument_group('stages')
    stage.add_argument('--scenario', metavar='NAME_OR_PATH',
                       help='where sun, reflectance, gravity and friction are from (default: '
                            'their defaults)')
    stage.add_argument('--sun', nargs=2, type=float, metavar=('AZIMUTH', 'ELEVATION'),
                       help='[deg] from east towards north, above the horizontal')
    stage.add_argument('--name', metavar='NAME', help='of the default prim (default: World)')
    stage.add_argument('--no-surroundings', action='store_true',
                       help='leave the coarse levels and distant rocks out')
    export.set_defaults(run=run_export, check_output=check_file)


def _add_build(add_parser: Callable[..., argparse.ArgumentParser]) -> None:
    text = 'make a world folder from a scenario, an elevation model or a mesh'
    build = add_parser('build', help=text, description=text)
    build.add_argument('--scenario', default='baseline', metavar='NAME_OR_PATH',
                       help='scenario whose world section is the recipe (default: baseline)')
    source = build.add_mutually_exclusive_group()
    source.add_argument('--dem', metavar='FILE',
                        help='elevation model: GeoTIFF, or folder with dem.npy and dem.yaml')
    source.add_argument('--mesh', metavar='FILE', help='mesh: OBJ, STL, PLY, GLB')
    build.add_argument('--window', nargs=2, type=float, metavar=('X', 'Y'),
                       help='middle of the world in the elevation model or mesh')
    build.add_argument('--window-in', default='offset',
                       choices=('offset', 'crs', 'lonlat', 'pixel'),
                       help='what X and Y are: metres from the middle of the file (default), its'
                            ' CRS, degrees, or pixels')
    build.add_argument('--size', type=float, metavar='M', help='side of the fine ground [m]')
    build.add_argument('--seed', type=int, help='seed of everything random')
    build.add_argument('--set', action='append', default=[], metavar='world.PARAM=VALUE',
                       help='set any parameter, for example world.rocks.abundance=0.02')
    build.add_argument('-o', '--output', required=True, type=Path, metavar='DIR',
                       help='folder to make')
    build.add_argument('--overwrite', action='store_true', help='replace an existing world')
    build.set_defaults(run=run_build, check_output=check_folder)


def overrides(args: argparse.Namespace) -> list[str]:
    """Return what the options of `build` set, as `--set` would."""
    result = []
    if args.dem is not None:
        result += ['world.source=dem', f'world.path={json.dumps(args.dem)}']
    if args.mesh is not None:
        result += ['world.source=mesh', f'world.path={json.dumps(args.mesh)}']
    if args.window is not None:
        x, y = args.window
        if args.mesh is not None and args.window_in != 'offset':
            raise ConfigError(f'--window-in: {args.window_in} is not valid for a mesh; valid is '
                              'offset')
        section = 'mesh' if args.mesh is not None else 'dem'
        result.append(f'world.{section}.center=[{x!r}, {y!r}]')
        if section == 'dem':
            result.append(f'world.dem.center_mode={args.window_in}')
    if args.size is not None:
        result.append(f'world.size_m={args.size!r}')
    for item in args.set:
        if not item.startswith('world.'):
            raise ConfigError(f'--set {item}: valid is world.PARAM=VALUE')
    return result + args.set


def run_build(args: argparse.Namespace) -> int:
    """Build a world and write it to a folder."""
    if args.seed is not None and not 0 <= args.seed < 2**31:
        raise ConfigError(f'--seed: {args.seed} is not valid; valid is 0 to 2147483647')
    settings = overrides(args)
    if args.seed is not None:
        settings.append(f'world.seed={args.seed}')
    scenario = Scenario.load(args.scenario, settings, seed=args.seed)
    folder: Path = args.output
    if folder.exists() and not args.overwrite:
        raise WorldError(f'{folder}: exists already; choose another folder, remove it, or say '
                         '--overwrite')
    start = time.monotonic()
    columns = (TextColumn('{task.description:<22}'), BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True,
                  disable=not console.is_terminal) as progress:
        task = progress.add_task('world', total=1.0)
        world = build_world(
            scenario.world, scenario.shared.seed,
            lambda what, done: progress.update(task, description=what, completed=done))
    save_world(world, folder, args.overwrite)
    seconds = time.monotonic() - start
    ground = world.ground
    print(f'{folder}: {2 * ground.half_extent_m:g} m at {ground.cell_m:g} m, '
          f'{len(world.rocks)} rocks, horizon at {world.levels[-1].half_extent_m:g} m, seed '
          f'{world.config.seed}, hash {world.hash} ({seconds:.1f} s)')
    for name in ('filled_pixels', 'holes', 'overhangs'):
        if world.report.get(name):
            print(f'{name}: {world.report[name]}')
    return 0


def run_info(args: argparse.Namespace) -> int:
    """Print what is in a world folder."""
    folder = Path(args.folder)
    world = load_world(folder)
    shown = terminal.table(('', ''), 2, show_header=False, title=str(folder))
    config, ground = world.config, world.ground
    shown.add_row('source', f'{config.source} {config.path}'.strip())
    shown.add_row('seed', str(config.seed))
    shown.add_row('hash', f'{world.hash} (checked)')
    for index, level in enumerate(world.levels):
        shown.add_row('ground' if index == 0 else f'level {index}',
                      f'{2 * level.half_extent_m:g} m at {level.cell_m:g} m, heights '
                      f'{level.heights_m.min():.2f} to {level.heights_m.max():.2f} m')
    slopes = ', '.join(f'{rms_slope_deg(ground, b):.1f}° at {b:g} m' for b in (0.1, 0.3, 1.0, 3.0)
                       if b < ground.half_extent_m)
    shown.add_row('RMS slope', slopes)
    line = horizon_deg(world, np.arange(0.0, 360.0, 2.0))
    shown.add_row('horizon', f'{line.min():.1f}° to {line.max():.1f}° from 0.3 m above the origin')
    inside = np.abs(world.craters.position_m).max(axis=1, initial=0.0) <= ground.half_extent_m
    shown.add_row('craters', f'{int(inside.sum())} on the ground, {len(inside)} in all')
    diameter = world.rocks.diameter_m
    if len(diameter):
        shown.add_row('rocks', f'{len(diameter)}, {diameter.min():.3g} to {diameter.max():.3g} m, '
                               f'{int((diameter >= 0.3).sum())} of 0.3 m and more')
    else:
        shown.add_row('rocks', 'none')
    shown.add_row('albedo factor', f'{world.albedo.mean():.3f} ± {world.albedo.std():.3f}')
    for name, value in world.report.items():
        shown.add_row(name.replace('_', ' '), f'{value:.6g}' if isinstance(value, float)
                      else str(value))
    size = sum(file.stat().st_size for file in folder.iterdir() if file.is_file())
    shown.add_row('size', f'{size / 1e6:.0f} MB')
    terminal.console().print(shown)
    return 0


def run_preview(args: argparse.Namespace) -> int:
    """Write the sheet of maps."""
    azimuth, elevation = _checked_sun(args.sun)
    folder = Path(args.folder)
    output = args.output or folder.resolve().with_suffix('.png')
    _refuse_existing(output, args.overwrite)
    world = load_world(folder)
    views: list = []
    if not args.no_views:
        views = four_views(world, azimuth, elevation)
    write_sheet(world, output, azimuth, elevation, views)
    print(output)
    return 0


def run_export(args: argparse.Namespace) -> int:
    """Write a mesh file or a stage."""
    output: Path = args.output
    of_stage = {'--scenario': args.scenario, '--sun': args.sun, '--name': args.name,
                '--no-surroundings': args.no_surroundings}
    of_mesh = {'--stride': args.stride, '--no-rocks': args.no_rocks,
               '--surroundings': args.surroundings}
    foreign = of_mesh if is_stage(output) else of_stage
    for name, value in foreign.items():
        if value:
            kind = 'mesh files' if foreign is of_mesh else 'stages'
            raise ConfigError(f'{name}: is for {kind}, and {output} is none')
    if args.at is not None and is_stage(output):
        raise ConfigError(f'--at: is for mesh files and .npz, and {output} is none')
    if args.at is None and (args.folder is None or args.time is not None
                            or output.suffix.lower() == '.npz'):
        raise ConfigError('export: give the folder of a world, or --at BAG; --time and .npz need '
                          '--at')
    if is_stage(output):
        _export_stage(args, output)
    else:
        _refuse_existing(output, args.overwrite)
        _export_mesh(args, output)
    print(f'{output}: {stage_bytes(output) / 1e6:.1f} MB')
    return 0


def _export_mesh(args: argparse.Namespace, output: Path) -> None:
    if args.at is None:
        write_mesh(load_world(args.folder), output, args.stride, not args.no_rocks,
                   args.surroundings)
        return
    world, overlay = recorded_ground(args.at, args.folder, args.time)
    patch = changed_patch(world.ground, overlay)
    if output.suffix.lower() == '.npz':
        save_patch(patch, output)
    else:
        write_mesh(world, output, args.stride, not args.no_rocks, args.surroundings, patch)


def _export_stage(args: argparse.Namespace, output: Path) -> None:
    # Here, because OpenUSD is an optional dependency.
    from lunar_rover_sim.usd.output import check_output, check_prim_name
    from lunar_rover_sim.usd.recorded_drive import settings_of
    from lunar_rover_sim.usd.world_stage import write_world
    check_output(output, args.overwrite)
    name = check_prim_name(args.name if args.name is not None else 'World')
    scenario = Scenario.load(args.scenario) if args.scenario else None
    settings = settings_of(scenario.physics_node if scenario else PhysicsNodeConfig(),
                           scenario.render_node if scenario else RenderNodeConfig())
    if args.sun is not None:
        azimuth, elevation = _checked_sun(args.sun)
        sun = dataclasses.replace(settings.sun, azimuth_deg=azimuth, elevation_deg=elevation)
        settings = dataclasses.replace(settings, sun=sun)
    with Console(stderr=True).status('writing the stage'):
        write_world(load_world(args.folder), output, settings, name=name,
                    surroundings=not args.no_surroundings, overwrite=args.overwrite)


def _checked_sun(sun: tuple[float, float]) -> tuple[float, float]:
    azimuth, elevation = sun
    if not (-360.0 <= azimuth <= 360.0 and -1.0 <= elevation <= 90.0):
        raise ConfigError(f'--sun: {azimuth:g} {elevation:g} is not valid; valid are an azimuth '
                          'of -360 to 360 and an elevation of -1 to 90 [deg]')
    return azimuth, elevation


def _refuse_existing(path: Path, overwrite: bool) -> None:
    if path.exists() and not overwrite:
        raise WorldError(f'{path}: exists already; choose another name or say --overwrite')
