"""`lunar_rover_sim world`: build a world, look at it, take it elsewhere."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import dataclasses
import json
from pathlib import Path
import time
from typing import Any

import numpy as np
from rich import box

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.paths import check_file, check_png
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_json, print_table, Progress, say
from lunar_rover_sim.ground.regolith.patch import changed_patch, save_patch
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.export import write as write_mesh
from lunar_rover_sim.ground.world.map_sheet import write as write_sheet
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.orbital import (HEIGHTS, OrbitalErrors, PHOTO, SUFFIXES,
                                                  write_features, write_map)
from lunar_rover_sim.ground.world.shade import horizon_deg, rms_slope_deg
from lunar_rover_sim.ground.world.site import reported_site, Site
from lunar_rover_sim.ground.world.world_folder import load_world, save_world
from lunar_rover_sim.image.illumination.dates import parse_date, shown
from lunar_rover_sim.image.illumination.light_time import sky_over_time, SkyOverTime, write_figure
from lunar_rover_sim.image.rendering.snapshot import four_views
from lunar_rover_sim.products.usd.names import is_stage, stage_bytes
from lunar_rover_sim.run.node_config import PhysicsNodeConfig, RenderNodeConfig
from lunar_rover_sim.run.recorded_run import RecordedRun
from lunar_rover_sim.run.scenario import Scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the commands."""
    actions = parser.add_subparsers(metavar='ACTION', required=True)
    _add_build(options.add_action(
        actions, 'build', 'make a world folder from a scenario, an elevation model or a mesh',
        run_build))
    info = options.add_action(actions, 'info', 'what a world folder holds; checks its hash',
                              run_info)
    info.add_argument('folder', help='world folder')
    options.add_json(info)
    preview = options.add_action(actions, 'preview', 'maps, statistics and camera views as a PNG',
                                 run_preview)
    preview.add_argument('folder', help='world folder')
    options.add_output(preview, check_png, 'FILE', 'PNG to write (default: FOLDER.png)',
                       required=False)
    preview.add_argument('--sun', nargs=2, type=float, default=(60.0, 6.0),
                         metavar=('AZIMUTH', 'ELEVATION'),
                         help='[deg] from east towards north, above the horizontal')
    preview.add_argument('--no-views', action='store_true',
                         help='leave the camera views out; they need EGL')
    options.add_overwrite(preview)
    _add_export(options.add_action(
        actions, 'export', 'a mesh file (GLB, OBJ, PLY), a map (GeoTIFF, GeoJSON) or an OpenUSD '
        'stage; the tracks of a recording in a mesh file, or as heights (NPZ)', run_export))
    _add_sun(options.add_action(
        actions, 'sun', 'sun, Earth and light at a place on the Moon over time', run_sun))


def _add_export(export: argparse.ArgumentParser) -> None:
    export.add_argument('folder', nargs='?', help='world folder (default with --at: the world of'
                        ' the recording)')
    options.add_output(export, check_file, 'FILE', 'file to write; its suffix says the format: '
                       '.glb, .obj, .ply, .tif (heights, or with --photo an orthophoto), '
                       '.geojson (rocks and craters), or .usd, .usda, .usdc, .usdz for a stage; '
                       'with --at also .npz: x, y, height, height change and compaction [m]')
    options.add_overwrite(export)
    mesh = export.add_argument_group('mesh files')
    mesh.add_argument('--stride', type=int, default=0, metavar='N',
                      help='keep every N-th sample of the ground (default: 513 along a side)')
    mesh.add_argument('--no-rocks', action='store_true', help='leave the rocks out')
    mesh.add_argument('--surroundings', action='store_true', help='add the coarse levels')
    mesh.add_argument('--at', type=Path, metavar='BAG', help='with the tracks that a recording '
                      'left on soft ground')
    mesh.add_argument('--time', type=float, metavar='S', help='simulated time of these tracks [s]'
                      ' (default: the end)')
    maps = export.add_argument_group('maps: what an orbiter knows of the fine ground')
    options.add_number(maps, '--resolution', 0.001, unit='m', default=1.0, metavar='M',
                       help='side of a pixel of .tif')
    maps.add_argument('--photo', action='store_true', help='an orthophoto, lit by --sun, in place '
                      'of heights')
    options.add_number(maps, '--height-error', 0.0, unit='m', default=0.0, metavar='M',
                       help='standard deviation of the heights')
    options.add_number(maps, '--shift-error', 0.0, unit='m', default=0.0, metavar='M',
                       help='standard deviation of the shift of the whole map')
    options.add_number(maps, '--noise', 0.0, 1.0, default=0.0,
                       help='standard deviation of the brightness of a photo, of full scale')
    options.add_number(maps, '--error-seed', 0, kind=int, default=1, help='seed of these errors')
    stage = export.add_argument_group('stages')
    options.add_scenario_option(stage, 'where sun, reflectance, gravity and friction are from '
                                '(default: their defaults)')
    stage.add_argument('--sun', nargs=2, type=float, metavar=('AZIMUTH', 'ELEVATION'),
                       help='[deg] from east towards north, above the horizontal')
    stage.add_argument('--name', metavar='NAME', help='of the default prim (default: World)')
    stage.add_argument('--no-surroundings', action='store_true',
                       help='leave the coarse levels and distant rocks out')


