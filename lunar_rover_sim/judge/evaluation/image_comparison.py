"""Two sets of images against each other: measures with intervals of both and of the difference.

A set is anything that `image_layouts.open_images` reads. Both are scaled down to the width of the
narrower one, since gradients, spectra and keypoints are counted in pixels. Images of the same
names (of a bag: the same stamps) in both sets are pairs: what changes along both alike, as the
place and the sun do, is then no scatter of the difference.
"""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from scipy.stats import wasserstein_distance

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.results import plain, save_figure
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.evaluation import statistics
from lunar_rover_sim.judge.evaluation.image_layouts import ImageSet, open_images
from lunar_rover_sim.judge.evaluation.image_statistics import (image_statistics, LEAST_PX,
                                                               LOG_BINS, LOG_FLOOR, LOG_STEP,
                                                               MEASURES, SHARES)
from lunar_rover_sim.judge.evaluation.statistics import Difference, SeriesMean

MOST_IMAGES = 40
DISTANCE = 'log gradient distance'


@dataclasses.dataclass(frozen=True)
class SetStatistics:
    """The statistics of the images of a set.

    Attributes:
        names: Of the n images.
        values: (n, len(MEASURES)).
        log_gradients: (n, LOG_BINS), as `ImageStatistics` has them.
    """

    images: ImageSet
    names: tuple[str, ...]
    values: Array
    log_gradients: Array


@dataclasses.dataclass(frozen=True)
class MeasureRow:
    """One measure: its mean in both sets, and the second less the first."""

    name: str
    first: SeriesMean
    second: SeriesMean
    difference: Difference


@dataclasses.dataclass(frozen=True)
class ImageComparison:
    """The result of `compare_images`.

    Attributes:
        distance: Wasserstein distance of the histograms of log10 of gradients [decades], p by
            permutation.
        chance: What one in twenty shuffles of the images between the sets exceeds.
    """

    first: SetStatistics
    second: SetStatistics
    width_px: int
    rows: tuple[MeasureRow, ...]
    distance: Difference
    chance: float

    @property
    def paired(self) -> bool:
        """Whether each image has its like in the other set."""
        return self.first.names == self.second.names

    @property
    def q(self) -> Array:
        """p of each row and, last, of the distance, corrected for the number of tests."""
        return statistics.adjusted([*(row.difference.p for row in self.rows), self.distance.p])

    @property
    def resembling(self) -> dict[str, float]:
        """Correlation of neighbouring images in the measures where it makes intervals narrow."""
        found = {name: max(statistics.resemblance(one.values[:, k])
                           for one in (self.first, self.second))
                 for k, name in enumerate(MEASURES)}
        return {name: value for name, value in found.items() if value}

    def to_mapping(self) -> dict[str, Any]:
        """Return all numbers as plain values; None for what is not known."""
        *q, q_distance = self.q

        def described(one: SetStatistics) -> dict[str, Any]:
            return {'path': str(one.images.path), 'layout': one.images.layout,
                    'images': one.images.total, 'sampled': len(one.values)}

        return plain({
            'a': described(self.first), 'b': described(self.second), 'width_px': self.width_px,
            'interval': '95 %, block bootstrap', 'paired': self.paired,
            'resembling': self.resembling,
            'measures': {row.name: {'meaning': MEASURES[row.name], 'a': row.first._asdict(),
                                    'b': row.second._asdict(),
                                    'b_minus_a': {**row.difference._asdict(), 'q': one}}
                         for row, one in zip(self.rows, q)},
            DISTANCE: {'meaning': 'Wasserstein distance of the histograms of log10 of the '
                       'gradient [decades]', **self.distance._asdict(), 'q': q_distance,
                       'shuffled_95': self.chance}})


