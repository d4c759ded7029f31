"""Freed memory goes back to the system although what was allocated last is still used."""

import sys

import psutil
import pytest

from lunar_rover_sim.base.process import return_freed


@pytest.mark.skipif(not sys.platform.startswith('linux'), reason='glibc alone keeps it so')
def test_memory_below_what_is_used_goes_back():
    used = psutil.Process().memory_info
    blocks = [bytearray(100_000) for _ in range(1_000)]
    full, kept = used().rss, blocks[-1]
    del blocks
    return_freed()
    assert used().rss < full - 50_000_000 and len(kept) == 100_000
