"""Picture of a comparison of images: histograms of gradients, and each measure with intervals."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.results import save_figure
from lunar_rover_sim.judge.evaluation.image_comparison import ImageComparison, MeasureRow
from lunar_rover_sim.judge.evaluation.image_statistics import LOG_BINS, LOG_FLOOR, LOG_STEP

_COLOURS = {'A': 'tab:blue', 'B': 'tab:orange'}


def save_comparison(result: ImageComparison, path: Path) -> None:
    """Write the figure; raise EvaluationError if it cannot be written."""
    rows = [row for row in result.rows if row.first.n or row.second.n]
    figure = Figure(figsize=(11, 5.5), layout='constrained')
    left, right = np.asarray(figure.subfigures(1, 2, width_ratios=(1.0, 1.3)))
    _histograms(left.subplots(), result)
    columns = -(-len(rows) // 2)
    axes = right.subplots(2, columns, squeeze=False).ravel()
    for one, row in zip(axes, rows):
        _measure(one, row, result)
    for one in axes[len(rows):]:
        one.set_axis_off()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EvaluationError(f'{path}: cannot be written: {error.strerror}') from None
    save_figure(figure, path, EvaluationError)


def _histograms(axes: Axes, result: ImageComparison) -> None:
    edges = LOG_FLOOR + LOG_STEP * np.arange(LOG_BINS + 1)
    for (name, colour), one in zip(_COLOURS.items(), (result.first, result.second)):
        bag = '/'.join(one.images.path.parts[-2:])      # with the folder of its run
        axes.stairs(one.log_gradients.mean(axis=0) / LOG_STEP, edges, color=colour, lw=1.5,
                    label=f'{name}: {bag} ({len(one.values)} images)')
    axes.set(xlabel='log10 of the gradient [full scale per px]', ylabel='density')
    axes.set_title(f'Wasserstein distance {result.distance.value:.3f} decades', fontsize=10)
    axes.legend(fontsize=8, loc='upper right')
    axes.grid(alpha=0.3)


def _measure(axes: Axes, row: MeasureRow, result: ImageComparison) -> None:
    index = [other.name for other in result.rows].index(row.name)
    sets = (row.first, result.first), (row.second, result.second)
    for k, ((name, colour), (estimate, one)) in enumerate(zip(_COLOURS.items(), sets)):
        values = one.values[:, index]
        axes.plot(k + np.linspace(-0.2, 0.2, len(values)), values, '.', color=colour, ms=3,
                  alpha=0.4)
        axes.plot(k, estimate.value, 'o', color=colour)
        if estimate.low == estimate.low:
            axes.vlines(k, estimate.low, estimate.high, color=colour, lw=2.5)
    axes.set_xticks((0, 1), tuple(_COLOURS))
    axes.set_xlim(-0.6, 1.6)
    p = row.difference.p
    axes.set_title(row.name + (f'\np = {p:.3g}' if p == p else ''), fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3, axis='y')
