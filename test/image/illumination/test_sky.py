"""Sun and Earth by date, held against published tables."""

import dataclasses

import numpy as np
import pytest

from lunar_rover_sim.base.errors import ConfigError, WorldError
from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.ground.world.moon_place import MoonPlace
from lunar_rover_sim.image.illumination import light_time
from lunar_rover_sim.image.illumination.config import GIVEN, SunConfig, SunSiteConfig
from lunar_rover_sim.image.illumination.dates import parse_date
from lunar_rover_sim.image.illumination.light_time import sky_over_time, SkyOverTime
from lunar_rover_sim.image.illumination.sky import lit_share, sky, sun_and_earth
from lunar_rover_sim.image.illumination.sun_of_date import check_last_date, sun_of_date, SunPath

# NASA's Scientific Visualization Studio, Moon Phase and Libration 2020, 2021 and 2022 (svs 4768,
# 4874, 4955), mooninfo_YYYY.txt, from JPL's DE421: UTC, distance of the Earth [km], then longitude
# and latitude of the places below the sun and below the Earth [deg].
PUBLISHED = [
    ('2020-01-23T13:00', 390759, -159.326, -0.709, 4.815, 1.111),
    ('2020-03-24T18:00', 406691, 175.685, -1.568, -0.428, 6.544),
    ('2020-05-25T00:00', 390406, 148.281, -0.712, -5.467, -0.085),
    ('2020-07-25T05:00', 368392, 120.201, 0.862, -0.521, -6.693),
    ('2020-09-24T10:00', 380276, 92.798, 1.519, 7.092, 1.406),
    ('2020-11-24T15:00', 403084, 67.267, 0.491, 4.593, 6.733),
    ('2021-01-23T12:00', 401996, 59.194, -1.109, -2.185, 1.946),
    ('2021-03-25T13:00', 377101, 36.323, -1.459, -7.064, -6.108),
    ('2021-05-25T14:00', 357555, 11.568, -0.178, -0.949, -2.202),
    ('2021-07-25T15:00', 375611, -14.343, 1.29, 5.528, 6.389),
    ('2021-09-24T16:00', 401867, -39.624, 1.39, 2.315, 2.263),
    ('2021-11-24T17:00', 400887, -63.119, -0.035, -5.436, -5.87),
    ('2022-01-23T12:00', 383150, -70.171, -1.401, -6.017, -5.189),
    ('2022-03-25T13:00', 370346, -93.052, -1.157, 0.757, 4.704),
    ('2022-05-25T14:00', 389161, -117.885, 0.37, 6.522, 4.686),
    ('2022-07-25T15:00', 405984, -143.903, 1.511, 1.853, -4.178),
    ('2022-09-24T16:00', 392373, -169.305, 1.094, -4.085, -5.682),
    ('2022-11-24T17:00', 364211, 167.099, -0.498, -2.724, 3.319)]
# JPL Horizons (DE441), sun from longitude 0, latitude 0 on the Moon, apparent and airless: UT,
# azimuth, elevation [deg], distance [au].
HORIZONS = [
    ('2024-06-01T00:00', 271.364365, -17.730340, 1.01331236894816),
    ('2024-06-01T06:00', 271.393978, -20.786094, 1.01321803258123),
    ('2024-06-15T00:00', 88.497638, 9.077305, 1.01614798699260),
    ('2024-06-15T12:00', 88.458421, 15.182862, 1.01644033901335)]


def dates(rows):
    """Return the first column."""
    return np.array([row[0] for row in rows], 'datetime64[us]')


def lon_lat_deg(position):
    """Return longitude and latitude of the place below a position."""
    x, y, z = np.moveaxis(position / np.linalg.norm(position, axis=-1, keepdims=True), -1, 0)
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(z))


def turn(angle_deg):
    """Return angles between -180 and 180."""
    return (np.asarray(angle_deg) + 180.0) % 360.0 - 180.0


