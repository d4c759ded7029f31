"""The equidistant fisheye: where it images what, and how bright."""

import math

import cv2
import numpy as np
import pytest

from lunar_rover_sim.image.camera import equidistant
from lunar_rover_sim.image.camera.config import LensConfig
from lunar_rover_sim.image.camera.fisheye import FisheyeCamera, FisheyeLens
from lunar_rover_sim.image.camera.hazard import (fixed_frames, HazardCameraConfig, HazardConfig,
                                                 HazardRig, sides)
from lunar_rover_sim.image.camera.image_geometry import FisheyeImage, PinholeImage

REAL = (-0.02, 0.004, -0.003, 0.0006)


@pytest.mark.parametrize('k', [(0.0,) * 4, REAL])
def test_opencv_projects_to_the_same_pixels(k) -> None:
    """cv2.fisheye with K and D has the same pixels, ahead of the lens, which is all it knows."""
    camera = FisheyeCamera(HazardCameraConfig(width=400, height=300, fisheye_distortion=k))
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (500, 3)) + [0.0, 0.0, 1.05]
    expected, _ = cv2.fisheye.projectPoints(points[None], np.zeros(3), np.zeros(3), camera.K,
                                            camera.D)
    assert np.allclose(camera.project(points), expected[0], atol=1e-6)


@pytest.mark.parametrize('k', [(0.0,) * 4, REAL])
def test_directions_are_the_inverse(k) -> None:
    """Every pixel shows the direction that is projected to it, behind the lens too."""
    camera = FisheyeCamera(HazardCameraConfig(width=200, height=190, horizontal_fov_deg=185.0,
                                              fisheye_distortion=k))
    places = camera.pixels()
    directions = camera.directions(places)
    inside = np.isfinite(directions[..., 0])
    assert np.nanmin(directions[..., 2]) < -0.02
    assert 0.80 < inside.mean() < 0.83      # a circle, cut above and below
    assert np.allclose(camera.project(directions[inside]), places[inside], atol=1e-6)
    assert np.allclose(FisheyeImage(camera).rays(places[inside]), directions[inside], atol=1e-6)
    assert np.all(np.isnan(camera.project([(0.1, 0.0, -1.0), (0.0, 1.0, -0.06)])))


@pytest.mark.parametrize('k', [(0.0,) * 4, REAL])
def test_the_falloff_is_the_solid_angle(k) -> None:
    """Irradiance over that on the axis is the solid angle of pixels, from their corners."""
    camera = FisheyeCamera(HazardCameraConfig(width=100, height=100, fisheye_distortion=k))
    places = np.array([(50.0, 50.0), (80.0, 50.0), (30.0, 75.0), (50.0, 4.0)])
    h = 0.05
    along, down = ((camera.directions(places + step) - camera.directions(places - step)) / (2 * h)
                   for step in ([h, 0.0], [0.0, h]))
    solid = np.linalg.norm(np.cross(along, down), axis=1) * camera.focal_px**2
    assert np.allclose(camera.falloff(places), solid, rtol=1e-3)
    ideal = FisheyeCamera(HazardCameraConfig())
    at_90 = ideal.K[:2, 2] + [0.5 * math.pi * ideal.focal_px, 0.0]
    assert ideal.falloff(at_90) == pytest.approx(2.0 / math.pi)


def test_the_field_of_view_is_that_across_the_width() -> None:
    """The edges of the image lie half the field of view off the axis, with distortion too."""
    for k in ((0.0,) * 4, REAL):
        config = HazardCameraConfig(horizontal_fov_deg=160.0, fisheye_distortion=k)
        camera = FisheyeCamera(config)
        edge = camera.directions([camera.width - 0.5, camera.K[1, 2]])
        assert math.degrees(math.acos(edge[2])) == pytest.approx(80.0, abs=1e-6)


