"""Evaluation of trajectories: identities, agreement with evo, truth between its samples."""

from types import SimpleNamespace

from judge.evaluation.wandering import noisy, wander
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.frames import inverse, se3
from lunar_rover_sim.judge.evaluation import metrics
from lunar_rover_sim.judge.evaluation.registration import align, associate, MODES
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.rover.pose import RoverPose


@pytest.mark.parametrize('mode', MODES)
def test_a_moved_copy_has_no_error(mode):
    truth = wander(300, 1)
    turn = Rotation.from_rotvec([0.0, 0.0, 0.7] if mode == 'yaw' else [0.3, -0.2, 0.9])
    scale = 3.0 if mode == 'sim3' else 1.0
    copy = truth if mode == 'none' else truth.moved(turn.as_matrix(), [1.0, 2.0, 3.0], scale)
    result = evaluate(truth, copy, align=mode)
    assert result.ate_m.max < 1e-12
    assert result.ate_deg.max < 1e-5
    assert result.rpe_distance_m.max < 1e-12 and result.rpe_time_m.max < 1e-12
    assert result.scale == pytest.approx(1.0 / scale, abs=1e-12)
    assert result.tracked_share == 1.0
    assert result.end_drift_percent < 1e-9


def test_states_become_a_trajectory():
    states = [RoverPose(se3(Rotation.from_euler('Z', 0.1 * k).as_matrix(), [k, 0.0, 0.5]))
              for k in range(4)]
    found = Trajectory.of_states(
        SimpleNamespace(stamp_ns=5_000_000 * k, position_m=state.T_world_base[:3, 3],
                        orientation_wxyz=[np.cos(0.05 * k), 0.0, 0.0, np.sin(0.05 * k)])
        for k, state in enumerate(states))
    assert found.stamps_ns.tolist() == [0, 5_000_000, 10_000_000, 15_000_000]
    np.testing.assert_allclose(found.positions_m[:, 0], range(4))
    np.testing.assert_allclose(found.rotations.as_matrix(),
                               [state.T_world_base[:3, :3] for state in states], atol=1e-12)
    assert len(Trajectory.of_states([])) == 0


def test_alignment_is_the_least_squares_one():
    """No small change of the alignment makes the error smaller."""
    truth = wander(200, 2)
    pair = associate(truth, noisy(truth, 3, scale=2.0))
    for mode in ('se3', 'sim3', 'yaw'):
        best = align(pair.estimate, pair.truth, mode)

        def cost(rotation: np.ndarray, translation: np.ndarray, scale: float) -> float:
            moved = pair.estimate.moved(rotation, translation, scale)
            return float(np.sum((moved.positions_m - pair.truth.positions_m)**2))

        least = cost(best.rotation, best.translation_m, best.scale)
        for axis in range(3):
            step = 1e-3 * np.eye(3)[axis]
            for sign in (1.0, -1.0):
                assert cost(best.rotation, best.translation_m + sign * step, best.scale) > least
                if mode != 'yaw' or axis == 2:
                    turned = Rotation.from_rotvec(sign * step).as_matrix() @ best.rotation
                    centre = pair.truth.positions_m.mean(axis=0)
                    shift = centre - best.scale * turned @ pair.estimate.positions_m.mean(axis=0)
                    assert cost(turned, shift, best.scale) > least


@pytest.mark.parametrize('seed', range(2))
@pytest.mark.parametrize('scale', [1.0, 7.3])
def test_equal_to_evo(seed, scale):
    """ATE, scale and RPE agree with evo to 1e-9, with noise, gaps and another scale."""
    evo_metrics = pytest.importorskip('evo.core.metrics')
    evo_trajectory = pytest.importorskip('evo.core.trajectory')
    evo_sync = pytest.importorskip('evo.core.sync')
    truth = wander(400, seed)
    estimate = noisy(truth, seed + 10, scale)

    def as_evo(t: Trajectory) -> object:
        return evo_trajectory.PoseTrajectory3D(t.positions_m, t.orientations_wxyz,
                                               t.stamps_ns * 1e-9)

    for mode in ('se3', 'sim3', 'origin'):
        reference, other = evo_sync.associate_trajectories(
            as_evo(truth), as_evo(estimate), max_diff=0.01)
        if mode == 'origin':
            other.align_origin(reference)
            found_scale = None
        else:
            _, _, found_scale = other.align(reference, correct_scale=mode == 'sim3')
        result = evaluate(truth, estimate, align=mode)
        if mode == 'sim3':
            assert result.scale == pytest.approx(found_scale, abs=1e-9)
        for relation, mine in ((evo_metrics.PoseRelation.translation_part, result.ate_m),
                               (evo_metrics.PoseRelation.rotation_angle_deg, result.ate_deg)):
            ape = evo_metrics.APE(relation)
            ape.process_data((reference, other))
            _agree(mine, ape.get_all_statistics(), 1e-9)
        for relation, mine in (
                (evo_metrics.PoseRelation.translation_part, result.rpe_distance_m),
                (evo_metrics.PoseRelation.rotation_angle_deg, result.rpe_distance_deg)):
            rpe = evo_metrics.RPE(relation, delta=1.0, delta_unit=evo_metrics.Unit.meters,
                                  rel_delta_tol=metrics.PAIR_TOLERANCE, all_pairs=True,
                                  pairs_from_reference=True)
            rpe.process_data((reference, other))
            _agree(mine, rpe.get_all_statistics(), 1e-9)


def test_relative_errors_over_time_are_evos_over_frames():
    evo_metrics = pytest.importorskip('evo.core.metrics')
    evo_trajectory = pytest.importorskip('evo.core.trajectory')
    truth = wander(300, 5)
    rng = np.random.default_rng(5)
    estimate = Trajectory(truth.stamps_ns,
                          truth.positions_m + 0.01 * rng.standard_normal((300, 3)),
                          truth.orientations_wxyz, 'estimate')
    result = evaluate(truth, estimate, align='none')
    pair = tuple(evo_trajectory.PoseTrajectory3D(t.positions_m, t.orientations_wxyz,
                                                 t.stamps_ns * 1e-9) for t in (truth, estimate))
    rpe = evo_metrics.RPE(evo_metrics.PoseRelation.translation_part, delta=20,
                          delta_unit=evo_metrics.Unit.frames, all_pairs=True)
    rpe.process_data(pair)
    _agree(result.rpe_time_m, rpe.get_all_statistics(), 1e-9)


def _agree(mine: metrics.Statistics, theirs: dict[str, float], bound: float) -> None:
    for name in ('rmse', 'mean', 'median', 'std', 'min', 'max'):
        assert getattr(mine, name) == pytest.approx(theirs[name], abs=bound), name


def test_the_moving_frame_is_taken_into_account():
    truth = wander(200, 7)
    T_base_camera = se3(Rotation.from_rotvec([0.4, 0.1, -0.2]).as_matrix(), [0.1, 0.05, 0.2])
    camera = truth.of_frame(T_base_camera)
    assert evaluate(truth, camera).ate_m.rmse > 1e-3
    assert evaluate(truth, camera).turned_deg == pytest.approx(26.0, abs=2.0)
    result = evaluate(truth.of_frame(T_base_camera), camera)
    assert result.turned_deg is None
    assert result.ate_m.max < 1e-12
    back = camera.of_frame(inverse(T_base_camera))
    assert np.allclose(back.positions_m, truth.positions_m, atol=1e-12)
    assert np.allclose(np.abs(np.sum(back.orientations_wxyz * truth.orientations_wxyz, axis=1)),
                       1.0)
