"""Files of arrays are read by several threads at once."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
import gc
from pathlib import Path
import time

import numpy as np
import pytest

from lunar_rover_sim.base.errors import LunarRoverSimError
from lunar_rover_sim.base.files.arrays import map_array, read_archive


@pytest.fixture
def _busy_collector() -> Iterator[None]:
    """Let another thread go on in most collections of garbage, of which there are many."""
    def pause(_phase: str, _info: dict[str, int]) -> None:
        time.sleep(0.0)
    thresholds = gc.get_threshold()
    gc.set_threshold(2)
    gc.callbacks.append(pause)
    yield
    gc.callbacks.remove(pause)
    gc.set_threshold(*thresholds)


@pytest.mark.usefixtures('_busy_collector')
def test_threads_that_read_at_once(tmp_path: Path) -> None:
    """Without a lock Python 3.11 raises SystemError: AST constructor recursion depth mismatch."""
    array, archive = tmp_path / 'a.npy', tmp_path / 'b.npz'
    expected = np.arange(6.0).reshape(2, 3)
    np.save(array, expected)
    np.savez(archive, a=expected)

    def read(_: int) -> None:
        for _ in range(100):
            np.testing.assert_array_equal(map_array(array, LunarRoverSimError), expected)
            arrays = read_archive(archive, LunarRoverSimError, 1000)
            np.testing.assert_array_equal(arrays['a'], expected)
    with ThreadPoolExecutor(3) as pool:
        list(pool.map(read, range(3)))
