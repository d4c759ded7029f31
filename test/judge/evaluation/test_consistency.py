"""NEES of estimates whose errors are drawn: right covariances give 1, too small ones more."""

import dataclasses
import json

from judge.evaluation.wandering import wander
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.frames import se3
from lunar_rover_sim.cli.main import execute
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory, wxyz
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import (consistency, evaluate, fixes,
                                                                    nees_interval)
from lunar_rover_sim.judge.evaluation.trajectory_files import (read_trajectory, write_tum,
                                                               write_tum_covariance)

STEP_M, STEP_RAD = 0.01, 0.002      # of the random walk, per root of a pose
DRIVES = 200


def walked(truth: Trajectory, seed: int, told: float = 1.0) -> Trajectory:
    """Return the truth with errors that walk at random, and `told` times their deviations."""
    rng = np.random.default_rng(seed)
    n = len(truth)
    steps = np.array([STEP_M] * 3 + [STEP_RAD] * 3) * rng.standard_normal((n, 6))
    steps[0] = 0.0
    errors = np.cumsum(steps, axis=0)
    variance = told**2 * np.array([STEP_M**2] * 3 + [STEP_RAD**2] * 3)
    return Trajectory(truth.stamps_ns, truth.positions_m + errors[:, :3],
                      wxyz(Rotation.from_rotvec(errors[:, 3:]) * truth.rotations), 'estimate',
                      np.arange(n)[:, None, None] * np.diag(variance))


@pytest.mark.parametrize('told, nees', [(1.0, 1.0), (0.5, 4.0)])
def test_nees_is_what_the_covariances_deserve(told, nees):
    """Over many drives their mean lies where chi^2 says, and 4 with deviations of a half."""
    truth = wander(40, 3)
    found = [evaluate(truth, walked(truth, seed, told)).consistency for seed in range(DRIVES)]
    low, high = nees_interval(3, DRIVES)
    assert low == pytest.approx(chi2.ppf(0.025, 600) / 600) and 0.85 < low < 1.0 < high < 1.15
    for of in ('position', 'orientation'):
        mean = np.mean([getattr(one, of).per_dof for one in found])
        assert low <= mean / nees <= high, of
        inside = np.mean([getattr(one, of).share_inside for one in found])
        assert (inside > 0.93) == (told == 1.0), of
    assert found[0].frame == 'pose' and found[0].position.poses == 39


def test_an_estimate_of_one_pose_that_chooses_its_frame_is_not_judged():
    """It tells deviations of a micrometre, and rounding may be as large."""
    truth = wander(40, 3)
    estimate = walked(truth, 1).select([0])
    covariances = estimate.covariances + 1e-13 * np.eye(6)
    found = consistency(truth.select([0]), dataclasses.replace(estimate, covariances=covariances))
    assert found.frame == 'pose' and found.position.poses == found.orientation.poses == 0
    assert np.isnan(found.position.per_dof)


def test_an_alignment_changes_nothing_and_another_frame_of_the_rover_little():
    """The covariance follows the arm to a camera: there the same errors have the same NEES."""
    truth = wander(40, 4)
    estimate = walked(truth, 1)
    ways = [evaluate(truth, estimate, align=mode).consistency
            for mode in ('se3', 'yaw', 'origin', 'none')]
    assert all(way == ways[0] for way in ways)
    arm = se3(Rotation.from_euler('xyz', [0.3, -0.2, 0.9]).as_matrix(), [0.4, -0.3, 0.2])
    there = consistency(truth.of_frame(arm), estimate.of_frame(arm))
    assert there.orientation.per_dof == pytest.approx(ways[0].orientation.per_dof, rel=1e-6)
    back = estimate.of_frame(arm).of_frame(np.linalg.inv(arm))
    np.testing.assert_allclose(back.covariances, estimate.covariances, atol=1e-12)
    # Drawn: errors of the camera, most of them by the arm, spread as its covariance tells.
    n, one = 4000, truth.select([20])
    P = np.diag([1e-4] * 3 + [4e-4, 2e-4, 9e-4])
    errors = np.random.default_rng(5).multivariate_normal(np.zeros(6), P, n)
    moved = Trajectory(np.arange(n), one.positions_m + errors[:, :3],
                       wxyz(Rotation.from_rotvec(errors[:, 3:]) * one.rotations)).of_frame(arm)
    told = dataclasses.replace(one, covariances=P[None]).of_frame(arm).covariances[0, :3, :3]
    spread = np.cov((moved.positions_m - one.of_frame(arm).positions_m).T)
    np.testing.assert_allclose(spread, told, atol=0.05 * np.trace(told))
    assert np.abs(told - np.diag(np.diagonal(told))).max() > 0.15 * np.trace(told)


@pytest.mark.parametrize('first, frame', [
    ((0.0,) * 6, 'pose'), ((0.0, 0.0, 0.0, 1e-4, 1e-4, 0.0), 'position and yaw'),
    ((0.0, 0.0, 0.0, 1e-4, 1e-4, 1e-4), 'position'), ((1e-2,) * 3 + (1e-4,) * 3, 'nothing')])
