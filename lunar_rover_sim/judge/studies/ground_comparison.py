"""Grounds against each other on the same worlds: means, intervals and paired tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import dataclasses
import math
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
import numpy as np

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.files.results import markdown_table, save_figure
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.evaluation.statistics import (adjusted, CONFIDENCE, either_alone_p,
                                                         Estimate, Mean, Share, signed_rank_p)


@dataclasses.dataclass(frozen=True)
class Quantity:
    """What is compared: its name with unit, and its value in a result; NaN where it has none.

    A share is 1 or 0 in each result.
    """

    name: str
    of: Callable[[Any], float]
    digits: int = 2
    share: bool = False

    def estimate(self, values: Array) -> Estimate:
        """Return the mean of (n,) values, or their share, with its interval."""
        if self.share:
            return Share.of(int(np.nansum(values)), int(np.sum(~np.isnan(values))))
        return Mean.of(values)


@dataclasses.dataclass(frozen=True)
class Compared:
    """One quantity on one ground, and what it is more there than on the first ground.

    Attributes:
        difference, p: Of the worlds that have the value on both grounds, pairwise; p of Wilcoxon's
            signed-rank test, of a share McNemar's, two-sided; NaN on the first ground.
    """

    quantity: Quantity
    ground: str
    estimate: Estimate
    difference: Mean | None = None
    p: float = math.nan


def compare(results: Mapping[str, Sequence[Any]],
            quantities: Sequence[Quantity]) -> list[Compared]:
    """Compare grounds; results: ground → results in the order of worlds, the same on each ground.

    Raises:
        StudyError: If there are not as many on each ground.
    """
    counts = {name: len(each) for name, each in results.items()}
    if len(set(counts.values())) != 1:
        raise StudyError(f'results of {counts} worlds are not pairs; valid is the same number')
    found = []
    for quantity in quantities:
        first: Array | None = None
        for ground, each in results.items():
            values = np.array([quantity.of(result) for result in each], dtype=float)
            values[~np.isfinite(values)] = math.nan
            own = quantity.estimate(values)
            if first is None:
                first = values
                found.append(Compared(quantity, ground, own))
                continue
            more = values - first
            more = more[~np.isnan(more)]
            p = (either_alone_p(int(np.sum(more > 0.0)), int(np.sum(more < 0.0)))
                 if quantity.share else signed_rank_p(more))
            found.append(Compared(quantity, ground, own, Mean.of(more), p))
    return found


def comparison_text(compared: Sequence[Compared], first: str) -> str:
    """Return the comparison as a Markdown table."""
    rows = []
    for c, q in zip(compared, adjusted([c.p for c in compared])):
        digits = c.quantity.digits
        against = ['–'] * 3 if c.difference is None else [
            c.difference.text(digits, '+'), f'{c.p:.2g}', f'{q:.2g}']
        rows.append([c.quantity.name, c.ground, c.estimate.text(digits), str(c.estimate.count),
                     *against])
    return '\n'.join([
        f'Means with {100 * CONFIDENCE:.0f} % intervals of Student (shares: Wilson); differences '
        f'to {first} on the same worlds; p of the signed-rank test of Wilcoxon (shares: McNemar); '
        'q is p corrected for the number of tests in this table (Benjamini and Hochberg).', '',
        *markdown_table(('quantity', 'ground', 'mean', 'n', 'difference', 'p', 'q'), rows), ''])


def plot_comparison(results: Mapping[str, Sequence[Any]], quantities: Sequence[Quantity],
                    path: Path) -> None:
    """Write a figure: each quantity over the grounds, one line a world, means with intervals."""
    columns = math.ceil(len(quantities) / 2)
    figure = Figure(figsize=(4.0 * columns, 6.5), layout='constrained')
    panels = figure.subplots(2, columns, squeeze=False).ravel()
    places = np.arange(len(results))
    for quantity, axes in zip(quantities, panels):
        values = np.array([[quantity.of(r) for r in each] for each in results.values()], float)
        values[~np.isfinite(values)] = math.nan
        axes.plot(places, values, '.-', color='0.75', lw=0.8, ms=4)
        for place, row in zip(places, values):
            own = quantity.estimate(row)
            if own.count:
                axes.errorbar(place, own.value, [[own.value - own.low], [own.high - own.value]],
                              fmt='o', color='C0', capsize=4)
        axes.set(title=quantity.name)
        axes.set_xticks(places, list(results))
        axes.grid(alpha=0.3)
    for axes in panels[len(quantities):]:
        axes.remove()
    save_figure(figure, path, StudyError)
