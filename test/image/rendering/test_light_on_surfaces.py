"""Each source of light falls on each kind of surface: on ground, rocks and the rover."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.image.camera.config import CameraConfig, LensConfig
from lunar_rover_sim.image.illumination.config import (EarthConfig, GIVEN, LampConfig, SunConfig,
                                                       SunSiteConfig)
from lunar_rover_sim.image.illumination.sun_of_date import sun_of_date
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.labels import LABEL_FIRST_ROCK, rover_links
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

# A camera behind and above the rover: body, front legs, ground and rocks are in view.
SEEN = dataclasses.replace(scene.ROVER, stereo=dataclasses.replace(
    scene.ROVER.stereo, position_m=(-0.3, 0.0, 0.42), pitch_deg=33.0))
SURFACES = {'ground': lambda label: label == 1, 'rock': lambda label: label >= LABEL_FIRST_ROCK,
            'rover': rover_links}
NO_SUN = SunConfig(irradiance=0.0)
LOW_SUN = SunConfig(azimuth_deg=180.0, elevation_deg=8.0)
# Where the Earth stands 5 to 15 deg high in a night.
EARTHLIT = sun_of_date(SunConfig(date='2026-08-12T17:46:00Z', allow_night=True,
                                 site=SunSiteConfig(GIVEN, 40.0, -75.0)), None)
# Above the deck, so that its light falls on the deck, too.
LAMP = LampConfig(power_w=20.0, position_m=(-0.1, 0.0, 0.3), pitch_deg=25.0, cone_deg=60.0)


def drawn(sun, bounce=False, **groups):
    """Return radiance and label of rover, ground and rocks."""
    world = scene.plane(257, heights=scene.hills(257), far=False,
                        stones=scene.rocks([(1.0, 0.4, 0.1), (1.2, -0.3, 0.1)], 0.3))
    detail = dataclasses.replace(scene.SMOOTH, bounce=bounce)
    config = RenderConfig(camera=CameraConfig(width=160, height=120), detail=detail, sun=sun,
                          lens=LensConfig(scatter_share=0.0, veil_share=0.0),
                          **{'earth': EarthConfig(drawn=False), **groups})
    with Renderer(world, SEEN, config) as renderer:
        frame = renderer.render(RoverPose(scene.pose(z=0.12)), layers=('radiance', 'label'))
    return frame.radiance.astype(float), frame.label


@pytest.fixture(scope='module')
def light():
    """Return the radiance by each source alone, and the labels."""
    by_source = {'sun': drawn(LOW_SUN)[0], 'lamp': drawn(NO_SUN, lamp=LAMP)[0],
                 'earth': drawn(EARTHLIT, earth=EarthConfig(drawn=False, lights_ground=True))[0]}
    scattered, label = drawn(LOW_SUN, bounce=True)
    return {**by_source, 'scattered': scattered - by_source['sun']}, label


@pytest.mark.parametrize('surface', SURFACES)
@pytest.mark.parametrize('source', ['sun', 'lamp', 'earth', 'scattered'])
def test_a_source_lights_a_surface(light, surface, source):
    """A share of the pixels of a surface gets light, and none gets less than none.

    Scattered light comes from the ground: of the rover it falls on what faces down.
    """
    by_source, label = light
    shown = by_source[source][SURFACES[surface](label)]
    assert len(shown) > 100
    usual = np.median(by_source[source][by_source[source] > 0.0])
    assert np.mean(shown > 0.1 * usual) > (0.03 if source == 'scattered' else 0.1)
    assert shown.min() > -1e-5 * by_source[source].max()


def test_a_rock_before_the_lamp_is_about_as_bright_as_the_ground():
    """The map of the lamp's shadow knows rocks by a sign; they are not in their own shadow."""
    lamp = LampConfig(power_w=20.0)
    stone = scene.plane(stones=scene.rocks([(0.8, 0.0, 0.1)], 0.25), shape=scene.block())
    with Renderer(stone, scene.ROVER, scene.config(sun=NO_SUN, lamp=lamp)) as renderer:
        frame = renderer.render(RoverPose(scene.pose()), layers=('radiance', 'label', 'depth'))
    rock = frame.label >= LABEL_FIRST_ROCK
    ground = (frame.label == 1) & (frame.depth_m < 0.8) & (frame.radiance > 0.0)
    assert rock.sum() > 1000
    assert np.mean(frame.radiance[rock] > 0.0) > 0.9
    assert 0.3 < np.median(frame.radiance[rock]) / np.median(frame.radiance[ground]) < 30.0
