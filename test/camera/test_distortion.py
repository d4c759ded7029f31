"""Distortion: inverse of itself, OpenCV's own, and what cannot be inverted is refused."""

import camera_scene as scene
import cv2
import numpy as np
import pytest

from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.camera.distortion import distort, undistort
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

BARREL = (-0.28, 0.07, 0.0008, -0.0005, 0.0)


def test_distort_and_undistort_are_inverse():
    x, y = np.meshgrid(np.linspace(-0.7, 0.7, 31), np.linspace(-0.5, 0.5, 21))
    points = np.stack([x, y], axis=-1)
    np.testing.assert_allclose(undistort(distort(points, BARREL), BARREL), points, atol=1e-8)


def test_distortion_is_that_of_opencv():
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 2))
    expected, _ = cv2.projectPoints(np.column_stack([points, np.ones(50)]), np.zeros(3),
                                    np.zeros(3), np.eye(3), np.array(BARREL))
    np.testing.assert_allclose(distort(points, BARREL), expected[:, 0], atol=1e-12)


def test_what_cannot_be_inverted_is_refused():
    with pytest.raises(ConfigError, match='distortion: .* can be inverted over 70 deg'):
        CameraConfig(distortion=(-1.2, 0.0, 0.0, 0.0, 0.0))


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
