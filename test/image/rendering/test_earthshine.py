"""Earthshine: the light of the Earth is added to that of the sun, on all that is drawn."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.image.camera.config import CameraConfig, LensConfig
from lunar_rover_sim.image.illumination.config import (EarthConfig, GIVEN, LampConfig, LOWEST_DEG,
                                                       SunConfig, SunSiteConfig)
from lunar_rover_sim.image.illumination.discs import earth_as_sun, earth_disc
from lunar_rover_sim.image.illumination.sun_of_date import sun_of_date
from lunar_rover_sim.image.rendering.config import DetailConfig, RenderConfig
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

# A camera behind and above the rover: body, front legs, ground, rocks and sky are in view.
SEEN = dataclasses.replace(scene.ROVER, stereo=dataclasses.replace(
    scene.ROVER.stereo, position_m=(-0.3, 0.0, 0.42), pitch_deg=33.0))
STATE = RoverPose(scene.pose(z=0.12))
SMOOTH = dataclasses.replace(scene.SMOOTH, bounce=True, smooth_outlines=True)
SHINES = EarthConfig(drawn=False, lights_ground=True)


def sun_at(date: str, lon_deg: float = 40.0) -> SunConfig:
    return sun_of_date(SunConfig(date=date, allow_night=True,
                                 site=SunSiteConfig(GIVEN, lon_deg, -75.0)), None)


NIGHT = sun_at('2026-08-12T17:46:00Z')
DAY = sun_at('2026-08-20T00:00:00Z')            # half of the Earth is lit
FAR_SIDE = sun_at('2026-08-20T00:00:00Z', 220.0)


@pytest.fixture(scope='module')
def world():
    return scene.plane(257, heights=scene.hills(257), far=False,
                       stones=scene.rocks([(1.0, 0.4, 0.1), (1.2, -0.3, 0.1)], 0.3))


def radiance(world, sun, *, dates=(), **groups):
    """Return the radiance under a sun; dates: of suns that are shown before it."""
    config = RenderConfig(camera=CameraConfig(width=160, height=120), lens=LensConfig(
        scatter_share=0.0, veil_share=0.0), sun=sun,
        **{'earth': EarthConfig(drawn=False), 'detail': SMOOTH, **groups})
    with Renderer(world, SEEN, dataclasses.replace(config, sun=(*dates, sun)[0])) as drawn:
        drawn.follow(scene.trodden(world))
        for later in (*dates, sun)[1:]:
            drawn.show_sun(drawn.light_of(later))
        frame = drawn.render(STATE, layers=('radiance', 'label', 'shadow'))
    assert set(np.unique(frame.label)) >= {0, 1, 2, 3, 16}
    return frame.radiance.astype(float)


def test_at_night_the_earth_lights_the_ground_as_a_sun_in_its_place(world):
    """Ground, prints, rocks, rover and their shadows; without it the night is black."""
    earth = earth_as_sun(NIGHT)
    assert 5.0 < earth.elevation_deg < 15.0 and 0.1 < earth.irradiance < 0.2
    lit = radiance(world, NIGHT, earth=SHINES, detail=DetailConfig())
    expected = radiance(world, earth, detail=DetailConfig())
    assert lit == pytest.approx(expected, rel=1e-6, abs=1e-9) and lit.max() > 0.0
    assert not radiance(world, NIGHT).any()


def test_by_day_both_lights_add_up_and_the_lamp_counts_once(world):
    """Every pixel, in sun, shadow and penumbra; light is linear."""
    lamp = LampConfig(power_w=10.0)
    alone = radiance(world, DAY, lamp=lamp)
    earth = earth_as_sun(DAY)
    assert DAY.elevation_deg > 1.0 and earth.elevation_deg > 5.0
    added = radiance(world, DAY, lamp=lamp, earth=SHINES) - alone
    expected = radiance(world, earth)
    scale = expected.max()
    # The sum is one of float32 values 10,000 times as large.
    np.testing.assert_allclose(added, expected, rtol=0.0, atol=0.02 * scale)
    assert np.corrcoef(added.ravel(), expected.ravel())[0, 1] > 0.999


def test_it_follows_the_date(world):
    """A renderer whose sky has moved draws what a new one draws, and nothing of an Earth below."""
    first = sun_at('2026-08-10T00:00:00Z')
    moved = radiance(world, NIGHT, earth=SHINES, dates=[first])
    np.testing.assert_array_equal(moved, radiance(world, NIGHT, earth=SHINES))
    assert earth_disc(FAR_SIDE) is None
    assert earth_as_sun(FAR_SIDE).irradiance == 0.0
    moved = radiance(world, FAR_SIDE, earth=SHINES, dates=[NIGHT])
    np.testing.assert_array_equal(moved, radiance(world, FAR_SIDE))


def test_a_crescent_gives_less():
    """Its light on the ground is that of its disc in the sky."""
    full, half = (earth_as_sun(sun).irradiance for sun in (NIGHT, DAY))
    assert half == earth_disc(DAY).irradiance and 0.2 < half / full < 0.45


def test_a_sun_that_is_down_lights_no_peaks():
    """It is held at the lowest valid elevation, at which a real sun lights them."""
    heights = np.zeros((257, 257))
    heights[:, 128:] = 0.6      # a wall that the sun sees from the west
    high = scene.plane(257, heights=heights, far=False)
    config = scene.config(LOWEST_DEG, 180.0, camera=CameraConfig(width=160, height=120))
    with Renderer(high, scene.ROVER, config) as drawn:
        frame = drawn.render(RoverPose(scene.pose(x=-2.0, z=0.1)), layers=('radiance',))
    assert not frame.radiance.any()


def test_without_a_date_it_is_refused():
    with pytest.raises(ConfigError, match='earth.lights_ground: true is not valid without a date'):
        RenderConfig(earth=SHINES)


def test_a_night_is_refused_unless_it_is_allowed():
    assert NIGHT.elevation_deg == LOWEST_DEG and not NIGHT.shines
    with pytest.raises(ConfigError, match='with sun.allow_night=true it may be down'):
        sun_of_date(dataclasses.replace(NIGHT, allow_night=False), None)
