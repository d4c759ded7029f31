"""Words and tables of messages and reports."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def counted(count: int, thing: str) -> str:
    """Return `1 world`, `2 worlds`: a number, and a noun whose plural ends in s."""
    return f'{count} {thing}' if count == 1 else f'{count} {thing}s'


def markdown_table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a table in Markdown; a `|` within a cell is escaped."""
    return ['| ' + ' | '.join(cell.replace('|', r'\|') for cell in row) + ' |'
            for row in (titles, ['---'] * len(titles), *rows)]
