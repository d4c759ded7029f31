"""Illumination: sun and Earth over time, and the sensors of light on the rover."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from references.cases import reference
from references.figures import drawn
from references.scenes import stony_world

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.frames import matrix_from_wxyz, sun_direction, wxyz_from_rpy
from lunar_rover_sim.illumination.config import EarthConfig, SunConfig, SunSiteConfig
from lunar_rover_sim.illumination.dates import parse_date, shown
from lunar_rover_sim.illumination.earth_disc import earth_disc, lambert_phase, phase_function
from lunar_rover_sim.illumination.earthshine import earth_as_sun
from lunar_rover_sim.illumination.ephemeris import sun_and_earth
from lunar_rover_sim.illumination.light_time import sky_over_time
from lunar_rover_sim.illumination.moon_rotation import rotation_moon_icrf
from lunar_rover_sim.illumination.sky import lit_share, sky
from lunar_rover_sim.illumination.sky_figure import figure
from lunar_rover_sim.illumination.sun_of_date import earth_of_date, sun_after, sun_of_date
from lunar_rover_sim.illumination.sun_path import check_last_date, SunPath
from lunar_rover_sim.illumination.sun_view import SeenSun
from lunar_rover_sim.sensors.solar_panel import solar_power_w, SolarPanelConfig
from lunar_rover_sim.sensors.star_tracker import StarCamera, StarTrackerConfig
from lunar_rover_sim.sensors.sun_sensor import SunHeads, SunSensorConfig
from lunar_rover_sim.world.site import Site

_SITES = (Site(0.0, 0.0), Site(23.4, -71.0, 35.0), Site(-140.0, 88.5, -170.0))
# Past dates: leap seconds to come are unknown.
_DATES = np.array(['1972-01-01T00:00:00', '1981-07-03T11:12:13', '1999-12-31T23:59:59',
                   '2009-03-20T05:06:07', '2016-10-11T12:13:14', '2023-05-06T07:08:09'],
                  'datetime64[us]')


def _refused(call: Any, *arguments: Any) -> str:
    try:
        call(*arguments)
    except ConfigError as error:
        return str(error)
    return ''


@reference
def sun_and_earth_at_dates() -> dict[str, Any]:
    """Rotation of the Moon, positions, the sky over three sites."""
    days = np.array([-9000.0, -1000.5, 0.0, 3333.3, 9999.9, 30000.0])
    found: dict[str, Any] = {'rotation': rotation_moon_icrf(days),
                             'positions': sun_and_earth(_DATES)}
    for site in _SITES:
        seen = sky(site, _DATES)
        found[f'{site.lon_deg}'] = {'sky': seen, 'lit': lit_share(
            seen.sun, seen.sun.elevation_deg + np.linspace(-0.3, 0.3, len(_DATES)))}
    return found


@reference
def days_and_nights() -> dict[str, Any]:
    """Light over a month, before a level horizon and before that of a world; its figure."""
    dates = np.datetime64('2016-10-01T00:00:00', 'us') + np.arange(90) * np.timedelta64(9, 'h')
    found: dict[str, Any] = {}
    for site, world in ((_SITES[1], None), (_SITES[2], stony_world())):
        over = sky_over_time(site, dates, world)
        found[f'{site.lon_deg}'] = {
            'share': over.light_share, 'night': over.longest_night_h, 'lit': over.lit,
            'horizon': over.horizon_deg, 'mask': over.mask_deg, 'azimuth': over.mask_azimuth_deg}
        found[f'figure {site.lon_deg}'] = drawn(figure(over, 'a title'))
    return found


@reference
def suns_of_dates() -> dict[str, Any]:
    """The sun of a date, on its way, at its end; the Earth as a disc and as a lamp."""
    found: dict[str, Any] = {}
    for k, site in enumerate(_SITES):
        sun = SunConfig(date=str(_DATES[k + 2]) + 'Z', allow_night=True, rate=60.0, step_deg=0.2)
        dated = sun_of_date(sun, site)
        path = SunPath(dated)
        stamps = (0, 10**9, 10**13, 7 * 10**13, 10**15)
        earth = earth_disc(dated, EarthConfig(geometric_albedo=0.5))
        facing = earth_of_date(dated)
        found[f'{site.lon_deg}'] = {
            'sun': _told(dated), 'later': [_told(sun_after(dated, s)) for s in (0.5, 3e5)],
            'same': sun_of_date(dated, None) == dated, 'moves': path.moves,
            'steps': [path.step(stamp) for stamp in stamps],
            'starts': [path.start_ns(step) for step in (0, 1, 17)],
            'of steps': [_told(path.of_step(step)) for step in (0, 1, 17)],
            'earth': earth, 'lamp': _told(earth_as_sun(dated, EarthConfig())), 'to earth': facing}
        if earth is not None:
            rays = earth.direction + 0.02 * np.random.default_rng(k).normal(size=(150, 3))
            found[f'{site.lon_deg}']['radiance'] = earth.radiance(3.0 * rays)
            found[f'{site.lon_deg}']['phase'] = earth.phase_rad
    still = SunPath(SunConfig())
    found['still'] = [still.moves, still.step(10**15), _told(still.of_step(0))]
    found['phases'] = {'earth': [phase_function(a) for a in (0.0, 0.7, 1.9, 3.0)],
                       'lambert': [lambert_phase(a) for a in (0.0, 0.7, 1.9, 3.0)]}
    found['dates'] = [shown(parse_date('d', text)) for text in (
        '2026-11-22T06:00:00Z', '2026-11-22T06:00:00+02:30', '1972-01-01', '2099-12-31T23:00z')]
    given = SunConfig(date='2023-05-06T07:08:09Z', site=SunSiteConfig('given', 10.0, -60.0, 5.0))
    found['given'] = _told(sun_of_date(dataclasses.replace(given, allow_night=True), None))
    found['refused'] = [
        _refused(sun_of_date, dataclasses.replace(given, date='2023-05-14T00:00:00Z'), None)[:60],
        _refused(sun_of_date, SunConfig(date='2023-05-06'), None),
        _refused(parse_date, 'd', '1971-12-31T23:59:59'), _refused(parse_date, 'd', '2100-01-02'),
        _refused(check_last_date, dataclasses.replace(given, rate=1e5), 1e5),
        _refused(check_last_date, given, 1e5), _refused(check_last_date, SunConfig(), 1e20)]
    return found


def _told(sun: SunConfig) -> dict[str, Any]:
    return {'azimuth': sun.azimuth_deg, 'elevation': sun.elevation_deg, 'date': sun.date,
            'diameter': sun.angular_diameter_deg, 'irradiance': sun.irradiance,
            'site': str(sun.site.to_mapping())}


@reference
def sensors_of_light() -> dict[str, Any]:
    """Sun sensor, star tracker and solar panel in many attitudes."""
    found: dict[str, Any] = {}
    attitudes = [matrix_from_wxyz(wxyz_from_rpy(*rpy)) for rpy in np.random.default_rng(6).uniform(
        -0.6, 0.6, (30, 3)) * [1.0, 1.0, 5.0]]
    suns = [SeenSun(sun_direction(37.0 * k, 7.0 * (k % 9)), 0.4 + 0.02 * k) for k in range(30)]
    for name, config in (('default', SunSensorConfig()), ('off', SunSensorConfig(enabled=False)),
                         ('two', SunSensorConfig(
                             heads_yaw_deg=(20.0, 170.0), field_of_view_deg=100.0,
                             heads_elevation_deg=45.0, least_share=0.7, bias_deg=1.0,
                             noise_deg=3.0))):
        sensor = SunHeads(config, np.random.default_rng(7))
        rows = [sensor.measure(sun, turn) for sun, turn in zip([None, *suns], attitudes)]
        found[f'sun {name}'] = np.array([[np.nan] * 3 if row is None else row for row in rows])
        found[f'deviation {name}'] = config.stddev_deg
    for name, stars in (('default', StarTrackerConfig()),
                        ('off', StarTrackerConfig(enabled=False)),
                        ('other', StarTrackerConfig(
                            yaw_deg=30.0, elevation_deg=50.0, cross_arcsec=200.0,
                            roll_arcsec=900.0, largest_rate_degps=30.0, sun_exclusion_deg=20.0,
                            earth_exclusion_deg=50.0, ground_exclusion_deg=10.0))):
        tracker = StarCamera(stars, np.random.default_rng(8))
        turns = [tracker.measure(turn, np.array([0.0, 0.003 * k, 0.01]),
                                 sun if k % 3 else None, sun_direction(10.0 * k, 60.0)
                                 if k % 2 else None)
                 for k, (turn, sun) in enumerate(zip(attitudes, suns))]
        found[f'stars {name}'] = np.array([np.full((3, 3), np.nan) if turn is None else turn
                                           for turn in turns])
        found[f'covariance {name}'] = tracker.covariance_rad2(attitudes[3])
    panel = SolarPanelConfig(normal=(0.3, -0.2, 2.0), area_m2=0.2)
    found['power'] = [solar_power_w(panel, sun, 1300.0, turn)
                      for sun, turn in zip([None, *suns], attitudes)]
    return found
