"""The sun's disc: its place, size and light, what hides it, and its glare."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.image.camera.config import CameraConfig, LensConfig
from lunar_rover_sim.image.camera.distortion import distort
from lunar_rover_sim.image.camera.lens import Lens
from lunar_rover_sim.image.camera.sensor import SensorModel
from lunar_rover_sim.image.illumination.config import LampConfig, SunConfig
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

CAMERA = CameraConfig(width=480, height=360)
CLEAR = LensConfig(scatter_share=0.0, veil_share=0.0)
EVEN = dataclasses.replace(scene.IDEAL, exposure_mode='fixed', exposure_s=1e-3, encoding='mono16',
                           bits=16)
E = 1361.0
RADIUS = np.radians(0.5 * 0.533)
SUN = 1e4           # radiance that nothing but the sun has [W m-2 sr-1]
WALL_M = 2.0        # distance of the near face of a wall, which ends at y = 0.5 m and -0.5 m


def settings(camera=CAMERA, lens=CLEAR, sensor=EVEN, elevation_deg=6.0, **groups):
    return RenderConfig(camera=camera, lens=lens, sensor=sensor, detail=scene.SMOOTH,
                        sun=SunConfig(azimuth_deg=0.0, elevation_deg=elevation_deg), **groups)


def walled():
    """Return a small plane with a wall across the line to the sun."""
    return scene.plane(n=257, far=False, shape=scene.block(half=(0.05, 0.5, 0.5)),
                       stones=scene.rocks([(WALL_M + 0.05, 0.0, 0.4)]))


@pytest.fixture(scope='module')
def clear():
    """Return a renderer with a perfect lens."""
    with Renderer(walled(), scene.ROVER, settings()) as renderer:
        yield renderer


@pytest.fixture(scope='module')
def hooded():
    """Return a renderer with a lens that strays, and a hood."""
    lens = LensConfig(hood_deg=10.0)
    with Renderer(walled(), scene.ROVER, settings(lens=lens)) as renderer:
        yield renderer


def draw(renderer, pose, layers=('radiance', 'depth', 'label')):
    return renderer.render(RoverPose(pose), layers=layers)


def optical(renderer, pose):
    """Return the direction to the sun in axes of the left camera."""
    return (pose @ renderer.rig.T_base_left)[:3, :3].T @ renderer.sun_direction


def seen(renderer, pose):
    """Return the share of the sun's light that is in the left image."""
    rays = renderer.rig.rays()
    solid_angle = (rays**2).sum(axis=-1)**-1.5 / renderer.rig.focal_px**2
    radiance = draw(renderer, pose, ('radiance',)).radiance.astype(float)
    return (np.where(radiance > SUN, radiance, 0.0) * solid_angle).sum() / E


def beside(renderer, y, **turn):
    """Return the pose with the left camera at a distance y from the middle of the wall."""
    camera = (scene.pose(**turn) @ renderer.rig.T_base_left)[:3, 3]
    return scene.pose(y=y - camera[1], **turn)


def test_place_size_and_light(clear):
    for azimuth, elevation, yaw, pitch in (
            (0.0, 6.0, 0.0, 0.0), (0.0, 6.0, 17.3, 3.0), (0.0, 6.0, -24.1, -8.0),
            (-130.0, 2.0, -121.7, -8.0), (10.0, 14.0, 4.0, -2.0)):
        if (azimuth, elevation) != (clear.config.sun.azimuth_deg, clear.config.sun.elevation_deg):
            clear.set_sun(azimuth, elevation)
        pose = scene.pose(x=2.5, y=2.0, yaw_deg=yaw, pitch_deg=pitch)
        frame, d = draw(clear, pose), optical(clear, pose)
        disc = np.where(frame.radiance > SUN, frame.radiance, 0.0).astype(float)
        total = disc.sum()
        v, u = np.indices(disc.shape)
        place = np.array([(disc * u).sum(), (disc * v).sum()]) / total
        np.testing.assert_allclose(place, (clear.rig.K @ d)[:2] / d[2], atol=0.1)
        # A disc with I = mu^a has <r^2> = 2 / (a + 4); a pixel adds 1/12 along each axis. Off the
        # axis the image is longer by 1 / cos^2 and wider by 1 / cos.
        square = (disc * ((u - place[0])**2 + (v - place[1])**2)).sum() / total - 1.0 / 6.0
        stretch = 0.5 * (d[2]**-4 + d[2]**-2)
        diameter = 2.0 * np.sqrt(square / stretch * 0.5 * 4.464)
        assert diameter == pytest.approx(2.0 * clear.rig.focal_px * np.tan(RADIUS), abs=0.1)
        assert seen(clear, pose) == pytest.approx(1.0, abs=0.01)
        assert np.all(np.isinf(frame.depth_m[disc > 0.0]))
        assert np.all(frame.label[disc > 0.0] == 0)
    clear.set_sun(0.0, 6.0)


