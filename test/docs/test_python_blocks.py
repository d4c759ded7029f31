"""Python in README and documentation runs, page by page, in a folder with a small bag."""

from __future__ import annotations

from collections.abc import Iterator
import itertools
import os
from pathlib import Path

from conftest import PLAIN, SMALL
import pytest
from snippets import Snippet, snippets
from synthetic_bag import drive, write

from lunar_rover_sim.run.scenario import Scenario

# Blocks that start a graph, and a node, are run by test_tutorials_with_ros.
PAGES = {page: list(blocks) for page, blocks in itertools.groupby(
    (snippet for snippet in snippets('python') if 'record(' not in snippet.text),
    key=lambda snippet: snippet.page)}
PROGRAMS = {'controller.md'}


@pytest.fixture()
def folder(tmp_path: Path) -> Iterator[Path]:
    """Return a folder with a bag, which is the working directory."""
    before = os.getcwd()
    (tmp_path / 'runs' / 'a').mkdir(parents=True)
    write(tmp_path / 'runs' / 'a' / 'bag', drive())
    os.chdir(tmp_path)
    yield tmp_path
    os.chdir(before)


@pytest.mark.parametrize('blocks', [
    pytest.param(blocks, id=blocks[0].name) for page, blocks in PAGES.items()
    if page.name not in PROGRAMS])
def test_page(blocks: list[Snippet], folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The blocks of a page run one after the other, on a small world with small images."""
    load = Scenario.load
    monkeypatch.setattr(Scenario, 'load', lambda name, **options: load(
        name, (*SMALL, *PLAIN), **options))
    namespace: dict[str, object] = {}
    for block in blocks:
        exec(compile(block.text, block.name, 'exec'), namespace)
