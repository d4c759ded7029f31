"""The report of the terramechanics study: walks, slopes and pull as text, CSV, figure."""

from __future__ import annotations

from collections.abc import Sequence
import math
from pathlib import Path

from matplotlib.figure import Figure

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.results import csv_table, markdown_table, save_figure
from lunar_rover_sim.judge.studies.terramechanics import GroundWalk, holding

_FIELDS = ('speed_mps', 'lateral_mps', 'slip', 'transport', 'power_w', 'pitch_rms_deg',
           'sinkage_m', 'sinkage_max_m')


def write_all(walks: Sequence[GroundWalk], folder: Path) -> str:
    """Write terramechanics.md, .csv and .png into a folder; return the text."""
    text = report_text(walks)
    atomic_write(folder / 'terramechanics.md', text, StudyError)
    table = csv_table(('ground', 'slope_deg', 'pull', 'outcome', *_FIELDS), (
        (walk.ground.name, walk.ground.slope_deg, walk.ground.pull, walk.outcome,
         *(getattr(walk, name) for name in _FIELDS)) for walk in walks))
    atomic_write(folder / 'terramechanics.csv', table, StudyError)
    plot(walks, folder / 'terramechanics.png')
    return text


def report_text(walks: Sequence[GroundWalk]) -> str:
    """Return the report as Markdown."""
    return '\n'.join([
        '# Terramechanics', '',
        'Slip: 1 - way / way that the loaded feet sweep, along the heading. Transport:'
        ' electric energy / (weight × distance). Pull: backward, over the weight.', '',
        *markdown_table(('ground', 'slope [°]', 'pull', 'outcome', 'speed [m/s]', 'slip [%]',
                         'transport', 'power [W]', 'pitch RMS [°]', 'sinkage [mm]', 'max'),
                        map(_walk_row, walks)), ''])


def _walk_row(w: GroundWalk) -> list[str]:
    transport = '–' if math.isinf(w.transport) else f'{w.transport:.2f}'
    return [w.ground.name, f'{w.ground.slope_deg:g}', f'{w.ground.pull:g}', w.outcome,
            f'{w.speed_mps:.3f}', f'{1e2 * w.slip:.1f}', transport, f'{w.power_w:.2f}',
            f'{w.pitch_rms_deg:.2f}', f'{1e3 * w.sinkage_m:.1f}', f'{1e3 * w.sinkage_max_m:.1f}']


def plot(walks: Sequence[GroundWalk], path: Path) -> None:
    """Write a figure: slip and power against slope, pull against slip, sinkage."""
    figure = Figure(figsize=(11.0, 7.5), layout='constrained')
    (slip, power), (pull, sinkage) = figure.subplots(2, 2)
    for name in dict.fromkeys(walk.ground.name for walk in walks):
        sloping = [w for w in walks if w.ground.name == name and w.ground.pull == 0.0]
        pulled = [w for w in walks if w.ground.name == name and w.ground.slope_deg == 0.0]
        degrees = [w.ground.slope_deg for w in sloping]
        slip.plot(degrees, [1e2 * w.slip for w in sloping], 'o-', ms=3, label=name)
        power.plot(degrees, [w.power_w for w in sloping], 'o-', ms=3)
        held = holding(pulled)
        line, = pull.plot([1e2 * w.slip for w in held], [w.ground.pull for w in held], 'o-', ms=3)
        # Beyond that pull, it depends on the start whether a walk is drawn back.
        later = [w for w in pulled if w.speed_mps > 0.0 and w not in held]
        pull.plot([1e2 * w.slip for w in later], [w.ground.pull for w in later], 'x',
                  color=line.get_color())
        sinkage.plot(degrees, [1e3 * w.sinkage_m for w in sloping], 'o-', ms=3)
    slip.set(xlabel='slope [°]', ylabel='slip [%]', ylim=(-2.0, 100.0))
    power.set(xlabel='slope [°]', ylabel='electric power [W]')
    pull.set(xlabel='slip [%]', ylabel='pull over weight', xlim=(-2.0, 100.0))
    sinkage.set(xlabel='slope [°]', ylabel='mean sinkage of the deepest foot [mm]')
    for axes in (slip, power, pull, sinkage):
        axes.grid(alpha=0.3)
    slip.legend()
    save_figure(figure, path, StudyError)
