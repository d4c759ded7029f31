"""Statistics, pairs and drift by their definitions, and by hand."""

import numpy as np
import pytest

from lunar_rover_sim.judge.evaluation.trajectory import Trajectory
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.judge.evaluation.trajectory_files import read_tum


def path(points, period_s=0.1):
    points = np.asarray(points, float)
    stamps = np.round(np.arange(len(points)) * period_s * 1e9).astype(np.int64)
    return Trajectory(stamps, points, np.tile([1.0, 0.0, 0.0, 0.0], (len(points), 1)), 'path')


def bent(n=201):
    """Return 10 m of path in steps of 5 cm, in the plane, bent in the middle by 90 deg."""
    steps = np.where(np.arange(n - 1)[:, None] < (n - 1) // 2, [[0.05, 0.0, 0.0]],
                     [[0.0, 0.05, 0.0]])
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


@pytest.mark.parametrize('distance_m', [0.5, 1.0, 2.0])
@pytest.mark.parametrize('error', [0.02, -0.05])
def test_a_wrong_scale_is_that_drift_over_any_straight_distance(distance_m, error):
    truth = path(np.linspace([0.0, 0.0, 0.0], [10.0, 0.0, 0.0], 201))
    result = evaluate(truth, path((1.0 + error) * truth.positions_m),
                      align='none', distance_m=distance_m)
    assert result.drift_percent == pytest.approx(100.0 * abs(error), rel=1e-9)
    assert result.rpe_distance_m.mean == pytest.approx(distance_m * abs(error), rel=0.01)
    assert result.end_drift_percent == pytest.approx(100.0 * abs(error), rel=1e-9)
    assert result.length_m == pytest.approx(10.0)


def test_the_end_drift_is_the_gap_at_the_end_over_the_whole_path():
    """10 m of path; the estimate ends 0.3 m too far east, and starts somewhere else."""
    truth = path(bent())
    late = truth.positions_m.copy()
    late[150:] += [0.3, 0.0, 0.0]
    result = evaluate(truth, path(late + [5.0, -2.0, 1.0]), align='none')
    assert result.end_drift_percent == pytest.approx(3.0)
    assert result.ate_m.min == pytest.approx(np.sqrt(30.0))


@pytest.mark.parametrize('angle_deg,scatter,told', [
    (5.1, 0.0, True), (4.9, 0.0, False), (20.0, 0.19, True), (20.0, 0.21, False)])
def test_a_turn_that_all_orientations_share_is_told(angle_deg, scatter, told):
    """More than 5 deg, and alike to a fifth."""
    truth = path(bent())
    angles = np.radians(angle_deg * (1.0 + scatter * np.resize([-1.0, 1.0], len(truth))))
    half = np.stack([np.cos(angles / 2), np.sin(angles / 2), 0 * angles, 0 * angles], axis=1)
    estimate = Trajectory(truth.stamps_ns, truth.positions_m, half, 'turned')
    pairs = np.arange(len(truth) // 2 * 2)
    result = evaluate(truth.select(pairs), estimate.select(pairs), align='none')
    assert (result.turned_deg is not None) == told
    if told:
        assert result.turned_deg == pytest.approx(angle_deg)


def test_a_map_that_is_moved_is_a_jump():
    """More than 0.1 m in a step; steps that are as wrong throughout are none."""
    truth = path(bent())
    shift = np.zeros((len(truth), 3))
    shift[60:] += [0.0, 0.09, 0.0]
    shift[120:] += [0.0, 0.0, -0.2]
    shift[150:] += [0.15, 0.0, 0.0]

    def estimated(positions_m):
        estimate = Trajectory(truth.stamps_ns, positions_m, truth.orientations_wxyz, 'moved')
        return evaluate(truth, estimate, align='none')

    result = estimated(truth.positions_m + shift)
    assert result.jumps == [pytest.approx((1e-9 * truth.stamps_ns[120], 0.2)),
                            pytest.approx((1e-9 * truth.stamps_ns[150], 0.15))]
    assert estimated(truth.positions_m).jumps == []
    wrong = truth.positions_m + 0.2 * np.resize([0.0, 1.0], len(truth))[:, None]
    assert estimated(wrong).jumps == []
    shift[150:] += [20.0, 0.0, 0.0]         # 20 times those steps, of 0.35 m, is 6.9 m
    assert [stamp for stamp, _ in estimated(wrong + shift).jumps] \
        == [pytest.approx(1e-9 * truth.stamps_ns[150])]


def test_the_share_tracked_counts_images_with_a_pose_near_them():
    """Within the tolerance, and within half of the time between images."""
    truth = path(bent())
    images = truth.stamps_ns[::10]                      # 1 s apart
    estimate = truth.select(np.arange(3, 201, 20))      # 0.3 s after every second image

    def share(stamps, **options):
        return evaluate(truth, estimate, align='none', frame_stamps_ns=stamps,
                        **options).tracked_share

    assert share(images, tolerance_s=0.3) == pytest.approx(10.0 / 21.0)
    assert share(images, tolerance_s=0.299999999) == 0.0
    assert share(images[::2], tolerance_s=5.0) == pytest.approx(10.0 / 11.0)
    assert share(images, tolerance_s=5.0) == pytest.approx(10.0 / 21.0)     # 0.5 s at most
    assert share(images[:1], tolerance_s=5.0) == 1.0
    # Without images the truth counts, at the estimate's own rate; never more than all.
    assert share(np.zeros(0, np.int64)) == pytest.approx(10.0 / 11.0)
    every = truth.select(np.arange(201))
    assert evaluate(truth, every, align='none').tracked_share == 1.0
    doubled = evaluate(truth.select(np.arange(0, 201, 2)), every, align='none', tolerance_s=0.05)
    assert doubled.tracked_share <= 1.0


def test_a_rover_that_stands_has_no_drift_in_percent():
    truth = path(np.zeros((20, 3)))
    result = evaluate(truth, truth, align='none')
    assert np.isnan([result.drift_percent, result.end_drift_percent, result.scale]).all()
    assert result.ate_m.max == 0.0


@pytest.mark.parametrize('word,ns', [
    ('12.5', 12_500_000_000), ('0.000000001', 1), ('.25', 250_000_000), ('7', 7_000_000_000),
    ('1.0000000019', 1_000_000_001), ('+3.5', 3_500_000_000), ('1e1', 10_000_000_000),
    ('1403636579.763555584', 1_403_636_579_763_555_584)])
def test_stamps_in_seconds_are_read_exactly(tmp_path, word, ns):
    """Digits are counted, not rounded by a double; other notations are read as numbers."""
    (tmp_path / 'tum.txt').write_text(f'{word} 0 0 0 0 0 0 1\n')
    assert read_tum(tmp_path / 'tum.txt').stamps_ns.tolist() == [ns]