def _add_build(build: argparse.ArgumentParser) -> None:
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
    options.add_number(build, '--seed', 0, 2**31 - 1, kind=int, help='seed of everything random')
    options.add_overrides(build, 'world.PARAM=VALUE',
                          'set any parameter, for example world.rocks.abundance=0.02')
    options.add_folder(build, 'folder to make')
    options.add_overwrite(build, 'an existing world')


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
    for item in args.overrides:
        if not item.startswith('world.'):
            raise ConfigError(f'--set {item}: valid is world.PARAM=VALUE')
    return result + args.overrides


def run_build(args: argparse.Namespace) -> int:
    """Build a world and write it to a folder."""
    settings = overrides(args)
    if args.seed is not None:
        settings.append(f'world.seed={args.seed}')
    scenario = Scenario.load(args.scenario, settings, seed=args.seed)
    folder: Path = args.output
    options.refuse_existing(folder, args.overwrite)
    start = time.monotonic()
    with Progress('building the world', 1.0, '%') as progress:
        world = build_world(scenario.world, scenario.shared.seed, progress.named)
    save_world(world, folder, args.overwrite)
    seconds = time.monotonic() - start
    ground = world.ground
    say(f'{folder}: {2 * ground.half_extent_m:g} m at {ground.cell_m:g} m, '
        f'{len(world.rocks)} rocks, horizon at {world.levels[-1].half_extent_m:g} m, seed '
        f'{world.config.seed}, hash {world.hash} ({seconds:.1f} s)')
    for name in ('filled_pixels', 'holes', 'overhangs'):
        if world.report.get(name):
            say(f'{name}: {world.report[name]}')
    return 0


def run_info(args: argparse.Namespace) -> int:
    """Print what is in a world folder."""
    found = _info(Path(args.folder))
    if args.json:
        print_json(found)
        return 0
    rows = [('source', f'{found["source"]} {found["path"]}'.strip()), ('seed', str(found['seed'])),
            ('hash', f'{found["hash"]} (checked)')]
    for index, level in enumerate(found['levels']):
        low, high = level['height_m']
        rows.append(('ground' if index == 0 else f'level {index}',
                     f'{level["side_m"]:g} m at {level["cell_m"]:g} m, heights {low:.2f} to '
                     f'{high:.2f} m'))
    rows.append(('RMS slope', ', '.join(f'{slope:.1f}° at {baseline} m' for baseline, slope
                                        in found['rms_slope_deg'].items())))
    low, high = found['horizon_deg']
    rows.append(('horizon', f'{low:.1f}° to {high:.1f}° from 0.3 m above the origin'))
    craters, rocks = found['craters'], found['rocks']
    rows.append(('craters', f'{craters["on_ground"]} on the ground, {craters["all"]} in all'))
    if rocks['all']:
        low, high = rocks['diameter_m']
        rows.append(('rocks', f'{rocks["all"]}, {low:.3g} to {high:.3g} m, '
                              f'{rocks["of_0.3_m_and_more"]} of 0.3 m and more'))
    else:
        rows.append(('rocks', 'none'))
    rows.append(('albedo factor', '{mean:.3f} ± {std:.3f}'.format(**found['albedo_factor'])))
    rows += [(name.replace('_', ' '), f'{value:.6g}' if isinstance(value, float) else str(value))
             for name, value in found['report'].items()]
    rows.append(('size', f'{found["size_bytes"] / 1e6:.0f} MB'))
    print_table(('', ''), 2, rows, show_header=False, title=args.folder)
    return 0


