"""Messages of errors reach a terminal as one printable line, whatever a file held."""

from __future__ import annotations

import pytest

from lunar_rover_sim.arguments import brief
from lunar_rover_sim.errors import ConfigError, LunarRoverSimError
from lunar_rover_sim.files.yaml_text import parse_yaml


@pytest.mark.parametrize(('message', 'shown'), [
    ('a: 3 is not valid; valid is >= 5 [µm²]', 'a: 3 is not valid; valid is >= 5 [µm²]'),
    ('two\nlines\x1b[31m', 'two\\nlines\\x1b[31m'),
    ('x' * 5000, 'x' * 1500 + ' ...')])
def test_messages_are_one_line(message: str, shown: str) -> None:
    """Control characters are written out, long ones cut."""
    assert str(LunarRoverSimError(message)) == shown


def test_values_are_shown_briefly() -> None:
    """Neither size nor depth nor digits of a value make a message long or slow."""
    deep: list[object] = []
    for _ in range(25):
        deep = [deep, deep]     # 2^25 elements, were it written out
    for value in (deep, 'x' * 10**6, 10**5000, list(range(10**5)), {'k': deep}):
        assert len(brief(value)) < 300
    assert brief([1, 2.5, 'a']) == "[1, 2.5, 'a']"


@pytest.mark.parametrize('text', ['&a 1', '*a', 'a: &x {b: 1}', 'a: !!int 3', '!t {}', '!!str 1'])
def test_yaml_is_plain(text: str) -> None:
    """No anchors, aliases, tags."""
    with pytest.raises(ConfigError, match='not valid YAML: (anchors|tags|found undefined alias)'):
        parse_yaml(text, 'x.yaml')


def test_a_key_twice_is_refused() -> None:
    """At any depth."""
    for text in ('a: 1\na: 2', 'x: [{a: 1, a: 1}]', 'x: {y: {"a": 1, a: 2}}'):
        with pytest.raises(ConfigError, match="'a' is given twice"):
            parse_yaml(text, 'x.yaml')


def test_plain_yaml_is_read() -> None:
    """What people write is read as before: exponents without a point are numbers."""
    assert parse_yaml('a: [1e-3, 1.0e6, 2.5, 1e3x, x, true, null]\nb: {c: "d"}', 'x') == {
        'a': [1e-3, 1e6, 2.5, '1e3x', 'x', True, None], 'b': {'c': 'd'}}