def test_what_the_first_pose_tells_as_exact_is_the_choice_of_a_frame(first, frame):
    """A map elsewhere, turned about z, is no error where the first pose says so."""
    truth = wander(30, 6)
    turn = {'pose': [0.2, -0.1, 0.7], 'position and yaw': [0.0, 0.0, 0.7]}.get(frame, [0.0] * 3)
    shift = np.zeros(3) if frame == 'nothing' else np.array([3.0, -2.0, 1.0])
    R = Rotation.from_rotvec(turn).as_matrix()
    P = np.tile(np.diag(np.array(first) + 1e-9), (30, 1, 1))
    P[1:] += 1e-4 * np.eye(6)
    moved = truth.moved(R, shift)
    estimate = Trajectory(moved.stamps_ns, moved.positions_m, moved.orientations_wxyz, 'e', P)
    found = consistency(truth, estimate)
    assert found.frame == frame
    assert found.position.per_dof == pytest.approx(0.0, abs=1e-9)
    assert found.orientation.per_dof == pytest.approx(0.0, abs=1e-9)
    wrong = truth.moved(Rotation.from_rotvec([0.0, 0.1, 0.0]).as_matrix(), [50.0, 0.0, 0.0])
    wrong = Trajectory(wrong.stamps_ns, wrong.positions_m, wrong.orientations_wxyz, 'e', P)
    assert consistency(truth, wrong).orientation.per_dof > (1.0 if frame != 'pose' else -1.0)


def test_a_fix_is_where_the_place_becomes_known_and_false_where_it_is_not_there():
    truth = wander(60, 7)
    sigma = np.full(60, 20.0)
    sigma[20:30], sigma[40:] = 0.5, 0.5
    P = np.einsum('n,ij->nij', sigma**2, np.eye(6))
    positions = truth.positions_m + [0.3, 0.0, 0.0]
    positions[40:] += [0.0, 10.0, 0.0]
    estimate = Trajectory(truth.stamps_ns, positions, truth.orientations_wxyz, 'e', P)
    found = evaluate(truth, estimate, align='none').fixes
    assert (found.count, found.false) == (2, 1)
    assert found.first_s == pytest.approx(20 * 0.05)
    assert found.first_m == pytest.approx(truth.distances_m[20])
    assert evaluate(truth, estimate, align='origin').fixes is None
    assert fixes(truth, walked(truth, 1)) is None
    never = Trajectory(truth.stamps_ns, positions, truth.orientations_wxyz, 'e',
                       np.tile(400.0 * np.eye(6), (60, 1, 1)))
    assert fixes(truth, never).count == 0 and np.isnan(fixes(truth, never).first_s)


def test_files_keep_covariances_and_tum_stays_as_it_is(tmp_path, capsys):
    truth, told = wander(40, 8), tmp_path / 'told.txt'
    estimate = walked(truth, 3)
    write_tum_covariance(told, estimate)
    again = read_trajectory(told)
    np.testing.assert_array_equal(again.covariances, estimate.covariances)
    np.testing.assert_array_equal(again.positions_m, estimate.positions_m)
    write_tum(tmp_path / 'plain.txt', estimate)
    assert {len(line.split()) for line in (tmp_path / 'plain.txt').read_text().splitlines()} == {8}
    write_tum(tmp_path / 'truth.txt', truth)
    with pytest.raises(EvaluationError, match='has no covariances'):
        write_tum_covariance(told, truth)

    assert execute(['evaluate', str(tmp_path / 'truth.txt'), str(told)]) == 0
    said = capsys.readouterr().out
    assert 'NEES per degree of freedom, position: ' in said and '1 m' in said
    assert execute(['evaluate', str(tmp_path / 'truth.txt'), str(told), '--json']) == 0
    values = json.loads(capsys.readouterr().out)
    assert values['consistency']['position']['per_dof'] > 0.0 and values['fixes'] is None
    assert [row['distance_m'] for row in values['over_distance']] == [1.0, 2.0]

    told.write_text(told.read_text().replace(' 0.0 ', ' nan ', 1))
    with pytest.raises(EvaluationError, match='line 1: nan is not valid'):
        execute(['evaluate', str(tmp_path / 'truth.txt'), str(told)])


@pytest.mark.filterwarnings('ignore:invalid value')
@pytest.mark.parametrize('change', [
    lambda P: np.where(np.arange(6) == 2, -1.0, 1.0) * np.eye(6), lambda P: P + np.eye(6, k=1),
    lambda P: P * np.inf])
def test_what_is_no_covariance_is_refused_by_its_pose(change):
    truth = wander(10, 9)
    P = np.tile(np.eye(6), (10, 1, 1))
    P[4] = change(P[4])
    with pytest.raises(EvaluationError, match='pose 4 is no cov'):
        Trajectory(truth.stamps_ns, truth.positions_m, truth.orientations_wxyz, 'e', P)
    with pytest.raises(EvaluationError, match=r'covariances \(9, 6, 6\)'):
        Trajectory(truth.stamps_ns, truth.positions_m, truth.orientations_wxyz, 'e', P[:9])
