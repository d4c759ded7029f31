"""The mean over an exposure, without a renderer: widths, long paths, links that stand still."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.image.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.image.camera.fisheye import FisheyeCamera
from lunar_rover_sim.image.camera.hazard import HazardCameraConfig
from lunar_rover_sim.image.camera.image_geometry import FisheyeImage, PinholeImage
from lunar_rover_sim.image.camera.motion import CameraTwist
from lunar_rover_sim.image.camera.motion_blur import MotionBlur, Movement, MovingBody

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


@pytest.mark.parametrize('upwards', [False, True])
@pytest.mark.parametrize('path_px', [0.4, 0.8, 3.5, 6.3, 9.3])     # none of whole steps
def test_a_line_becomes_as_wide_as_the_path_is_long(path_px, upwards):
    """The camera moves across lines on a wall, so that all of it moves by f v T / Z."""
    exposure_s = 0.01
    velocity = np.roll([path_px / FOCAL * 3.0 / exposure_s, 0.0, 0.0], upwards)
    image = np.ascontiguousarray(np.tile(lines()[0, :H, None], W)) if upwards else lines()
    mean = blur().mean(image, DEPTH_M, moving(velocity), exposure_s)
    window = (mean.T if upwards else mean)[40, 60:81].astype(float)
    offset = np.arange(-10, 11)
    assert window.sum() == pytest.approx(1.0, rel=1e-3)
    assert (window * offset).sum() == pytest.approx(0.0, abs=1e-3)
    # Between pixels the image is interpolated, which adds up to a sixth.
    variance = (window * offset**2).sum()
    assert path_px**2 / 12.0 - 0.02 < variance < path_px**2 / 12.0 + 0.2


def test_short_paths_spread_a_point_by_the_variance_of_the_path():
    """p^2 / 12 along either axis, for a camera that turns about all axes and shifts; and along
    the path: with the sign of the product where both are."""
    v, w, exposure_s = np.array([0.05, -0.04, 0.4]), np.array([0.02, 0.03, 0.8]), 0.01
    image = np.zeros((H, W), np.float32)
    image[6::6, 6::6] = 1.0
    depth_m = np.tile(np.linspace(1.0, 4.0, W, dtype=np.float32), (H, 1))
    mean = blur().mean(image, depth_m, moving(v, w), exposure_s)
    at_rows, at_columns = (place.ravel() for place in np.mgrid[6:H - 6:6, 6:W - 6:6])
    rays = PinholeImage(K, W, H).rays(np.stack([at_columns, at_rows], axis=-1).astype(float))
    points = rays * depth_m[at_rows, at_columns, None]
    ends = [(Rotation.from_rotvec(sign * w * exposure_s / 2.0).apply(points)
             + sign * v * exposure_s / 2.0) @ K.T for sign in (-1.0, 1.0)]
    path = ends[1][:, :2] / ends[1][:, 2:] - ends[0][:, :2] / ends[0][:, 2:]
    assert 0.5 < np.abs(path).max() < 1.0
    spread = np.array([mean[r - 1:r + 2, c - 1:c + 2] for r, c in zip(at_rows, at_columns)])
    step = np.array([-1.0, 0.0, 1.0])
    moments = [np.einsum('nvu,v,u->n', spread, a, b)
               for a, b in ((step**0, step**2), (step**2, step**0), (step, step))]
    var_u, var_v = (path**2 / 12.0).T
    along = np.sign(path.prod(axis=1)) * var_u * var_v
    for found, expected in zip(moments, (var_u, var_v, along)):
        np.testing.assert_allclose(found, expected, atol=2e-3)
    np.testing.assert_allclose(spread.sum(axis=(1, 2)), 1.0, atol=2e-3)


@pytest.mark.parametrize('path_px', [0.5, 2.5, 8.0])
def test_motion_keeps_even_light_and_has_no_favourite_side(path_px):
    """Up to the borders: a mirrored picture with mirrored motion has the mirrored mean."""
    image = np.random.default_rng(3).random((H, W)).astype(np.float32)
    velocity = np.array([1.0, 0.6, 0.0]) * path_px / FOCAL * 3.0 / 0.01
    mean = blur().mean(image, DEPTH_M, moving(velocity), 0.01)
    for axis in (0, 1):
        mirrored = np.flip(image, axis).copy()
        turned = velocity * np.where(np.arange(3) == 1 - axis, -1.0, 1.0)
        np.testing.assert_allclose(blur().mean(mirrored, DEPTH_M, moving(turned), 0.01),
                                   np.flip(mean, axis), atol=2e-4)
    even = blur().mean(np.ones_like(image), DEPTH_M, moving(velocity), 0.01)
    np.testing.assert_allclose(even, 1.0, atol=1e-6)
    assert mean.std() < 0.98 * image.std()


@pytest.mark.parametrize('line_time_s', [0.0, 2e-4])
def test_parts_have_no_favourite_side_either(line_time_s):
    """Blocks of a part that moves otherwise, up to all borders, on ground: mirrored alike."""
    rng, shape = np.random.default_rng(4), (H // 8, W // 8)
    link = np.kron(rng.random(shape) < 0.4, np.ones((8, 8))).astype(np.uint8) * 3
    link = np.roll(link, (1, 1), (0, 1))        # some are one pixel wide at a border
    image = (rng.random((H, W)) + 2.0 * link).astype(np.float32)
    depth_m = np.where(link > 0, 1.5, 3.0).astype(np.float32)
    along, other = np.array([0.37, 0.23, 0.0]), np.array([-0.21, 0.31, 0.0])

    def mean(axis=None):
        turn = np.where(np.arange(3) == (9 if axis is None else 1 - axis), -1.0, 1.0)
        pictures = [picture if axis is None else np.flip(picture, axis).copy()
                    for picture in (image, depth_m, link)]
        leg = MovingBody(CameraTwist(turn * other, np.zeros(3)), 3, 1.0 / 1.5)
        made = blur(line_time_s=line_time_s).mean(
            *pictures[:2], moving(turn * along, (0.0, 0.0, 0.0), leg), 0.1, pictures[2])
        return made if axis is None else np.flip(made, axis)

    plain = mean()
    assert np.abs(plain - image).max() > 1.0
    for axis in (1,) if line_time_s else (0, 1):    # rows are read from above
        np.testing.assert_allclose(mean(axis), plain, atol=1e-4)


def test_nothing_moves_at_rest():
    image = lines()
    assert blur().mean(image, DEPTH_M, moving(), 0.01) is image
    assert blur(motion_blur=False).mean(image, DEPTH_M, moving((9.0, 0.0, 0.0)), 0.01) is image


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_the_farthest_corner_decides_whether_motion_is_seen(side):
    """Ahead over level ground 1 m below, the lower corners move fastest: by f x y v T."""
    x, y = 79.5 / FOCAL, 59.5 / FOCAL
    ahead = Movement([MovingBody(CameraTwist(np.array([0.0, 0.0, 1.0]), np.zeros(3)))],
                     np.array([0.0, side, 0.0]), 1.0)
    exposure_s = 0.2 / (FOCAL * np.hypot(x, y) * y)
    assert [blur().is_seen(ahead, part * exposure_s) for part in (0.99, 1.01)] == [False, True]


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


@pytest.mark.parametrize('line_time_s, k', [(0.0, None), (5e-4, None), (0.0, (0.0,) * 4),
                                            (5e-4, (-0.02, 0.004, -0.003, 0.0006))])
def test_the_mean_is_that_of_pictures_taken_along_the_way(line_time_s, k):
    """A camera before a painted wall shifts and turns about all axes, far around its own.

    It is a pinhole, or a fisheye of these coefficients, with either shutter.
    """
    v, w, exposure_s = np.array([0.3, 0.6, 0.4]), np.array([0.1, -0.2, 4.0]), 0.2
    pixels = np.stack(np.meshgrid(np.arange(W), np.arange(H)), axis=-1).astype(float)
    if k is None:
        config = CameraConfig(width=W, height=H, distortion=(-0.3, 0.1, 0.02, -0.01, 0.05))
        camera, depth_m = PinholeImage(K, W, H), DEPTH_M
        rays = camera.rays(pixels.reshape(-1, 2)).reshape(H, W, 3)
        places = cv2.projectPoints(rays.reshape(-1, 3), np.zeros(3), np.zeros(3), K,
                                   np.array(config.distortion))[0].reshape(H, W, 2)
    else:
        config = HazardCameraConfig(width=W, height=H, horizontal_fov_deg=185.0,
                                    fisheye_distortion=k)
        camera, places = FisheyeImage(FisheyeCamera(config)), pixels
        rays = camera.ray_table
        depth_m = np.where(rays[..., 2] > 0.1, 3.0 / rays[..., 2], 0.0).astype(np.float32)
    wave_m = 1.2 * FOCAL / camera.focal_px

    def picture(t):
        at = Rotation.from_rotvec(w * np.reshape(t, (-1, 1))).apply(rays.reshape(-1, 3))
        t = np.reshape(t, (-1, 1))
        place = v * t + 0.5 * t * t * np.cross(w, v)
        x, y = (at[:, i] / at[:, 2] * (3.0 - place[:, 2]) + place[:, i] for i in (0, 1))
        return (np.sin(2.0 * np.pi * x / wave_m) + np.cos(2.4 * np.pi * y / wave_m)).reshape(H, W)

    image = np.nan_to_num(picture(0.0)).astype(np.float32)
    mean = MotionBlur(config, SensorConfig(line_time_s=line_time_s), camera, on_body=True).mean(
        image, depth_m, moving(v, w), exposure_s)
    # A row of the sensor is as much later as the lens images it below the middle one.
    row_s = line_time_s * (places[..., 1] - camera.K[1, 2])
    expected = np.mean([picture(row_s + exposure_s * t) for t in (np.arange(30) - 14.5) / 30.0],
                       axis=0)
    # Beyond this circle the image does not show all that comes into view.
    inside = np.linalg.norm(pixels - camera.K[:2, 2], axis=-1) < 45.0
    assert np.abs(mean - expected)[inside].max() < 0.03
    assert np.abs(image - expected)[inside].max() > 0.5
    assert not mean[np.isnan(rays[..., 0])].any(), 'beyond the limit of a fisheye'


def test_ground_that_passes_behind_a_leg_does_not_mix_with_it():
    link, image = np.zeros((H, W), np.uint8), np.full((H, W), 1.0, np.float32)
    link[40:80, 70:90], image[40:80, 70:90] = 3, 5.0
    leg = MovingBody(CameraTwist(np.zeros(3), np.zeros(3)), 3, 1.0 / 3.0)
    for velocity in ((1.1, 0.3, 0.0), (-0.3, -1.1, 0.0)):
        mean = blur().mean(image, DEPTH_M, moving(velocity, (0.0, 0.0, 0.0), leg), 0.1, link)
        np.testing.assert_allclose(mean, image, atol=1e-6)


def test_parts_have_the_mean_of_pictures_taken_along_their_own_way():
    """A wall and a plate before it, which turn and shift otherwise, both rigid and painted.

    Well inside of either, where nothing else comes into view, also while rows are read one after
    the other.
    """
    exposure_s, plate = 0.2, (slice(30, 90), slice(50, 110))
    link, depth_m = np.zeros((H, W), np.uint8), DEPTH_M.copy()
    link[plate], depth_m[plate] = 4, 1.5
    pixels = np.stack(np.meshgrid(np.arange(W), np.arange(H)), axis=-1).astype(float)
    rays = PinholeImage(K, W, H).rays(pixels.reshape(-1, 2))
    motions = [(np.array([0.15, 0.3, 0.2]), np.array([0.05, -0.1, 2.0]), 3.0),
               (np.array([-0.2, 0.1, -0.2]), np.array([-0.1, 0.15, -2.5]), 1.5)]

    def picture(v, w, z_m, t):
        t = np.reshape(t, (-1, 1))
        at = Rotation.from_rotvec(w * t).apply(rays)
        place = v * t + 0.5 * t * t * np.cross(w, v)
        x, y = (at[:, i] / at[:, 2] * (z_m - place[:, 2]) + place[:, i] for i in (0, 1))
        return (np.sin(2.0 * np.pi * x / 0.15 / z_m)
                + np.cos(2.4 * np.pi * y / 0.15 / z_m)).reshape(H, W)

    image = np.where(link > 0, picture(*motions[1], 0.0), picture(*motions[0], 0.0)).astype(
        np.float32)
    (v, w, _), (v_plate, w_plate, _) = motions
    unseen = MovingBody(CameraTwist(np.zeros(3), np.array([1.0, 0.0, 0.0])), 2, 1.0)
    movement = moving(v, w, unseen, MovingBody(CameraTwist(v_plate, w_plate), 4, 1.0 / 1.5))
    inside = np.zeros((2, H, W), bool)
    inside[0] = cv2.dilate(link, np.ones((61, 61), np.uint8)) == 0
    inside[0, :, :12] = inside[0, :, -12:] = inside[0, :12] = inside[0, -12:] = False
    inside[1] = cv2.erode(link, np.ones((31, 31), np.uint8)) > 0
    for line_time_s in (0.0, 2e-4):
        mean = blur(line_time_s=line_time_s).mean(image, depth_m, movement, exposure_s, link)
        row_s = np.repeat((np.arange(H) - 59.5) * line_time_s, W)
        for here, motion in zip(inside, motions):
            expected = np.mean([picture(*motion, row_s + exposure_s * t)
                                for t in (np.arange(12) - 5.5) / 12.0], axis=0)
            assert here.sum() > 500
            assert np.abs(mean - expected)[here].max() < 0.08
            assert np.abs(image - expected)[here].max() > 0.3
