"""`lunar_rover_sim world sun`: sun, Earth and light at a place on the Moon over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
import re

import click
import numpy as np
from rich import box

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.paths import check_png
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_table, say
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.moon_place import MoonPlace, reported_site
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.image.illumination.dates import parse_date, shown
from lunar_rover_sim.image.illumination.light_time import sky_over_time, SkyOverTime, write_figure

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
