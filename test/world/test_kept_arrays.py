"""Arrays beside the cache of worlds: computed once a recipe, whatever state their file is in."""

import os

import numpy as np
import pytest

from lunar_rover_sim.world.kept_arrays import kept


@pytest.fixture
def calls(monkeypatch, tmp_path):
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path / 'cache'))
    return []


def computed(calls, recipe):
    def make():
        calls.append(recipe)
        return np.arange(6, dtype=np.float32).reshape(2, 3) * recipe
    return kept('test', [1, recipe], make)


def test_an_array_is_computed_once_for_each_recipe(calls):
    first, again, other = (computed(calls, k) for k in (2, 2, 3))
    assert calls == [2, 3]
    np.testing.assert_array_equal(first, again)
    assert again.dtype == np.float32 and again.flags.writeable
    np.testing.assert_array_equal(other, 1.5 * first)


def test_a_damaged_file_is_written_again(calls, tmp_path, caplog):
    computed(calls, 2)
    file, = (tmp_path / 'cache' / 'arrays').iterdir()
    file.write_bytes(file.read_bytes()[:-5])
    assert computed(calls, 2)[1, 2] == 10.0
    assert 'computing it again' in caplog.text
    computed(calls, 2)
    assert calls == [2, 2]


def test_a_file_that_would_run_code_is_written_again(calls, tmp_path):
    """Unpickling it would make a folder."""
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / 'trapped'),)

    computed(calls, 2)
    file, = (tmp_path / 'cache' / 'arrays').iterdir()
    np.save(file, np.array([Trap()], dtype=object), allow_pickle=True)
    assert computed(calls, 2)[1, 2] == 10.0
    assert calls == [2, 2] and not (tmp_path / 'trapped').exists()


def test_without_a_place_for_it_the_array_is_still_there(calls, tmp_path, caplog):
    (tmp_path / 'cache').write_text('a file, not a folder')
    assert computed(calls, 2)[1, 2] == 10.0
    assert 'is not kept' in caplog.text
