"""The pictures of an evaluation: both paths, the ground of a bag below, errors and scale."""


import numpy as np
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.judge.evaluation import trajectory_plots
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.judge.evaluation.trajectory_files import load
from lunar_rover_sim.judge.evaluation.trajectory_plots import save_plots, top_view_svg


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


def test_pictures_that_cannot_be_written_are_named(tmp_path):
    (tmp_path / 'file').write_text('in the way')
    with pytest.raises(EvaluationError, match='file/out/top_view.png: cannot be written'):
        save_plots(evaluate(drive(), drive(), align='none'), tmp_path / 'file' / 'out')
