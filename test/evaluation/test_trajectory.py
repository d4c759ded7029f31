"""Evaluation of trajectories: identities, agreement with evo, files, bad input."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
import synthetic_bag as synthetic

from lunar_rover_sim.cli.main import parse
from lunar_rover_sim.errors import ConfigError, EvaluationError
from lunar_rover_sim.evaluation import metrics, trajectory_files
from lunar_rover_sim.evaluation import trajectory_sources as sources
from lunar_rover_sim.evaluation.registration import align, associate, MODES
from lunar_rover_sim.evaluation.trajectory import Trajectory, wxyz
from lunar_rover_sim.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.frames import inverse, se3
from lunar_rover_sim.inspection.summary import summarise
from lunar_rover_sim.rover.pose import RoverPose


def wander(n: int, seed: int, period_ns: int = 50_000_000) -> Trajectory:
    """Return a smooth random walk of 5 cm steps with turning attitude."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(0.1 * rng.standard_normal(n))
    climb = 0.2 * np.sin(np.linspace(0.0, 9.0, n))
    steps = 0.05 * np.stack([np.cos(heading), np.sin(heading), climb], axis=1)
    rotations = Rotation.from_euler('ZYX', np.stack(
        [heading, climb, 0.1 * rng.standard_normal(n)], axis=1))
    return Trajectory(period_ns * np.arange(1, n + 1), np.cumsum(steps, axis=0),
                      wxyz(rotations), 'truth')


