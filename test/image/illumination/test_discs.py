"""Sun and Earth as discs: their radiance adds up to their irradiance; phases; no renderer."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import quad
from textbook_hapke import phase_function as lobes

from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.ground.world.moon_place import MoonPlace
from lunar_rover_sim.image.illumination.config import GIVEN, SunConfig, SunSiteConfig
from lunar_rover_sim.image.illumination.discs import (central_radiance, disc_radiance,
                                                      earth_as_sun, earth_disc, EarthDisc,
                                                      lambert_phase, limb_darkening,
                                                      phase_function)
from lunar_rover_sim.image.illumination.hapke import hockey_stick, normal_albedo, reflectance, SETS
from lunar_rover_sim.image.illumination.sky import sky, sun_and_earth

NEAR_SIDE = SunSiteConfig(GIVEN, 10.0, 40.0)
DATES = ['2026-11-22T06:00:00Z', '2026-11-12T12:00:00Z', '2026-12-02T00:00:00Z']


def rays_around(direction, radius_rad, n=401):
    """Return (n, n, 3) rays of any length over a square around a direction, and their area."""
    direction = np.asarray(direction) / np.linalg.norm(direction)
    right = np.cross([0.3, 0.1, 1.0], direction)
    right /= np.linalg.norm(right)
    up = np.cross(direction, right)
    reach = 1.25 * math.tan(radius_rad)
    a, b = np.meshgrid(*[(np.arange(n) + 0.5 - n / 2) * (2.0 * reach / n)] * 2)
    rays = direction + a[..., None] * right + b[..., None] * up
    # A step in the plane at distance 1 covers cos^3 of its area: all angles are small here.
    return 7.0 * rays, (2.0 * reach / n)**2


@pytest.mark.parametrize('diameter_deg', [0.533, 4.0])
def test_the_radiance_of_the_sun_adds_up_to_its_irradiance(diameter_deg):
    sun = SunConfig(azimuth_deg=200.0, elevation_deg=11.0, irradiance=1300.0,
                    angular_diameter_deg=diameter_deg)
    direction = sun_direction(200.0, 11.0)
    rays, area = rays_around(direction, math.radians(0.5 * diameter_deg))
    radiance = disc_radiance(rays, direction, sun)
    assert radiance.sum() * area == pytest.approx(1300.0, rel=0.006)
    assert radiance.max() == pytest.approx(central_radiance(sun), rel=1e-4)
    assert not disc_radiance(-rays, direction, sun).any()
    # Half of a square of 1.25 radii is beyond the limb.
    assert np.mean(radiance > 0.0) == pytest.approx(math.pi / 4.0 / 1.25**2, rel=0.01)


def test_the_limb_is_darker():
    """The radiance of the middle over the mean, and its fall (a power of the cosine)."""
    mean = 2.0 * quad(lambda r: r * float(limb_darkening(r)), 0.0, 1.0)[0]
    sun = SunConfig()
    whole = math.pi * math.sin(math.radians(0.5 * sun.angular_diameter_deg))**2
    assert central_radiance(sun) * mean * whole == pytest.approx(sun.irradiance, rel=1e-6)
    assert limb_darkening([0.0, 0.6, 1.0, 1.5]) == pytest.approx(
        [1.0, 0.8**0.464, 0.0, 0.0])


@pytest.mark.parametrize('phase_deg', [0.0, 40.0, 90.0, 140.0])
def test_the_radiance_of_the_earth_adds_up_to_its_irradiance(phase_deg):
    direction = sun_direction(30.0, 50.0)
    side = np.cross(direction, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    phase = math.radians(phase_deg)
    disc = EarthDisc(direction, -math.cos(phase) * direction + math.sin(phase) * side,
                     math.radians(0.95), 0.12)
    assert disc.phase_rad == pytest.approx(phase, abs=1e-7)
    rays, area = rays_around(direction, disc.radius_rad)
    radiance = disc.radiance(rays)
    assert radiance.sum() * area == pytest.approx(0.12, rel=0.01)
    assert not disc.radiance(-rays).any()
    # The lit limb is that towards the sun.
    towards = (rays / 7.0 - direction) @ side
    assert phase_deg < 1.0 or (radiance * towards).sum() > 0.0


def test_phases_of_spheres():
    """A full disc is 1, a half Lambert sphere 1 / pi; the Earth's half one is that of its law."""
    assert lambert_phase(0.0) == pytest.approx(1.0)
    assert lambert_phase(math.pi) == pytest.approx(0.0)
    assert lambert_phase(math.pi / 2.0) == pytest.approx(1.0 / math.pi)
    assert phase_function(0.0) == 1.0
    magnitudes = -1.060e-3 * 90.0 + 2.054e-4 * 8100.0
    assert phase_function(math.pi / 2.0) == pytest.approx(100.0**(-magnitudes / 5.0))


