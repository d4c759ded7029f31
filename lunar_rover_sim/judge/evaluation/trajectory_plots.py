"""Pictures of an evaluation: top view, error over time, scale over time."""

from __future__ import annotations

from contextlib import nullcontext
import io
from pathlib import Path

from matplotlib.figure import Figure
import numpy as np

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.results import save_figure
from lunar_rover_sim.judge.evaluation import metrics
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import Evaluation
from lunar_rover_sim.products.inspection.bag_pictures import draw_around

TOP_VIEW = 'top_view.png'


def save_plots(result: Evaluation, output: Path, bag: Path | None = None) -> list[Path]:
    """Write top_view.png, error.png and scale.png into `output` and return their paths.

    Args:
        bag: Its world is drawn below the top view, if the world's folder still exists.

    Raises:
        EvaluationError: If the files cannot be written.
    """
    figures = {TOP_VIEW: _top_view(result, bag), 'error.png': _error(result),
               'scale.png': _scale(result)}
    for name, figure in figures.items():
        save_figure(figure, output / name, EvaluationError)
    return [output / name for name in figures]


def top_view_svg(result: Evaluation) -> str:
    """Return the paths seen from above as SVG, small."""
    figure = _top_view(result, None)
    figure.set_size_inches(4, 3.7)
    text = io.StringIO()
    figure.savefig(text, format='svg')
    return text.getvalue()[text.getvalue().index('<svg'):]


def _top_view(result: Evaluation, bag: Path | None) -> Figure:
    figure = Figure(figsize=(7, 6.5), layout='constrained')
    axes = figure.subplots()
    truth, estimate = result.truth.positions_m[:, :2], result.estimate.positions_m[:, :2]
    both = np.concatenate([truth, estimate])
    with nullcontext() if bag is None else open_bag(bag) as recording:
        draw_around(axes, both, 0.6, recording)
    axes.plot(*truth.T, color='tab:green', lw=2.0, label='truth')
    axes.plot(*estimate.T, color='tab:red', lw=1.0, label=f'estimate ({result.options.align})')
    axes.plot(*truth[0], 'o', color='tab:green')
    axes.set_title(f'ATE {result.ate_m.rmse:.4f} m over {result.length_m:.2f} m', fontsize=10)
    axes.legend()
    return figure


def _error(result: Evaluation) -> Figure:
    figure = Figure(figsize=(9, 5), layout='constrained')
    upper, lower = figure.subplots(2, 1, sharex=True)
    t = result.truth.seconds
    upper.plot(t, result.errors_m, color='tab:red', lw=0.9)
    upper.axhline(result.ate_m.rmse, color='0.4', ls='--', lw=0.8, label='RMSE')
    upper.set_ylabel('position error [m]')
    upper.legend()
    angles = np.degrees(metrics.absolute_angles_rad(result.truth, result.estimate))
    lower.plot(t, angles, color='tab:blue', lw=0.9)
    lower.set(xlabel='time [s]', ylabel='rotation error [deg]')
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    return figure


def _scale(result: Evaluation) -> Figure:
    figure = Figure(figsize=(9, 3.5), layout='constrained')
    axes = figure.subplots()
    pairs = metrics.pairs_by_distance(result.truth, result.options.distance_m)
    if len(pairs):
        start, end = pairs.T
        true = np.linalg.norm(np.diff(result.truth.positions_m[pairs], axis=1)[:, 0], axis=1)
        found = np.linalg.norm(np.diff(result.estimate.positions_m[pairs], axis=1)[:, 0], axis=1)
        moved = (found > 0.0) & (true > 0.0)
        t = 0.5 * (result.truth.seconds[start] + result.truth.seconds[end])
        axes.plot(t[moved], (true[moved] / found[moved]) * result.alignment.scale, lw=0.9)
    axes.axhline(result.scale, color='0.4', ls='--', lw=0.8,
                 label=f'whole path: {result.scale:.4f}')
    axes.set(xlabel='time [s]', ylabel=f'scale over {result.options.distance_m:g} m')
    axes.grid(alpha=0.3)
    axes.legend()
    return figure