def compare_images(first: Path | str, second: Path | str, *, frames: int = MOST_IMAGES,
                   width_px: int | None = None, seed: int = 1,
                   progress: Callable[[], None] | None = None) -> ImageComparison:
    """Compare two sets of images.

    Args:
        frames: At most so many images of each set, evenly over it.
        width_px: Images are scaled down to this width; by default to that of the narrower set.
        seed: Of the bootstrap.
        progress: Called once per image.

    Raises:
        EvaluationError: If a set cannot be read.
        BagError: If a set cannot be read.
    """
    if frames < 1:
        raise EvaluationError(f'frames: {frames} is not valid; valid is at least 1')
    if width_px is not None and width_px < LEAST_PX:
        raise EvaluationError(f'width: {width_px} is not valid; valid is at least {LEAST_PX} px')
    sets = open_images(first), open_images(second)
    firsts = [next(images.read(1)) for images in sets]
    widths = [pair.left.shape[1] for pair in firsts]
    # One definition for both: one that only one set could meet would itself make a gap.
    truth_shows_sky = all(pair.truth_px is not None for pair in firsts)
    width = min([*widths, *([] if width_px is None else [width_px])])
    a, b = (_measured(images, frames, width, truth_shows_sky, progress) for images in sets)
    rng = np.random.default_rng(seed)
    rows = tuple(_row(name, a.values[:, k], b.values[:, k], a.names == b.names, rng)
                 for k, name in enumerate(MEASURES))
    return ImageComparison(a, b, width, rows, *_distance(a, b, rng))


def _row(name: str, first: Array, second: Array, paired: bool,
         rng: np.random.Generator) -> MeasureRow:
    share = name in SHARES
    one, means = statistics.estimate(first, rng, share)
    other, other_means = statistics.estimate(second, rng, share)
    value, resamples = other.value - one.value, other_means - means
    if paired and (np.isfinite(first) == np.isfinite(second)).all():
        of_pairs, resamples = statistics.estimate(second - first, rng)
        value = of_pairs.value
    if share:
        resamples = np.clip(resamples, -1.0, 1.0)
    return MeasureRow(name, one, other, statistics.difference(value, resamples))


def _measured(images: ImageSet, frames: int, width_px: int, truth_shows_sky: bool,
              progress: Callable[[], None] | None) -> SetStatistics:
    found, names = [], []
    for pair in images.read(frames):
        narrow = pair.narrowed(width_px)
        if len(narrow.left) < LEAST_PX:
            raise EvaluationError(f'{images.path}: {pair.name} is {len(narrow.left)} px high at '
                                  f'the common width of {width_px} px; valid is at least '
                                  f'{LEAST_PX} px')
        found.append(image_statistics(narrow, truth_shows_sky))
        names.append(pair.name)
        if progress is not None:
            progress()
    return SetStatistics(images, tuple(names), np.stack([one.values for one in found]),
                         np.stack([one.log_gradients for one in found]))


def _distance(a: SetStatistics, b: SetStatistics,
              rng: np.random.Generator) -> tuple[Difference, float]:
    """Return the distance of the histograms, and what chance gives."""
    centres = LOG_FLOOR + LOG_STEP * (np.arange(LOG_BINS) + 0.5)
    one, other = a.log_gradients.mean(axis=0), b.log_gradients.mean(axis=0)
    nan = float('nan')
    if not one.sum() or not other.sum():
        return Difference(nan, nan, nan, nan), nan
    value = float(wasserstein_distance(centres, centres, one, other))
    if min(len(a.values), len(b.values)) < statistics.LEAST:
        return Difference(value, nan, nan, nan), nan
    paired = a.names == b.names
    places = statistics.resampled(len(a.values), rng)
    means = [a.log_gradients[places].mean(axis=1), b.log_gradients[
        places if paired else statistics.resampled(len(b.values), rng)].mean(axis=1)]
    resamples = LOG_STEP * np.abs(np.cumsum(means[0] - means[1], axis=1)).sum(axis=1)
    # A distance grows with every scatter: the mean of that is taken off.
    resamples = np.maximum(resamples - (resamples.mean() - value), 0.0)
    low, high = np.percentile(resamples, (2.5, 97.5))
    p, chance = statistics.permutation_p(a.log_gradients, b.log_gradients, rng, paired=paired)
    return Difference(value, float(low), float(high), p), LOG_STEP * chance


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