def test_a_wall_hides_a_share_of_the_disc(clear):
    camera = (scene.pose() @ clear.rig.T_base_left)[:3, 3]
    reach = (WALL_M - camera[0]) / np.cos(np.radians(6.0)) * np.tan(RADIUS)
    x = np.linspace(-1.0, 1.0, 2001)
    strip = np.maximum(1.0 - x**2, 0.0)**(0.5 * 1.464)      # integral of mu^a across the disc
    for side in (1.0, -1.0):
        for offset in (-1.5, -0.7, 0.0, 0.4, 1.5):
            share = strip[x < offset].sum() / strip.sum()
            pose = beside(clear, side * (0.5 + offset * reach))
            assert seen(clear, pose) == pytest.approx(share, abs=0.025), (side, offset)


def test_the_horizon_hides_half_of_the_disc():
    """A terrace whose edge stands as high as the middle of the sun."""
    edge, heights = (209 - 128) * 0.025, np.zeros((257, 257))
    heights[:, 209:] = 0.4
    with Renderer(scene.plane(n=257, heights=heights, far=False), scene.ROVER,
                  settings()) as renderer:
        mount = (scene.pose(z=0.0) @ renderer.rig.T_base_left)[:3, 3]
        shares = []
        for lift_deg in (0.0, 0.4, -0.4, 0.1):
            z = 0.4 - (edge - mount[0]) * np.tan(np.radians(6.0 - lift_deg)) - mount[2]
            shares.append(seen(renderer, scene.pose(z=z)))
    assert shares[:3] == pytest.approx([0.5, 1.0, 0.0], abs=0.03)
    assert shares[3] == pytest.approx(0.74, abs=0.04)   # the limb is darker: 0.73 evenly lit


def test_the_limb_is_darker():
    camera = CameraConfig(width=200, height=150, horizontal_fov_deg=2.0)
    with Renderer(scene.plane(n=257, far=False), scene.ROVER, settings(camera)) as renderer:
        mount_deg = np.degrees(np.arcsin(-renderer.rig.T_base_left[2, 2]))
        pose = scene.pose(pitch_deg=-6.0 - mount_deg)
        frame, d = draw(renderer, pose), optical(renderer, pose)
        rays = renderer.rig.rays()
    sine = np.linalg.norm(np.cross(rays, d), axis=-1) / np.linalg.norm(rays, axis=-1)
    r = sine / np.sin(RADIUS)
    middle = frame.radiance[r < 0.05].mean()
    # Neckel & Labs (1994) give 0.81 for the mean of the disc at 590 to 600 nm.
    assert E / (np.pi * np.sin(RADIUS)**2) / middle == pytest.approx(0.81, abs=0.01)
    at = frame.radiance[(r > 0.79) & (r < 0.81)].mean() / middle
    assert at == pytest.approx(0.6**0.464, abs=0.01)
    assert not np.any(frame.radiance[(r > 1.05) & (r < 1.2)])


@pytest.mark.parametrize('distortion', [(-0.2, 0.05, 0.0, 0.0, 0.0), (0.1, 0.0, 1e-3, -1e-3, 0.0)])
def test_the_place_in_distorted_images(distortion):
    camera = dataclasses.replace(CAMERA, distortion=distortion)
    scale = SensorModel(camera, EVEN).electrons_per_radiance_second
    sensor = dataclasses.replace(EVEN, companding='linear',
                                 exposure_s=0.8 * EVEN.full_well_e / (2.5e7 * scale))
    with Renderer(scene.plane(n=257, far=False), scene.ROVER,
                  settings(camera, sensor=sensor)) as renderer:
        for yaw in (5.0, -23.0):
            pose = scene.pose(yaw_deg=yaw)
            frame, d = draw(renderer, pose, ('left', 'right')), optical(renderer, pose)
            expected = distort(d[:2] / d[2], distortion) * renderer.rig.focal_px \
                + renderer.rig.K[:2, 2]
            for image in (frame.left, frame.right):     # the sun has no disparity
                level = image.astype(float)
                v, u = np.indices(level.shape)
                place = np.array([(level * u).sum(), (level * v).sum()]) / level.sum()
                np.testing.assert_allclose(place, expected, atol=0.1)


