"""Samples of mutants: a table with a row for each, which keeps what the tests said of it."""

import csv
import dataclasses
import pathlib

from forked import PACKAGE, ROOT

ROOMS = ('bag', 'camera', 'evaluation', 'gait', 'illumination', 'physics', 'regolith', 'sensors',
         'stereo', 'world')


@dataclasses.dataclass
class Mutant:
    """One changed line of one module, and what the tests said of it."""

    module: str
    line: int
    before: str
    after: str
    outcome: str = ''
    by: str = ''    # the test that failed


def modules() -> list[str]:
    """Return the modules of the rooms, relative to the package."""
    return sorted(path.relative_to(ROOT / PACKAGE).as_posix() for room in ROOMS
                  for path in (ROOT / PACKAGE / room).glob('*.py') if path.stem != '__init__')


def write(path: pathlib.Path, sample: list[Mutant]) -> None:
    """Write the sample with its outcomes, at once or not at all."""
    partial = path.with_suffix('.partial')
    with partial.open('w', newline='', encoding='utf-8') as file:
        writer = csv.DictWriter(file, [field.name for field in dataclasses.fields(Mutant)])
        writer.writeheader()
        writer.writerows(dataclasses.asdict(mutant) for mutant in sample)
    partial.replace(path)


def read(path: pathlib.Path) -> list[Mutant]:
    """Read what `write` wrote."""
    with path.open(newline='', encoding='utf-8') as file:
        return [Mutant(row['module'], int(row['line']), row['before'], row['after'],
                       row['outcome'], row['by']) for row in csv.DictReader(file)]
