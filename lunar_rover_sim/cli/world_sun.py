"""`lunar_rover_sim world sun`: sun, Earth and light at a site over time."""

from __future__ import annotations

import argparse

import numpy as np
from rich import box
from rich.table import Table

from lunar_rover_sim.cli import options, terminal
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.paths import check_png
from lunar_rover_sim.illumination.dates import parse_date, shown
from lunar_rover_sim.illumination.light_time import sky_over_time, SkyOverTime
from lunar_rover_sim.illumination.sky_figure import write as write_figure
from lunar_rover_sim.world.model import World
from lunar_rover_sim.world.site import reported_site, Site
from lunar_rover_sim.world.world_folder import load_world

_MONTH_H = 708.7        # from one noon to 29.53 days later
_MAX_H = 20.0 * 365.25 * 24.0


def add_arguments(sun: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
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


def run(args: argparse.Namespace) -> int:
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
    terminal.console().print(_table(over, fine, name))
    terminal.say(_summary(over, site, world))
    if args.output is not None:
        write_figure(over, args.output, name if world is None else f'{args.place[0]}: {name}')
        terminal.say(args.output)
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


def _table(over: SkyOverTime, every: int, title: str) -> Table:
    """Return every n-th sample as a row."""
    table = terminal.table(('UTC', 'sun elev.', 'azimuth', 'true az.', 'in light', 'Earth elev.',
                            'azimuth'), 1, title=title, box=box.SIMPLE_HEAD, padding=(0, 0))
    sun, earth = over.sky.sun, over.sky.earth
    for k in range(0, len(over.dates_utc), every):
        table.add_row(np.datetime_as_string(over.dates_utc[k], unit='m').replace('T', ' '),
                      f'{sun.elevation_deg[k]:.2f}°', f'{sun.azimuth_deg[k]:.2f}°',
                      f'{sun.true_azimuth_deg[k]:.2f}°', f'{100.0 * over.lit[k]:.0f} %',
                      f'{earth.elevation_deg[k]:.2f}°', f'{earth.azimuth_deg[k]:.2f}°')
    return table


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
