"""`lunar_rover_sim world`: build a world, look into it, picture it; sun and Earth over it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import json
from pathlib import Path
import re
import time
from typing import Any

import click
import numpy as np
from rich import box

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.paths import check_png
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_json, print_table, Progress, say
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.map_sheet import write as write_sheet
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.moon_place import MoonPlace, reported_site
from lunar_rover_sim.ground.world.shade import horizon_deg, rms_slope_deg
from lunar_rover_sim.ground.world.world_folder import load_world, save_world
from lunar_rover_sim.image.illumination.dates import parse_date, shown
from lunar_rover_sim.image.illumination.light_time import sky_over_time, SkyOverTime, write_figure
from lunar_rover_sim.image.rendering.snapshot import four_views
from lunar_rover_sim.run.scenario import Scenario


@options.command()
@click.option('--scenario', default='baseline', metavar='NAME_OR_PATH',
              help='scenario whose world section is the recipe')
@click.option('--dem', metavar='FILE',
              help='elevation model: GeoTIFF, or folder with dem.npy and dem.yaml')
@click.option('--mesh', metavar='FILE', help='mesh: OBJ, STL, PLY, GLB')
@click.option('--window', nargs=2, type=float, metavar='X Y',
              help='middle of the world in the elevation model or mesh')
@click.option('--window-in', type=options.Choice(('offset', 'crs', 'lonlat', 'pixel')),
              default='offset', help='metres from the middle of the file, its CRS, degrees, or '
              'pixels')
@click.option('--size', type=float, metavar='M', help='side of the fine ground [m]')
@options.bounded('--seed', 0, 2**31 - 1, kind=int, help='seed of everything random')
@options.overrides('world.PARAM=VALUE',
                   help='set any parameter, for example world.rocks.abundance=0.02')
@options.folder('folder to make')
@options.overwrite('an existing world')
def build(scenario: str, dem: str | None, mesh: str | None, window: tuple[float, float] | None,
          window_in: str, size: float | None, seed: int | None, overrides: list[str],
          output: Path, overwrite: bool) -> int:
    """Make a world folder from a scenario, an elevation model or a mesh."""
    options.not_both(dem=dem, mesh=mesh)
    settings = _settings(dem, mesh, window, window_in, size, overrides)
    if seed is not None:
        settings.append(f'world.seed={seed}')
    loaded = Scenario.load(scenario, settings, seed=seed)
    options.refuse_existing(output, overwrite)
    start = time.monotonic()
    with Progress('building the world', 1.0, '%') as progress:
        world = build_world(loaded.world, loaded.shared.seed, progress.named)
    save_world(world, output, overwrite)
    seconds = time.monotonic() - start
    ground = world.ground
    say(f'{output}: {2 * ground.half_extent_m:g} m at {ground.cell_m:g} m, '
        f'{len(world.rocks)} rocks, horizon at {world.levels[-1].half_extent_m:g} m, seed '
        f'{world.config.seed}, hash {world.hash} ({seconds:.1f} s)')
    for name in ('filled_pixels', 'holes', 'overhangs'):
        if world.report.get(name):
            say(f'{name}: {world.report[name]}')
    return 0


def _settings(dem: str | None, mesh: str | None, window: tuple[float, float] | None,
              window_in: str, size: float | None, overrides: list[str]) -> list[str]:
    """Return what the options of `build` set, as `--set` would."""
    result = []
    if dem is not None:
        result += ['world.source=dem', f'world.path={json.dumps(dem)}']
    if mesh is not None:
        result += ['world.source=mesh', f'world.path={json.dumps(mesh)}']
    if window is not None:
        x, y = window
        if mesh is not None and window_in != 'offset':
            raise ConfigError(f'--window-in: {window_in} is not valid for a mesh; valid is '
                              'offset')
        section = 'mesh' if mesh is not None else 'dem'
        result.append(f'world.{section}.center=[{x!r}, {y!r}]')
        if section == 'dem':
            result.append(f'world.dem.center_mode={window_in}')
    if size is not None:
        result.append(f'world.size_m={size!r}')
    for item in overrides:
        if not item.startswith('world.'):
            raise ConfigError(f'--set {item}: valid is world.PARAM=VALUE')
    return result + overrides


@options.command()
@options.argument('folder', 'world folder', type=options.PATH, metavar='FOLDER')
@options.at_place('look into the window of the site around this place')
@options.as_json
def info(folder: Path, at: tuple[float, float] | None, as_json: bool) -> int:
    """Print what a world folder holds; check its hash."""
    found = _info(folder, at)
    if as_json:
        print_json(found)
        return 0
    rows = [('source', f'{found["source"]} {found["path"]}'.strip()), ('seed', str(found['seed'])),
            ('hash', f'{found["hash"]} (checked)')]
    if at is not None:
        rows.append(('middle', '(%g, %g) m in the site' % tuple(found['middle_m'])))
    for index, level in enumerate(found['levels']):
        low, high = level['height_m']
        rows.append(('ground' if index == 0 else f'level {index}',
                     f'{level["side_m"]:g} m at {level["cell_m"]:g} m, heights {low:.2f} to '
                     f'{high:.2f} m'))
    rows.append(('RMS slope', ', '.join(f'{slope:.1f}° at {baseline} m' for baseline, slope
                                        in found['rms_slope_deg'].items())))
    low, high = found['horizon_deg']
    rows.append(('horizon', f'{low:.1f}° to {high:.1f}° from 0.3 m above the middle'))
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
    print_table(('', ''), 2, rows, show_header=False, title=str(folder))
    return 0


def _info(folder: Path, at: tuple[float, float] | None) -> dict[str, Any]:
    """Return what a world folder holds, or a window of its site, as plain values."""
    world = options.window_of(folder, at)
    config, ground, diameter = world.config, world.ground, world.rocks.diameter_m
    line = horizon_deg(world, np.arange(0.0, 360.0, 2.0))
    inside = np.abs(world.craters.position_m).max(axis=1, initial=0.0) <= ground.half_extent_m
    return {
        'source': config.source, 'path': str(config.path), 'seed': config.seed, 'hash': world.hash,
        'middle_m': list(world.origin_m),
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


@options.command()
@options.argument('folder', 'world folder', type=options.PATH, metavar='FOLDER')
@options.output(check_png, 'FILE', 'PNG to write (default: FOLDER.png)', required=False)
@options.sun(default=(60.0, 6.0))
@options.at_place('draw the window of the site around this place')
@click.option('--no-views', is_flag=True, help='leave the camera views out; they need EGL')
@options.overwrite()
def preview(folder: Path, output: Path | None, sun: tuple[float, float],
            at: tuple[float, float] | None, no_views: bool, overwrite: bool) -> int:
    """Draw maps, statistics and camera views as a PNG."""
    azimuth, elevation = options.checked_sun(sun)
    output = output or folder.resolve().with_suffix('.png')
    options.refuse_existing(output, overwrite)
    world = options.window_of(folder, at)
    views: list = []
    if not no_views:
        views = four_views(world, azimuth, elevation)
    write_sheet(world, output, azimuth, elevation, views)
    say(output)
    return 0


_MONTH_H = 708.7        # from one noon to 29.53 days later
_MAX_H = 20.0 * 365.25 * 24.0


# A latitude may be negative: what looks like an option is looked at in `_place`.
@click.command(context_settings={'ignore_unknown_options': True})
@options.argument('place', 'longitude and latitude [deg], or a world folder, whose horizon then '
                  'hides the sun', nargs=-1, required=True, metavar='PLACE...')
@click.option('--at', nargs=2, type=float, metavar='LON LAT',
              help='where a world lies that does not say so')
@click.option('--from', 'start', default='', metavar='DATE', show_default=False,
              help='UTC in ISO 8601 (default: now)')
@click.option('--to', 'end', default='', metavar='DATE', show_default=False,
              help='UTC in ISO 8601 (default: a lunar day, 29.5 days, later)')
@click.option('--step', type=float, default=24.0, metavar='H',
              help='time between rows of the table [h]')
@options.output(check_png, 'FILE', 'PNG to write: elevations over time, the way before the '
                'horizon', required=False)
@options.overwrite()
def sun(place: Sequence[str], at: tuple[float, float] | None, start: str, end: str, step: float,
        output: Path | None, overwrite: bool) -> int:
    """Print sun, Earth and light at a place on the Moon over time, or draw them."""
    site, world = _place(place, at)
    begin, hours = _time(start, end, step)
    if output is not None:
        options.refuse_existing(output, overwrite)
    # Hourly at least, and on every row of the table.
    fine = max(int(np.ceil(step)), 1)
    count = int(hours / step * fine) + 1
    over = sky_over_time(site, begin + np.arange(count) * np.timedelta64(
        round(step * 3.6e9 / fine), 'us'), world)
    name = f'longitude {site.lon_deg:.4f}°, latitude {site.lat_deg:.4f}°'
    print_table(('UTC', 'sun elev.', 'azimuth', 'true az.', 'in light', 'Earth elev.', 'azimuth'),
                1, _rows(over, fine), title=name, box=box.SIMPLE_HEAD, padding=(0, 0))
    say(_summary(over, site, world))
    if output is not None:
        write_figure(over, output, name if world is None else f'{place[0]}: {name}')
        say(output)
    return 0


def _place(place: Sequence[str], at: tuple[float, float] | None) -> tuple[MoonPlace, World | None]:
    """Return the site, and the world if a folder is given."""
    for word in place:
        if re.match(r'-[^.\d]', word):
            raise click.NoSuchOption(word)
    if len(place) > 2:
        raise ConfigError(f'PLACE: {" ".join(place)} is not valid; valid are a longitude and '
                          'a latitude [deg], or a world folder')
    if len(place) == 2:
        if at is not None:
            raise ConfigError('--at: is for a world folder')
        try:
            lon, lat = map(float, place)
        except ValueError:
            raise ConfigError(f'PLACE: {" ".join(place)} is not valid; valid are two numbers '
                              '[deg], or a world folder') from None
        return _site('PLACE', lon, lat), None
    world = load_world(place[0])
    site = reported_site(world.report)
    if at is not None:
        if site is not None:
            raise ConfigError(f'--at: {at[0]:g} {at[1]:g} is not valid; {place[0]} '
                              f'lies at {site.lon_deg:.4f} {site.lat_deg:.4f}')
        site = _site('--at', *at)
    if site is None:
        raise ConfigError(f'{place[0]}: does not say where on the Moon it is; give --at LON '
                          'LAT. Worlds of a GeoTIFF say it if this version built them')
    return site, world


def _site(name: str, lon_deg: float, lat_deg: float) -> MoonPlace:
    if not (abs(lon_deg) <= 360.0 and abs(lat_deg) <= 90.0):
        raise ConfigError(f'{name}: {lon_deg:g} {lat_deg:g} is not valid; valid are a longitude '
                          'of -360 to 360 and a latitude of -90 to 90 [deg]')
    return MoonPlace(lon_deg, lat_deg)


def _time(start: str, end: str, step: float) -> tuple[np.datetime64, float]:
    """Return the start and the length [h]."""
    begin = parse_date('--from', start) if start else np.datetime64('now', 'us')
    hours = _MONTH_H
    if end:
        hours = float((parse_date('--to', end) - begin) / np.timedelta64(1, 'h'))
    if not 0.1 <= step <= _MAX_H:
        raise ConfigError(f'--step: {step:g} is not valid; valid is 0.1 to {_MAX_H:g} [h]')
    if not step <= hours <= _MAX_H:
        raise ConfigError(f'--to: {end or "29.5 days"} is {hours:.6g} h after --from '
                          f'({shown(begin)}); valid is --step ({step:g} h) to 20 years')
    return begin, hours


def _rows(over: SkyOverTime, every: int) -> Iterator[tuple[str, ...]]:
    """Yield every n-th sample as a row."""
    sun, earth = over.sky.sun, over.sky.earth
    for k in range(0, len(over.dates_utc), every):
        yield (np.datetime_as_string(over.dates_utc[k], unit='m').replace('T', ' '),
               f'{sun.elevation_deg[k]:.2f}°', f'{sun.azimuth_deg[k]:.2f}°',
               f'{sun.true_azimuth_deg[k]:.2f}°', f'{100.0 * over.lit[k]:.0f} %',
               f'{earth.elevation_deg[k]:.2f}°', f'{earth.azimuth_deg[k]:.2f}°')


def _summary(over: SkyOverTime, site: MoonPlace, world: World | None) -> str:
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
