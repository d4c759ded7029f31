"""The hood of a lens, the centre of images, and lenses at the edge of what can be inverted."""

import math

import numpy as np
import pytest

from lunar_rover_sim.camera.config import CameraConfig, LensConfig
from lunar_rover_sim.camera.distortion import distort, is_invertible
from lunar_rover_sim.camera.encoding import encoding_of
from lunar_rover_sim.camera.fisheye import FisheyeCamera, FisheyeLens, geometry_of
from lunar_rover_sim.camera.hazard import HazardCameraConfig, HazardConfig
from lunar_rover_sim.camera.lens import Lens
from lunar_rover_sim.camera.rig import PinholeCamera

WIDE = CameraConfig(width=300, height=200, horizontal_fov_deg=80.0)


@pytest.mark.parametrize('camera', [PinholeCamera(WIDE), FisheyeCamera(HazardCameraConfig(
    width=300, height=200, horizontal_fov_deg=150.0, image_circle_deg=170.0))])
def test_the_axis_hits_the_middle_of_the_image(camera):
    """The centre of the upper left pixel is (0, 0), so the middle of 300 x 200 is (149.5, 99.5).
    """
    axis = np.array([0.0, 0.0, 2.0])
    for matrix in (camera.K, camera.P_left[:, :3]):
        pixel = matrix @ axis
        assert (pixel / pixel[2]).tolist() == [149.5, 99.5, 1.0]
    assert camera.K[0, 0] == camera.K[1, 1] == camera.focal_px and camera.K[0, 1] == 0.0
    assert camera.K[2].tolist() == [0.0, 0.0, 1.0] and camera.K[1, 0] == 0.0
    assert camera.P_left[:, 3].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(camera.R, np.eye(3))
    assert camera.falloff([149.5, 99.5]) == pytest.approx(1.0)
    # Half a pixel beyond the last one lies the edge.
    left, right = camera.falloff([[-0.5, 99.5], [299.5, 99.5]])
    assert left == pytest.approx(right) and left < 1.0


def test_rays_of_a_pinhole_fall_by_the_fourth_power():
    camera = PinholeCamera(WIDE)
    rays = camera.rays()
    assert rays.shape == (200, 300, 3) and (rays[..., 2] == 1.0).all()
    cosine = 1.0 / np.linalg.norm(rays, axis=-1)
    u, v = np.meshgrid(np.arange(300.0), np.arange(200.0))
    np.testing.assert_allclose(camera.falloff(np.stack([u, v], axis=-1)), cosine**4)
    np.testing.assert_allclose(rays @ camera.K.T, np.stack([u, v, 1.0 + 0.0 * u], axis=-1))


def lenses(**values):
    config = LensConfig(hood_deg=20.0, **values)
    return [Lens(config, WIDE), FisheyeLens(config, HazardCameraConfig(
        width=300, height=200, horizontal_fov_deg=90.0, image_circle_deg=120.0))]


@pytest.mark.parametrize('which', [0, 1])
def test_the_hood_falls_smoothly_from_the_edge_on(which):
    """1 at the edge, a half in the middle, 0 at its end; without a kink at either end."""
    lens = lenses()[which]
    corner = math.radians(40.0) if which == 0 else min(
        math.hypot(150.0, 100.0) / (150.0 / math.radians(45.0)), math.radians(60.0))
    hood = math.radians(20.0)
    for share, value in ((-1.0, 1.0), (0.0, 1.0), (0.25, 0.84375), (0.5, 0.5), (0.75, 0.15625),
                         (1.0, 0.0), (1.5, 0.0)):
        assert lens.hood(towards(corner + share * hood)) == pytest.approx(value)
        light = towards(corner + (share + 0.01) * hood)
        assert lens.strays(light) == (share < 0.99)
    assert lens.strays(np.array([0.0, 0.0, 1.0 + 1e-12]))
    assert not lens.strays(np.array([0.0, 0.0, -1.0 - 1e-12]))
    if which == 0:      # as far above the frame, whose rows end earlier
        edge = math.atan(100.0 / (150.0 / math.tan(math.radians(40.0))))
        above = towards(edge + 0.5 * hood)[[1, 0, 2]]
        assert lens.hood(above) == pytest.approx(0.5)