def _info(folder: Path) -> dict[str, Any]:
    """Return what a world folder holds, as plain values."""
    world = load_world(folder)
    config, ground, diameter = world.config, world.ground, world.rocks.diameter_m
    line = horizon_deg(world, np.arange(0.0, 360.0, 2.0))
    inside = np.abs(world.craters.position_m).max(axis=1, initial=0.0) <= ground.half_extent_m
    return {
        'source': config.source, 'path': str(config.path), 'seed': config.seed, 'hash': world.hash,
        'levels': [{'side_m': 2 * level.half_extent_m, 'cell_m': level.cell_m,
                    'height_m': [float(level.heights_m.min()), float(level.heights_m.max())]}
                   for level in world.levels],
        'rms_slope_deg': {f'{b:g}': float(rms_slope_deg(ground, b)) for b in (0.1, 0.3, 1.0, 3.0)
                          if b < ground.half_extent_m},
        'horizon_deg': [float(line.min()), float(line.max())],
        'craters': {'on_ground': int(inside.sum()), 'all': len(inside)},
        'rocks': {'all': len(diameter), 'of_0.3_m_and_more': int((diameter >= 0.3).sum()),
                  'diameter_m': [float(diameter.min()), float(diameter.max())]
                  if len(diameter) else None},
        'albedo_factor': {'mean': float(world.albedo.mean()), 'std': float(world.albedo.std())},
        'report': dict(world.report),
        'size_bytes': sum(file.stat().st_size for file in folder.iterdir() if file.is_file())}


def run_preview(args: argparse.Namespace) -> int:
    """Write the sheet of maps."""
    azimuth, elevation = options.checked_sun(args.sun)
    folder = Path(args.folder)
    output = args.output or folder.resolve().with_suffix('.png')
    options.refuse_existing(output, args.overwrite)
    world = load_world(folder)
    views: list = []
    if not args.no_views:
        views = four_views(world, azimuth, elevation)
    write_sheet(world, output, azimuth, elevation, views)
    say(output)
    return 0


def run_export(args: argparse.Namespace) -> int:
    """Write a mesh file or a stage."""
    output: Path = args.output
    of_stage = {'--scenario': args.scenario, '--sun': args.sun, '--name': args.name,
                '--no-surroundings': args.no_surroundings}
    of_mesh = {'--stride': args.stride, '--no-rocks': args.no_rocks,
               '--surroundings': args.surroundings}
    is_map = output.suffix.lower() in SUFFIXES
    if is_map:
        return _export_map(args, output)
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
        options.refuse_existing(output, args.overwrite)
        _export_mesh(args, output)
    say(f'{output}: {stage_bytes(output) / 1e6:.1f} MB')
    return 0


def _export_map(args: argparse.Namespace, output: Path) -> int:
    """Write heights, a photo, or rocks and craters."""
    if args.folder is None or args.at is not None:
        raise ConfigError(f'export: {output.name} needs the folder of a world, without --at')
    options.refuse_existing(output, args.overwrite)
    world = load_world(args.folder)
    if output.suffix.lower() == '.geojson':
        say(f'{output}: {write_features(world, output)} rocks and craters')
        return 0
    sun = options.checked_sun(args.sun) if args.sun is not None else (60.0, 6.0)
    write_map(world, output, args.resolution, PHOTO if args.photo else HEIGHTS,
              OrbitalErrors(args.height_error, args.shift_error, args.noise, args.error_seed), sun)
    say(f'{output}: {output.stat().st_size / 1e6:.2f} MB')
    return 0