def test_places_below_sun_and_earth():
    """Better than 0.01 deg for the sun and 0.02 deg for the Earth."""
    table = np.array([row[1:] for row in PUBLISHED])
    found = sun_and_earth(dates(PUBLISHED))
    for position, column, bound in ((found.sun_km, 1, 0.005), (found.earth_km, 3, 0.008)):
        lon, lat = lon_lat_deg(position)
        assert np.abs(turn(lon - table[:, column])).max() < bound
        assert np.abs(lat - table[:, column + 1]).max() < bound
    assert np.abs(np.linalg.norm(found.earth_km, axis=-1) - table[:, 0]).max() < 120.0


def test_sun_over_a_site():
    """Azimuth, elevation and distance are those of Horizons."""
    _, azimuth, elevation, distance_au = np.array(HORIZONS, object).T.tolist()
    sun = sky(MoonPlace(0.0, 0.0), dates(HORIZONS)).sun
    assert turn(sun.true_azimuth_deg - azimuth) == pytest.approx(0.0, abs=0.003)
    assert sun.elevation_deg == pytest.approx(elevation, abs=0.003)
    assert sun.distance_km / 149597870.7 == pytest.approx(distance_au, abs=1e-6)


def test_example_of_meeus():
    """Astronomical Algorithms (1998), example 53.a, within 0.03 deg: its librations are older."""
    # 0 h of terrestrial time, 58.2 s less in UTC.
    found = sun_and_earth(np.array(['1992-04-11T23:59:01'], 'datetime64[us]'))
    assert np.ravel(lon_lat_deg(found.earth_km)) == pytest.approx([-1.23, 4.20], abs=0.03)
    assert np.ravel(lon_lat_deg(found.sun_km)) == pytest.approx([67.89, 1.46], abs=0.03)


def test_the_earth_hides_the_sun_in_a_lunar_eclipse():
    """14 March 2025, total from 6:26 to 7:32 UTC (NASA); and not two hours before."""
    when = np.array(['2025-03-14T06:59', '2025-03-14T04:00'], 'datetime64[us]')
    found = sky(MoonPlace(0.0, 0.0), when)
    to_sun = sun_direction(found.sun.azimuth_deg, found.sun.elevation_deg)
    to_earth = sun_direction(found.earth.azimuth_deg, found.earth.elevation_deg)
    apart = np.degrees(np.arccos(np.sum(to_sun * to_earth, axis=0)))
    assert apart[0] < found.earth.radius_deg[0] - found.sun.radius_deg[0]
    assert apart[1] > found.earth.radius_deg[1] + found.sun.radius_deg[1]
    assert found.earth.radius_deg[0] * 2.0 == pytest.approx(6585.0 / 3600.0, abs=0.005)


def test_earth_over_the_limb_is_lower_by_its_parallax():
    when = np.array(['2021-05-25T14:00'], 'datetime64[us]')
    lon, lat = lon_lat_deg(sun_and_earth(when).earth_km)
    earth = sky(MoonPlace(float(lon[0]) + 90.0, 0.0), when).earth
    parallax = np.degrees(np.arcsin(1737.4 / earth.distance_km))
    assert earth.elevation_deg == pytest.approx(-parallax, abs=1e-3)
    below = sky(MoonPlace(float(lon[0]), float(lat[0])), when).earth
    assert below.elevation_deg == pytest.approx(90.0, abs=1e-3)
    assert below.distance_km == pytest.approx(357555 - 1737.4, abs=120.0)


def test_azimuth_counts_from_x_towards_y():
    """In the morning the sun is in the east, which is x; a turned grid takes it along."""
    when = np.asarray('2024-06-15T00:00', 'datetime64[us]')
    plain, turned = (sky(MoonPlace(0.0, 0.0, g), when).sun for g in (0.0, 30.0))
    assert plain.azimuth_deg == pytest.approx(90.0 - 88.4976, abs=0.002)
    # y points 30 deg east of north, so it is so much nearer to the east.
    assert turned.azimuth_deg - plain.azimuth_deg == pytest.approx(30.0)


