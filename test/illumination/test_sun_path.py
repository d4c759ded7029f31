"""The sun over simulated time: one function, in steps of a bounded angle."""

import dataclasses

import numpy as np
import pytest

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.frames import sun_direction
from lunar_rover_sim.illumination.config import GIVEN, SunConfig, SunSiteConfig
from lunar_rover_sim.illumination.sky import sky
from lunar_rover_sim.illumination.sun_of_date import sun_of_date
from lunar_rover_sim.illumination.sun_path import check_last_date, SunPath
from lunar_rover_sim.world.site import Site

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
        body = sky(Site(0.0, -85.0), np.asarray(date)).sun
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


def test_bad_input():
    with pytest.raises(ConfigError, match='rate: 60 is not valid without a date'):
        SunConfig(rate=60.0)
    with pytest.raises(ConfigError, match='step_deg: 0.0 is not valid'):
        SunConfig(step_deg=0.0)
    late = dated('2099-12-31T00:00:00Z', rate=86400.0)
    check_last_date(late, 1.0)
    with pytest.raises(ConfigError, match='rate: 86400 is not valid with a duration of 2 s') as e:
        check_last_date(late, 2.0)
    assert 'valid is <= 4.32e+04' in str(e.value)
    with pytest.raises(ConfigError, match='sun.date: 2100-01-01T23'):
        SunPath(late).of_step(SunPath(late).step(2 * 10**9))
    check_last_date(dataclasses.replace(late, rate=0.0), 1e9)