def _export_mesh(args: argparse.Namespace, output: Path) -> None:
    if args.at is None:
        write_mesh(load_world(args.folder), output, args.stride, not args.no_rocks,
                   args.surroundings)
        return
    with open_bag(args.at) as bag:
        world, overlay = RecordedRun(bag).ground(args.time, args.folder)
    patch = changed_patch(world.ground, overlay)
    if output.suffix.lower() == '.npz':
        save_patch(patch, output)
    else:
        write_mesh(world, output, args.stride, not args.no_rocks, args.surroundings, patch)


def _export_stage(args: argparse.Namespace, output: Path) -> None:
    # Here, because OpenUSD is an optional dependency.
    from lunar_rover_sim.products.usd.drive_stage import settings_of
    from lunar_rover_sim.products.usd.output import check_output, check_prim_name
    from lunar_rover_sim.products.usd.world_stage import write_world
    check_output(output, args.overwrite)
    name = check_prim_name(args.name if args.name is not None else 'World')
    scenario = Scenario.load(args.scenario) if args.scenario else None
    settings = settings_of(scenario.physics_node if scenario else PhysicsNodeConfig(),
                           scenario.render_node if scenario else RenderNodeConfig())
    if args.sun is not None:
        azimuth, elevation = options.checked_sun(args.sun)
        sun = dataclasses.replace(settings.sun, azimuth_deg=azimuth, elevation_deg=elevation)
        settings = dataclasses.replace(settings, sun=sun)
    with Progress('writing the stage'):
        write_world(load_world(args.folder), output, settings, name=name,
                    surroundings=not args.no_surroundings, overwrite=args.overwrite)


_MONTH_H = 708.7        # from one noon to 29.53 days later
_MAX_H = 20.0 * 365.25 * 24.0


def _add_sun(sun: argparse.ArgumentParser) -> None:
    """Declare what `world sun` takes."""
    sun.add_argument('place', nargs='+', metavar='PLACE',
                     help='longitude and latitude [deg], or a world folder, whose horizon then '
                          'hides the sun')
    sun.add_argument('--at', nargs=2, type=float, metavar=('LON', 'LAT'),
                     help='where a world lies that does not say so')
    sun.add_argument('--from', dest='start', default='', metavar='DATE',
                     help='UTC in ISO 8601 (default: now)')
    sun.add_argument('--to', dest='end', default='', metavar='DATE',
                     help='UTC in ISO 8601 (default: a lunar day, 29.5 days, later)')
    sun.add_argument('--step', type=float, default=24.0, metavar='H',
                     help='time between rows of the table [h] (default: 24)')
    options.add_output(sun, check_png, 'FILE', 'PNG to write: elevations over time, the way '
                       'before the horizon', required=False)
    options.add_overwrite(sun)


def run_sun(args: argparse.Namespace) -> int:
    """Print the table, and write the figure if one is asked for."""
    site, world = _place(args)
    start, hours = _time(args)
    if args.output is not None:
        options.refuse_existing(args.output, args.overwrite)
    # Hourly at least, and on every row of the table.
    fine = max(int(np.ceil(args.step)), 1)
    count = int(hours / args.step * fine) + 1
    over = sky_over_time(site, start + np.arange(count) * np.timedelta64(
        round(args.step * 3.6e9 / fine), 'us'), world)
    name = f'longitude {site.lon_deg:.4f}°, latitude {site.lat_deg:.4f}°'
    print_table(('UTC', 'sun elev.', 'azimuth', 'true az.', 'in light', 'Earth elev.', 'azimuth'),
                1, _rows(over, fine), title=name, box=box.SIMPLE_HEAD, padding=(0, 0))
    say(_summary(over, site, world))
    if args.output is not None:
        write_figure(over, args.output, name if world is None else f'{args.place[0]}: {name}')
        say(args.output)
    return 0


