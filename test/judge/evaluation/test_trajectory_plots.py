"""The pictures of an evaluation show its numbers: curves are read back from the figures."""

from pathlib import Path

from matplotlib.figure import Figure
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
import synthetic_bag as synthetic

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory, wxyz
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate, Evaluation
from lunar_rover_sim.judge.evaluation.trajectory_plots import save_plots
from lunar_rover_sim.judge.evaluation.trajectory_sources import load

N, PERIOD_S, START_S = 81, 0.25, 40.0


def drive(scale: float = 1.0, turn_deg: float = 0.0) -> Trajectory:
    """Return 6 m east and 2 m north, far from the origin, in a bend; turned by a constant."""
    s = np.linspace(0.0, 1.0, N)
    x, y = 6.0 * s, 2.0 * s**2
    stamps = np.round((START_S + PERIOD_S * np.arange(N)) * 1e9).astype(np.int64)
    turns = Rotation.from_euler('z', np.full((N, 1), turn_deg), degrees=True)
    return Trajectory(stamps, np.stack([300.0 + scale * x, -70.0 + scale * y, 0.1 * s], axis=1),
                      wxyz(turns), 'drive')


def drawn(result: Evaluation, output: Path, monkeypatch: pytest.MonkeyPatch,
          bag: Path | None = None) -> dict[str, Figure]:
    """Return the figures that `save_plots` would have written, by file name."""
    figures: dict[str, Figure] = {}
    monkeypatch.setattr('lunar_rover_sim.judge.evaluation.trajectory_plots.save_figure',
                        lambda figure, path, _: figures.update({Path(path).name: figure}))
    paths = save_plots(result, output, bag)
    assert [path.name for path in paths] == list(figures)
    assert all(path.parent == output for path in paths) and output.is_dir()
    return figures


