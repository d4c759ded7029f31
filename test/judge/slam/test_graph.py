"""The graph on a closed way: loops, honest covariances, and what goes wrong."""

import dataclasses
import json

from judge.slam import closed_way
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
import synthetic_bag as synthetic

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.cli.main import execute
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate, nees_interval
from lunar_rover_sim.judge.evaluation.trajectory_files import read_trajectory
from lunar_rover_sim.judge.slam.euroc_reader import Camera
from lunar_rover_sim.judge.slam.graph import from_bag, odometry, pose_graph
from lunar_rover_sim.judge.slam.graph.measured import Wheels
from lunar_rover_sim.judge.slam.graph.odometry import GraphOdometry

needs_gtsam = pytest.mark.skipif(not pose_graph.has_gtsam(), reason='gtsam is not installed')


@pytest.fixture(scope='module')
def steps() -> list[closed_way.Step]:
    """Give a drive of 1.15 laps of 6.3 m, with sun sensor and star tracker; it is only read."""
    return closed_way.drive(heading=True)


@pytest.fixture(scope='module')
def bag(steps, tmp_path_factory):
    """Give the same as a bag; the star tracker is left out."""
    return closed_way.write(tmp_path_factory.mktemp('closed') / 'bag', steps)


def driven(steps, loops=True, change=lambda k, step: step):
    """Return the graph after a drive, and its answers; `change` may spoil a step."""
    graph = GraphOdometry(closed_way.CAMERA, closed_way.T_BASE_LEFT, synthetic.GRAVITY, loops)
    answers = [graph.add(*change(k, step).given) for k, step in enumerate(steps)]
    return graph, answers


def plain(k, step):
    """Return a step without sun and stars."""
    return dataclasses.replace(step, aids=dataclasses.replace(step.aids, sun=None, stars=None))


def largest_m(answer) -> float:
    """Return the largest standard deviation of a position."""
    return float(np.sqrt(np.linalg.eigvalsh(answer.covariance[:3, :3])[-1]))


@needs_gtsam
def test_loops_lower_the_error_at_the_end_and_the_covariance_says_so(steps):
    """Half the error and less than half of the deviation; all frames have a pose."""
    truth = closed_way.truth(steps)
    found = {}
    for loops in (False, True):
        graph, answers = driven(steps, loops, plain)
        assert all(answer is not None and answer.seen for answer in answers)
        estimate = graph.trajectory()
        result = evaluate(truth, estimate, align='origin')
        assert result.tracked_share == 1.0
        # Not worse than told, within the interval of one drive.
        assert result.consistency.frame == 'position and yaw'
        for nees in (result.consistency.position, result.consistency.orientation):
            assert nees.per_dof < nees.high
        assert (graph.counts.loops > 3) == loops and graph.counts.unseen == 0
        found[loops] = result.errors_m[-1], np.sqrt(estimate.covariances[-1, :2, :2].trace())
    assert found[True][0] < 0.5 * found[False][0] < 0.05
    assert found[True][1] < 0.5 * found[False][1]


@needs_gtsam
def test_a_lamp_that_goes_along_does_not_hide_the_motion(steps):
    """It lights the middle of each image from below; the near ground is white, the far one black.
    """
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, closed_way.WIDTH),
                       np.linspace(-1.0, 1.0, closed_way.HEIGHT))
    light = 0.05 + 3.0 * np.exp(-(u**2 + (v - 1.0)**2) / 0.6)

    def by_lamp(k, step):
        noise = np.random.default_rng(k).standard_normal((2, *light.shape))
        left, right = (np.clip(light * image + n, 0, 255).astype(np.uint8)
                       for image, n in zip((step.left, step.right), noise))
        return dataclasses.replace(plain(k, step), left=left, right=right)

    graph, _ = driven(steps[:45], change=by_lamp)
    assert graph.counts.unseen == 0
    assert evaluate(closed_way.truth(steps[:45]), graph.trajectory(),
                    align='origin').errors_m[-1] < 0.02


