"""Docstrings of this package are plain text; autodoc wants reStructuredText.

Paragraphs stay paragraphs, `code` becomes literal, indented paragraphs are formulas and become
literal blocks, and lines of the form `name: meaning` become a list. Nothing in a docstring is
markup by accident.
"""

from __future__ import annotations

import re
from typing import Any

_ITEM = re.compile(r'(?:- |[A-Za-z_]\w*\*?(?:, [A-Za-z_]\w*\*?)*: )')


def escaped(text: str) -> str:
    """Return text with `code` as literals and everything else meaning itself."""
    pieces = text.split('`')
    if len(pieces) % 2 == 0:        # a lone backquote is itself
        return re.sub(r'([\\*|_`])', r'\\\1', text)
    return ''.join(f'\\ ``{piece}``\\ ' if k % 2 and piece else
                   re.sub(r'([\\*|_])', r'\\\1', piece)
                   for k, piece in enumerate(pieces)).strip()


def paragraph(lines: list[str]) -> list[str]:
    """Return the lines of one paragraph as reStructuredText."""
    if all(line.startswith('  ') for line in lines):
        return ['::', '', *(f'    {line}' for line in lines)]
    if not _ITEM.match(lines[0]):
        return [escaped(' '.join(line.strip() for line in lines))]
    items: list[str] = []
    for line in lines:
        if _ITEM.match(line) or not line.startswith(' '):
            items.append(line.removeprefix('- '))
        else:
            items[-1] += ' ' + line.strip()
    result = []
    for item in items:
        name, colon, meaning = item.partition(': ')
        marked = colon and _ITEM.match(item)
        result.append(f'- ``{name}``: {escaped(meaning)}' if marked else f'- {escaped(item)}')
    return result


def process(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Rewrite a docstring in place: a handler of `autodoc-process-docstring`."""
    result: list[str] = []
    block: list[str] = []
    for line in [*lines, '']:
        if line.strip():
            block.append(line)
        elif block:
            result += [*paragraph(block), '']
            block = []
    lines[:] = result
