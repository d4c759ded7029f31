"""Rotations and frames: identities."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base import frames


@pytest.fixture()
def quats(rng_seed: int = 3) -> np.ndarray:
    """Random unit quaternions, w >= 0, with the corner cases of the conversion."""
    rng = np.random.default_rng(rng_seed)
    quats = rng.normal(size=(200, 4))
    quats = np.vstack([quats, np.eye(4), [[0, 1, 1, 0], [0, 0, 1, -1]]])
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return np.where(quats[:, :1] < 0, -quats, quats)


def test_quaternion_matrix_round_trip(quats: np.ndarray) -> None:
    """q and -q are the same rotation; the conversion back picks w >= 0."""
    for quat in quats:
        back = frames.wxyz_from_matrix(frames.matrix_from_wxyz(quat))
        assert min(np.abs(back - quat).max(), np.abs(back + quat).max()) < 1e-12


def test_matrices_of_many_quaternions(quats: np.ndarray) -> None:
    """An array of quaternions of any shape gives the very matrices of the single ones."""
    several = quats[:24].reshape(2, 3, 4, 4)
    matrices = frames.matrix_from_wxyz(several)
    assert matrices.shape == (2, 3, 4, 3, 3)
    single = [frames.matrix_from_wxyz(quat) for quat in quats[:24]]
    assert matrices.reshape(24, 3, 3).tolist() == np.array(single).tolist()


@pytest.mark.parametrize('angle_rad', [0.0, 1e-12, 1e-4, 0.1, 3.0])
def test_rotation_vectors(angle_rad: float) -> None:
    """As SciPy rotates by them, to rounding."""
    vector = angle_rad * np.array([0.36, -0.48, 0.8])
    np.testing.assert_allclose(frames.matrix_from_rotvec(vector),
                               Rotation.from_rotvec(vector).as_matrix(), rtol=0.0, atol=1e-15)


def test_rpy_round_trip() -> None:
    """Fixed-axis roll, pitch, yaw come back."""
    rpy = np.array([0.3, -0.7, 2.5])
    assert np.allclose(frames.rpy_from_wxyz(frames.wxyz_from_rpy(*rpy)), rpy)


def test_positive_pitch_is_nose_down() -> None:
    """REP-103: x forward, y left, so a positive turn about y lowers the nose."""
    forward = frames.matrix_from_wxyz(frames.wxyz_from_rpy(0, 0.1, 0)) @ [1, 0, 0]
    assert forward[2] < 0


def test_inverse(quats: np.ndarray) -> None:
    """inverse(T) T is the identity."""
    T = frames.se3(frames.matrix_from_wxyz(quats[0]), [1, 2, 3])
    assert np.allclose(frames.inverse(T) @ T, np.eye(4))


def test_optical_axes() -> None:
    """Optical z looks along body x, optical x to the right, optical y down."""
    assert np.allclose(frames.R_BODY_OPTICAL @ [0, 0, 1], [1, 0, 0])
    assert np.allclose(frames.R_BODY_OPTICAL @ [1, 0, 0], [0, -1, 0])
    assert np.allclose(frames.R_BODY_OPTICAL @ [0, 1, 0], [0, 0, -1])
    assert np.isclose(np.linalg.det(frames.R_BODY_OPTICAL), 1)


def test_sun_direction() -> None:
    """Azimuth from x towards y, elevation from the horizontal."""
    assert np.allclose(frames.sun_direction(90, 0), [0, 1, 0])
    assert np.allclose(frames.sun_direction(0, 90), [0, 0, 1])


def test_the_product_of_quaternions_is_that_of_their_matrices(quats: np.ndarray) -> None:
    """The second rotation is applied first, as with matrices."""
    first, second = quats[:100], quats[100:200]
    product = frames.matrix_from_wxyz(frames.product_wxyz(first, second))
    expected = frames.matrix_from_wxyz(first) @ frames.matrix_from_wxyz(second)
    np.testing.assert_allclose(product, expected, atol=1e-12)


def test_the_length_of_a_path_is_the_sum_of_its_steps() -> None:
    """Three, four and twelve metres along the axes; nothing for a point or none."""
    points = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, -12.0]])
    np.testing.assert_allclose(frames.distance_along(points), [0.0, 3.0, 7.0, 19.0])
    assert frames.path_length(points) == pytest.approx(19.0)
    assert frames.path_length(points[:, :2]) == pytest.approx(7.0)
    assert frames.path_length(points[:1]) == frames.path_length(points[:0]) == 0.0
    assert frames.distance_along(points[:0]).shape == (0,)


def test_tilt_is_the_angle_of_the_axes_upward() -> None:
    """Whatever the heading; what is not finite passes no bound."""
    rolls = np.radians([0.0, 30.0, 89.0, 180.0])
    quats = np.array([frames.wxyz_from_rpy(roll, 0.0, 1.0) for roll in rolls])
    np.testing.assert_allclose(frames.tilt_deg(quats), np.degrees(rolls), atol=1e-6)
    np.testing.assert_allclose(frames.tilt_deg(frames.matrix_from_wxyz(quats)),
                               np.degrees(rolls), atol=1e-6)
    assert frames.tilt_deg([1.0, 0.0, 0.0, 0.0]) == 0.0
    for bad in (np.full(4, np.nan), np.full((3, 3), np.nan)):
        assert frames.tilt_deg(bad) == 180.0