@needs_gtsam
def test_the_stars_tell_what_the_accelerometers_are_off(steps):
    """A bias grows for 40 s, under stars; then the rover sees nothing, and gravity holds it."""
    def change(k, step):
        forces = step.aids.inertial.forces_mps2 + [0.0, 0.012 * min(k, 40), 0.0]
        aids = dataclasses.replace(step.aids, sun=None)
        aids = dataclasses.replace(aids, inertial=aids.inertial._replace(forces_mps2=forces))
        if k < 40:
            return dataclasses.replace(step, aids=aids)
        return dataclasses.replace(step, left=None, right=None,
                                   aids=dataclasses.replace(aids, stars=None))

    tilts = {}
    for walk in (0.0, 0.05):
        graph = GraphOdometry(closed_way.CAMERA, closed_way.T_BASE_LEFT, synthetic.GRAVITY,
                              accel_walk=walk)
        answers = [graph.add(*change(k, step).given) for k, step in enumerate(steps)]
        up = (answers[-1].T_map_left @ np.linalg.inv(closed_way.T_BASE_LEFT))[2, :3]
        error = np.degrees(np.arccos(np.clip(up @ steps[-1].T_world_base[2, :3], -1.0, 1.0)))
        tilts[walk] = error, np.degrees(np.sqrt(answers[-1].covariance[3:5, 3:5].trace()))
    assert tilts[0.05][0] < 2.0 * tilts[0.05][1]
    assert tilts[0.0][0] > 3.0 * tilts[0.0][1]
    assert tilts[0.05][0] < 0.3 * tilts[0.0][0]


@needs_gtsam
def test_the_bias_of_the_gyroscope_is_learnt(steps):
    """It grows for 40 s, under stars and with images; then the rover turns by it for 30 s."""
    def change(k, step):
        rates = step.aids.inertial.rates_radps + [0.0, 0.0, 1e-4 * min(k, 40)]
        aids = dataclasses.replace(
            step.aids, sun=step.aids.sun if k < 5 else None,
            inertial=step.aids.inertial._replace(rates_radps=rates))
        if k < 40:
            return dataclasses.replace(step, aids=aids)
        return dataclasses.replace(step, left=None, right=None,
                                   aids=dataclasses.replace(aids, stars=None))

    graph = GraphOdometry(closed_way.CAMERA, closed_way.T_BASE_LEFT, synthetic.GRAVITY,
                          gyro_walk=5e-4)
    answers = [graph.add(*change(k, step).given) for k, step in enumerate(steps[:70])]
    R = (steps[69].T_world_base @ closed_way.T_BASE_LEFT)[:3, :3]
    error = Rotation.from_matrix(R.T @ answers[-1].T_map_left[:3, :3]).magnitude()
    assert graph.counts.stars_refused == 0
    assert error < 2.0 * np.sqrt(answers[-1].covariance[3:, 3:].trace())
    assert error < 0.3 * 4e-3 * 30.0        # of what the bias turns


@needs_gtsam
@pytest.mark.parametrize('seen', ['stars', 'sun'])
def test_a_sky_that_is_seen_late_holds_the_attitude_from_then_on(steps, seen):
    """The map looks where the rover looked; then it turns without images, by a wrong gyroscope."""
    def change(k, step):
        rates = step.aids.inertial.rates_radps + [0.0, 0.0, 6e-4 * (k > 12)]
        sky = {'stars': None, 'sun': None}
        if k > 7:
            sky[seen] = getattr(step.aids, seen)
        aids = dataclasses.replace(
            step.aids, inertial=step.aids.inertial._replace(rates_radps=rates), **sky)
        images = {} if k < 10 else {'left': None, 'right': None}
        return dataclasses.replace(step, aids=aids, **images)

    graph = GraphOdometry(closed_way.CAMERA, closed_way.T_BASE_LEFT, synthetic.GRAVITY)
    answers = [graph.add(*change(k, step).given) for k, step in enumerate(steps[:60])]
    R = [steps[k].T_world_base[:3, :3] @ closed_way.T_BASE_LEFT[:3, :3] for k in (0, 59)]
    # Both differ from the world by where the rover looked at first.
    begin, end = (R[n] @ answers[k].T_map_left[:3, :3].T for n, k in enumerate((0, 59)))
    turned = np.degrees(Rotation.from_matrix(begin.T @ end).as_rotvec())
    assert graph.counts.stars_refused == graph.counts.sun_refused == 0
    assert abs(turned[2]) < 0.6 < np.degrees(6e-4 * 47.0) / 2.0


