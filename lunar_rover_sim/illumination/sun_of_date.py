"""Sun and Earth of a date: the sun as the parameters of the light hold it."""

from __future__ import annotations

import dataclasses

import numpy as np

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.frames import Array
from lunar_rover_sim.illumination.config import (GIVEN, LOWEST_DEG, OF_WORLD, SunConfig,
                                                 SunSiteConfig)
from lunar_rover_sim.illumination.dates import check_dates, parse_date
from lunar_rover_sim.illumination.sky import sky
from lunar_rover_sim.world.site import Site

# A millionth of a degree is far below the error of the series.
_DECIMALS = 6


def given_site(config: SunSiteConfig) -> Site | None:
    """Return the place that the parameters give; None if it is that of the world."""
    if config.source == OF_WORLD:
        return None
    return Site(config.lon_deg, config.lat_deg, config.grid_north_deg)


def sun_of_date(sun: SunConfig, of_world: Site | None) -> SunConfig:
    """Return the sun with azimuth and elevation of its date, and its site spelled out.

    Without a date it is returned as it is. A second call changes nothing.

    With `sun.allow_night` it is returned at the lowest valid elevation then, where it lights
    nothing.

    Args:
        of_world: Where the world lies, if it says so; used unless a site is given.

    Raises:
        ConfigError: If there is no site, or if the sun is below what is valid.
    """
    if not sun.date:
        return sun
    site = given_site(sun.site) or of_world
    if site is None:
        raise ConfigError(f'sun.site.source: {OF_WORLD} is not valid: the world does not say '
                          f'where on the Moon it is; set it to {GIVEN}, with '
                          'lon_deg and lat_deg beside it')
    azimuth_deg, elevation_deg = _sun_deg(site, parse_date('sun.date', sun.date))
    if sun.allow_night:
        elevation_deg = max(elevation_deg, LOWEST_DEG)
    try:
        return dataclasses.replace(
            sun, azimuth_deg=azimuth_deg, elevation_deg=elevation_deg,
            site=SunSiteConfig(GIVEN, site.lon_deg, site.lat_deg, site.grid_north_deg))
    except ConfigError as error:
        raise ConfigError(f'sun.date: {sun.date} at longitude {site.lon_deg:.4f}, latitude '
                          f'{site.lat_deg:.4f}: {error}; `lunar_rover_sim world sun` lists when '
                          'it is up; with sun.allow_night=true it may be down') from None


def sun_after(sun: SunConfig, seconds: float) -> SunConfig:
    """Return the sun `seconds` later, with its date.

    A sun below what is valid, where it lights nothing, is returned at the lowest valid elevation.

    Args:
        sun: As `sun_of_date` returned it, with a date.
        seconds: Of the date, not of simulated time.

    Raises:
        ConfigError: If the series do not cover the date.
    """
    site = given_site(sun.site)
    assert site is not None
    date = parse_date('sun.date', sun.date) + np.timedelta64(round(1e6 * seconds), 'us')
    check_dates('sun.date', np.asarray(date))
    azimuth_deg, elevation_deg = _sun_deg(site, date)
    return dataclasses.replace(
        sun, azimuth_deg=azimuth_deg, elevation_deg=max(elevation_deg, LOWEST_DEG),
        date=f'{np.datetime_as_string(date, unit="us")}Z')


def earth_of_date(sun: SunConfig) -> Array | None:
    """Return the (3,) unit vector to the middle of the Earth, world frame.

    Args:
        sun: As `sun_of_date` returned it. None without a date, or if the Earth is below the
            horizontal.
    """
    site = given_site(sun.site)
    if not sun.date or site is None:
        return None
    earth = sky(site, np.asarray(parse_date('sun.date', sun.date))).earth
    return earth.direction if earth.elevation_deg > 0.0 else None


def _sun_deg(site: Site, date: np.datetime64) -> tuple[float, float]:
    """Return azimuth and elevation of the sun [deg]."""
    sun = sky(site, np.asarray(date)).sun
    return round(float(sun.azimuth_deg), _DECIMALS), round(float(sun.elevation_deg), _DECIMALS)
