"""Simulated time by the wall clock: what is made up for, given up and reported."""

from __future__ import annotations

import re
from typing import Any

import pytest

from lunar_rover_sim.nodes.pacing import WallPace


class Wall:
    """A wall clock that the test sets, and a log."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.lines: list[str] = []

    def monotonic(self) -> float:
        """Return the time [s]."""
        return self.now_s

    def warning(self, text: str) -> None:
        """Keep a line."""
        self.lines.append(text)


@pytest.fixture()
def wall(monkeypatch: pytest.MonkeyPatch) -> Wall:
    """Give a wall clock that stands still."""
    wall = Wall()
    monkeypatch.setattr('lunar_rover_sim.nodes.pacing.time', wall)
    return wall


def pace(wall: Any, factor: float = 1.0) -> WallPace:
    """Return a pace with periods of 5 ms, of which 20 may be made up for."""
    return WallPace(factor, 5_000_000, 20, wall)


def test_what_is_due_follows_factor_and_wall_clock(wall: Wall) -> None:
    """Half the speed: half the states."""
    slow = pace(wall, 0.5)
    wall.now_s += 0.1
    assert slow.due_periods(0) == 10
    assert slow.due_periods(50_000_000) == 0
    assert not wall.lines


def test_a_slow_machine_is_reported_once_a_minute_with_the_mean(wall: Wall) -> None:
    """Half of the wall time passes as simulated time, for three minutes."""
    real = pace(wall)
    now_ns = 0
    for _ in range(900):
        wall.now_s += 0.2
        real.due_periods(now_ns)
        now_ns += 100_000_000
    assert len(wall.lines) == 3     # after 5, 65 and 125 s
    reached = [re.search(r'([0-9.]+) in the mean of', line) for line in wall.lines]
    assert all(match and 0.47 < float(match[1]) < 0.51 for match in reached)