def glare(renderer, pose):
    """Return the mean signal of the upper corners of both images, as a share of full scale."""
    frame = draw(renderer, pose, ('left', 'right'))
    return np.array([[renderer.sensor.linear(image[:20, part]).mean()
                      for part in (slice(0, 20), slice(-20, None))]
                     for image in (frame.left, frame.right)]).mean(axis=1)


def test_half_of_the_sun_has_half_of_the_glare(hooded):
    """The left camera looks past the edge of the wall; the right one is behind it."""
    half = glare(hooded, beside(hooded, 0.5))
    free = glare(hooded, beside(hooded, 1.0))
    none = glare(hooded, beside(hooded, 0.0))
    assert free[0] == pytest.approx(free[1], rel=0.02)
    assert np.all(none < 0.05 * free)       # that of the ground is left
    assert half[0] - none[0] == pytest.approx(0.5 * (free[0] - none[0]), rel=0.05)
    assert half[1] < 0.05 * free[1]


def test_glare_from_beyond_the_frame_dies_out_at_the_hood(hooded):
    lens = Lens(hooded.config.lens, CAMERA)
    levels, shares = [], []
    for yaw in (36.0, 38.0, 40.0, 42.0, 44.0, 46.0, 48.0, 60.0):
        pose = beside(hooded, 2.0, yaw_deg=yaw)
        assert seen(hooded, pose) == 0.0
        shares.append(lens.hood(optical(hooded, pose)))
        levels.append(glare(hooded, pose)[0])
    assert shares[0] > 0.85 and shares[-1] == 0.0 and len(set(shares)) >= 5
    levels = np.array(levels) - levels[-1]
    assert np.all(np.diff(levels) <= 1e-4) and levels[0] > 0.05
    assert levels[1:] / levels[0] == pytest.approx(np.array(shares[1:]) / shares[0], abs=0.2)


def test_a_rock_hides_a_sun_beyond_the_frame(hooded):
    turn = {'yaw_deg': 36.0}
    free, hidden = (glare(hooded, beside(hooded, y, **turn))[0] for y in (2.0, 0.0))
    assert hidden < 0.1 * free


def test_a_sun_below_the_horizon_changes_nothing():
    images = []
    for irradiance in (E, 0.0):
        config = settings(lens=LensConfig(), elevation_deg=-0.9, lamp=LampConfig(power_w=20.0))
        config = dataclasses.replace(config, sun=dataclasses.replace(
            config.sun, irradiance=irradiance))
        with Renderer(scene.plane(n=257, far=False), scene.ROVER, config) as renderer:
            frame = draw(renderer, scene.pose(), ('left', 'right', 'radiance'))
        images.append(np.stack([frame.left, frame.right]))
        assert 0.0 < frame.radiance.max() < SUN and images[-1].max() > 0
    np.testing.assert_array_equal(*images)


def test_automatic_exposure_when_the_sun_comes_into_the_image():
    """The ground decides, and the veil over it: hardly any of it is clipped."""
    sensor = dataclasses.replace(EVEN, exposure_mode='auto', auto_lag=0.5, auto_max_s=0.1)
    exposures = []
    with Renderer(scene.plane(n=257, far=False), scene.ROVER,
                  settings(lens=LensConfig(), sensor=sensor)) as renderer:
        for k, yaw in enumerate(np.repeat([60.0, 30.0, 0.0, -30.0, -60.0], 6)):
            frame = renderer.render(RoverPose(scene.pose(yaw_deg=yaw)), k, ('left',))
            exposures.append(frame.exposure_s)
            saturated = (frame.left == 65535).mean()
            assert (saturated > 0.0) == (abs(yaw) < 50.0) and saturated < 0.1
    settled = np.array(exposures)[5::6]
    assert settled.max() < 4.0 * settled.min()
    steps = np.abs(np.diff(np.log(exposures)))
    assert steps.max() < np.log(2.0)
