"""Seeds of drives, as they are named on the command line and in reports."""

from __future__ import annotations

from collections.abc import Iterable
import re

from lunar_rover_sim.arguments import brief
from lunar_rover_sim.errors import SlamError

_MOST_SEEDS = 10_000


def seeds_of(text: str) -> tuple[int, ...]:
    """Return the seeds that a text names: `6` is 1 to 6, `7-10` and `1,4,7-10` are as they stand.

    Raises SlamError if it names none, or one twice.
    """
    found: list[int] = []
    for part in text.split(','):
        match = re.fullmatch(r'\s*(\d{1,9})\s*(?:-\s*(\d{1,9})\s*)?', part, re.ASCII)
        if match is None:
            raise SlamError(f'seeds: {brief(text)} is not valid; valid is N for 1 to N, FROM-TO, '
                            'or several of these with commas')
        first, last = int(match[1]), int(match[2] or match[1])
        if match[2] is None and ',' not in text:
            first = 1
        if not 1 <= first <= last or last - first >= _MOST_SEEDS:
            raise SlamError(f'seeds: {brief(part.strip())} is not valid; valid are seeds from 1, '
                            f'the lower one first, at most {_MOST_SEEDS}')
        found += range(first, last + 1)
    double = next((seed for seed in found if found.count(seed) > 1), None)
    if double is not None:
        raise SlamError(f'seeds: {brief(text)} names {double} twice')
    return tuple(found)


def text_of_seeds(seeds: Iterable[int]) -> str:
    """Return seeds in words: `1 to 6, 9`."""
    runs: list[list[int]] = []
    for seed in sorted(set(seeds)):
        if runs and runs[-1][-1] == seed - 1:
            runs[-1].append(seed)
        else:
            runs.append([seed])
    return ', '.join(str(run[0]) if len(run) == 1 else f'{run[0]} to {run[-1]}' for run in runs)
