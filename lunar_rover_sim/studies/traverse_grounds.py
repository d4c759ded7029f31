"""The traverse study on several grounds: the same worlds and routes, rigid and soft."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from lunar_rover_sim.errors import StudyError
from lunar_rover_sim.files.atomic import atomic_write
from lunar_rover_sim.studies import traverse_report
from lunar_rover_sim.studies.ground_comparison import (compare, comparison_text, plot_comparison,
                                                       Quantity)
from lunar_rover_sim.studies.traverse_result import Traverse

QUANTITIES = (
    Quantity('speed [m/s]', lambda r: r.speed_mps, 4),
    Quantity('slip [%]', lambda r: 1e2 * r.slip, 1),
    Quantity('electric cost of transport', lambda r: r.transport_electric, 2),
    Quantity('mechanical cost of transport', lambda r: r.transport_mechanical, 2),
    Quantity('pitch RMS [°]', lambda r: r.pitch_rms_deg, 2),
    Quantity('stops per drive', lambda r: float(r.stuck + r.tilted), 2))


def write_all(results: Mapping[str, Sequence[Traverse]], scenario: str, folder: Path) -> str:
    """Write grounds.md and grounds.png, and a report of each ground; return the text."""
    grounds = list(results)
    text = (f'# Traverses of {scenario} on {", ".join(grounds)}\n\n'
            + comparison_text(compare(results, QUANTITIES), grounds[0]) + '\n'
            + '\n'.join(f'{name}: {len(each)} drives, {traverse_report.tipped(each)} tipped over,'
                        f' {traverse_report.stranded(each)} stranded.\n'
                        for name, each in results.items()))
    atomic_write(folder / 'grounds.md', text, StudyError)
    plot_comparison(results, QUANTITIES, folder / 'grounds.png')
    for name, each in results.items():
        (folder / name).mkdir(exist_ok=True)
        traverse_report.write_all(each, f'{scenario} on {name}', folder / name)
    return text