@needs_gtsam
def test_without_images_the_covariance_grows_and_loops_bring_it_back(steps):
    """20 s on wheels alone: no pose leaps, and the deviation covers the error."""
    gone = range(25, 45)

    def change(k, step):
        step = plain(k, step)
        return dataclasses.replace(step, left=None, right=None) if k in gone else step

    graph, answers = driven(steps, True, change)
    deviations = [largest_m(answer) for answer in answers]
    assert not any(answers[k].seen for k in gone) and answers[24].seen and answers[-1].seen
    # Gravity, every 8 s, takes a little of it off.
    assert all(deviations[k + 5] > deviations[k] for k in gone[:-5])
    assert deviations[gone[-1]] > 5.0 * deviations[gone[0] - 1]
    places = np.array([answer.T_map_left[:3, 3] for answer in answers])
    leaps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    for k, leap in enumerate(leaps, 1):
        assert leap < 0.2 or answers[k].news, k
    start = closed_way.truth(steps).positions_m
    R = Rotation.from_rotvec([0.0, 0.0, -np.pi / 2]).as_matrix()     # the map looks ahead
    errors = np.linalg.norm(places - places[0] - (start - start[0]) @ R.T, axis=1)
    assert errors[gone[-1]] < 4.0 * deviations[gone[-1]]
    assert graph.counts.unseen == len(gone) + 1     # the first image has none before it
    assert graph.counts.loops > 0 and deviations[-1] < 0.5 * deviations[gone[-1]]


@needs_gtsam
def test_without_images_and_wheels_only_a_bound_on_the_speed_is_left(steps):
    graph, answers = driven(steps[:14], True, lambda k, step: dataclasses.replace(
        step, left=None if k > 8 else step.left,
        aids=dataclasses.replace(step.aids, wheels=None, sun=None, stars=None)))
    assert largest_m(answers[13]) > 0.5
    assert np.linalg.norm(answers[13].T_map_left[:3, 3] - answers[8].T_map_left[:3, 3]) < 0.5


@needs_gtsam
def test_a_lying_sun_sensor_is_refused_and_counted(steps):
    """It lies by 20 degrees from the 20th second on; the heading stays."""
    lie = Rotation.from_rotvec([0.0, 0.0, np.radians(20.0)]).as_matrix()

    def change(k, step):
        sun = step.aids.sun
        if k >= 20:
            sun = sun._replace(in_base=step.T_world_base[:3, :3].T @ lie @ closed_way.SUN)
        return dataclasses.replace(step, aids=dataclasses.replace(step.aids, sun=sun, stars=None))

    graph, _ = driven(steps, True, change)
    assert graph.counts.sun_refused > 10
    result = evaluate(closed_way.truth(steps), graph.trajectory(), align='none')
    assert result.ate_deg.max < 1.5
    honest, _ = driven(steps)
    assert honest.counts.sun_refused == honest.counts.stars_refused == 0
    # The stars tell the heading of the world.
    assert evaluate(closed_way.truth(steps), honest.trajectory(), align='none').ate_deg.max < 0.5


@needs_gtsam
def test_wheels_that_slip_are_refused_and_counted(steps):
    """They claim three times the way."""
    graph, _ = driven(steps[:30], True, lambda k, step: dataclasses.replace(
        step, aids=dataclasses.replace(step.aids, sun=None, stars=None,
                                       wheels=step.aids.wheels._replace(
                                           pose=step.aids.wheels.pose * [3.0, 3.0, 1.0]))))
    assert graph.counts.wheels_refused > 5
    result = evaluate(closed_way.truth(steps[:30]), graph.trajectory(), align='origin')
    assert result.ate_m.max < 0.05


@needs_gtsam
def test_wheels_that_slide_aside_all_the_time_are_learnt(steps):
    """A fifth of the way, which images show for 30 s; then there are none for 30 s."""
    slide = Rotation.from_euler('Z', 0.2).as_matrix()

    def change(k, step):
        wheels = step.aids.wheels
        wheels = Wheels(slide @ wheels.pose, slide @ wheels.covariance @ slide.T)
        images = {} if k < 30 else {'left': None, 'right': None}
        return dataclasses.replace(step, aids=dataclasses.replace(step.aids, wheels=wheels),
                                   **images)

    graph, answers = driven(steps[:60], change=change)
    truth = closed_way.truth(steps[:60]).positions_m
    nees = []
    for answer, true in zip(answers[30:], truth[30:]):
        assert not answer.seen
        error = answer.T_map_left[:3, 3] - answers[0].T_map_left[:3, 3] - (true - truth[0])
        nees.append(error @ np.linalg.solve(answer.covariance[:3, :3], error) / 3.0)
    assert np.mean(nees) < nees_interval(3).high
    assert graph.counts.wheels_refused == 0


