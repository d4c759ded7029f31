"""Sun and Earth of a date: the sun as the parameters of the light hold it, and over a run.

Over simulated time it stands still, or it follows its date in small steps. All that depends on the
sun asks here, so that pictures, sensors and topics have one sun. The steps are equal in time, such
that the sun never moves by more than `sun.step_deg` in one of them: the sun of a time depends on
that time alone, not on what was asked before.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.ground.world.moon_place import MoonPlace
from lunar_rover_sim.image.illumination.config import (GIVEN, LOWEST_DEG, OF_WORLD, SunConfig,
                                                       SunSiteConfig)
from lunar_rover_sim.image.illumination.dates import check_dates, LAST, parse_date, shown
from lunar_rover_sim.image.illumination.sky import sky

# A millionth of a degree is far below the error of the series.
_DECIMALS = 6


def given_site(config: SunSiteConfig) -> MoonPlace | None:
    """Return the place that the parameters give; None if it is that of the world."""
    if config.source == OF_WORLD:
        return None
    return MoonPlace(config.lon_deg, config.lat_deg, config.grid_north_deg)


def sun_of_date(sun: SunConfig, of_world: MoonPlace | None) -> SunConfig:
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


def _sun_deg(site: MoonPlace, date: np.datetime64) -> tuple[float, float]:
    """Return azimuth and elevation of the sun [deg]."""
    sun = sky(site, np.asarray(date)).sun
    return round(float(sun.azimuth_deg), _DECIMALS), round(float(sun.elevation_deg), _DECIMALS)


# The fastest that the sun goes over the Moon's sky; it is 0.5050 at the slowest.
_FASTEST_DEG_PER_H = 0.511
_NS_PER_H = 3600 * NS_PER_S


class SunPath:
    """The sun at each time of a run.

    Attributes:
        moves: Whether it moves at all.
    """

    def __init__(self, sun: SunConfig) -> None:
        """Prepare; sun: at time 0, as `sun_of_date` returned it."""
        self._sun = sun
        self.moves = bool(sun.date) and sun.rate > 0.0
        self._period_ns = 0
        if self.moves:
            self._period_ns = max(1, int(sun.step_deg / _FASTEST_DEG_PER_H / sun.rate * _NS_PER_H))

    def step(self, stamp_ns: int) -> int:
        """Return the number of the step that a time is in; a sun that stands still has only 0."""
        return stamp_ns // self._period_ns if self.moves else 0

    def start_ns(self, step: int) -> int:
        """Return the time from which the sun of a step holds [ns]."""
        return step * self._period_ns

    def of_step(self, step: int) -> SunConfig:
        """Return the sun of a step; its date is that of the start of the step.

        A sun below -1 deg, where it lights nothing, is returned at -1 deg.

        Raises:
            ConfigError: After the last date of the series.
        """
        if step == 0:
            return self._sun
        return sun_after(self._sun, 1e-9 * self.start_ns(step) * self._sun.rate)


def check_last_date(sun: SunConfig, duration_s: float) -> None:
    """Raise ConfigError if a run ends after the last date of the series."""
    if not sun.date or not np.isfinite(duration_s):
        return
    left_s = float((LAST - parse_date('sun.date', sun.date)) / np.timedelta64(1, 's'))
    if sun.rate * duration_s > left_s:
        raise ConfigError(f'sun.rate: {sun.rate:g} is not valid with a duration of {duration_s:g} '
                          f's from {sun.date}; valid is <= {left_s / duration_s:.4g}, so that the '
                          f'run ends before {shown(LAST)}')
