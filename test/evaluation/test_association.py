"""Association held to its definition, written down pose by pose, at stamps that hit each bound."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.errors import EvaluationError
from lunar_rover_sim.evaluation.registration import associate
from lunar_rover_sim.evaluation.trajectory import Trajectory, wxyz


def poses(stamps_ns, seed):
    """Return poses at random places and attitudes."""
    rng = np.random.default_rng(seed)
    return Trajectory(stamps_ns, rng.normal(size=(len(stamps_ns), 3)),
                      wxyz(Rotation.random(len(stamps_ns), random_state=seed)), f'poses {seed}')


def by_definition(place, stamp, tolerance_ns):
    """Return the true (position, rotation) at a stamp, or None; place: those of the truth."""
    stamps = list(place)
    if stamp in place:
        return place[stamp]
    before = max((s for s in stamps if s < stamp), default=None)
    after = min((s for s in stamps if s > stamp), default=None)
    near = [s for s in (before, after) if s is not None and abs(s - stamp) <= tolerance_ns]
    if len(near) == 2:
        share = (stamp - before) / (after - before)
        (p, a), (q, b) = place[before], place[after]
        turn = (a.inv() * b).as_rotvec()
        return p + share * (q - p), a * Rotation.from_rotvec(share * turn)
    if near:
        return place[near[0]]
    return None


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('tolerance_ns', [0, 3, 5])
@pytest.mark.parametrize('start', [0, 1_400_000_000_000_000_000])
def test_each_pose_is_that_of_the_definition(seed, tolerance_ns, start):
    """Stamps of a few ns: many agree, many are just as far as the tolerance, some lie outside.

    They count from the start of a simulation, or from 1970, which doubles do not hold.
    """
    rng = np.random.default_rng(seed)
    truth = poses(start + np.sort(rng.choice(200, 50, replace=False)), seed)
    estimate = poses(start + np.sort(rng.choice(np.arange(-9, 210), 90, replace=False)), seed + 9)
    place = dict(zip(truth.stamps_ns.tolist(), zip(truth.positions_m, truth.rotations)))
    expected = [by_definition(place, s, tolerance_ns) for s in estimate.stamps_ns.tolist()]
    kept = [i for i, pose in enumerate(expected) if pose is not None]
    found = associate(truth, estimate, tolerance_ns * 1e-9)
    assert found.unmatched == 90 - len(kept) > 0 and found.truth.name == truth.name
    assert found.estimate.stamps_ns.tolist() == estimate.stamps_ns[kept].tolist()
    assert found.truth.stamps_ns.tolist() == estimate.stamps_ns[kept].tolist()
    np.testing.assert_array_equal(found.estimate.positions_m, estimate.positions_m[kept])
    for i, k in enumerate(kept):
        position, rotation = expected[k]
        np.testing.assert_allclose(found.truth.positions_m[i], position, atol=1e-12)
        assert (found.truth.rotations[i].inv() * rotation).magnitude() < 1e-6


def test_a_pose_outside_the_truth_takes_its_end():
    """1 ns before the first and after the last pose."""
    truth = poses(np.array([10, 20, 30]), 1)
    found = associate(truth, poses(np.array([9, 20, 31]), 2), 1e-9)
    np.testing.assert_array_equal(found.truth.positions_m, truth.positions_m)
    with pytest.raises(EvaluationError, match='1 of 3 poses lie within 0 s'):
        associate(truth, poses(np.array([9, 20, 31]), 2), 0.0)


@pytest.mark.parametrize('tolerance_s', [-1e-9, -0.5, float('nan')])
def test_a_tolerance_below_nothing_is_refused(tolerance_s):
    truth = poses(np.array([10, 20, 30]), 1)
    assert associate(truth, truth, 0.0).unmatched == 0
    with pytest.raises(EvaluationError, match='is not valid; valid is >= 0'):
        associate(truth, truth, tolerance_s)


def test_three_poses_are_enough_and_two_are_not():
    truth, three = poses(np.arange(10), 1), poses(np.array([2, 4, 9]), 2)
    assert len(associate(truth, three).estimate) == 3
    for pair in ((truth, three.select([0, 1])), (truth.select([3, 4]), three)):
        with pytest.raises(EvaluationError, match='holds 2 poses; at least 3'):
            associate(*pair)
    with pytest.raises(EvaluationError, match=r'2 of 3 poses .* \(estimate 0.000 to 5.000 s, '
                       r'truth 0.000 to 0.000 s\)'):
        associate(truth, poses(np.array([0, 5, 5 * 10**9]), 3), 0.0)
