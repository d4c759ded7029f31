"""The distance driven: horizontal, in steps of 0.1 s, the same from a stream and from a whole."""

from __future__ import annotations

import math

import pytest

from lunar_rover_sim.bag.totals import driven_distance_m, every_step


def test_rocking_is_no_distance():
    """At 200 Hz, 5 mm of rocking at 10 Hz would add 1 m/s to 0.1 m/s."""
    stamped = [(k * 5_000_000, (0.1 * k * 0.005, 0.0025 * math.sin(0.1 * math.pi * k), 0.0))
               for k in range(1, 2001)]
    assert driven_distance_m(stamped) == pytest.approx(0.1 * 9.995, abs=2e-3)


def test_height_is_no_distance():
    assert driven_distance_m([(0, (0.0, 0.0, 0.0)), (10**9, (3.0, 4.0, 12.0))]) == 5.0


@pytest.mark.parametrize('first_ns', [1_000_000_000, 1_030_000_000, 99_999_999])
def test_of_every_step_the_first_and_the_last_of_all(first_ns):
    """Steps count from the first stamp, wherever that is."""
    stamped = [(first_ns + k * 30_000_000, k) for k in range(10)]
    kept = list(every_step(stamped))
    assert [k for _, k in kept] == [0, 4, 7, 9]
    assert list(every_step(kept)) == kept


@pytest.mark.parametrize('points', [[], [(7, (1.0, 2.0))]])
def test_less_than_two_points_are_no_distance(points):
    assert driven_distance_m(points) == 0.0


def test_a_pause_in_the_recording_is_crossed_straight():
    assert driven_distance_m([(0, (0.0, 0.0)), (60 * 10**9, (0.0, 7.0))]) == 7.0
