"""Grounds against each other on the same worlds: means, intervals and paired tests.

Straight walks are compared over the relief of regolith: of each seed one world, of the recipe of
`baseline` without craters and rocks, on every ground at every speed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import dataclasses
import functools
import math
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
import numpy as np

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.results import markdown_table, save_figure
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.judge.evaluation.statistics import (adjusted, CONFIDENCE, either_alone_p,
                                                         Estimate, Mean, Share, signed_rank_p)
from lunar_rover_sim.judge.studies.study_folder import map_in_processes
from lunar_rover_sim.judge.studies.terramechanics import Ground, GroundWalk, measure, WalkSettings


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


SIZE_M, SAMPLES = 12.8, 257   # of the worlds: room for a walk, and no more
WALKED = 'walked'

WALK_QUANTITIES = (
    Quantity('speed [m/s]', lambda w: w.speed_mps, 4),
    Quantity('slip [%]', lambda w: 1e2 * w.slip, 1),
    Quantity('electric cost of transport', lambda w: w.transport, 2),
    Quantity('electric power [W]', lambda w: w.power_w, 3),
    Quantity('pitch RMS [°]', lambda w: w.pitch_rms_deg, 2),
    Quantity('share that stops', lambda w: float(w.outcome != WALKED), 2, share=True))

Walks = Mapping[float, Mapping[str, Sequence[GroundWalk]]]


def walk_study(settings: WalkSettings, grounds: Sequence[str],
               speeds_mps: Sequence[float], seeds: Sequence[int], workers: int = 1,
               progress: Callable[[int, int], object] = lambda done, total: None) -> Walks:
    """Return speed → ground → walks in the order of seeds."""
    worlds = WorldConfig()
    relief = dataclasses.replace(
        worlds, size_m=SIZE_M, craters=dataclasses.replace(worlds.craters, density=0.0),
        rocks=dataclasses.replace(worlds.rocks, abundance=0.0),
        surroundings=dataclasses.replace(worlds.surroundings, samples=SAMPLES))
    jobs = [(speed, name, seed) for seed in seeds for speed in speeds_mps for name in grounds]
    walks = dict(zip(jobs, map_in_processes(functools.partial(_walk, settings, relief), jobs,
                                            workers,
                                            lambda _, done, total: progress(done, total))))
    return {speed: {name: [walks[speed, name, seed] for seed in seeds] for name in grounds}
            for speed in speeds_mps}


def write_walks(walks: Walks, folder: Path) -> str:
    """Write grounds.md and a figure for each speed into a folder; return the text."""
    parts = ['# Straight walks on several grounds', '']
    for speed, results in walks.items():
        parts += [f'## {speed:g} m/s', '',
                  comparison_text(compare(results, WALK_QUANTITIES), next(iter(results)))]
        plot_comparison(results, WALK_QUANTITIES, folder / f'grounds_{speed:g}.png')
    text = '\n'.join(parts)
    atomic_write(folder / 'grounds.md', text, StudyError)
    return text


def _walk(settings: WalkSettings, relief: WorldConfig,
          job: tuple[float, str, int]) -> GroundWalk:
    speed, name, seed = job
    return measure(dataclasses.replace(settings, speed_mps=speed), Ground(name),
                   _relief_world(relief, seed))


@functools.lru_cache(maxsize=1)
def _relief_world(config: WorldConfig, seed: int) -> World:
    return build_world(config, seed)
