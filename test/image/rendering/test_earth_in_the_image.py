"""The Earth's disc: its place, size, phase and light, and what hides it."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.image.camera.config import CameraConfig, LensConfig
from lunar_rover_sim.image.illumination.config import EarthConfig, GIVEN, SunConfig, SunSiteConfig
from lunar_rover_sim.image.illumination.discs import earth_disc, phase_function
from lunar_rover_sim.image.illumination.sun_of_date import sun_of_date
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

NARROW = CameraConfig(width=240, height=180, horizontal_fov_deg=10.0)
WIDE = CameraConfig(width=320, height=240)
CLEAR = LensConfig(scatter_share=0.0, veil_share=0.0)


def sun_at(date, lon_deg, lat_deg):
    return sun_of_date(SunConfig(date=date, site=SunSiteConfig(GIVEN, lon_deg, lat_deg)), None)


FULL = sun_at('2026-08-12T17:46:00Z', 93.5, 0.0)            # an eclipse of the sun on Earth
CRESCENT = sun_at('2026-11-28T00:00:00Z', 0.0, -85.0)       # the sun stands 48 deg to its left


def renderer(sun, camera=NARROW, earth=EarthConfig(), **world):
    config = RenderConfig(camera=camera, lens=CLEAR, detail=scene.SMOOTH, sun=sun, earth=earth)
    return Renderer(scene.plane(n=257, far=False, **world), scene.ROVER, config)


def angles(disc):
    x, y, z = disc.direction
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(z))


def towards(drawn, disc, **place):
    """Return a pose that looks at the Earth, and its place in the image [px]."""
    azimuth, elevation = angles(disc)
    mount = np.degrees(np.arcsin(-drawn.rig.T_base_left[2, 2]))
    pose = scene.pose(yaw_deg=azimuth, pitch_deg=-elevation - mount, **place)
    d = (pose @ drawn.rig.T_base_left)[:3, :3].T @ disc.direction
    return pose, (drawn.rig.K @ d)[:2] / d[2]


def sky_of(drawn, pose):
    """Return radiance of the sky, and the solid angles of pixels."""
    frame = drawn.render(RoverPose(pose), layers=('radiance', 'depth'))
    rays = drawn.rig.rays()
    solid = (rays**2).sum(axis=-1)**-1.5 / drawn.rig.focal_px**2
    return np.where(np.isinf(frame.depth_m), frame.radiance, 0.0).astype(float), solid


@pytest.mark.parametrize('camera', [NARROW, WIDE])
def test_place_size_and_light_of_a_full_earth(camera):
    disc = earth_disc(FULL)
    assert np.degrees(disc.phase_rad) < 1.0
    with renderer(FULL, camera) as drawn:
        pose, place = towards(drawn, disc)
        sky, solid = sky_of(drawn, pose)
        focal = drawn.rig.focal_px
        beside = ((pose @ drawn.rig.T_base_left)[:3, :3].T @ disc.sun_direction)[:2]
    # Lambert's law shifts the light by 3/8 of the radius, times the sine of the phase angle.
    place = place + 0.375 * focal * np.tan(disc.radius_rad) * beside
    v, u = np.indices(sky.shape)
    np.testing.assert_allclose([(sky * u).sum() / sky.sum(), (sky * v).sum() / sky.sum()], place,
                               atol=0.1)
    # A disc with I = cos has <r^2> = 2/5; a pixel adds 1/12 along each axis.
    square = (sky * ((u - place[0])**2 + (v - place[1])**2)).sum() / sky.sum() - 1.0 / 6.0
    radius = focal * np.tan(disc.radius_rad)
    assert 2.0 * np.sqrt(2.5 * square) == pytest.approx(2.0 * radius, abs=0.25)
    assert 1.8 < 2.0 * np.degrees(disc.radius_rad) < 2.1
    # 1361 W/m2 x 0.434 x (6378 km / distance)^2: 0.16 W/m2 at 384,400 km, more at perigee.
    assert (sky * solid).sum() == pytest.approx(disc.irradiance, rel=0.01)
    assert disc.irradiance == pytest.approx(1361.0 * 0.434 * np.sin(disc.radius_rad)**2, rel=0.01)


def test_the_phase():
    """Its lit side is that of the sun, its lit share (1 + cos phase) / 2, its light published."""
    disc = earth_disc(CRESCENT)
    with renderer(CRESCENT) as drawn:
        pose, place = towards(drawn, disc)
        sky, solid = sky_of(drawn, pose)
        radius = drawn.rig.focal_px * np.tan(disc.radius_rad)
        sun = (pose @ drawn.rig.T_base_left)[:3, :3].T @ drawn.sun_direction
    # Sun and Earth are 48 deg apart: the phase angle is 180 deg less that, but for parallax.
    apart = np.degrees(np.arccos(drawn.sun_direction @ disc.direction))
    assert np.degrees(disc.phase_rad) == pytest.approx(180.0 - apart, abs=0.2)
    lit = (sky > 0.02 * sky.max()).sum() / (np.pi * radius**2)
    assert lit == pytest.approx(0.5 * (1.0 + np.cos(disc.phase_rad)), abs=0.03)
    v, u = np.indices(sky.shape)
    shift = np.array([(sky * u).sum(), (sky * v).sum()]) / sky.sum() - place
    assert shift / np.linalg.norm(shift) == pytest.approx(sun[:2] / np.linalg.norm(sun[:2]),
                                                          abs=0.03)
    assert shift[0] < -0.5 * radius and 0.0 < shift[1] < -shift[0]
    assert (sky * solid).sum() == pytest.approx(disc.irradiance, rel=0.02)
    # 180 deg less 47 deg is a phase of 133 deg: 3.5 mag fainter than a full Earth.
    assert phase_function(disc.phase_rad) == pytest.approx(10**(-0.4 * 3.47), rel=0.01)


def test_a_ridge_hides_half_of_it():
    """The edge of a terrace stands as high as the middle of the disc, or beside it."""
    disc = earth_disc(FULL)
    heights = np.zeros((257, 257))
    azimuth, elevation = angles(disc)
    assert abs(azimuth - 180.0) < 8.0 or abs(azimuth + 180.0) < 8.0     # to the west
    heights[:, :48] = 0.4
    edge = (47 - 128) * 0.025
    seen = []
    with renderer(FULL, heights=heights) as drawn:
        for lift_deg in (2.0, 0.0, -2.0):
            pose, _ = towards(drawn, disc, z=0.0)
            camera = (pose @ drawn.rig.T_base_left)[:3, 3]
            rise = (camera[0] - edge) / abs(disc.direction[0]) \
                * np.hypot(*disc.direction[:2]) * np.tan(np.radians(elevation - lift_deg))
            pose[2, 3] = 0.4 - rise - camera[2]
            sky, solid = sky_of(drawn, pose)
            seen.append((sky * solid).sum() / disc.irradiance)
    assert seen == pytest.approx([1.0, 0.5, 0.0], abs=0.05)


def test_without_a_date_or_not_wanted():
    plain = dataclasses.replace(CRESCENT, date='')
    assert earth_disc(plain) is None
    shown = []
    for drawn_too in (True, False):
        with renderer(CRESCENT, earth=EarthConfig(drawn=drawn_too)) as drawn:
            pose, _ = towards(drawn, earth_disc(CRESCENT))
            sky, _ = sky_of(drawn, pose)
            shown.append(sky.any())
    assert shown == [True, False]
