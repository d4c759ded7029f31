"""The identities that a print must obey."""

import math

import numpy as np
import pytest

from lunar_rover_sim.ground.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.ground.regolith.tracks import press, RIM_RADII
from lunar_rover_sim.ground.world.grid import HeightGrid

R = 0.0087
WIDE = -60, -50, 130, 110       # a window around all prints here


def ground(slope_x=0.0, slope_y=0.0, n=161):
    """Return a plane; 161 samples of 5 mm reach to 0.4 m, so that samples are exact."""
    axis = (np.arange(n) - (n - 1) / 2) * CELL_M
    heights = slope_x * axis[None, :] + slope_y * axis[:, None]
    return HeightGrid(heights.astype(np.float32), CELL_M)


WAY = (0.013, -0.021, R - 0.002), (0.034, -0.012, R - 0.006)        # on and deeper


def test_the_rim_spares_what_is_pressed_and_ends_at_its_width():
    overlay = Overlay()
    press(overlay, ground(), (0.0, 0.0, R - 0.004), (0.0, 0.0, R - 0.004), R, 0.0)
    change = overlay.window(*WIDE)[0]
    x, y = np.meshgrid((WIDE[0] + np.arange(WIDE[2])) * CELL_M,
                       (WIDE[1] + np.arange(WIDE[3])) * CELL_M)
    away = np.hypot(x, y)
    print_m = math.sqrt(0.004 * (2.0 * R - 0.004))      # radius of the ball at the surface
    assert (change[away < print_m] < 0.0).all()
    outer = (1.0 + RIM_RADII) * R
    assert (change[(away > print_m) & (away < outer)] > 0.0).all()
    assert not change[away > outer].any()


@pytest.mark.parametrize('radius,beyond', [(R, -0.005), (R, 0.0), (R, 0.006), (0.005, 0.003)])
def test_at_the_corner_of_the_world_soil_goes_where_there_is_ground(radius, beyond):
    """What is not compacted is laid on however few samples the rim has there."""
    overlay, at, corner = Overlay(), 0.4 + beyond, 80
    press(overlay, ground(), (at, at, 0.2 * radius), (at, at, 0.2 * radius), radius, 0.4)
    window = corner - 8, corner - 8, 9, 9
    change, compaction = overlay.window(*window)
    x, y = np.meshgrid(*[(corner - 8 + np.arange(9)) * CELL_M] * 2)
    away = np.hypot(x - at, y - at)
    into = np.maximum(np.sqrt(np.maximum(radius**2 - away**2, 0.0)) - 0.2 * radius, 0.0)
    taken = into[away < radius].sum()
    rim = (away >= radius) & (away < (1.0 + RIM_RADII) * radius)
    assert taken > 0.0 and rim.any() and np.all(change[rim] > 0.0)
    assert compaction.sum() == pytest.approx(0.4 * taken, abs=1e-7)
    assert change.sum() == pytest.approx(-0.4 * taken, abs=1e-7)


def test_a_print_pressed_again_hardly_changes():
    """Samples at which the ball just arrives are no switch: rounding does not move soil."""
    start, end = WAY
    overlay, ways = Overlay(), []
    press(overlay, ground(), start, end, R, 0.4)
    for lift in (1e-12, -1e-12):
        again = overlay.copy()
        press(again, ground(), end, (end[0] + 0.001, end[1], end[2] - 0.0005 + lift), R, 0.4)
        ways.append(again.window(*WIDE)[0])
    np.testing.assert_allclose(ways[0], ways[1], rtol=0.0, atol=4e-9)


@pytest.mark.parametrize('turn', [lambda p: (-p[1], p[0], p[2]), lambda p: (p[0], -p[1], p[2]),
                                  lambda p: (p[1], p[0], p[2]), lambda p: (-p[0], -p[1], p[2])])
def test_a_turned_or_mirrored_way_leaves_a_turned_or_mirrored_print(turn):
    start, end = WAY
    plain, turned = Overlay(), Overlay()
    press(plain, ground(), start, end, R, 0.4)
    press(turned, ground(), turn(start), turn(end), R, 0.4)
    found = plain.snapshot()
    for (ix, iy), height, compaction in zip(found.index, found.height_m, found.compaction_m):
        x, y, _ = turn((ix * CELL_M, iy * CELL_M, 0.0))
        assert turned.at(x, y) == pytest.approx((height, compaction), abs=1e-8)
    assert len(found) > 15 and len(turned.snapshot()) == len(found)


def test_a_print_moves_with_the_ball_and_with_the_ground():
    """By whole cells across the borders of tiles, and up with a higher ground."""
    start, end = WAY
    plain, moved = Overlay(), Overlay()
    press(plain, ground(), start, end, R, 0.4)
    higher = HeightGrid(ground().heights_m + np.float32(0.25), CELL_M)
    shift = (-23 * CELL_M, 31 * CELL_M, 0.25)
    press(moved, higher, tuple(np.add(start, shift)), tuple(np.add(end, shift)), R,
          0.4)
    one = plain.window(-20, -20, 60, 60)
    other = moved.window(-43, 11, 60, 60)
    for a, b in zip(one, other):
        np.testing.assert_allclose(a, b, atol=1e-8)
    assert np.count_nonzero(one[0]) > 15


def test_a_ball_that_touches_nothing_leaves_nothing():
    overlay = Overlay()
    window = press(overlay, ground(), (0.0, 0.0, R + 1e-6), (0.01, 0.0, R + 1e-6), R,
                   0.5)
    assert len(overlay.snapshot()) == 0 and overlay.writes == 0 and window[2] > window[3]


def test_the_rest_of_rounding_is_laid_on_the_next_rim():
    overlay, fine = Overlay(), ground()
    overlay.residue_m = 1e-4
    press(overlay, fine, (0.0, 0.0, R - 0.003), (0.0, 0.0, R - 0.003), R, 0.5)
    height, compaction = overlay.sums_m()
    assert height + compaction == pytest.approx(1e-4, abs=1e-7)
    assert abs(overlay.residue_m) < 1e-7
