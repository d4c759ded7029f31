"""A print against its definition, sample by sample, and the identities that it must obey."""

import math

import numpy as np
import pytest

from lunar_rover_sim.ground.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.ground.regolith.tracks import CLEAR_M, heights, hull, press, RIM_RADII
from lunar_rover_sim.ground.world.grid import HeightGrid

R = 0.0087
WIDE = -60, -50, 130, 110       # a window around all prints here


def ground(slope_x=0.0, slope_y=0.0, n=161):
    """Return a plane; 161 samples of 5 mm reach to 0.4 m, so that samples are exact."""
    axis = (np.arange(n) - (n - 1) / 2) * CELL_M
    heights = slope_x * axis[None, :] + slope_y * axis[:, None]
    return HeightGrid(heights.astype(np.float32), CELL_M)


def by_definition(base, change, start, end, compacted):
    """Return (change, compaction) after a press, by loops over the samples of WIDE."""
    ix, iy, nx, ny = WIDE
    length = math.hypot(end[0] - start[0], end[1] - start[1])
    taken, clear = np.zeros((ny, nx)), np.ones((ny, nx))
    away, ahead = np.full((ny, nx), np.inf), np.zeros((ny, nx))
    for j in range(ny):
        for i in range(nx):
            x, y = (ix + i) * CELL_M, (iy + j) * CELL_M
            part = 1.0
            if length > 0.0:
                part = ((x - start[0]) * (end[0] - start[0])
                        + (y - start[1]) * (end[1] - start[1])) / length**2
                part = min(max(part, 0.0), 1.0)
            cx, cy = (start[k] + part * (end[k] - start[k]) for k in (0, 1))
            away[j, i] = math.hypot(x - cx, y - cy)
            if away[j, i] > 0.0 and length > 0.0:
                ahead[j, i] = ((x - cx) * (end[0] - start[0]) + (y - cy) * (end[1] - start[1])
                               ) / length / away[j, i]
            if away[j, i] < R:
                centre = start[2] + part * (end[2] - start[2])
                below = centre - math.sqrt(R**2 - away[j, i]**2)
                into = base[j, i] + change[j, i] - below
                taken[j, i] = max(0.0, into)
                clear[j, i] = min(max(-into / CLEAR_M, 0.0), 1.0)
    weight = np.maximum(0.0, 1.0 - away / ((1.0 + RIM_RADII) * R)) * clear
    weight *= 1.0 + ahead * min(1.0, length / CELL_M)
    rim = (1.0 - compacted) * taken.sum() * weight / weight.sum()
    return change - taken + rim, compacted * taken


WAYS = [((0.013, -0.021, R - 0.004), (0.013, -0.021, R - 0.004)),        # straight down
        ((0.013, -0.021, R - 0.002), (0.034, -0.012, R - 0.006)),        # on and deeper
        ((0.013, -0.021, R - 0.006), (0.0117, -0.0225, R - 0.005)),      # back, less than a cell
        ((-0.021, 0.052, R - 0.010), (-0.021, 0.031, R - 0.010))]


@pytest.mark.parametrize('compacted', [0.0, 0.35, 1.0])
@pytest.mark.parametrize('start,end', WAYS)
def test_a_print_is_that_of_the_definition(start, end, compacted):
    """On a slope, over the rim of an earlier print."""
    plane = ground(0.05, -0.08)
    overlay = Overlay()
    press(overlay, plane, (0.02, -0.005, R - 0.003), (0.02, -0.005, R - 0.003), R, 0.2)
    ix, iy, nx, ny = WIDE
    base = heights(plane, *WIDE)
    before, compaction = overlay.window(*WIDE)
    residue = overlay.residue_m
    window = press(overlay, plane, start, end, R, compacted)
    after, more = overlay.window(*WIDE)
    expected, added = by_definition(base, before, start, end, compacted)
    # The rest that earlier rounding left is laid on the rim, 1e-9 m of it.
    assert abs(residue) < 1e-6
    np.testing.assert_allclose(after, expected, atol=2e-8)
    np.testing.assert_allclose(more - compaction, added, atol=2e-8)
    height, pressed = overlay.sums_m()
    assert abs(height + pressed + overlay.residue_m) < 1e-12
    # The window holds all that changed, and no more than two samples beyond the reach of a rim.
    jy, jx = np.nonzero((after != before) | (more != compaction))
    wx, wy, wnx, wny = window
    assert wx <= ix + jx.min() and ix + jx.max() < wx + wnx
    assert wy <= iy + jy.min() and iy + jy.max() < wy + wny
    reach = (1.0 + RIM_RADII) * R
    for first, count, ends in ((wx, wnx, (start[0], end[0])), (wy, wny, (start[1], end[1]))):
        assert -1.0 < first - (min(ends) - reach) / CELL_M <= 0.0
        assert 0.0 <= first + count - 1 - (max(ends) + reach) / CELL_M < 1.0


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
    start, end = WAYS[1]
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
    start, end = WAYS[1]
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
    start, end = WAYS[1]
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


@pytest.mark.parametrize('seed', range(20))
def test_the_hull_of_two_windows_is_the_smallest_around_both(seed):
    rng = np.random.default_rng(seed)
    one, other = (tuple([*rng.integers(-9, 9, 2).tolist(), *rng.integers(1, 9, 2).tolist()])
                  for _ in range(2))

    def samples(window):
        ix, iy, nx, ny = window
        return {(x, y) for x in range(ix, ix + nx) for y in range(iy, iy + ny)}

    both = samples(one) | samples(other)
    found = samples(hull(one, other))
    assert both <= found
    for k in (0, 1):
        assert {p[k] for p in found} == set(range(min(p[k] for p in both),
                                                  max(p[k] for p in both) + 1))
    assert hull(one, other) == hull(other, one)