def _place(args: argparse.Namespace) -> tuple[Site, World | None]:
    """Return the site, and the world if a folder is given."""
    if len(args.place) > 2:
        raise ConfigError(f'PLACE: {" ".join(args.place)} is not valid; valid are a longitude and '
                          'a latitude [deg], or a world folder')
    if len(args.place) == 2:
        if args.at is not None:
            raise ConfigError('--at: is for a world folder')
        try:
            lon, lat = map(float, args.place)
        except ValueError:
            raise ConfigError(f'PLACE: {" ".join(args.place)} is not valid; valid are two numbers '
                              '[deg], or a world folder') from None
        return _site('PLACE', lon, lat), None
    world = load_world(args.place[0])
    site = reported_site(world.report)
    if args.at is not None:
        if site is not None:
            raise ConfigError(f'--at: {args.at[0]:g} {args.at[1]:g} is not valid; {args.place[0]} '
                              f'lies at {site.lon_deg:.4f} {site.lat_deg:.4f}')
        site = _site('--at', *args.at)
    if site is None:
        raise ConfigError(f'{args.place[0]}: does not say where on the Moon it is; give --at LON '
                          'LAT. Worlds of a GeoTIFF say it if this version built them')
    return site, world


def _site(name: str, lon_deg: float, lat_deg: float) -> Site:
    if not (abs(lon_deg) <= 360.0 and abs(lat_deg) <= 90.0):
        raise ConfigError(f'{name}: {lon_deg:g} {lat_deg:g} is not valid; valid are a longitude '
                          'of -360 to 360 and a latitude of -90 to 90 [deg]')
    return Site(lon_deg, lat_deg)


def _time(args: argparse.Namespace) -> tuple[np.datetime64, float]:
    """Return the start and the length [h]."""
    start = parse_date('--from', args.start) if args.start else np.datetime64('now', 'us')
    hours = _MONTH_H
    if args.end:
        hours = float((parse_date('--to', args.end) - start) / np.timedelta64(1, 'h'))
    if not 0.1 <= args.step <= _MAX_H:
        raise ConfigError(f'--step: {args.step:g} is not valid; valid is 0.1 to {_MAX_H:g} [h]')
    if not args.step <= hours <= _MAX_H:
        raise ConfigError(f'--to: {args.end or "29.5 days"} is {hours:.6g} h after --from '
                          f'({shown(start)}); valid is --step ({args.step:g} h) to 20 years')
    return start, hours


def _rows(over: SkyOverTime, every: int) -> Iterator[tuple[str, ...]]:
    """Yield every n-th sample as a row."""
    sun, earth = over.sky.sun, over.sky.earth
    for k in range(0, len(over.dates_utc), every):
        yield (np.datetime_as_string(over.dates_utc[k], unit='m').replace('T', ' '),
               f'{sun.elevation_deg[k]:.2f}°', f'{sun.azimuth_deg[k]:.2f}°',
               f'{sun.true_azimuth_deg[k]:.2f}°', f'{100.0 * over.lit[k]:.0f} %',
               f'{earth.elevation_deg[k]:.2f}°', f'{earth.azimuth_deg[k]:.2f}°')


def _summary(over: SkyOverTime, site: Site, world: World | None) -> str:
    """Return what holds for the whole time, in words."""
    elevation = over.sky.sun.elevation_deg
    high, low = int(np.argmax(elevation)), int(np.argmin(elevation))
    horizon = 'level' if world is None else (
        f'{over.mask_deg.min():.2f}° to {over.mask_deg.max():.2f}°, of the ground within '
        f'{world.levels[-1].half_extent_m:g} m')
    return (f'azimuth from x (east) towards y, true azimuth from north towards east; y is '
            f'{site.grid_north_deg:.3f}° from true north towards east\n'
            f'sun highest {elevation[high]:.3f}° at {shown(over.dates_utc[high])}, lowest '
            f'{elevation[low]:.3f}° at {shown(over.dates_utc[low])}; horizon {horizon}\n'
            f'in light {100.0 * over.light_share:.1f} % of the time, longest night '
            f'{over.longest_night_h:.0f} h; apparent diameter of the sun '
            f'{2.0 * over.sky.sun.radius_deg.mean():.4f}°, of the Earth '
            f'{2.0 * over.sky.earth.radius_deg.mean():.3f}°')
