"""Tracks: what is pressed in comes out beside it or is compacted, and nothing stands too steep."""

import math

import numpy as np
import pytest

from lunar_rover_sim.ground.regolith.overlay import CELL_M, Overlay, TILE
from lunar_rover_sim.ground.regolith.tracks import heights, press, relax, WallSlides, WIDEST
from lunar_rover_sim.ground.world.grid import HeightGrid

R = 0.008


def flat(n: int = 81, slope: float = 0.0) -> HeightGrid:
    x = (np.arange(n) - (n - 1) / 2) * 0.025
    return HeightGrid(np.tile(slope * x, (n, 1)).astype(np.float32), 0.025)


def trample(overlay: Overlay, ground: HeightGrid, prints: int = 60, seed: int = 1,
            repose_deg: float = 38.0) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(prints):
        x, y = rng.uniform(-0.25, 0.25, 2)
        z = ground.height_at_point(x, y) + R
        low = z - rng.uniform(0.001, 0.03)
        press(overlay, ground, (x, y, z), (x, y, low), R, 0.6)
        window = press(overlay, ground, (x, y, low), (x - 0.004, y + 0.002, low), R, 0.6)
        relax(overlay, ground, window, repose_deg)


def steepest_deg(overlay: Overlay, ground: HeightGrid, n: int = 160) -> float:
    window = -n // 2, -n // 2, n, n
    total = overlay.window(*window)[0] + heights(ground, *window)
    rises = [np.abs(total[:, 1:] - total[:, :-1]), np.abs(total[1:] - total[:-1]),
             np.abs(total[1:, 1:] - total[:-1, :-1]) / math.sqrt(2.0),
             np.abs(total[1:, :-1] - total[:-1, 1:]) / math.sqrt(2.0)]
    return math.degrees(math.atan(max(r.max() for r in rises) / CELL_M))


@pytest.mark.parametrize('slope', [0.0, 0.3])
def test_rim_and_compaction_are_the_print(slope):
    overlay, ground = Overlay(), flat(slope=slope)
    trample(overlay, ground)
    height, compaction = overlay.sums_m()
    assert compaction > 0.5
    assert abs(height + compaction + overlay.residue_m) < 1e-12
    # What float32 keeps back is far less than one sample of a print.
    assert abs(overlay.residue_m) < 1e-6
    assert overlay.snapshot().height_m.max() > 0.001


@pytest.mark.parametrize('repose_deg', [33.0, 38.0])
def test_no_slope_is_steeper_than_the_angle_of_repose(repose_deg):
    overlay, ground = Overlay(), flat(slope=0.2)
    trample(overlay, ground, repose_deg=repose_deg)
    assert 0.8 * repose_deg < steepest_deg(overlay, ground) < repose_deg + 1.0


def test_ground_that_is_steep_by_itself_stays():
    overlay, ground = Overlay(), flat(slope=1.0)
    relax(overlay, ground, (-20, -20, 40, 40), 35.0)
    assert len(overlay.snapshot()) == 0
    trample(overlay, ground, prints=3)
    assert overlay.memory_bytes < 20 * TILE * TILE * 9


def test_calm_soil_is_not_written_again():
    """Gentle slopes stay as they are, and nobody is told of a change."""
    overlay, ground = Overlay(), flat(slope=0.1)
    overlay.put(-2, -2, np.full((5, 5), 0.001), np.zeros((5, 5)))
    writes = overlay.writes
    relax(overlay, ground, (-10, -10, 20, 20), 38.0)
    assert overlay.writes == writes and overlay.residue_m == pytest.approx(0.0, abs=1e-7)


def test_a_print_is_the_ball():
    overlay, ground = Overlay(), flat()
    press(overlay, ground, (0.0, 0.0, R - 0.004), (0.0, 0.0, R - 0.004), R, 1.0)
    for x, depth in ((0.0, 0.004), (CELL_M, 0.004 - R + math.sqrt(R ** 2 - CELL_M ** 2))):
        assert overlay.height_change([x, 0.0]) == pytest.approx(-depth, abs=1e-9)
        assert overlay.compaction([x, 0.0]) == pytest.approx(depth, abs=1e-9)
    # Halfway between samples it is linear.
    low, high = overlay.height_change([[0.0, 0.0], [CELL_M, 0.0]])
    assert overlay.height_change([0.5 * CELL_M, 0.0]) == pytest.approx(0.5 * (low + high))


def test_more_soil_goes_where_the_tip_moves_to():
    overlay, ground = Overlay(), flat()
    press(overlay, ground, (0.0, 0.0, R - 0.004), (-0.02, 0.0, R - 0.004), R, 0.0)
    behind, ahead = overlay.height_change([[0.01, 0.0], [-0.03, 0.0]])
    assert ahead > 2.0 * behind >= 0.0