def towards(angle_rad):
    """Return the unit vector to the right of the axis by an angle."""
    return np.array([math.sin(angle_rad), 0.0, math.cos(angle_rad)])


def test_nothing_strays_in_a_perfect_lens():
    """What strays is missing where it belongs."""
    for lens in lenses(scatter_share=0.0, veil_share=0.0):
        assert lens.perfect and lens.direct_share == 1.0
        assert not lens.strays(np.array([0.0, 0.0, 1.0]))
    for values in ({'scatter_share': 0.0, 'veil_share': 0.01}, {'scatter_share': 0.02,
                                                                'veil_share': 0.0}):
        for lens in lenses(**values):
            assert not lens.perfect and lens.direct_share == 1.0 - sum(values.values())


def test_light_from_behind_passes_no_hood():
    """A pinhole camera sees less than 90 deg to each side, whatever its hood."""
    lens = Lens(LensConfig(hood_deg=90.0), WIDE)
    assert lens.hood(towards(math.radians(89.9))) > 0.0
    assert lens.hood(towards(math.radians(90.1))) == 0.0


@pytest.mark.parametrize('exponent', [1.55, 1.9999, 2.0, 2.5])
def test_scattered_light_adds_up_to_its_share(exponent):
    """Over all directions in front of a pinhole, of light on its axis."""
    lens = Lens(LensConfig(scatter_share=0.02, scatter_exponent=exponent), WIDE)
    d = np.geomspace(1e-7, 1.0, 200_001)
    total = np.trapezoid(lens.scatter(d) * 2.0 * np.pi * d, d)
    assert total == pytest.approx(0.02, rel=1e-3)
    core = math.radians(lens.config.scatter_core_deg)
    assert lens.scatter(core) / lens.scatter_peak == pytest.approx(2.0**(-0.5 * exponent))


@pytest.mark.parametrize('slope,valid', [(0.06, True), (0.04, False)])
def test_a_lens_must_stretch_the_image_by_a_twentieth(slope, valid):
    """The area of what r + k r^3 makes of a patch is (1 + k r^2) (1 + 3 k r^2)."""
    half = 0.5
    # At the corner of the image, r = ideal radius there, by the quadratic in k r^2.
    x = (-4.0 + math.sqrt(16.0 - 12.0 * (1.0 - slope))) / 6.0
    ideal = math.sqrt(2.0) * half / (1.0 + x)
    lens = (x / ideal**2, 0.0, 0.0, 0.0, 0.0)
    assert np.hypot(*distort([ideal, 0.0], lens)) == pytest.approx(math.sqrt(2.0) * half)
    assert is_invertible(lens, half, half) == valid


def test_encodings_and_models_follow_from_what_is_given():
    for kind, shape, name in (('uint8', (2, 3), 'mono8'), ('uint16', (2, 3), 'mono16'),
                              ('uint8', (2, 3, 3), 'rgb8'), ('float32', (2, 3), '32FC1'),
                              ('float32', (2, 3, 2), '32FC2'), ('float32', (2, 3, 3), '32FC3')):
        assert encoding_of(np.zeros(shape, kind)) == name
    assert isinstance(geometry_of(HazardConfig()), FisheyeCamera)
    pinhole = HazardConfig(camera=HazardCameraConfig(model='pinhole', horizontal_fov_deg=100.0))
    assert isinstance(geometry_of(pinhole), PinholeCamera)
    assert geometry_of(pinhole).focal_px == pytest.approx(160.0 / math.tan(math.radians(50.0)))
