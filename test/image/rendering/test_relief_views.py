"""At low views the relief below the grid looks as rays cast at its heights see it."""

import dataclasses
import math

from benchmarks.bench_contrast import bands
from benchmarks.relief_rays import ReliefRays
import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.illumination import hapke
from lunar_rover_sim.image.illumination.config import LampConfig
from lunar_rover_sim.image.rendering.config import DetailConfig
from lunar_rover_sim.image.rendering.relief_tiles import start_tiles
from lunar_rover_sim.image.rendering.relief_views import relief_views
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

DETAIL = DetailConfig(bounce=False, smooth_outlines=False)
SUN_DEG, SEED = 15.0, 61
DISTANCES_M = 3.0, 6.0


@pytest.fixture(scope='module')
def config():
    """Return a sun that stands towards x, and the default camera."""
    return scene.config(detail=DETAIL, camera=CameraConfig(),
                        sun=scene.SunConfig(azimuth_deg=0.0, elevation_deg=SUN_DEG))


@pytest.fixture(scope='module')
def renderer(config):
    """Return one of level ground."""
    with Renderer(scene.plane(1025, cell_m=0.05), scene.ROVER, config, SEED) as renderer:
        yield renderer


@pytest.fixture(scope='module')
def rays(renderer, config):
    """Return rays at the heights of the same tiles."""
    tiles = start_tiles(DETAIL, SEED, renderer.sun_direction).result()
    return ReliefRays(tiles, hapke.parameter_set(config.reflectance.ground),
                      config.reflectance.albedo_scale)


@pytest.mark.parametrize('azimuth_deg', [0.0, 60.0, 120.0])
def test_contrast_is_that_of_rays(renderer, rays, azimuth_deg):
    """Drawn by its slopes, it has a third of that at 3 m, and a tenth at 6 m."""
    for light, view, side in zip(*bands(renderer, azimuth_deg, DISTANCES_M, places=3)):
        by_rays = rays.contrast(math.tan(math.radians(SUN_DEG)), view, side, 600, (4, 16))[0]
        assert light.std() / light.mean() == pytest.approx(by_rays, rel=0.3)
        assert light.mean() == pytest.approx(1.0, abs=0.06)


def test_no_shadow_is_seen_away_from_the_sun(renderer):
    """The eye is lower than the sun: what it sees is lit."""
    for light in bands(renderer, 180.0, DISTANCES_M, places=2)[0]:
        assert light.min() > 0.7


def test_light_does_not_depend_on_what_is_asked_for(renderer):
    """Where textures have all of the light, slopes are looked up for the truth alone."""
    state = RoverPose(scene.pose(yaw_deg=30.0))
    alone = renderer.render(state, 0, ('radiance',)).radiance.copy()
    both = renderer.render(state, 0, ('radiance', 'shadow', 'normal')).radiance
    np.testing.assert_array_equal(alone, both)


def test_the_mask_of_shadows_is_of_what_is_seen(config):
    """Towards a low sun more of it is in shadow than away from it, and all of that is dark."""
    low = dataclasses.replace(config, sun=dataclasses.replace(config.sun, elevation_deg=6.0))
    shares = []
    with Renderer(scene.plane(513, cell_m=0.05), scene.ROVER, low, SEED) as renderer:
        for azimuth_deg in (0.0, 90.0, 180.0):
            frame = renderer.render(RoverPose(scene.pose(yaw_deg=azimuth_deg)), 0,
                                    ('radiance', 'shadow', 'depth'))
            far = (frame.depth_m > 2.0) & (frame.depth_m < 4.0) & (frame.shadow[..., 1] == 0)
            share, light = frame.shadow[far][:, 0] / 255.0, frame.radiance[far]
            shares.append(share.mean())
            assert light[share < 0.1].mean() < 0.06 * light.mean() < light[share > 0.9].mean()
            assert np.corrcoef(share, light)[0, 1] > 0.35
    assert shares[0] < shares[1] - 0.1 < shares[2] - 0.2


def test_light_of_sun_and_lamp_adds_up(config):
    """The relief that the sun shows is no factor on what the lamp lights."""
    def image(irradiance, power_w):
        own = dataclasses.replace(
            config, sun=dataclasses.replace(config.sun, irradiance=irradiance),
            lamp=LampConfig(power_w=power_w))
        with Renderer(scene.plane(513, cell_m=0.05), scene.ROVER, own, SEED) as renderer:
            frame = renderer.render(RoverPose(scene.pose()), 0, ('radiance', 'depth'))
            return frame.radiance.astype(float), frame.depth_m
    bright = config.sun.irradiance
    (both, depth_m), (sun, _), (lamp, _) = image(bright, 5e3), image(bright, 0.0), image(0.0, 5e3)
    far = (depth_m > 1.4) & (depth_m < 2.5)     # farther, pixels take light of their neighbours
    assert far.sum() > 10_000 and (lamp[far] > 0.1 * sun[far].mean()).mean() > 0.2
    np.testing.assert_allclose(both[far], (sun + lamp)[far], atol=2e-3 * sun[far].mean())


def test_order_of_views_does_not_matter(config):
    """Textures are cast when they are first seen, by any thread."""
    def images(yaws_deg):
        relief_views.cache_clear()
        with Renderer(scene.plane(513, cell_m=0.05), scene.ROVER, config, SEED) as renderer:
            found = {yaw: renderer.render(RoverPose(scene.pose(yaw_deg=yaw)), 0,
                                          ('radiance',)).radiance.copy() for yaw in yaws_deg}
        return found
    there, back = images((10.0, 100.0, 190.0)), images((190.0, 100.0, 10.0))
    for yaw, image in there.items():
        np.testing.assert_array_equal(image, back[yaw])
