"""Tables and texts on a terminal of any width, in a pipe or a file: nothing is cut off.

On a terminal, and where COLUMNS says a width, cells are folded to it. In a pipe lines are as long
as what they say, so that one row is one line for `grep`.
"""

from __future__ import annotations

from collections.abc import Sequence
import os
from typing import Any

from rich.console import Console
from rich.markdown import Markdown
from rich.table import Table

_UNBOUNDED = 100_000
_CUT = '…'     # what rich puts in the place of text


def console() -> Console:
    """Return a console for stdout."""
    of_terminal = Console()
    if of_terminal.is_terminal or os.environ.get('COLUMNS'):
        return of_terminal
    return Console(width=_UNBOUNDED)


def table(titles: Sequence[str], left: int, **options: Any) -> Table:
    """Return a table, of whose columns the first so many are for text, the others for numbers.

    options: of rich.table.Table
    """
    result = Table(**options)
    for k, title in enumerate(titles):
        result.add_column(title, justify='left' if k < left else 'right', overflow='fold')
    return result


def print_markdown(to: Console, text: str) -> None:
    """Print a report: formatted where its tables fit on a terminal, else as it is written."""
    if to.is_terminal:
        with to.capture() as capture:
            to.print(Markdown(text))
        if _CUT in text or _CUT not in capture.get():
            to.print(Markdown(text))
            return
    to.print(text, highlight=False, markup=False, soft_wrap=True)
