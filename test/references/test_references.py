"""Results that were written down once: a change of one is deliberate, and writes it anew.

A benchmark must not change its numbers unnoticed, also those that are choices. These tests know
nothing of what is right; the tests of the rooms do. `python test/references/write.py` writes the
results anew, see CONTRIBUTING.md.
"""

from pathlib import Path

import pytest
from references.cases import all_cases, found, ROOMS, stored
from references.summary import difference, summarised, Within

CASES = all_cases()


@pytest.mark.parametrize('case', CASES)
def test_the_result_is_the_stored_one(case: str, tmp_path: Path) -> None:
    room, _, name = case.partition('/')
    before = stored(room)
    assert name in before, f'{case} is not stored; write it'
    text = difference(before[name], found(case, tmp_path), case)
    assert not text, f'{text}. If it was to change: python test/references/write.py {case}'


def test_nothing_is_stored_that_is_no_case() -> None:
    assert {f'{room}/{name}' for room in ROOMS for name in stored(room)} == set(CASES)


@pytest.mark.parametrize('one, other', [
    (1, 2), (1.0, 1.00001), ('a', 'b'), (True, False), ([1.0, 2.0], [2.0, 1.0]),
    ([1.0, 2.0, 4.0, 5.0], [2.0, 1.0, 5.0, 4.0]), ({'a': 1}, {'b': 1}), (float('nan'), 1.0),
    ([float('nan'), 1.0], [1.0, float('nan')]), ([0.0, 1.0], [0.0, 1.0 + 1e-5])])
def test_what_differs_is_told(one: object, other: object) -> None:
    assert difference(summarised(one), summarised(one), 'value') == ''
    assert 'value' in difference(summarised(one), summarised(other), 'value')


@pytest.mark.parametrize('one, other', [
    (1.0, 1.0 + 1e-9), ([1.0, 1e-9], [1.0, 2e-9]), (0.0, 1e-15),
    (Within(1.0, 0.1), Within(1.05, 0.1))])
def test_rounding_is_no_difference(one: object, other: object) -> None:
    assert difference(summarised(one), summarised(other), 'value') == ''
