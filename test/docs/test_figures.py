"""Figures of pages come from result files, which know what they depend on."""

from __future__ import annotations

import json
from pathlib import Path
import re
from types import ModuleType

import pytest
from snippets import module_of, ROOT


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    """Return docs/figures.py on a checkout of two files."""
    module = module_of(ROOT / 'docs' / 'figures.py')
    monkeypatch.setattr(module, 'ROOT', tmp_path)
    monkeypatch.setattr(module, 'RESULTS', tmp_path)
    monkeypatch.setattr(module, 'SUBJECTS', {'light': ('*.csv::sum',)})
    (tmp_path / 'a.csv').write_text('sum = 1\nremark\n')
    program = "import json, sys; json.dump(dict(mean=0.25), open(sys.argv[1], 'w'))"
    (tmp_path / 'glow.json').write_text(json.dumps(
        {'command': f'python -c "{program}" {{file}}', 'depends': ['light']}))
    return module


def test_a_figure_is_marked_once_what_it_depends_on_has_changed(figures: ModuleType) -> None:
    """Measured, it stands without a mark, until a file of its subject changes where it counts."""
    assert figures.substitutions()['glow'].get('mean') is None
    figures.measure(['glow'])
    assert figures.substitutions()['glow']['mean'] == '0.25'
    (figures.ROOT / 'a.csv').write_text('sum = 1\nanother\n')
    assert not figures.changed(figures.read()['glow'])
    (figures.ROOT / 'a.csv').write_text('sum = 2\nanother\n')
    assert figures.substitutions()['glow']['mean'] == '0.25 †'
    assert figures.substitutions()['glow']['where'].endswith('† before a change of the light**')
    figures.measure(['glow'])
    assert figures.substitutions()['glow']['mean'] == '0.25'


def test_tables_are_kept_and_what_was_stopped_goes_on(figures: ModuleType) -> None:
    """A plain table, one with a title, one of boxes; a kept folder is there until it is done."""
    file = figures.RESULTS / 'rows.json'
    file.write_text(json.dumps({'depends': ['light'], 'command': (
        'test -d {kept} && test ! -e {new} || { mkdir -p {kept} {new}; exit 3; }; '
        "printf 'x\\n| a | b |\\n|---|:-:|\\n| 1 | 2 |\\n## Far\\n│ c │\\n│ 3 │\\n'")}))
    with pytest.raises(SystemExit, match='rows: ended with status 3'):
        figures.measure(['rows'])
    figures.measure(['rows'])
    assert figures.read()['rows']['table'] == ['| a | b |', '|---|---|', '| 1 | 2 |', '',
                                               '**Far**', '', '| c |', '|---|', '| 3 |']
    assert figures.substitutions()['rows']['table'].startswith('| a | b |\n')
    assert not list((figures.ROOT / 'build' / 'figures').iterdir())


def test_files_of_a_folder_stay_for_pages(figures: ModuleType) -> None:
    """They are copied before the folder goes."""
    (figures.ROOT / 'pages' / 'results').mkdir(parents=True)
    figures.RESULTS = figures.ROOT / 'pages' / 'results'
    (figures.RESULTS / 'rows.json').write_text(json.dumps(
        {'depends': ['light'], 'files': {'all.csv': 'drives.csv'},
         'command': "mkdir -p {kept}; echo 'a,b' > {kept}/all.csv"}))
    figures.measure(['rows'])
    assert (figures.ROOT / 'pages' / 'drives.csv').read_text() == 'a,b\n'


def test_pages_take_figures_that_exist() -> None:
    """And each result is taken by a page."""
    figures = module_of(ROOT / 'docs' / 'figures.py')
    known = figures.substitutions()
    taken = {(name, value) for page in (ROOT / 'docs').rglob('*.md')
             for name, value in re.findall(r'\{\{ (\w+)\.(\w+) \}\}', page.read_text('utf-8'))}
    assert {name for name, _ in taken} == set(known)
    assert all(value in known[name] for name, value in taken)
    for result in figures.read().values():
        assert set(result['depends']) <= set(figures.SUBJECTS)
