"""Pages are written so that a difference can be read: short lines, or one sentence a line."""

from __future__ import annotations

from pathlib import Path
import re

import pytest
from snippets import ROOT

COLUMNS = 110
PAGES = [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md',
         *(path for path in sorted((ROOT / 'docs').rglob('*.md'))
           if not {'_build', '_generated'} & set(path.parts))]
# What may hold a full stop within a sentence.
ASIDE = re.compile(r'`[^`]*`|\]\([^)]*\)|\([^()]*\)|\b(?:e\.g|i\.e|cf|al|Nov|[A-Z])\. |^\s*\d+\. ')


def typed(page: Path) -> str:
    """Return the text of a page but what a script writes into it."""
    return re.sub('<!-- Written by .*<!-- End of ', '', page.read_text(encoding='utf-8'),
                  flags=re.DOTALL)


def prose(page: Path) -> list[str]:
    """Return the lines of a page but those of code and tables."""
    lines, fence = [], ''
    for line in typed(page).splitlines():
        mark = re.match(r'\s*(`{3,}|:{3,})', line)
        if mark:
            fence = '' if mark[1] == fence else fence or mark[1]
        elif not fence and not line.startswith('|'):
            lines.append(line)
    return lines


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_lines(page: Path) -> None:
    """A line has at most 110 columns, or one sentence; a link has a text, as forges need it."""
    long = [line for line in prose(page) if len(line) > COLUMNS
            and re.search(r'[.!?] [A-Z`*\[]', ASIDE.sub('', line).strip())]
    assert not long
    assert '[](' not in page.read_text(encoding='utf-8')


def test_status_of_howtos() -> None:
    """Every how-to is in the index under its title, and by what it is known to work."""
    folder = ROOT / 'docs' / 'howto'
    index = (folder / 'index.md').read_text(encoding='utf-8')
    rows = re.findall(r'^\| \[([^]]+)\]\((\w+\.md)\) \| (.+) \|$', index, re.M)
    titles = {path.name: path.read_text(encoding='utf-8').splitlines()[0].removeprefix('# ')
              for path in folder.glob('*.md') if path.name != 'index.md'}
    assert {name: title for title, name, _ in rows} == titles
    assert all(re.match('tests|by hand|untried', status) for *_, status in rows)