def test_top_view(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both paths from above, around their common middle, at one scale."""
    truth, estimate = drive(), drive(1.1, 3.0)
    result = evaluate(truth, estimate, align='none')
    (axes,) = drawn(result, tmp_path / 'new' / 'out', monkeypatch)['top_view.png'].axes
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    np.testing.assert_allclose(lines['truth'], truth.positions_m[:, :2])
    np.testing.assert_allclose(lines['estimate (none)'], estimate.positions_m[:, :2])
    start = axes.lines[-1]
    assert start.get_marker() == 'o' and start.get_xydata().tolist() == [[300.0, -70.0]]
    # The two of them reach from 300 to 306.6 and from -70 to -67.8.
    assert axes.get_xlim() == pytest.approx((303.3 - 0.6 * 6.6, 303.3 + 0.6 * 6.6))
    assert axes.get_ylim() == pytest.approx((-68.9 - 0.6 * 6.6, -68.9 + 0.6 * 6.6))
    assert axes.get_aspect() == 1.0
    assert axes.get_title() == f'ATE {result.ate_m.rmse:.4f} m over {result.length_m:.2f} m'


def test_a_rover_that_stood_is_drawn_in_half_a_metre(tmp_path: Path,
                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    """However little it moved."""
    still = Trajectory(drive().stamps_ns, np.full((N, 3), 7.0), drive().orientations_wxyz, 'still')
    (axes,) = drawn(evaluate(still, still, align='none'), tmp_path,
                    monkeypatch)['top_view.png'].axes
    assert axes.get_xlim() == axes.get_ylim() == pytest.approx((6.75, 7.25))


def test_errors_over_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Positions drift apart evenly, orientations are 3 deg apart throughout."""
    truth, estimate = drive(), drive(1.1, 3.0)
    result = evaluate(truth, estimate, align='none')
    upper, lower = drawn(result, tmp_path, monkeypatch)['error.png'].axes
    time, error = upper.lines[0].get_xydata().T
    np.testing.assert_allclose(time, START_S + PERIOD_S * np.arange(N))
    np.testing.assert_allclose(
        error, np.linalg.norm(truth.positions_m - estimate.positions_m, axis=1))
    assert set(upper.lines[1].get_ydata()) == {result.ate_m.rmse}
    time, angle = lower.lines[0].get_xydata().T
    np.testing.assert_allclose(time, START_S + PERIOD_S * np.arange(N))
    np.testing.assert_allclose(angle, 3.0, atol=1e-6)
    assert lower.get_xlabel() == 'time [s]' and upper.get_shared_x_axes().joined(upper, lower)


@pytest.mark.parametrize('align', ['none', 'sim3'])
def test_scale_over_the_path(align: str, tmp_path: Path,
                             monkeypatch: pytest.MonkeyPatch) -> None:
    """1 / 1.1 all along, whatever was aligned, at the middle of each pair's time."""
    flat = drive()
    flat = Trajectory(flat.stamps_ns, flat.positions_m * [1.0, 1.0, 0.0], flat.orientations_wxyz)
    large = flat.moved(np.eye(3), [0.0, 0.0, 0.0], 1.1)
    result = evaluate(flat, large, align=align, distance_m=1.5)
    (axes,) = drawn(result, tmp_path, monkeypatch)['scale.png'].axes
    time, scale = axes.lines[0].get_xydata().T
    np.testing.assert_allclose(scale, 1.0 / 1.1, rtol=1e-6)
    # The path is 6.4 m long; its last pair begins 1.5 m before its end.
    steps = np.linalg.norm(np.diff(flat.positions_m, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    end = int(np.argmin(np.abs(along - along[0] - 1.5)))
    assert time[0] == pytest.approx(START_S + 0.5 * PERIOD_S * end)
    last = int(np.max(np.flatnonzero(along <= along[-1] - 1.5 + 0.15)))
    assert time[-1] <= START_S + 0.5 * PERIOD_S * (last + N - 1) + 1e-9
    assert len(time) > 40 and np.all(np.diff(time) > 0.0)
    assert set(axes.lines[1].get_ydata()) == {result.scale}
    assert result.scale == pytest.approx(1.0 / 1.1, rel=1e-6)
    assert axes.get_ylabel() == 'scale over 1.5 m'


def test_steps_without_motion_have_no_scale(tmp_path: Path,
                                            monkeypatch: pytest.MonkeyPatch) -> None:
    """An estimate that stands still for a while leaves a gap, not a scale of infinity."""
    truth = drive()
    positions = truth.positions_m.copy()
    positions[20:70] = positions[20]
    result = evaluate(truth, Trajectory(truth.stamps_ns, positions, truth.orientations_wxyz),
                      align='none', distance_m=0.5)
    (axes,) = drawn(result, tmp_path, monkeypatch)['scale.png'].axes
    time, scale = axes.lines[0].get_xydata().T
    assert np.isfinite(scale).all() and 0 < len(time) < result.rpe_distance_m.count
    # A path that is shorter than the distance has no pairs, and only the line of the whole.
    short = evaluate(truth, truth, align='none', distance_m=50.0)
    (axes,) = drawn(short, tmp_path, monkeypatch)['scale.png'].axes
    assert len(axes.lines) == 1


def test_the_ground_of_a_bag_lies_below(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bag whose world is gone has none; its paths are drawn all the same."""
    items = [item for item in synthetic.drive(0.2) if 'stereo' not in item.topic]
    bag = synthetic.write(tmp_path / 'bag', items)
    truth = load(bag)
    (axes,) = drawn(evaluate(bag, truth, align='none'), tmp_path, monkeypatch,
                    bag)['top_view.png'].axes
    np.testing.assert_allclose(axes.lines[0].get_xydata(), truth.positions_m[:, :2])


def test_pictures_that_cannot_be_written_are_named(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('in the way')
    result = evaluate(drive(), drive(), align='none')
    with pytest.raises(EvaluationError, match='file/out: cannot be written'):
        save_plots(result, tmp_path / 'file' / 'out')