def test_share_of_the_disc():
    sun = sky(MoonPlace(0.0, 0.0), np.asarray('2024-06-15T00:00', 'datetime64[us]')).sun
    heights = sun.elevation_deg + np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0]) * sun.radius_deg
    # The segment beyond half the radius is 1/3 - sqrt(3) / (4 pi) of a disc.
    segment = 1.0 / 3.0 - np.sqrt(3.0) / (4.0 * np.pi)
    assert lit_share(sun, heights) == pytest.approx([1.0, 1.0, 1.0 - segment, 0.5, segment, 0.0])


def test_light_of_a_month():
    """On the equator half of the time; the night lasts half a lunar day less the disc's share."""
    hours = np.datetime64('2026-03-01T00:00:00', 'us') + np.arange(709) * np.timedelta64(1, 'h')
    over = sky_over_time(MoonPlace(20.0, 0.0), hours)
    assert over.light_share == pytest.approx(0.5, abs=0.01)
    assert over.longest_night_h == pytest.approx(353.0, abs=3.0)


@pytest.mark.parametrize(('text', 'utc'), [
    ('2026-11-22T06:00:00Z', '2026-11-22T06:00:00'), ('2026-11-22', '2026-11-22T00:00:00'),
    ('2026-11-22T06:00', '2026-11-22T06:00:00'),
    ('2026-11-22T07:00:00+01:00', '2026-11-22T06:00:00')])
def test_dates(text, utc):
    assert parse_date('date', text) == np.datetime64(utc)


def test_sun_of_a_date():
    """The parameters state the date and what follows from it, and stay when done again."""
    site = MoonPlace(0.0, 0.0, 30.0)
    found = sun_of_date(SunConfig(date='2024-06-15T00:00:00Z'), site)
    assert found.azimuth_deg == pytest.approx(31.502, abs=0.003)
    assert found.elevation_deg == pytest.approx(9.077, abs=0.003)
    assert found.site == SunSiteConfig(GIVEN, 0.0, 0.0, 30.0)
    assert sun_of_date(found, None) == found
    assert sun_of_date(SunConfig(), None) == SunConfig()
    elsewhere = dataclasses.replace(found, site=SunSiteConfig(GIVEN, 10.0, 0.0))
    assert sun_of_date(elsewhere, site).elevation_deg == pytest.approx(19.07, abs=0.05)


SITE = SunSiteConfig(GIVEN, 0.0, -85.0)
HOUR_NS = 3600 * 10**9


def dated(date='2026-11-28T00:00:00Z', **more):
    return sun_of_date(SunConfig(date=date, site=SITE, **more), None)


def direction(sun):
    return sun_direction(sun.azimuth_deg, sun.elevation_deg)


@pytest.mark.parametrize('more', [{}, {'rate': 3600.0}, {'step_deg': 0.5, 'rate': 60.0}])
def test_steps(more):
    """The sun of a step is that of the ephemeris at its start, and moves by no more than asked."""
    sun = dated(**more)
    path = SunPath(sun)
    assert path.of_step(0) == sun
    moved = []
    for step in (1, 2, 500, 501):
        before, after = (direction(path.of_step(k)) for k in (step - 1, step))
        moved.append(np.degrees(np.linalg.norm(after - before)))
        seconds = 1e-9 * path.start_ns(step) * sun.rate
        date = np.datetime64('2026-11-28T00:00:00', 'us') + np.timedelta64(
            round(1e6 * seconds), 'us')
        body = sky(MoonPlace(0.0, -85.0), np.asarray(date)).sun
        assert path.of_step(step).azimuth_deg == pytest.approx(float(body.azimuth_deg), abs=1e-5)
        assert path.step(path.start_ns(step)) == step == path.step(path.start_ns(step) - 1) + 1
    assert np.all(np.array(moved) <= sun.step_deg * 1.0001)
    assert np.all(np.array(moved) > 0.98 * sun.step_deg)


