"""Alignment and association of trajectories, held to their definitions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.judge.evaluation.registration import align, associate
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory, wxyz

NO_TURN = [1.0, 0.0, 0.0, 0.0]


def through(points):
    """Return a trajectory without turning through (n, 3) points, one a second."""
    points = np.asarray(points, float)
    return Trajectory(np.arange(1, len(points) + 1) * 10**9, points,
                      np.tile(NO_TURN, (len(points), 1)), 'path')


def curve(n=40):
    t = np.linspace(0.0, 3.0, n)
    return np.stack([np.cos(t), np.sin(2.0 * t), 0.3 * t], axis=1)


@pytest.mark.parametrize('mode', ['se3', 'sim3', 'yaw'])
def test_a_short_drive_far_from_the_origin_is_aligned(mode):
    """A few decimetres of motion at map coordinates of 1000 km, as exactly as doubles hold them.

    Coordinates of 1e6 m are stored to 1e-10 m; the turn follows from 40 of them over 0.1 m.
    """
    turn = Rotation.from_rotvec([0.0, 0.0, 0.8])
    far = np.array([1.2e6, -0.9e6, 300.0])
    estimate = 0.1 * curve()
    for offset_x, offset_y in ((far, 0.0 * far), (0.0 * far, far), (far, -far)):
        x, y = through(estimate + offset_x), through(turn.apply(estimate) + offset_y)
        found = align(x, y, mode)
        np.testing.assert_allclose(found.rotation, turn.as_matrix(), atol=1e-6)
        assert found.scale == pytest.approx(1.0, abs=1e-6)
        moved = found.apply(x).positions_m
        # A turn that is off by 1e-9 would move the far point by a millimetre: that is taken back.
        np.testing.assert_allclose(moved, y.positions_m, atol=1e-6)


@pytest.mark.parametrize('angle', [0.1, 2.0, -3.0])
def test_yaw_alignment_turns_about_the_vertical_only(angle):
    """Noise in roll and pitch stays: the best turn about z of a tilted copy is that about z."""
    tilt = Rotation.from_rotvec([0.05, 0.0, 0.0])
    turn = Rotation.from_rotvec([0.0, 0.0, angle])
    flat = curve() * [1.0, 1.0, 0.0]
    found = align(through(flat), through(turn.apply(tilt.apply(flat))), 'yaw')
    np.testing.assert_allclose(found.rotation[2], [0.0, 0.0, 1.0])
    np.testing.assert_allclose(found.rotation[:, 2], [0.0, 0.0, 1.0])
    # Tilting about x shortens y by cos(0.05), which turns the best yaw by far less than 1e-2.
    np.testing.assert_allclose(found.rotation, turn.as_matrix(), atol=1e-3)


def test_yaw_of_two_spots_is_the_angle_between_their_lines():
    """Three points on a line along x onto a line at 30 deg: turned by 30 deg, means onto means."""
    x = through([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    c, s = np.cos(np.pi / 6.0), np.sin(np.pi / 6.0)
    y = through([[5.0 + c * r, 7.0 + s * r, -2.0] for r in (0.0, 1.0, 2.0)])
    found = align(x, y, 'yaw')
    np.testing.assert_allclose(found.rotation, [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]],
                               atol=1e-12)
    np.testing.assert_allclose(found.translation_m, [5.0, 7.0, -2.0], atol=1e-12)


def test_a_mirrored_copy_is_aligned_by_a_proper_rotation():
    """No rotation undoes a reflection: the best one is proper, and the scale is smaller than 1.

    Umeyama's Eq. (43): scale = (d1 + d2 - d3) / variance of x.
    """
    points = curve() - curve().mean(axis=0)
    mirrored = points * [1.0, 1.0, -1.0]
    found = align(through(points), through(mirrored), 'sim3')
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    axes = np.linalg.svd(points.T @ points / len(points), compute_uv=False)
    best = (axes[0] + axes[1] - axes[2]) / axes.sum()
    assert found.scale == pytest.approx(best, rel=1e-9)


@pytest.mark.parametrize('straight', ['estimate', 'truth'])
def test_a_straight_path_is_refused_whichever_it_is(straight):
    line = through(np.outer(np.linspace(0.0, 1.0, 40), [1.0, 2.0, 0.5]))
    pair = (line, through(curve())) if straight == 'estimate' else (through(curve()), line)
    with pytest.raises(EvaluationError, match=f'the {straight} moves on a straight line'):
        align(*pair, 'se3')


def test_a_path_that_is_bent_by_a_ten_thousandth_is_not_straight():
    t = np.linspace(0.0, 1.0, 40)
    bent = through(np.stack([t, 1e-4 * t**2, 0.0 * t], axis=1))
    np.testing.assert_allclose(align(bent, bent, 'se3').rotation, np.eye(3), atol=1e-6)


def poses(stamps_ns, seed):
    """Return poses at random places and attitudes."""
    rng = np.random.default_rng(seed)
    return Trajectory(stamps_ns, rng.normal(size=(len(stamps_ns), 3)),
                      wxyz(Rotation.random(len(stamps_ns), random_state=seed)), f'poses {seed}')


def test_a_pose_outside_the_truth_takes_its_end():
    """1 ns before the first and after the last pose."""
    truth = poses(np.array([10, 20, 30]), 1)
    found = associate(truth, poses(np.array([9, 20, 31]), 2), 1e-9)
    np.testing.assert_array_equal(found.truth.positions_m, truth.positions_m)
    with pytest.raises(EvaluationError, match='1 of 3 poses lie within 0 s'):
        associate(truth, poses(np.array([9, 20, 31]), 2), 0.0)


def test_three_poses_are_enough_and_two_are_not():
    truth, three = poses(np.arange(10), 1), poses(np.array([2, 4, 9]), 2)
    assert len(associate(truth, three).estimate) == 3
    for pair in ((truth, three.select([0, 1])), (truth.select([3, 4]), three)):
        with pytest.raises(EvaluationError, match='holds 2 poses; at least 3'):
            associate(*pair)
    with pytest.raises(EvaluationError, match=r'2 of 3 poses .* \(estimate 0.000 to 5.000 s, '
                       r'truth 0.000 to 0.000 s\)'):
        associate(truth, poses(np.array([0, 5, 5 * 10**9]), 3), 0.0)
