"""The mean over an exposure, without a renderer: widths, long paths, links that stand still."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.camera.image_geometry import PinholeImage
from lunar_rover_sim.camera.motion import CameraTwist
from lunar_rover_sim.camera.motion_blur import MotionBlur, Movement, MovingBody

W, H, FOCAL = 160, 120, 150.0
K = np.array([[FOCAL, 0.0, 79.5], [0.0, FOCAL, 59.5], [0.0, 0.0, 1.0]])
DEPTH_M = np.full((H, W), 3.0, np.float32)


def blur(**sensor):
    return MotionBlur(CameraConfig(width=W, height=H), SensorConfig(**sensor),
                      PinholeImage(K, W, H), on_body=True)


def moving(velocity=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0), *links):
    """Return the movement of a camera 1 m above the ground that looks ahead."""
    return Movement([MovingBody(CameraTwist(np.array(velocity), np.array(rate))), *links],
                    np.array([0.0, 1.0, 0.0]), 1.0)


def lines():
    """Return an image of thin bright upright lines, 20 px apart."""
    image = np.zeros((H, W), np.float32)
    image[:, 10::20] = 1.0
    return image


@pytest.mark.parametrize('path_px', [0.4, 0.8, 3.5, 6.0, 9.0])
def test_a_line_becomes_as_wide_as_the_path_is_long(path_px):
    """The camera moves sideways before a wall, so that all of it moves by f v T / Z."""
    exposure_s = 0.01
    speed = path_px / FOCAL * 3.0 / exposure_s
    mean = blur().mean(lines(), DEPTH_M, moving((speed, 0.0, 0.0)), exposure_s)
    window = mean[40, 80:101].astype(float)
    offset = np.arange(-10, 11)
    assert window.sum() == pytest.approx(1.0, rel=1e-3)
    assert (window * offset).sum() == pytest.approx(0.0, abs=1e-3)
    # Between pixels the image is interpolated, which adds up to a sixth.
    variance = (window * offset**2).sum()
    assert path_px**2 / 12.0 - 0.02 < variance < path_px**2 / 12.0 + 0.2


def test_nothing_moves_at_rest():
    image = lines()
    assert blur().mean(image, DEPTH_M, moving(), 0.01) is image
    assert blur(motion_blur=False).mean(image, DEPTH_M, moving((9.0, 0.0, 0.0)), 0.01) is image


def test_what_moves_with_the_camera_stays_sharp():
    """The body of the rover, which is link 0, and the ground around it."""
    link = np.zeros((H, W), np.uint8)
    link[60:, 40:120] = 1
    movement = moving((0.5, 0.0, 0.0))
    image = lines()
    mean = blur().mean(image, DEPTH_M, movement, 0.1, link)
    np.testing.assert_array_equal(mean[link == 1], image[link == 1])
    plain = blur().mean(image, DEPTH_M, movement, 0.1)
    np.testing.assert_array_equal(mean[:50], plain[:50])


def test_a_leg_smears_over_ground_that_stands():
    """A leg that sweeps by 8 px: a share of it lies beside where it is at the stamp."""
    link, image = np.zeros((H, W), np.uint8), np.full((H, W), 1.0, np.float32)
    link[:, 70:90], image[:, 70:90] = 3, 5.0
    leg = MovingBody(CameraTwist(np.array([1.6, 0.0, 0.0]), np.zeros(3)), 3, 1.0 / 3.0)
    mean = blur().mean(image, DEPTH_M, moving((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), leg), 0.1, link)
    row = mean[60]
    assert row[80] == pytest.approx(5.0) and row[60] == pytest.approx(1.0)
    assert 1.5 < row[69] < 4.5 and 1.0 < row[67] < row[69]


def test_the_mean_is_that_of_pictures_taken_along_the_way():
    """A camera before a painted wall shifts and turns about all axes, far around its own."""
    v, w, exposure_s = np.array([0.3, 0.6, 0.4]), np.array([0.1, -0.2, 4.0]), 0.2
    columns, rows = np.meshgrid(np.arange(W), np.arange(H))
    rays = np.stack([columns, rows, np.ones((H, W))], axis=-1) @ np.linalg.inv(K).T

    def picture(t):
        at = rays @ Rotation.from_rotvec(w * t).as_matrix().T
        place = v * t + 0.5 * t * t * np.cross(w, v)
        x, y = (at[..., k] / at[..., 2] * (3.0 - place[2]) + place[k] for k in (0, 1))
        return np.sin(2.0 * np.pi * x / 1.2) + np.cos(2.0 * np.pi * y)

    image = picture(0.0).astype(np.float32)
    mean = blur().mean(image, DEPTH_M, moving(v, w), exposure_s)
    expected = np.mean([picture(t) for t in exposure_s * ((np.arange(400) + 0.5) / 400 - 0.5)],
                       axis=0)
    # Beyond this circle the image does not show all that comes into view.
    inside = np.hypot(columns - 79.5, rows - 59.5) < 45.0
    assert np.abs(mean - expected)[inside].max() < 0.03
    assert np.abs(image - expected)[inside].max() > 0.5


def test_ground_that_passes_behind_a_leg_does_not_mix_with_it():
    link, image = np.zeros((H, W), np.uint8), np.full((H, W), 1.0, np.float32)
    link[40:80, 70:90], image[40:80, 70:90] = 3, 5.0
    leg = MovingBody(CameraTwist(np.zeros(3), np.zeros(3)), 3, 1.0 / 3.0)
    for velocity in ((1.1, 0.3, 0.0), (-0.3, -1.1, 0.0)):
        mean = blur().mean(image, DEPTH_M, moving(velocity, (0.0, 0.0, 0.0), leg), 0.1, link)
        np.testing.assert_allclose(mean, image, atol=1e-6)
