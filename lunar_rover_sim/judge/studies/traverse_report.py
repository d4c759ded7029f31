"""The report of the traverse study: table, CSV and the paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure
import numpy as np

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.results import csv_table, markdown_table, save_figure
from lunar_rover_sim.base.frames import distance_along
from lunar_rover_sim.judge.studies.ground_comparison import (compare, comparison_text,
                                                             plot_comparison, Quantity)
from lunar_rover_sim.judge.studies.traverse import DRIVEN, DUG_IN, STRANDED, TIPPED_OVER, Traverse

ALLOWED_SHARE = 0.05   # of drives that end tipped over or stranded: one in twenty

_FIELDS = ('seed', 'outcome', 'driven_s', 'distance_m', 'speed_mps', 'waypoints', 'stuck',
           'tilted', 'slip', 'transport_mechanical', 'transport_electric', 'tilt_mean_deg',
           'tilt_p95_deg', 'tilt_max_deg', 'pitch_rms_deg', 'penetration_max_m')


def tipped(results: Sequence[Traverse]) -> int:
    """Return how many drives ended tipped over."""
    return sum(result.tipped_over for result in results)


def stranded(results: Sequence[Traverse]) -> int:
    """Return how many drives ended stuck in one place."""
    return sum(result.outcome in (STRANDED, DUG_IN) for result in results)


def acceptable(results: Sequence[Traverse]) -> bool:
    """Return whether all drives could be simulated and at most one in twenty was lost.

    A drive is lost if the rover tipped over or is stranded.
    """
    return (all(result.outcome in (DRIVEN, TIPPED_OVER, STRANDED, DUG_IN) for result in results)
            and tipped(results) + stranded(results)
            <= max(1, round(ALLOWED_SHARE * len(results))))


def report_text(results: Sequence[Traverse], scenario: str) -> str:
    """Return the report as Markdown."""
    driven = sum(result.driven_s for result in results)
    distance = sum(result.distance_m for result in results)
    lines = [f'# Traverse of {scenario}', '',
             f'{len(results)} worlds, {driven / 60.0:.1f} min, {distance:.1f} m:'
             f' {tipped(results)} tipped over, {stranded(results)} stranded,'
             f' {sum(r.stuck for r in results)} times stuck and'
             f' {sum(r.tilted for r in results)} times stopped by tilt, and backed up.', '',
             'Slip: 1 - true distance / commanded distance of the feet in stance.'
             ' Transport: energy / (weight × distance), mechanical at the legs, electric from the'
             ' supply. Penetration: of a spoke tip into ground or rock, at 200 Hz.', '',
             *markdown_table(
                 ('seed', 'outcome', 'time [s]', 'distance [m]', 'speed [m/s]', 'waypoints',
                  'stuck', 'tilted', 'slip', 'transport mech.', 'electric', 'tilt mean [°]',
                  '95 %', 'max', 'pitch RMS [°]', 'penetration max [mm]'),
                 ([str(r.seed), r.outcome, f'{r.driven_s:.0f}', f'{r.distance_m:.2f}',
                   f'{r.speed_mps:.3f}', str(r.waypoints), str(r.stuck), str(r.tilted),
                   f'{r.slip:.3f}', f'{r.transport_mechanical:.2f}',
                   f'{r.transport_electric:.2f}', f'{r.tilt_mean_deg:.1f}',
                   f'{r.tilt_p95_deg:.1f}', f'{r.tilt_max_deg:.1f}',
                   f'{r.pitch_rms_deg:.2f}', f'{1000.0 * r.penetration_max_m:.1f}']
                  for r in results))]
    return '\n'.join(lines) + '\n'


def write_all(results: Sequence[Traverse], scenario: str, folder: Path) -> str:
    """Write traverse.md, traverse.csv and traverse.png; return the text of the first.

    Raises:
        StudyError: If one cannot be written.
    """
    text = report_text(results, scenario)
    atomic_write(folder / 'traverse.md', text, StudyError)
    write_csv(results, folder / 'traverse.csv')
    plot_paths(results, folder / 'traverse.png')
    return text


def write_csv(results: Sequence[Traverse], path: str | Path) -> None:
    """Write one row per drive; raise StudyError if the file cannot be written."""
    rows = ([getattr(result, name) for name in _FIELDS] for result in results)
    atomic_write(path, csv_table(_FIELDS, rows), StudyError)


def plot_paths(results: Sequence[Traverse], path: str | Path) -> None:
    """Write a plot of all paths, and of distance over time.

    Raises:
        StudyError: If the file cannot be written.
    """
    figure = Figure(figsize=(12.0, 5.5), layout='constrained')
    above, along = figure.subplots(1, 2)
    for result in results:
        if len(result.path_m) < 2:
            continue
        x, y = result.path_m[:, 0], result.path_m[:, 1]
        line, = above.plot(x, y, lw=0.8, label=str(result.seed))
        above.plot(x[-1], y[-1], 'x' if result.tipped_over else '.', color=line.get_color())
        gone = distance_along(result.path_m[:, :2])
        along.plot(np.linspace(0.0, result.driven_s, len(gone)), gone, lw=0.8,
                   color=line.get_color())
    above.set(xlabel='x [m]', ylabel='y [m]', title='paths; x: tipped over')
    above.set_aspect('equal')
    along.set(xlabel='time [s]', ylabel='distance [m]')
    for axis in (above, along):
        axis.grid(alpha=0.3)
    above.legend(title='seed', fontsize=7, ncols=2)
    save_figure(figure, path, StudyError)


QUANTITIES = (
    Quantity('speed [m/s]', lambda r: r.speed_mps, 4),
    Quantity('slip [%]', lambda r: 1e2 * r.slip, 1),
    Quantity('electric cost of transport', lambda r: r.transport_electric, 2),
    Quantity('mechanical cost of transport', lambda r: r.transport_mechanical, 2),
    Quantity('pitch RMS [°]', lambda r: r.pitch_rms_deg, 2),
    Quantity('stops per drive', lambda r: float(r.stuck + r.tilted), 2))


def write_grounds(results: Mapping[str, Sequence[Traverse]], scenario: str, folder: Path) -> str:
    """Write grounds.md and grounds.png, and a report of each ground; return the text."""
    grounds = list(results)
    text = (f'# Traverses of {scenario} on {", ".join(grounds)}\n\n'
            + comparison_text(compare(results, QUANTITIES), grounds[0]) + '\n'
            + '\n'.join(f'{name}: {len(each)} drives, {tipped(each)} tipped over,'
                        f' {stranded(each)} stranded.\n'
                        for name, each in results.items()))
    atomic_write(folder / 'grounds.md', text, StudyError)
    plot_comparison(results, QUANTITIES, folder / 'grounds.png')
    for name, each in results.items():
        (folder / name).mkdir(exist_ok=True)
        write_all(each, f'{scenario} on {name}', folder / name)
    return text
