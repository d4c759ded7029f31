"""Locks between processes: held once, and made or not."""

import os
from pathlib import Path

import pytest

from lunar_rover_sim.bag import marker
from lunar_rover_sim.files.paths import lock


@pytest.mark.parametrize('name', ['file', '.'])
def test_a_lock_is_held_once(tmp_path: Path, name: str) -> None:
    """On a file that is made, and on a folder."""
    first = lock(tmp_path / name)
    with pytest.raises(BlockingIOError):
        lock(tmp_path / name)
    os.close(first)
    os.close(lock(tmp_path / name))


def test_a_bag_without_a_mark_gets_none(tmp_path: Path) -> None:
    """An empty mark would call a complete bag incomplete."""
    with pytest.raises(FileNotFoundError):
        marker.lock(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_mark_of_a_bag_is_locked(tmp_path: Path) -> None:
    """As long as the file is open."""
    marker.mark(tmp_path)
    with marker.lock(tmp_path), pytest.raises(BlockingIOError):
        marker.lock(tmp_path)
    marker.lock(tmp_path).close()
