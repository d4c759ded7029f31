"""What writes the generated parts of the documentation: tables."""

from __future__ import annotations

import re
from types import ModuleType

import pytest
from snippets import module_of, ROOT

from lunar_rover_sim.base.topics import CONTRACT
from lunar_rover_sim.run.node_config import NODE_CONFIGS, RenderNodeConfig


def script(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Import a script of docs/."""
    monkeypatch.syspath_prepend(str(ROOT / 'docs'))
    return module_of(ROOT / 'docs' / f'{name}.py')


def test_tables_are_complete(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every topic, parameter and command has its line."""
    generate = script('generate', monkeypatch)
    text = generate.topic_table()
    named = [name for row in text.splitlines()
             for name in re.findall('`(.+?)`', row.partition(' | ')[0])]
    assert sorted(named) == sorted(topic.name for topic in CONTRACT)
    text = generate.parameter_tables()
    assert all(f'## `{node}`' in text for node in NODE_CONFIGS)
    assert all(f'`{name}`' in text
               for name, _, info, _ in RenderNodeConfig().flatten(documented=True))
    text = generate.command_pages()
    assert '## `bag hash BAG`' in text
    assert '| `--duration S` | simulated time [s] |' in text


def test_tables_in_git_are_those_of_the_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """`python docs/generate.py` writes them."""
    assert not list(script('generate', monkeypatch).outdated(ROOT / 'docs'))
