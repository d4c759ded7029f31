"""Walls of prints slide some time after they were made, those of one leg together."""

import math

import numpy as np
import pytest

from lunar_rover_sim.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.regolith.tracks import SLIDE_S, WallSlides, WIDEST
from lunar_rover_sim.world.grid import HeightGrid

STEP_S = 0.002
DELAY = 50      # steps of 2 ms in a tenth of a second
DEPTH_M = 0.03  # of a pit of one sample: its walls are far too steep


def ground():
    return HeightGrid(np.zeros((81, 81), np.float32), 0.025)


def dug(*places):
    """Return an overlay with a pit at each sample."""
    overlay = Overlay()
    for ix, iy in places:
        overlay.put(ix, iy, np.full((1, 1), -DEPTH_M), np.zeros((1, 1)))
    return overlay


def depth_m(overlay, ix, iy):
    return -float(overlay.window(ix, iy, 1, 1)[0][0, 0])


def around(ix, iy):
    return ix - 2, iy - 2, 5, 5


def test_the_delay_is_a_tenth_of_a_second():
    assert SLIDE_S == pytest.approx(DELAY * STEP_S)


def test_a_wall_slides_when_its_time_has_come():
    slides, overlay = WallSlides(ground(), 38.0, STEP_S, 4), dug((0, 0))
    assert slides.next_step == math.inf
    slides.add(overlay, 2, around(0, 0), 7)
    assert slides.next_step == 7 + DELAY
    slides.slide_due(overlay, 6 + DELAY)
    assert depth_m(overlay, 0, 0) == pytest.approx(DEPTH_M) and slides.next_step == 7 + DELAY
    slides.slide_due(overlay, 7 + DELAY)
    # Neighbours stand no steeper than 38 deg and the tolerance.
    assert depth_m(overlay, 0, 0) - depth_m(overlay, 1, 0) \
        < CELL_M * math.tan(math.radians(39.0))
    assert overlay.sums_m()[0] == pytest.approx(-DEPTH_M, abs=1e-6)
    assert slides.next_step == math.inf


def test_prints_of_one_leg_slide_together_and_others_at_their_own_time():
    slides, overlay = WallSlides(ground(), 38.0, STEP_S, 4), dug((0, 0), (12, 3), (-60, 0))
    slides.add(overlay, 0, around(0, 0), 0)
    slides.add(overlay, 0, around(12, 3), 30)
    slides.add(overlay, 3, around(-60, 0), 40)
    slides.slide_due(overlay, DELAY)
    assert max(depth_m(overlay, 0, 0), depth_m(overlay, 12, 3)) < 0.5 * DEPTH_M
    assert depth_m(overlay, -60, 0) == pytest.approx(DEPTH_M)
    assert slides.next_step == 40 + DELAY
    slides.slide_due(overlay, 40 + DELAY)
    assert depth_m(overlay, -60, 0) < 0.5 * DEPTH_M


@pytest.mark.parametrize('apart, together', [(WIDEST - 5, True), (WIDEST - 4, False)])
@pytest.mark.parametrize('along_y', [False, True])
def test_what_lies_too_far_apart_does_not_wait_for_one_another(apart, together, along_y):
    """Windows of 5 samples: from one end to the other 40 samples, or 41."""
    second = (0, apart) if along_y else (apart, 0)
    slides, overlay = WallSlides(ground(), 38.0, STEP_S, 4), dug((0, 0), second)
    slides.add(overlay, 1, around(0, 0), 0)
    slides.add(overlay, 1, around(*second), 20)
    assert (depth_m(overlay, 0, 0) == pytest.approx(DEPTH_M)) == together
    assert depth_m(overlay, *second) == pytest.approx(DEPTH_M)
    slides.slide_due(overlay, DELAY)
    assert (depth_m(overlay, *second) < 0.5 * DEPTH_M) == together
    slides.slide_due(overlay, 20 + DELAY)
    assert depth_m(overlay, *second) < 0.5 * DEPTH_M


def test_all_walls_can_slide_at_once_or_never():
    slides, places = WallSlides(ground(), 38.0, STEP_S, 4), [(0, 0), (60, 0), (0, 60), (60, 60)]
    overlay = dug(*places)
    for leg, place in enumerate(places):
        slides.add(overlay, leg, around(*place), leg)
    slides.slide_all(overlay)
    assert all(depth_m(overlay, *place) < 0.5 * DEPTH_M for place in places)
    overlay = dug((0, 0))
    slides.add(overlay, 0, around(0, 0), 0)
    slides.forget()
    slides.slide_due(overlay, 10 * DELAY)
    assert depth_m(overlay, 0, 0) == pytest.approx(DEPTH_M)
