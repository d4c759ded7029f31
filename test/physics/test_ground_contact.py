"""Sinkage, slip and digging in, from tips whose values are given."""

import logging
from types import SimpleNamespace

import numpy as np
import pytest

from lunar_rover_sim.physics.ground_contact import ContactObserver

SPOKE_M, STEP_S = 0.08, 0.001


def tips(*sinkages):
    """Return three tips a leg: one in the ground, one less deep, one in the air."""
    return [SimpleNamespace(leg=leg, in_ground=k < 2, sinkage=value / (k + 1) if k < 2 else 9.0)
            for leg, value in enumerate(sinkages) for k in range(3)]


def test_sinkage_is_that_of_the_deepest_tip_in_the_ground():
    found = ContactObserver(SPOKE_M, STEP_S).observe(tips(0.004, 0.01, 0.0, 0.002), 5)
    assert found.sinkage_m == pytest.approx([0.004, 0.01, 0.0, 0.002])
    assert not found.dug_in
    none = ContactObserver(SPOKE_M, STEP_S).observe([], 5)
    assert not none.sinkage_m.any() and not none.slip_mps.any()


def test_slip_is_the_way_over_the_time_since_the_last_look():
    observer = ContactObserver(SPOKE_M, STEP_S)
    observer.add_slip(1, 0.002)
    observer.add_slip(1, 0.001)
    observer.add_slip(3, 0.004)
    # 20 steps of a millisecond.
    assert observer.observe([], 20).slip_mps == pytest.approx([0.0, 0.15, 0.0, 0.2])
    assert not observer.observe([], 20).slip_mps.any()      # the same state again
    observer.add_slip(0, 0.001)
    assert observer.observe([], 30).slip_mps == pytest.approx([0.1, 0.0, 0.0, 0.0])
    observer.add_slip(0, 0.001)
    observer.restart()
    observer.add_slip(2, 0.001)
    assert observer.observe([], 5).slip_mps == pytest.approx([0.0, 0.0, 0.2, 0.0])


@pytest.mark.parametrize('sinkages, dug_in', [
    ((0.06, 0.0, 0.0, 0.0), False), ((0.06, 0.0, 0.0, 0.057), True),
    ((0.055, 0.06, 0.055, 0.055), False), ((0.06, 0.06, 0.06, 0.06), True)])
def test_two_legs_deeper_than_seven_tenths_of_a_spoke_are_dug_in(sinkages, dug_in):
    """0.7 of 80 mm are 56 mm."""
    found = ContactObserver(SPOKE_M, STEP_S).observe(tips(*sinkages), 1)
    assert found.dug_in == dug_in


def test_digging_in_is_told_once_each_time(caplog):
    observer, deep, free = ContactObserver(SPOKE_M, STEP_S), tips(*[0.06] * 4), tips(*[0.01] * 4)
    told = []
    with caplog.at_level(logging.WARNING):
        for state in (deep, deep, free, deep):
            observer.observe(state, 1)
            told.append(len(caplog.records))
        observer.surface_again()
        observer.observe(deep, 1)
    assert told == [1, 1, 1, 2] and len(caplog.records) == 3
    assert 'tips are 60, 60, 60, 60 mm deep' in caplog.text
    assert np.all(observer.observe(deep, 2).sinkage_m == 0.06)
