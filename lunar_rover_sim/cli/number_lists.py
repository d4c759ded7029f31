"""Arguments of the command line that are several numbers, with commas or blanks between them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
import math
import re


def numbers(*counts: int) -> Callable[[str], tuple[float, ...]]:
    """Return what turns the text of an argument into so many finite numbers, for argparse.

    counts: the numbers of numbers that are valid
    """
    def convert(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in re.split(r'[,\s]+', text.strip()))
        except ValueError:
            raise argparse.ArgumentTypeError(f'{text!r} is not a list of numbers') from None
        if not all(map(math.isfinite, values)):
            raise argparse.ArgumentTypeError(f'{text!r} is not valid; valid is finite numbers')
        if len(values) not in counts:
            wanted = ' or '.join(map(str, counts))
            raise argparse.ArgumentTypeError(f'{text!r} is not {wanted} numbers')
        return values
    return convert