def test_a_day_of_the_sky_in_a_run():
    """After an hour at a rate of 24 it is a day later; at a rate of 0 nothing moves."""
    path = SunPath(dated(rate=24.0))
    later = path.of_step(path.step(HOUR_NS))
    tomorrow = dated('2026-11-29T00:00:00Z')
    apart = np.linalg.norm(direction(later) - direction(tomorrow))
    assert np.degrees(apart) <= 0.05
    for still in (dated(rate=0.0), SunConfig(azimuth_deg=10.0)):
        assert not SunPath(still).moves and SunPath(still).step(10**18) == 0


def test_the_sun_sets():
    """Below the horizontal it shines no more, and it stays valid."""
    path = SunPath(dated('2026-12-03T00:00:00Z', rate=86400.0))
    night = path.of_step(path.step(3 * 10**9))
    assert night.elevation_deg == -1.0 and not night.shines
    assert night.date.startswith('2026-12-0')


def test_dates_that_have_no_sun():
    """Without a site, in the night, and beyond the last date of the ephemeris."""
    for sun, site, named in (({'date': '2024-06-15'}, None, 'site.source'),
                             ({'date': '2024-06-01'}, MoonPlace(0.0, 0.0), 'elevation_deg')):
        with pytest.raises(ConfigError, match=named):
            sun_of_date(SunConfig(**sun), site)
    late = dated('2099-12-31T00:00:00Z', rate=86400.0)
    check_last_date(late, 1.0)
    with pytest.raises(ConfigError, match='rate: 86400'):
        check_last_date(late, 2.0)
    with pytest.raises(ConfigError, match='sun.date: 2100-01-01T23'):
        SunPath(late).of_step(SunPath(late).step(2 * 10**9))
    check_last_date(dataclasses.replace(late, rate=0.0), 1e9)


HOURS = np.datetime64('2026-03-01T00:00:00', 'us') + np.arange(0, 700, 7) * np.timedelta64(1, 'h')


def over(horizon_deg=2.0):
    """Return 29 days near the south pole before a horizon that rises to the north."""
    found = sky_over_time(MoonPlace(40.0, -88.0), HOURS)
    mask = horizon_deg * np.sin(np.radians(found.mask_azimuth_deg))
    return SkyOverTime(HOURS, found.sky, found.mask_azimuth_deg, mask,
                       np.interp(found.sky.sun.azimuth_deg, found.mask_azimuth_deg, mask),
                       np.where(found.sky.sun.elevation_deg > 0.0, 0.75, 0.0))


def curves(axes):
    return {line.get_label(): line.get_xydata() for line in axes.lines}


def test_elevations_over_time_and_ways_over_the_horizon():
    sky = over()
    figure = light_time.figure(sky, 'a site')
    upper, lower = figure.axes
    lines = curves(upper)
    for name, values in (('sun', sky.sky.sun.elevation_deg),
                         ('Earth', sky.sky.earth.elevation_deg),
                         ('horizon below the sun', sky.horizon_deg)):
        np.testing.assert_allclose(lines[name][:, 1], values)
    labels = [text.get_text() for text in upper.get_legend().get_texts()]
    assert f'in light, {100.0 * sky.light_share:.1f} % of the time' in labels
    lines = curves(lower)
    for name, body in (('sun', sky.sky.sun), ('Earth', sky.sky.earth)):
        np.testing.assert_allclose(lines[name],
                                   np.stack([body.azimuth_deg, body.elevation_deg], axis=1))


def test_it_is_written_or_the_reason_is_named(tmp_path):
    light_time.write_figure(over(), tmp_path / 'sky.png', 'a site')
    assert (tmp_path / 'sky.png').read_bytes().startswith(b'\x89PNG')
    (tmp_path / 'file').write_text('in the way')
    with pytest.raises(WorldError, match='cannot be written'):
        light_time.write_figure(over(), tmp_path / 'file' / 'sky.png', 'a site')
