"""Files, bags and trajectories judged by the command and by Python, and their pictures."""

import dataclasses
import json
from pathlib import Path

from judge.evaluation.wandering import wander
import numpy as np
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError, EvaluationError
from lunar_rover_sim.base.frames import inverse, se3
from lunar_rover_sim.cli.main import execute
from lunar_rover_sim.judge.evaluation import trajectory_files, trajectory_plots
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.judge.evaluation.trajectory_files import load
from lunar_rover_sim.judge.evaluation.trajectory_plots import save_plots, top_view_svg
from lunar_rover_sim.products.inspection.summary import summarise


@pytest.fixture(scope='module')
def bag(tmp_path_factory) -> Path:
    """Return a drive of 1.5 s; it is only read."""
    return synthetic.write(tmp_path_factory.mktemp('bags') / 'bag',
                           synthetic.drive(1.5, only=synthetic.FOR_ESTIMATORS))


def test_the_command_notes_a_moved_map_or_else_a_wrong_frame(bag, tmp_path, capsys):
    """All orientations are off where the frame is another one, and where a map is not aligned."""
    truth = trajectory_files.load(bag)
    turned = truth.of_frame(np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0],
                                      [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]))

    def said(positions_m):
        trajectory_files.write_tum(tmp_path / 'estimate.txt', dataclasses.replace(
            turned, positions_m=positions_m))
        args = ['evaluate', str(bag), str(tmp_path / 'estimate.txt'), '--align', 'none']
        assert execute(args) == 0
        return [line for line in capsys.readouterr().out.splitlines() if line.startswith('note')]

    notes = said(truth.positions_m)
    assert len(notes) == 1
    assert notes[0].startswith('note: all orientations are off by the same 90 deg')
    late = truth.stamps_ns >= 700_000_000
    notes = said(truth.positions_m + 0.5 * late[:, None])
    assert not any('orientations' in note for note in notes)
    assert notes[0].startswith('note: the estimate jumps once, at 0.70 s by 0.87 m: ')
    notes = said(truth.positions_m + (0.5 * late + (truth.stamps_ns >= 900_000_000))[:, None])
    assert notes[0].startswith('note: the estimate jumps 2 times, most at 0.90 s by 1.73 m: ')


def test_where_images_are_not_recorded_their_camera_info_tells_the_stamps(bag, tmp_path):
    """As of a bag of a live run, which has the poses and no images."""
    infos = [i for i in synthetic.drive(0.5, only=synthetic.FOR_ESTIMATORS)
             if i.topic in (topics.ODOM.name, topics.LEFT_INFO.name)]
    stamps = trajectory_files.image_stamps_ns(synthetic.write(tmp_path / 'bag', infos))
    assert stamps.tolist() == trajectory_files.image_stamps_ns(bag)[:len(stamps)].tolist()
    assert len(stamps) == 5
    neither = [i for i in infos if i.topic == topics.ODOM.name]
    assert trajectory_files.image_stamps_ns(synthetic.write(tmp_path / 'poses', neither)) is None


def test_the_command_judges_a_bag(bag, tmp_path, capsys):
    """A camera trajectory in its own frame has no error against the bag it was made from."""
    truth = trajectory_files.load(bag)
    T_base_left = trajectory_files.frame_on_rover(bag, 'left')
    assert np.allclose(T_base_left, synthetic.T_base_camera(+1.0))
    stamps = trajectory_files.image_stamps_ns(bag)
    keep = np.isin(truth.stamps_ns, stamps[:-3])
    camera = truth.of_frame(T_base_left)
    start = se3(camera.rotations[0].as_matrix(), camera.positions_m[0])
    camera = camera.moved(inverse(start)[:3, :3], inverse(start)[:3, 3]).select(keep)
    trajectory_files.write_tum(tmp_path / 'CameraTrajectory.txt', camera)
    output = tmp_path / 'out'
    args = ['evaluate', str(bag), str(tmp_path / 'CameraTrajectory.txt'),
            '--estimate-frame', 'left', '-o', str(output)]
    assert execute(args) == 0
    result = json.loads((output / 'evaluation.json').read_text())
    assert result['ate_m']['max'] < 1e-9
    assert result['tracked_share'] == pytest.approx(12 / 15)
    assert {p.name for p in Path(output).iterdir()} == {'evaluation.json', 'top_view.png',
                                                        'error.png', 'scale.png'}
    assert 'tracked 80.0 %' in ' '.join(capsys.readouterr().out.split())


