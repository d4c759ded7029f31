"""The lens model by its formula, up to where it folds over."""

import camera_scene as scene
import cv2
import numpy as np
import pytest

from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.camera.distortion import distort, is_invertible, undistort
from lunar_rover_sim.image.camera.fisheye import FisheyeCamera
from lunar_rover_sim.image.camera.hazard import HazardCameraConfig
from lunar_rover_sim.image.camera.image_geometry import FisheyeImage
from lunar_rover_sim.image.camera.miscalibration import padding, source_pixels
from lunar_rover_sim.image.camera.motion import CameraTwist
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

# Barrel, pincushion, moustache (k1 and k2 of different signs) and decentred lenses, all with k3.
LENSES = [(-0.28, 0.07, 0.0008, -0.0005, -0.009), (0.12, -0.05, 0.0, 0.0, 0.03),
          (0.2, -0.31, 0.002, 0.001, 0.09), (-0.1, 0.0, 0.03, -0.02, 0.004)]


@pytest.mark.parametrize('lens', LENSES)
def test_all_five_coefficients_are_those_of_opencv(lens):
    points = np.random.default_rng(0).uniform(-0.9, 0.9, (200, 2))
    expected, _ = cv2.projectPoints(np.column_stack([points, np.ones(200)]), np.zeros(3),
                                    np.zeros(3), np.eye(3), np.array(lens))
    np.testing.assert_allclose(distort(points, lens), expected[:, 0], atol=1e-12)


def up_to_the_fold(share, k1):
    """Return points all around up to a share of the radius at which a lens with k1 folds over.

    d/dr (r + k1 r^3) = 0 at r = 1 / sqrt(-3 k1).
    """
    radius = share / np.sqrt(-3.0 * k1) * np.linspace(0.0, 1.0, 12)[:, None]
    angle = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


@pytest.mark.parametrize('p1,p2', [(0.0, 0.0), (0.004, -0.003)])
def test_the_inverse_reaches_up_to_the_fold(p1, p2):
    """Near the fold radius and tangent are stretched differently: the whole Jacobian counts."""
    lens = (-0.28, 0.0, p1, p2, 0.0)
    points = up_to_the_fold(0.97, -0.28)
    np.testing.assert_allclose(undistort(distort(points, lens), lens), points, atol=1e-7)


@pytest.mark.parametrize('lens', LENSES)
def test_the_inverse_of_every_lens(lens):
    points = np.stack(np.meshgrid(np.linspace(-0.6, 0.6, 13), np.linspace(-0.5, 0.5, 11)), -1)
    np.testing.assert_allclose(undistort(distort(points, lens), lens), points, atol=1e-8)


def test_without_an_inverse_there_is_no_number():
    # The largest distorted radius of k1 = -0.28 is 2/3 of the radius of the fold: 0.7274.
    lens = (-0.28, 0.0, 0.0, 0.0, 0.0)
    inside, outside = undistort([[0.72, 0.0], [0.0, 0.735]], lens)
    assert np.isfinite(inside).all() and np.isnan(outside).all()


def test_images_are_invertible_up_to_the_fold():
    """Corners at 0.70 and 0.735, on either side of the largest distorted radius of 0.7274."""
    lens = (-0.28, 0.0, 0.0, 0.0, 0.0)
    for half_width, half_height in ((0.6, 0.8), (0.8, 0.6)):
        assert is_invertible(lens, 0.7 * half_width, 0.7 * half_height)
        assert not is_invertible(lens, 0.735 * half_width, 0.735 * half_height)
    assert is_invertible(np.zeros(5), 5.0, 5.0)


def test_a_lens_that_folds_and_unfolds_again_is_not_invertible():
    """r - 1.1 r^3 + 0.5 r^5 falls between 0.69 and 0.92 and then rises for good.

    Every distorted point has an ideal one, but points around the fold have three.
    """
    lens = (-1.1, 0.5, 0.0, 0.0, 0.0)
    radius = np.linspace(0.0, 2.0, 2001)
    slope = np.gradient(radius - 1.1 * radius**3 + 0.5 * radius**5, radius)
    assert slope.min() < -0.01 and slope[-1] > 0.0
    assert not is_invertible(lens, 1.4, 1.0)


