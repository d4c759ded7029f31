"""A share of `portability.py`: the same tests pass as on a processor of 2008."""

import os

import numpy as np
from portability import outcome, PARTS, run, switches, TEST
import pytest

CHOSEN = ('regression', 'ground/world/test_same_everywhere.py', 'rover/gait/test_controller.py',
          'rover/physics/test_walk.py', 'image/illumination/test_hapke.py',
          'judge/evaluation/test_metrics.py', 'image/lidar/test_returns.py')


def test_chosen_tests_pass_with_all_switches():
    """Code of NumPy, the C library, OpenCV, Numba and OpenBLAS for old processors, all at once."""
    found, said = run([str(TEST / name) for name in CHOSEN], switches()['all of these'], [], 500.0)
    assert found.isdigit() and int(found) > 50, said


def test_code_of_another_vector_width_is_not_drawn_with(tmp_path):
    """Mesa's cache of shaders does not tell widths apart: code for 256 bit corrupts the heap."""
    test = [str(TEST / 'image/rendering/test_rock_looks.py::test_rocks_are_drawn_to_300_m')]
    for width in ({}, {'LP_NATIVE_VECTOR_WIDTH': '128'}):
        found, said = run(test, {'MESA_SHADER_CACHE_DIR': str(tmp_path), **width}, [], 200.0)
        assert found == '1', said


def test_what_is_switched_off_is_there():
    """NumPy refuses names that it does not know, and those that it cannot do without."""
    core = np._core if hasattr(np, '_core') else np.core
    named = switches()['NumPy without AVX2']['NPY_DISABLE_CPU_FEATURES'].split()
    assert set(named) <= set(core._multiarray_umath.__cpu_dispatch__)
    newest = switches()['NumPy without AVX-512']['NPY_DISABLE_CPU_FEATURES'].split()
    assert set(newest) <= set(named) and not {'AVX2', 'X86_V3'} & set(newest)
    if os.uname().machine == 'x86_64' and core._multiarray_umath.__cpu_features__.get('AVX2'):
        assert named


def test_parts_are_folders_of_tests():
    assert all((TEST / folder).is_dir() for folders in PARTS.values() for folder in folders)


@pytest.mark.parametrize(('said', 'status', 'expected'), [
    ('..\n5 passed in 3.1s\n', 0, '5'), ('2 failed, 3 passed, 1 error in 9s', 1, '3, 3 failed'),
    ('', -4, 'signal 4'), ('no tests ran in 0.1s', 5, 'status 5')])
def test_outcome_of_a_part(said, status, expected):
    assert outcome(said, status) == expected