def test_files_bags_and_trajectories_are_judged_alike(bag, tmp_path):
    """A path, its text and what was loaded from it give the same result, in frozen form."""
    truth = trajectory_files.load(bag)
    estimate = truth.of_frame(trajectory_files.frame_on_rover(bag, 'left')).select(
        np.arange(0, 200, 7))
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


def test_the_length_of_the_path_is_that_of_the_recording(bag):
    """Whatever was tracked, and by which sensor: that of the summary."""
    truth = trajectory_files.load(bag)
    driven = summarise(bag).distance_m
    assert driven == pytest.approx(synthetic.SPEED * 1.495, rel=1e-3)
    assert truth.length_m == driven
    first_half = truth.select(np.arange(len(truth) // 2))
    assert evaluate(bag, first_half).length_m == driven
    camera = truth.of_frame(trajectory_files.frame_on_rover(bag, 'left'))
    assert evaluate(bag, camera, estimate_frame='left').length_m == driven


@pytest.mark.parametrize(('options', 'error', 'words'), [
    ({'align': 'sim'}, EvaluationError, 'did you mean sim3'),
    ({'estimate_frame': 'lefd'}, ConfigError, 'did you mean left'),
    ({'distance_m': 0.0}, EvaluationError, 'distance_m: 0.0 is not valid; valid is > 0'),
    ({'time_s': float('nan')}, EvaluationError, 'time_s: nan is not valid; valid is > 0'),
    ({'distance_m': float('inf')}, EvaluationError, 'distance_m: inf is not valid'),
    *(({'tolerance_s': bad}, EvaluationError, f'tolerance: {bad} is not valid; valid is 0 to')
      for bad in (-1e-9, float('inf'), float('nan'), 2000.0))])
def test_bad_options_are_one_line(options, error, words):
    truth = wander(100, 12)
    with pytest.raises(error, match=words) as caught:
        evaluate(truth, truth, **options)
    assert '\n' not in str(caught.value)


def drive(stands: bool = False) -> Trajectory:
    """Return 6 m east and 2 m north in a bend, which may stand still for a while."""
    s = np.linspace(0.0, 1.0, 81)
    positions = np.stack([6.0 * s, 2.0 * s**2, 0.0 * s], axis=1)
    if stands:
        positions[20:70] = positions[20]
    return Trajectory(250_000_000 * np.arange(81), positions,
                      np.tile([1.0, 0.0, 0.0, 0.0], (81, 1)))


@pytest.mark.parametrize('estimate', [drive(), drive(stands=True)], ids=['moves', 'stands'])
def test_each_picture_is_written_also_where_steps_have_no_scale(estimate, tmp_path):
    result = evaluate(drive(), estimate, align='none', distance_m=0.5)
    paths = save_plots(result, tmp_path / 'new' / 'out')
    assert sorted(path.name for path in paths) == ['error.png', 'scale.png', 'top_view.png']
    assert all(path.stat().st_size > 5000 for path in paths)
    assert top_view_svg(result).startswith('<svg')


def test_both_paths_are_drawn_and_a_bag_whose_world_is_gone_has_no_ground(tmp_path, monkeypatch):
    figures = {}
    monkeypatch.setattr(trajectory_plots, 'save_figure',
                        lambda figure, path, _: figures.update({path.name: figure}))
    items = [item for item in synthetic.drive(0.2) if 'stereo' not in item.topic]
    bag = synthetic.write(tmp_path / 'bag', items)
    truth = load(bag)
    save_plots(evaluate(bag, truth, align='none'), tmp_path, bag)
    (axes,) = figures['top_view.png'].axes
    assert not axes.images
    for line in axes.lines[:2]:
        np.testing.assert_allclose(line.get_xydata(), truth.positions_m[:, :2])
