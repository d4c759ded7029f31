"""Compiled code that processes share."""

from concurrent.futures import ThreadPoolExecutor
import os
import subprocess
import sys
import threading

import pytest

from lunar_rover_sim.base.compiled import SharedFiles

# A function is compiled for six types by each of three processes, in orders of their own.
CODE = """
import sys
import numpy as np
from lunar_rover_sim.base.compiled import compiled

@compiled
def squares(x):
    total = x[0]
    for k in range(len(x)):
        total += x[k] * x[k]
    return total

kinds = [np.int64, np.float64, np.float32, np.int32, np.int16, np.uint8]
first = int(sys.argv[1])
print(*(int(squares(np.arange(1, 6).astype(kind))) for kind in kinds[first:] + kinds[:first]))
"""


@pytest.fixture
def files(tmp_path):
    return [SharedFiles(str(tmp_path), 'function', 'stamp') for _ in range(2)]


def test_two_that_save_at_a_time_both_find_theirs(files):
    """The second one asks for a name before the first one has written its own into the index."""
    one, two = files
    writes, other = threading.Event(), ThreadPoolExecutor(1)
    save_index = one._save_index

    def slowly(index):
        writes.set()
        saved = other.submit(two.save, 'b', 'of b')
        with pytest.raises(TimeoutError):
            saved.result(0.2)
        save_index(index)
    one._save_index = slowly
    one.save('a', 'of a')
    other.shutdown()
    assert writes.is_set() and [two.load(key) for key in 'abc'] == ['of a', 'of b', None]


def test_what_was_cut_is_compiled_again(files):
    """Killed before the index is written, a process leaves no name of code that is another's."""
    one, two = files
    one._save_index = lambda index: None
    one.save('a', 'of a')
    assert two.load('a') is None


def test_processes_that_compile_at_a_time_get_their_own_code(tmp_path):
    script = tmp_path / 'squares.py'
    script.write_text(CODE)
    environment = {**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path / 'cache')}
    for _ in range(2):      # then they load it
        processes = [subprocess.Popen([sys.executable, script, str(first)], env=environment,
                                      stdout=subprocess.PIPE, text=True) for first in (0, 2, 4)]
        assert [process.communicate()[0].split() for process in processes] == [['56'] * 6] * 3


def test_what_other_files_change_is_compiled_again(tmp_path):
    """A function and a number that a file takes from another one; that file itself stays."""
    environment = {**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path / 'cache')}
    (tmp_path / 'user.py').write_text(
        'from lunar_rover_sim.base.compiled import compiled\nfrom shared import ADDED, twice\n\n'
        '@compiled\ndef result(x):\n    return twice(x) + ADDED\n\nprint(result(3))\n')
    head = 'from lunar_rover_sim.base.compiled import compiled, inlined\n'
    for added, times, expected in ((1, 2, '7'), (1, 20, '61'), (4, 20, '64')):
        (tmp_path / 'shared.py').write_text(
            f'{head}ADDED = {added}\n\n@inlined\ndef twice(x):\n    return {times} * x\n')
        told = subprocess.run([sys.executable, '-B', tmp_path / 'user.py'], env=environment,
                              capture_output=True, text=True, check=True)
        assert told.stdout.strip() == expected