@pytest.mark.parametrize('date', DATES)
def test_the_earth_of_a_date(date):
    """Place, size, phase and light by the vectors of the ephemeris."""
    sun = SunConfig(date=date, site=NEAR_SIDE, irradiance=1400.0, allow_night=True)
    disc = earth_disc(sun)
    when = np.asarray(np.datetime64(date[:-1], 'us'))
    earth = sky(MoonPlace(10.0, 40.0), when).earth
    assert disc.direction == pytest.approx(
        sun_direction(float(earth.azimuth_deg), float(earth.elevation_deg)))
    assert math.sin(disc.radius_rad) == pytest.approx(6378.137 / float(earth.distance_km))
    found = sun_and_earth(when)
    to_sun = found.sun_km - found.earth_km
    phase = math.acos(-found.earth_km @ to_sun / np.linalg.norm(found.earth_km)
                      / np.linalg.norm(to_sun))
    assert disc.phase_rad == pytest.approx(phase, abs=0.006)    # the site is not the centre
    expected = 1400.0 * 0.434 * math.sin(disc.radius_rad)**2 * phase_function(disc.phase_rad)
    assert disc.irradiance == pytest.approx(expected)
    assert np.linalg.norm(disc.sun_direction) == pytest.approx(1.0)


def test_where_there_is_no_earth():
    """Without a date, without a place of its own, and on the far side."""
    sun = SunConfig(date=DATES[0], site=NEAR_SIDE)
    assert earth_disc(sun) is not None
    assert earth_disc(dataclasses.replace(sun, date='')) is None
    assert earth_disc(dataclasses.replace(sun, site=SunSiteConfig())) is None
    far = dataclasses.replace(sun, site=SunSiteConfig(GIVEN, 190.0, 0.0))
    assert earth_disc(far) is None
    nothing = earth_as_sun(far)
    assert nothing.irradiance == 0.0 and nothing.elevation_deg == -1.0 and not nothing.shines


@pytest.mark.parametrize('lon_deg', np.arange(80.0, 100.0, 0.5))
def test_the_earth_is_drawn_until_it_is_a_degree_below_the_horizontal(lon_deg):
    """All of it: its upper limb counts. As a light it is never lower than a sun may be."""
    sun = SunConfig(date=DATES[0], site=SunSiteConfig(GIVEN, float(lon_deg), 0.0))
    earth = sky(MoonPlace(float(lon_deg), 0.0),
                np.asarray(np.datetime64(DATES[0][:-1], 'us'))).earth
    disc = earth_disc(sun)
    assert (disc is not None) == bool(earth.elevation_deg + earth.radius_deg >= -1.0)
    light = earth_as_sun(sun)
    if disc is not None:
        assert light.elevation_deg == pytest.approx(max(float(earth.elevation_deg), -1.0))
        assert light.azimuth_deg % 360.0 == pytest.approx(float(earth.azimuth_deg) % 360.0)
        assert light.angular_diameter_deg == pytest.approx(2.0 * float(earth.radius_deg))
        assert light.irradiance == disc.irradiance > 0.0


def test_the_site_lies_a_radius_of_the_moon_from_its_centre():
    when = np.asarray(np.datetime64('2026-11-22T06:00:00', 'us'))
    earth = sun_and_earth(when).earth_km
    lon, lat = math.degrees(math.atan2(earth[1], earth[0])), math.degrees(
        math.asin(earth[2] / np.linalg.norm(earth)))
    below = sky(MoonPlace(lon, lat), when).earth
    assert np.linalg.norm(earth) - float(below.distance_km) == pytest.approx(1737.4, abs=1e-3)


def test_rocks_scatter_less_back_than_soil_and_are_brighter():
    """By a tenth in the highlands and a fifth in the maria; all four are of the Moon."""
    cosine = math.cos(math.radians(30.0))
    for rock, soil, brighter in (('rock', 'highland', 1.1), ('basalt', 'mare', 1.2)):
        # At i = g = 30 deg, e = 0, as published reflectances are given.
        seen = [float(reflectance(cosine, 1.0, cosine, SETS[name])) for name in (rock, soil)]
        assert seen[0] / seen[1] == pytest.approx(brighter, abs=0.03)
        back = [float(np.divide(*lobes([0.1, 2.5], SETS[name].b, SETS[name].c)))
                for name in (rock, soil)]
        assert 1.0 < back[0] < back[1]
        assert SETS[rock].theta_deg < SETS[soil].theta_deg
    for name, kind in SETS.items():
        assert 0.0 < kind.b < 0.5 and -1.0 <= kind.c <= 1.0 and 0.0 < kind.h_s < 0.1
        assert 0.05 < normal_albedo(kind) < 0.35 and 1.0 < kind.b_s0 < 2.0
        if name != 'forward':       # which turns the lobes round
            assert kind.c == pytest.approx(hockey_stick(kind.b), abs=0.06)
    forth = SETS['forward']
    assert float(reflectance(cosine, 1.0, cosine, forth)) == pytest.approx(
        float(reflectance(cosine, 1.0, cosine, SETS['highland'])), rel=0.01)
    # Under a low sun, seen towards it at 120 deg of phase.
    low = math.cos(math.radians(75.0))
    assert float(reflectance(low, low, -0.5, forth)) > 1.5 * float(
        reflectance(low, low, -0.5, SETS['highland']))