@pytest.mark.parametrize('lens', [LENSES[0], (0.12, -0.05, 0.001, 0.0, 0.03)])
def test_each_distorted_pixel_shows_the_place_that_the_lens_moves_there(lens):
    """Distorting the place in the pinhole image gives the pixel back; the padding holds all."""
    camera = CameraConfig(width=160, height=120, distortion=lens)
    source = source_pixels(camera)
    centre = np.array([79.5, 59.5])
    back = distort((source - centre) / camera.focal_px, lens) * camera.focal_px + centre
    u, v = np.meshgrid(np.arange(160.0), np.arange(120.0))
    np.testing.assert_allclose(back, np.stack([u, v], axis=-1), atol=1e-5)
    x, y = padding(camera)
    assert source[..., 0].min() > -x and source[..., 0].max() < 159 + x
    assert source[..., 1].min() > -y and source[..., 1].max() < 119 + y
    # No more than needed: a barrel looks beyond the image, a pincushion needs next to nothing.
    beyond = max(-source[..., 0].min(), source[..., 0].max() - 159.0, 0.0)
    assert x <= beyond + 4


@pytest.mark.parametrize('distortion', [(0.0,) * 4, (-0.02, 0.004, -0.003, 0.0006)])
def test_a_fisheye_that_turns_about_its_axis_draws_circles(distortion):
    """As fast as they are wide: along the circles a fisheye is denser than from the middle out."""
    camera = FisheyeCamera(HazardCameraConfig(width=400, height=300,
                                              fisheye_distortion=distortion))
    middle = camera.K[:2, 2]
    assert camera.project([0.0, 0.0, 2.0]) == pytest.approx(middle, abs=1e-9)
    places = middle + np.array([[0.5, 0.0], [20.0, -30.0], [-90.0, 60.0], [0.0, 140.0]])
    image = FisheyeImage(camera)
    turning = CameraTwist(np.zeros(3), np.array([0.0, 0.0, 0.7]))
    speed = image.image_speed(turning, image.rays(places), np.ones(4))
    assert speed == pytest.approx(0.7 * np.hypot(*(places - middle).T), rel=1e-6)


BARREL = (-0.28, 0.07, 0.0008, -0.0005, 0.0)


def drawn(distortion):
    """Return left and right image, depth and rig of a view of hills."""
    world = scene.plane(heights=scene.hills())
    pose = scene.pose(z=float(world.height_at((0.0, 0.0))) + 0.1)
    camera = CameraConfig(width=400, height=300, distortion=distortion)
    config = scene.config(15.0, azimuth_deg=60.0, camera=camera)
    with Renderer(world, scene.ROVER, config) as renderer:
        frame = renderer.render(RoverPose(pose), 0, ('left', 'right', 'depth'))
        return frame.left, frame.right, frame.depth_m, renderer.rig


@pytest.fixture(scope='module')
def straight():
    return drawn((0.0,) * 5)


@pytest.mark.parametrize('distortion', [BARREL, (0.15, 0.02, 0.0, 0.0, 0.0)])
def test_undistorting_the_image_gives_the_rectified_one(straight, distortion):
    bent = drawn(distortion)
    # Truth is that of the undistorted view; where the mesh changes its resolution may differ.
    np.testing.assert_allclose(straight[2], bent[2], rtol=5e-3)
    for side in (0, 1):
        back = cv2.undistort(bent[side], bent[3].K, bent[3].D)
        inner = back[25:-25, 38:-38].astype(float)
        same = straight[side][25:-25, 38:-38].astype(float)
        assert np.corrcoef(inner.ravel(), same.ravel())[0, 1] > 0.99
        assert np.median(np.abs(inner - same)) <= 2.0
        assert bent[side][:, 0].max() > 0 and bent[side][-1].max() > 0
