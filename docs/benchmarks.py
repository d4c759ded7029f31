"""Tables and a figure of published benchmarks, from the CSV files that hold every drive."""

from __future__ import annotations

from contextlib import redirect_stdout
import csv
import io
from pathlib import Path
from tempfile import TemporaryDirectory

from matplotlib.figure import Figure

from lunar_rover_sim.cli.main import execute

MEASUREMENTS = Path(__file__).parent / 'measurements'
# Columns of `slam table` that the pages show; a sweep adds the name of its parameter.
SHOWN = ['scenario', 'sensor', 'system', 'success', 'ATE [m]', 'scale', 'RPE [m per m]',
         'tracked [%]']
NAMES = {'reference': 'reference', 'orbslam3': 'ORB-SLAM3'}


def table(drives: Path) -> str:
    """Return the Markdown table of a CSV of drives, as `slam table` makes it.

    Columns of a single value are left out.
    """
    with TemporaryDirectory() as folder, redirect_stdout(io.StringIO()):
        execute(['slam', 'table', str(drives), '-o', folder])
        text = Path(folder, 'table.md').read_text(encoding='utf-8')
    rows = [[cell.strip() for cell in line.strip('|').split(' | ')]
            for line in text.splitlines() if line.startswith('| ') and '---' not in line]
    head, *body = rows
    columns = [k for k, name in enumerate(head)
               if (name in SHOWN or '.' in name.split()[0]) and len({row[k] for row in body}) > 1]
    lines = [[NAMES.get(row[k], row[k]) for k in columns] for row in (head, *body)]
    lines.insert(1, ['---'] * len(columns))
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines) + '\n'


def figure(drives: Path, target: Path) -> None:
    """Draw the error of every drive that succeeded, by scenario, sensor and system, as SVG."""
    with drives.open(encoding='utf-8', newline='') as file:
        rows = [row for row in csv.DictReader(file) if row['ate_m']
                and float(row['tracked_share']) >= 0.9]
    groups = list(dict.fromkeys((row['scenario'], row['sensor']) for row in rows))
    picture = Figure(figsize=(9.0, 3.6), layout='constrained')
    axes = picture.add_subplot()
    for k, (system, label) in enumerate(NAMES.items()):
        places, errors = [], []
        for row in rows:
            if row['system'] == system:
                group = groups.index((row['scenario'], row['sensor']))
                places.append(group + 0.3 * (k - 0.5))
                errors.append(1e3 * float(row['ate_m']))
        axes.semilogy(places, errors, 'o', alpha=0.5, label=label)
    axes.set_xticks(range(len(groups)), ['\n'.join(group) for group in groups])
    axes.set_ylabel('ATE of a successful drive [mm]')
    axes.grid(axis='y', alpha=0.3)
    axes.legend()
    picture.savefig(target, format='svg', metadata={'Date': None})


def write_all(folder: Path) -> None:
    """Write the tables and the figure whose CSV files are newer, into a folder."""
    for drives in (MEASUREMENTS / 'table_1.csv', MEASUREMENTS / 'table_1_rates.csv'):
        target = folder / f'{drives.stem}.md'
        if not target.is_file() or target.stat().st_mtime < drives.stat().st_mtime:
            target.write_text(table(drives), encoding='utf-8')
            if drives.stem == 'table_1':
                figure(drives, folder / 'table_1.svg')