def noisy(truth: Trajectory, seed: int, scale: float = 1.0) -> Trajectory:
    """Return the truth with noise, gaps, another scale and another frame."""
    rng = np.random.default_rng(seed)
    n = len(truth)
    positions = (truth.positions_m + 0.01 * rng.standard_normal((n, 3))) / scale
    rotations = truth.rotations * Rotation.from_rotvec(0.01 * rng.standard_normal((n, 3)))
    keep = np.ones(n, dtype=bool)
    keep[n // 3:n // 3 + n // 20] = False
    keep[rng.choice(n, n // 10, replace=False)] = False
    moved = Trajectory(truth.stamps_ns, positions, wxyz(rotations), 'estimate').moved(
        Rotation.random(random_state=seed).as_matrix(), rng.standard_normal(3))
    return moved.select(keep)


@pytest.fixture(scope='module')
def bag(tmp_path_factory) -> Path:
    """Return a drive of 1.5 s; it is only read."""
    return synthetic.write(tmp_path_factory.mktemp('bags') / 'bag',
                           synthetic.drive(1.5, only=synthetic.FOR_ESTIMATORS))


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


def test_truth_is_interpolated():
    """A pose between two true ones on a straight line at constant turning has no error."""
    stamps = np.arange(1, 101) * 100_000_000
    t = stamps * 1e-9
    truth = Trajectory(stamps, np.stack([0.1 * t, 0.02 * t, 0 * t], axis=1),
                       wxyz(Rotation.from_rotvec(np.stack([0 * t, 0 * t, 0.2 * t], axis=1))))
    between = stamps[:-1] + 30_000_000
    s = between * 1e-9
    estimate = Trajectory(between, np.stack([0.1 * s, 0.02 * s, 0 * s], axis=1),
                          wxyz(Rotation.from_rotvec(np.stack([0 * s, 0 * s, 0.2 * s], axis=1))))
    result = evaluate(truth, estimate, align='none', tolerance_s=0.1)
    assert result.ate_m.max < 1e-12
    assert result.ate_deg.max < 1e-6
    with pytest.raises(EvaluationError, match='0 of 99 poses'):
        associate(truth, estimate, 0.01)


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


def test_tracked_share_counts_images():
    truth = wander(400, 8, period_ns=5_000_000)
    images = truth.stamps_ns[19::20]
    estimate = truth.select(np.arange(19, 400, 20)[:12])
    assert evaluate(truth, estimate, frame_stamps_ns=images).tracked_share == 0.6
    assert evaluate(truth, estimate).tracked_share == pytest.approx(0.6, abs=0.03)


def test_files_keep_what_is_written(tmp_path):
    truth = wander(50, 9, period_ns=33_333_333)
    trajectory_files.write_tum(tmp_path / 'a.txt', truth)
    trajectory_files.write_euroc(tmp_path / 'data.csv', truth)
    trajectory_files.write_kitti(tmp_path / 'k.txt', truth, tmp_path / 'times.txt')
    for path, times in (('a.txt', None), ('data.csv', None), ('k.txt', tmp_path / 'times.txt')):
        read = trajectory_files.read_trajectory(tmp_path / path, times)
        assert np.array_equal(read.stamps_ns, truth.stamps_ns)
        assert np.allclose(read.positions_m, truth.positions_m, rtol=0, atol=1e-15)
        dots = np.sum(read.orientations_wxyz * truth.orientations_wxyz, axis=1)
        assert np.allclose(np.abs(dots), 1.0, atol=1e-14)
    assert np.array_equal(trajectory_files.read_kitti(tmp_path / 'k.txt').stamps_ns,
                          np.arange(50) * 100_000_000)


def test_stamps_of_orb_slam3_are_ns(tmp_path):
    (tmp_path / 'f.txt').write_text('1403636579763555584.000000 1 2 3 0 0 0 1\n'
                                    '1403636579813555456.000000 1 2 4 0 0 0 1\n')
    read = trajectory_files.read_tum(tmp_path / 'f.txt')
    assert read.stamps_ns.tolist() == [1403636579763555584, 1403636579813555456]


BAD_FILES = {
    'empty.txt': ('# nothing\n', 'holds no poses'),
    'nan.txt': ('0.1 0 0 nan 0 0 0 1\n', 'line 1: nan is not valid; valid is finite'),
    'far.txt': ('0.1 0 0 1e300 0 0 0 1\n', 'line 1: 1e300 is not valid; valid is .* 1e[+]12'),
    'digits.txt': ('0.1 0 0 1_0 0 0 0 1\n', "line 1: '1_0' is not a number"),
    'other_digits.txt': ('0.1 0 0 \u0661 0 0 0 1\n', "line 1: '\u0661' is not a number"),
    'digits_of_time.txt': ('1_0 0 0 1 0 0 0 1\n', 'a stamp is not a finite number'),
    'inf_stamp.txt': ('inf 0 0 0 0 0 0 1\n', 'a stamp is not a finite number'),
    'late_stamp.txt': (f'{10**30} 0 0 0 0 0 0 1\n', 'stamp .* ns is not valid; valid are 64 bits'),
    'words.txt': ('0.1 0 0 0 0 0 0 1\n0.2 a 0 0 0 0 0 1\n', "line 2: 'a' is not a number"),
    'short.txt': ('0.1 0 0 0 0 0 0 1\n0.2 0 0\n', 'line 2 has 3 columns'),
    'columns.txt': ('1 2 3 4\n', 'line 1 has 4 columns'),
    'unsorted.txt': ('0.2 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0 1\n', 'line 2: stamp'),
    'zero.txt': ('0.1 0 0 0 0 0 0 0\n', 'quaternion of length 0'),
    'skew.txt': ('1 0 0 0 0 2 0 0 0 0 1 0\n', 'line 1: the first three columns'),
}


@pytest.mark.parametrize('name', BAD_FILES)
def test_bad_files_are_named(tmp_path, name):
    text, words = BAD_FILES[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(EvaluationError, match=words) as error:
        sources.load(tmp_path / name)
    assert name in str(error.value) and '\n' not in str(error.value)


def test_more_bad_input(tmp_path):
    (tmp_path / 'binary.txt').write_bytes(b'\xff\xfe\x00')
    with pytest.raises(EvaluationError, match='not a text file'):
        sources.load(tmp_path / 'binary.txt')
    with pytest.raises(EvaluationError, match='no such file'):
        sources.load(tmp_path / 'missing.txt')
    truth = wander(100, 11)
    late = Trajectory(truth.stamps_ns + 10**12, truth.positions_m, truth.orientations_wxyz, 'e')
    with pytest.raises(EvaluationError, match='e: 0 of 100 poses lie within 0.02 s of truth'):
        evaluate(truth, late)
    with pytest.raises(EvaluationError, match='holds 2 poses; at least 3'):
        evaluate(truth, truth.select([0, 1]))
    line = Trajectory(truth.stamps_ns, np.outer(np.arange(100.0), [0.3, 0.1, 0.2]),
                      truth.orientations_wxyz, 'line.txt')
    for mode in ('se3', 'sim3'):
        with pytest.raises(EvaluationError, match='line.txt: the estimate moves on a straight'):
            evaluate(truth, line, align=mode)
    assert evaluate(line, line, align='yaw').ate_m.max < 1e-12
    still = Trajectory(truth.stamps_ns, np.zeros((100, 3)), truth.orientations_wxyz, 'still')
    with pytest.raises(EvaluationError, match='does not move'):
        evaluate(truth, still)
    with pytest.raises(EvaluationError, match='no horizontal motion'):
        evaluate(truth, still, align='yaw')
    with pytest.raises(EvaluationError, match='did you mean sim3'):
        evaluate(truth, truth, align='sim')
    for stamps, pose in (([2, 1], 1), ([1, 2, 2], 2)):
        n = len(stamps)
        with pytest.raises(EvaluationError, match=f'stamps do not increase: pose {pose}'):
            Trajectory(stamps, np.zeros((n, 3)), np.tile([1.0, 0, 0, 0], (n, 1)))


@pytest.mark.parametrize('stamps', [np.array([1.0, 2.5]), np.array([True, False]), ['1', '2']])
def test_stamps_are_whole_nanoseconds(stamps):
    """Seconds would be cut to whole ns; without poses there is no type to refuse."""
    with pytest.raises(EvaluationError, match='^mine: stamps_ns: .* is not valid; valid are whole '
                       'nanoseconds$'):
        Trajectory(stamps, np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), 'mine')
    assert len(Trajectory([], np.zeros((0, 3)), np.zeros((0, 4)))) == 0
    assert Trajectory(np.array([1, 2], np.uint32), np.zeros((2, 3)),
                      np.tile([1.0, 0, 0, 0], (2, 1))).stamps_ns.dtype == np.int64


def test_the_command_judges_a_bag(bag, tmp_path, capsys):
    """A camera trajectory in its own frame has no error against the bag it was made from."""
    truth = sources.load(bag)
    T_base_left = sources.frame_on_rover(bag, 'left')
    assert np.allclose(T_base_left, synthetic.T_base_camera(+1.0))
    stamps = sources.image_stamps_ns(bag)
    keep = np.isin(truth.stamps_ns, stamps[:-3])
    camera = truth.of_frame(T_base_left)
    start = se3(camera.rotations[0].as_matrix(), camera.positions_m[0])
    camera = camera.moved(inverse(start)[:3, :3], inverse(start)[:3, 3]).select(keep)
    trajectory_files.write_tum(tmp_path / 'CameraTrajectory.txt', camera)
    output = tmp_path / 'out'
    args = parse(['evaluate', str(bag), str(tmp_path / 'CameraTrajectory.txt'),
                  '--estimate-frame', 'left', '-o', str(output)])
    assert args.run(args) == 0
    result = json.loads((output / 'evaluation.json').read_text())
    assert result['ate_m']['max'] < 1e-9
    assert result['tracked_share'] == pytest.approx(12 / 15)
    assert {p.name for p in Path(output).iterdir()} == {'evaluation.json', 'top_view.png',
                                                        'error.png', 'scale.png'}
    assert 'tracked 80.0 %' in capsys.readouterr().out


def test_files_bags_and_trajectories_are_judged_alike(bag, tmp_path):
    """A path, its text and what was loaded from it give the same result, in frozen form."""
    truth = sources.load(bag)
    estimate = truth.of_frame(sources.frame_on_rover(bag, 'left')).select(np.arange(0, 200, 7))
    file = tmp_path / 'estimate.txt'
    trajectory_files.write_tum(file, estimate)
    results = [evaluate(a, b, align='none', estimate_frame='left', distance_m=0.05)
               for a, b in ((bag, file), (str(bag), str(file)), (f'{bag}:odom', estimate))]
    for result in results:
        assert result.ate_m.max < 1e-12
        assert result.rpe_distance_m.count > 5 and result.rpe_distance_m.max < 1e-12
        assert result.length_m == truth.length_m
        assert result.tracked_share == results[0].tracked_share
        with pytest.raises(dataclasses.FrozenInstanceError):
            result.scale = 2.0
    assert evaluate(bag, file, align='none').ate_m.mean > 0.1


def test_two_files_are_judged_as_what_they_hold(tmp_path):
    truth = wander(200, 13)
    estimate = noisy(truth, 14)
    for name, trajectory in (('truth.txt', truth), ('estimate.txt', estimate)):
        trajectory_files.write_tum(tmp_path / name, trajectory)
    of_files = evaluate(tmp_path / 'truth.txt', tmp_path / 'estimate.txt', truth_frame='imu',
                        estimate_frame='left')
    expected = evaluate(truth, estimate, truth_frame='imu', estimate_frame='left')
    assert of_files.ate_m.rmse == pytest.approx(expected.ate_m.rmse, rel=1e-4)
    assert of_files.tracked_share == pytest.approx(expected.tracked_share)


def test_the_length_of_the_path_is_that_of_the_recording(bag):
    """Whatever was tracked, and by which sensor: that of the summary."""
    truth = sources.load(bag)
    driven = summarise(bag).distance_m
    assert driven == pytest.approx(synthetic.SPEED * 1.495, rel=1e-3)
    assert truth.length_m == driven
    first_half = truth.select(np.arange(len(truth) // 2))
    assert evaluate(bag, first_half).length_m == driven
    camera = truth.of_frame(sources.frame_on_rover(bag, 'left'))
    assert evaluate(bag, camera, estimate_frame='left').length_m == driven


@pytest.mark.parametrize(('options', 'error', 'words'), [
    ({'align': 'sim'}, EvaluationError, 'did you mean sim3'),
    ({'estimate_frame': 'lefd'}, ConfigError, 'did you mean left'),
    ({'distance_m': 0.0}, EvaluationError, 'distance_m: 0.0 is not valid; valid is > 0'),
    ({'time_s': float('nan')}, EvaluationError, 'time_s: nan is not valid; valid is > 0'),
    ({'tolerance_s': -1.0}, EvaluationError, 'tolerance: -1.0 is not valid; valid is >= 0')])
def test_bad_options_are_one_line(options, error, words):
    truth = wander(100, 12)
    with pytest.raises(error, match=words) as caught:
        evaluate(truth, truth, **options)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('name', ['missing', 'missing/bag:odom'])
def test_a_missing_truth_is_named(tmp_path, name):
    with pytest.raises(EvaluationError, match='there is no such file or bag'):
        evaluate(tmp_path / name, wander(100, 12))