def test_the_lens_scatters_its_share() -> None:
    """Scattered light sums up to its share over the plane of the image."""
    lens = FisheyeLens(LensConfig(), HazardCameraConfig())
    d = np.linspace(0.0, lens.reach, 2_000_001)
    assert np.trapezoid(lens.scatter(d) * 2.0 * np.pi * d, d) == pytest.approx(
        lens.config.scatter_share, rel=1e-3)
    for angle_deg, share in ((92.0, 1.0), (110.0, 0.0)):
        angle = math.radians(angle_deg)
        assert lens.hood(np.array([0.0, math.sin(angle), math.cos(angle)])) == share
    assert lens.strays(np.array([1.0, 0.0, 0.0])) and not lens.strays(np.array([0.0, 0.0, -1.0]))


def test_radius_and_angle_are_inverse_to_each_other() -> None:
    """Newton's method converges over the whole field."""
    theta = np.linspace(0.0, math.radians(92.5), 500)
    for k in ((0.0,) * 4, REAL, (0.1, 0.0, 0.0, 0.0), (-0.1, 0.0, 0.0, 0.0)):
        assert equidistant.grows(k, theta[-1])
        assert np.allclose(equidistant.angle(equidistant.radius(theta, k), k, theta[-1]), theta,
                           atol=1e-9)


def test_frames_of_a_pair() -> None:
    """The right camera is a baseline to the right of the left one, across the optical axis."""
    config = HazardConfig(stereo_baseline_m=0.1, orientation_rpy_deg=(0.0, 30.0, 90.0))
    rig = HazardRig(config)
    apart = np.linalg.inv(rig.T_base_left) @ rig.T_base_right
    assert np.allclose(apart[:3, 3], [0.1, 0.0, 0.0])
    # It looks to the left of the rover, and down.
    assert np.allclose(rig.T_base_left[:3, 2], [0.0, math.cos(math.pi / 6), -0.5])
    assert sides('rear', config) == ('rear/left', 'rear/right')
    assert [child for _, child, _ in fixed_frames('rear', config)] == [
        'hazard_rear_left_link', 'hazard_rear_left_optical_frame', 'hazard_rear_right_link',
        'hazard_rear_right_optical_frame']


@pytest.mark.parametrize('k', [(0.0,) * 4, REAL])
def test_light_from_beyond_the_image_has_its_place_in_the_image_plane(k) -> None:
    """Within the limit where it is projected to; beyond it, farther out by the angle.

    Scattered light counts the distance from there, and falls off as the solid angle does not.
    """
    camera = FisheyeCamera(HazardCameraConfig(width=200, height=190, horizontal_fov_deg=170.0,
                                              fisheye_distortion=k))
    image, turn = FisheyeImage(camera), math.radians(-50.0)
    edge = camera.focal_px * equidistant.radius(camera.limit_rad, camera.D)
    pixels = np.array([[(20.0, 30.0), (150.0, 80.0)]])
    for theta in (0.0, 0.4, 1.2, camera.limit_rad + 0.1, 2.5):
        direction = np.array([math.sin(theta) * math.cos(turn), math.sin(theta) * math.sin(turn),
                              math.cos(theta)])
        place = image.place(direction)
        beyond = edge + camera.focal_px * (theta - camera.limit_rad)
        expected = (camera.project(direction) if theta < camera.limit_rad else
                    camera.K[:2, 2] + beyond * np.array([math.cos(turn), math.sin(turn)]))
        assert place == pytest.approx(expected, abs=1e-9)
        apart, light = image.scatter(pixels[..., 0], pixels[..., 1], direction)
        assert apart * camera.focal_px == pytest.approx(np.hypot(*(pixels - place).T).T)
        assert light * camera.falloff(pixels) == pytest.approx(np.ones((1, 2)))
        assert image.pupil(direction) == 1.0


@pytest.mark.parametrize('image', [
    PinholeImage(np.array([[150.0, 0.0, 79.5], [0.0, 140.0, 59.5], [0.0, 0.0, 1.0]]), 160, 120),
    FisheyeImage(FisheyeCamera(HazardCameraConfig(width=160, height=120)))])
def test_the_place_of_a_ray_is_its_pixel_however_long_it_is(image) -> None:
    pixels = np.random.default_rng(3).uniform(20.0, 100.0, (50, 2))
    for pixel, ray in zip(pixels, image.rays(pixels)):
        for length in (0.3, 5.0):
            assert image.place(length * ray) == pytest.approx(pixel, abs=1e-5)