@needs_gtsam
@pytest.mark.parametrize('by_lamp', [True, False])
def test_in_the_dark_images_may_be_wrong_about_the_length_of_all_steps(steps, by_lamp):
    """Shadows go along with a lamp: each step looks longer by 3 %. By day they do not."""
    def change(k, step):
        sun = None if by_lamp else step.aids.sun
        return dataclasses.replace(step, aids=dataclasses.replace(step.aids, sun=sun, wheels=None))

    graph, _ = driven(steps[:35], change=change)
    truth = closed_way.truth(steps[:35])
    first_m = truth.positions_m[0]
    shorter = dataclasses.replace(
        truth, positions_m=first_m + (truth.positions_m - first_m) / 1.03)
    nees = evaluate(shorter, graph.trajectory(), align='none').consistency.position
    assert (nees.per_dof < nees.high) == by_lamp


def test_wheels_of_large_covariances_give_no_variance_below_0():
    """Their difference may have one: of rounding, or where another model made them."""
    before = Wheels(np.array([37.05, 16.41, 0.58]), np.diag([57.4, 182.6, 0.4264]))
    now = Wheels(np.array([37.29, 16.57, 0.62]), np.diag([57.3, 182.7, 0.4290]))
    _, covariance = pose_graph.rolled(before, now)
    assert np.linalg.eigvalsh(covariance)[0] > 0.0
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)


@needs_gtsam
def test_a_singular_graph_begins_anew_where_the_rover_is(steps):
    graph = GraphOdometry(closed_way.CAMERA, closed_way.T_BASE_LEFT, synthetic.GRAVITY)
    answers = []
    for k, step in enumerate(steps[:30]):
        if k == 20:
            # A pose of which only the tilt is held.
            graph._graph.add(10_000, np.eye(4))
            graph._graph.direction(10_000, np.eye(3)[2], np.eye(3)[2], 0.1)
        answers.append(graph.add(*plain(k, step).given))
    assert graph.counts.restarts == 1
    assert [k for k, answer in enumerate(answers) if 'singular' in answer.news][0] >= 20
    result = evaluate(closed_way.truth(steps[:30]), graph.trajectory(), align='origin')
    assert len(result.truth) == 30 and result.ate_m.max < 0.05
    assert 'restarts' in graph.counts.words


@needs_gtsam
def test_a_command_judges_a_bag_with_covariances_in_a_file_of_their_own(bag, tmp_path, capsys):
    assert execute(['slam', 'run', str(bag), '--system', 'graph', '-o',
                    str(tmp_path / 'out')]) == 0
    said = capsys.readouterr().out
    assert 'loops' in said and 'NEES per degree of freedom' in said
    values = json.loads((tmp_path / 'out' / 'result.json').read_text())
    assert values['system'] == 'graph' and values['tracked_share'] == 1.0
    assert values['ate_m'] < 0.02 and 0.0 < values['nees_position'] < 3.12
    plain, told = (read_trajectory(tmp_path / 'out' / name)
                   for name in ('estimate.txt', 'estimate_covariance.txt'))
    assert plain.covariances is None and told.covariances.shape == (len(plain), 6, 6)
    again = evaluate(bag, told, estimate_frame='left')
    assert again.consistency.position.per_dof == pytest.approx(values['nees_position'], rel=1e-6)


def test_without_gtsam_it_is_the_window_and_one_line_says_so(bag, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(pose_graph, 'has_gtsam', lambda: False)
    monkeypatch.setattr(from_bag, 'has_gtsam', lambda: False)
    with pytest.raises(SlamError, match=r'needs GTSAM, .* pip install "lunar_rover_sim\[graph\]"'):
        GraphOdometry(closed_way.CAMERA, np.eye(4), 1.62)
    assert execute(['slam', 'run', str(bag), '--system', 'graph', '-o',
                    str(tmp_path / 'out')]) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert said.count('the graph needs GTSAM') == 1
    assert '3.11 to 3.14); this is the window of the reference' in said
    assert not (tmp_path / 'out' / 'estimate_covariance.txt').exists()


@needs_gtsam
def test_bad_input_is_refused(steps):
    with pytest.raises(SlamError, match='baseline: 0 is not valid'):
        GraphOdometry(Camera((200.0, 200.0), (160.0, 120.0)), np.eye(4), 1.62)
    graph, _ = driven(steps[:2])
    with pytest.raises(SlamError, match='stamps must increase'):
        graph.add(*steps[1].given)
    with pytest.raises(SlamError, match='nothing was tracked'):
        GraphOdometry(closed_way.CAMERA, np.eye(4), 1.62).trajectory()
    assert odometry.gate(6) == pytest.approx(22.46, abs=0.01)
