"""Statistics and pairs by their definitions, written down without any cleverness."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.evaluation import metrics
from lunar_rover_sim.evaluation.trajectory import Trajectory, wxyz


def along_x(positions_x, stamps_s=None):
    """Return a trajectory on the x axis without turning."""
    x = np.asarray(positions_x, float)
    stamps = np.arange(len(x)) if stamps_s is None else np.asarray(stamps_s)
    return Trajectory(np.round(stamps * 1e9).astype(np.int64), np.stack([x, 0 * x, 0 * x], axis=1),
                      np.tile([1.0, 0.0, 0.0, 0.0], (len(x), 1)), 'path')


def pairs_by_definition(progress, delta, slack):
    """For every pose the later one whose progress is nearest to its own plus delta."""
    found = []
    for i in range(len(progress)):
        later = range(i + 1, len(progress))
        if not later:
            continue
        j = min(later, key=lambda j: (abs(progress[j] - progress[i] - delta), j))
        if abs(progress[j] - progress[i] - delta) <= slack:
            found.append([i, j])
    return found


@pytest.mark.parametrize('distance_m', [0.3, 1.0, 2.7])
@pytest.mark.parametrize('seed', range(5))
def test_pairs_by_distance_are_those_of_the_definition(seed, distance_m):
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.exponential(0.1, 120))
    truth = along_x(x)
    expected = pairs_by_definition(x - x[0], distance_m, metrics.PAIR_TOLERANCE * distance_m)
    assert len(expected) > 30
    assert metrics.pairs_by_distance(truth, distance_m).tolist() == expected


@pytest.mark.parametrize('time_s', [0.25, 1.0, 3.3])
@pytest.mark.parametrize('seed', range(5))
def test_pairs_by_time_are_those_of_the_definition(seed, time_s):
    rng = np.random.default_rng(seed)
    stamps = np.round(np.cumsum(rng.uniform(0.02, 0.18, 100)), 6)
    slack = 0.5 * np.median(np.diff(stamps))
    expected = pairs_by_definition(stamps, time_s, slack)
    assert len(expected) > 30
    assert metrics.pairs_by_time(along_x(0 * stamps, stamps), time_s).tolist() == expected


def test_the_last_pose_ends_a_pair():
    truth = along_x([0.0, 1.0, 2.0, 3.0, 4.0])
    assert metrics.pairs_by_distance(truth, 2.0).tolist() == [[0, 2], [1, 3], [2, 4]]
    assert metrics.pairs_by_distance(truth, 4.0).tolist() == [[0, 4]]
    assert metrics.pairs_by_distance(truth, 5.0).tolist() == []
    assert metrics.pairs_by_time(truth, 3.0).tolist() == [[0, 3], [1, 4]]


def test_of_two_equally_near_poses_the_earlier_ends_the_pair():
    # 0.9375 and 1.0625 are equally far from 1, exactly so in doubles.
    truth = along_x([0.0, 0.9375, 1.0625])
    assert metrics.pairs_by_distance(truth, 1.0).tolist() == [[0, 1]]


def test_the_tolerance_itself_is_still_within():
    assert metrics.pairs_by_distance(along_x([0.0, 1.25]), 1.0, 0.25).tolist() == [[0, 1]]
    assert metrics.pairs_by_distance(along_x([0.0, 0.75]), 1.0, 0.25).tolist() == [[0, 1]]
    assert metrics.pairs_by_distance(along_x([0.0, 1.26]), 1.0, 0.25).tolist() == []


def test_statistics_of_three_and_four():
    """3, 4 and 8: mean 5, median 4, squares sum to 89, variance (4 + 1 + 9) / 3."""
    found = metrics.Statistics.of(np.array([3.0, 8.0, 4.0]))
    assert (found.mean, found.median, found.min, found.max, found.count) == (5.0, 4.0, 3.0, 8.0, 3)
    assert found.rmse == pytest.approx(np.sqrt(89.0 / 3.0))
    assert found.std == pytest.approx(np.sqrt(14.0 / 3.0))
    nothing = metrics.Statistics.of(np.zeros(0))
    assert nothing.count == 0 and np.isnan([nothing.rmse, nothing.mean, nothing.std]).all()


def test_relative_errors_are_seen_from_the_pose_at_the_start():
    """Truth turns left by 90 deg and goes on; the estimate does the same but 0.1 m too far left.

    Seen from the first pose, facing +y, the motion is 1 m ahead for truth.
    """
    facing_y = Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
    stamps = np.array([0, 10**9])

    def drive(end, turned):
        return Trajectory(stamps, np.array([[0.0, 0.0, 0.0], end]),
                          wxyz(Rotation.concatenate([facing_y, turned * facing_y])), 'drive')

    truth = drive([0.0, 1.0, 0.0], Rotation.identity())
    estimate = drive([-0.1, 1.0, 0.0], Rotation.from_rotvec([0.0, 0.0, 0.2]))
    shift, turn = metrics.relative_errors(truth, estimate, np.array([[0, 1]]))
    assert shift == pytest.approx([0.1]) and turn == pytest.approx([0.2])
    # Another frame of the whole estimate, the heading at the start included, changes nothing.
    moved = estimate.moved(Rotation.from_rotvec([0.0, 0.0, 1.0]).as_matrix(), [5.0, 6.0, 7.0])
    shift, turn = metrics.relative_errors(truth, moved, np.array([[0, 1]]))
    assert shift == pytest.approx([0.1]) and turn == pytest.approx([0.2])
    assert [len(x) for x in metrics.relative_errors(truth, truth, np.zeros((0, 2), int))] == [0, 0]