def test_changes_rebuild_the_ground_elsewhere():
    overlay, ground, other = Overlay(), flat(), Overlay()
    for seed in range(3):
        trample(overlay, ground, prints=8, seed=seed)
        changes = overlay.take_changes()
        assert len(changes) > 20
        other.apply(changes)
    assert len(overlay.take_changes()) == 0
    for one, two in zip(vars(overlay.snapshot()).values(), vars(other.snapshot()).values()):
        assert np.array_equal(one, two)
    # A late reader takes the snapshot.
    late = Overlay()
    late.apply(overlay.snapshot())
    xy = np.random.default_rng(3).uniform(-0.3, 0.3, (100, 2))
    assert np.array_equal(late.height_change(xy), overlay.height_change(xy))


def test_indices_are_samples_of_5_mm_and_sorted_by_tile():
    overlay, ground = Overlay(), flat()
    press(overlay, ground, (-0.3, 0.2, R - 0.003), (-0.3, 0.2, R - 0.003), R, 1.0)
    changes = overlay.take_changes()
    deepest = changes.index[np.argmin(changes.height_m)]
    assert deepest.tolist() == [-60, 40]
    assert changes.index.dtype == np.int32 and changes.height_m.dtype == np.float32


def test_the_same_steps_give_the_same_bits():
    snapshots = []
    for _ in range(2):
        overlay = Overlay()
        trample(overlay, flat())
        snapshots.append(overlay.snapshot())
    assert snapshots[0].height_m.tobytes() == snapshots[1].height_m.tobytes()


def test_heights_of_samples_are_those_of_the_triangles_up_to_the_edge():
    """Edges of the ground lie on samples, 10 from the middle; beyond them nothing is known."""
    rough = np.random.default_rng(5).normal(size=(5, 5)).astype(np.float32)
    ground = HeightGrid(rough, 0.025)
    x, y = np.meshgrid(CELL_M * np.arange(-12, 14), CELL_M * np.arange(-11, 13))
    expected = ground.height_at(np.stack([x, y], axis=-1))
    np.testing.assert_allclose(heights(ground, -12, -11, 26, 24), expected, atol=1e-6)
    assert np.isfinite(expected).sum() == 21**2


def test_beyond_the_world_there_is_nothing_to_press():
    overlay, ground = Overlay(), flat(n=11)
    edge = ground.half_extent_m
    press(overlay, ground, (edge, 0.0, R), (edge, 0.0, R - 0.005), R, 0.5)
    snapshot = overlay.snapshot()
    assert len(snapshot) > 0
    assert (snapshot.index[:, 0] * CELL_M <= edge + 1e-9).all()
    height, compaction = overlay.sums_m()
    assert abs(height + compaction + overlay.residue_m) < 1e-12


def test_soil_slides_as_steep_along_the_diagonals_as_along_the_axes():
    """A deep hole becomes a cone: neighbours in all eight directions are as steep."""
    overlay, ground = Overlay(), flat()
    overlay.put(0, 0, np.full((1, 1), -1.0), np.zeros((1, 1)))
    relax(overlay, ground, (-3, -3, 7, 7), 38.0)
    height = overlay.window(-30, -30, 61, 61)[0]
    steepest = math.tan(math.radians(38.8)) + 1e-6
    for rise, way in ((height[:, 1:] - height[:, :-1], 1.0), (height[1:] - height[:-1], 1.0),
                      (height[1:, 1:] - height[:-1, :-1], math.sqrt(2.0)),
                      (height[1:, :-1] - height[:-1, 1:], math.sqrt(2.0))):
        slope = np.abs(rise).max() / (way * CELL_M)
        assert 0.9 * math.tan(math.radians(38.0)) < slope < steepest
    assert float(height.sum()) == pytest.approx(-1.0, abs=1e-5)


STEP_S = 0.002
DELAY = 50      # steps of 2 ms in a tenth of a second
DEPTH_M = 0.03  # of a pit of one sample: its walls are far too steep


def plain():
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


def test_a_wall_slides_when_its_time_has_come():
    slides, overlay = WallSlides(plain(), 38.0, STEP_S, 4), dug((0, 0))
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
    slides, overlay = WallSlides(plain(), 38.0, STEP_S, 4), dug((0, 0), (12, 3), (-60, 0))
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
    slides, overlay = WallSlides(plain(), 38.0, STEP_S, 4), dug((0, 0), second)
    slides.add(overlay, 1, around(0, 0), 0)
    slides.add(overlay, 1, around(*second), 20)
    assert (depth_m(overlay, 0, 0) == pytest.approx(DEPTH_M)) == together
    assert depth_m(overlay, *second) == pytest.approx(DEPTH_M)
    slides.slide_due(overlay, DELAY)
    assert (depth_m(overlay, *second) < 0.5 * DEPTH_M) == together
    slides.slide_due(overlay, 20 + DELAY)
    assert depth_m(overlay, *second) < 0.5 * DEPTH_M


def test_all_walls_can_slide_at_once_or_never():
    slides, places = WallSlides(plain(), 38.0, STEP_S, 4), [(0, 0), (60, 0), (0, 60), (60, 60)]
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
