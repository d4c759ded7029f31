"""Shadows of rocks: those of their outlines, and on cells as wide as they are."""

import camera_scene as scene
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from lunar_rover_sim.base.frames import matrix_from_wxyz, sun_direction
from lunar_rover_sim.ground.world import shapes
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.ground.world.shapes import library
from lunar_rover_sim.image.illumination import rock_shadow
from lunar_rover_sim.image.illumination.config import ReflectanceConfig, SunConfig
from lunar_rover_sim.image.illumination.horizon import ShadowLevel, SunGeometry
from lunar_rover_sim.image.illumination.sunlight import Sunlight


def sun(azimuth_deg, elevation_deg):
    return SunGeometry.towards(sun_direction(azimuth_deg, elevation_deg))


@pytest.mark.parametrize('cell_m', [0.2, 0.4])
@pytest.mark.parametrize('elevation_deg', [3.0, 15.0])
@pytest.mark.parametrize('azimuth_deg', [30.0, 230.0])
def test_a_patch_of_the_right_length_and_area(cell_m, elevation_deg, azimuth_deg):
    """A box of 0.4 m height, shadow length h / tan e, although cells are as wide as the box."""
    s = sun(azimuth_deg, elevation_deg)
    height, half = 0.4, 0.2
    shape = scene.block(half=(half, half, 0.5 * height))
    outline = rock_shadow.silhouettes(scene.rocks([(0.3, 0.1, 0.5 * height)]), (shape,), s)
    grid = HeightGrid(np.zeros((129, 129), np.float32), cell_m)
    share = rock_shadow.share(grid, outline, s, 0.0) / 255.0
    axis = (np.arange(129) - 64) * cell_m
    back = -((axis[None, :] - 0.3) * s.direction_xy[0]
             + (axis[:, None] - 0.1) * s.direction_xy[1])
    length = height / np.tan(np.radians(elevation_deg))
    width = 2.0 * outline.half_width[0] * 0.8       # of a body with the mean outline of rocks
    assert share.sum() * cell_m**2 == pytest.approx((length + half) * width, rel=0.2)
    dark = share.max(axis=None) * 0.25
    assert back[share > dark].max() == pytest.approx(length, abs=2.0 * cell_m + half)
    assert np.all(share[back < -2.0 * cell_m] == 0.0)


@pytest.mark.parametrize('elevation_deg', [6.0, 15.0, 40.0])
@pytest.mark.parametrize('azimuth_deg', [0.0, 90.0, 180.0, 270.0])
def test_a_share_adds_up_to_the_rectangle_that_is_shaded(azimuth_deg, elevation_deg):
    """Across the ray to the width of the outline, along it to its tip, wherever cells begin."""
    s, x, y, cell_m = sun(azimuth_deg, elevation_deg), 0.37, -0.23, 0.3
    shape = scene.block(half=(0.3, 0.2, 0.4))
    outline = rock_shadow.silhouettes(scene.rocks([(x, y, 0.4)]), (shape,), s)
    grid = HeightGrid(np.zeros((129, 129), np.float32), cell_m)
    share = rock_shadow.share(grid, outline, s, 0.0) / 255.0
    axis = (np.arange(129) - 64) * cell_m
    # Rows of cells across the ray, from that behind the rock on.
    rows = share.sum(axis=1 if azimuth_deg % 180.0 else 0)
    away = -axis * np.sign(s.direction_xy.sum())
    from_m = 0.5 - np.array([x, y]) @ s.direction_xy
    behind = away > from_m
    tip_m = outline.top[0] / np.sin(s.elevation_rad)
    width_m = 2.0 * 0.68 * outline.half_width[0]
    whole = behind & (away < tip_m - cell_m)
    np.testing.assert_allclose(rows[whole] * cell_m, width_m, atol=0.004)
    length_m = tip_m - (away[behind].min() - 0.5 * cell_m)
    assert rows[behind].sum() * cell_m**2 == pytest.approx(width_m * length_m, rel=0.01)


def test_shadows_over_one_another_are_no_darker_than_one():
    s, shape = sun(30.0, 6.0), scene.block(half=(0.6, 0.6, 0.4))
    grid = HeightGrid(np.zeros((65, 65), np.float32), 0.4)
    one, three = (rock_shadow.share(grid, rock_shadow.silhouettes(
        scene.rocks([(0.3, 0.1, 0.4)] * count), (shape,), s), s, 0.0) for count in (1, 3))
    assert one.max() == 255
    np.testing.assert_allclose(three, np.minimum(3.0 * one, 255.0), atol=1.0)


def test_area_of_many_real_shapes_agrees_with_that_of_their_outlines():
    """Rocks of 0.3 to 1 m on 1.6 m cells, against outlines drawn on a fine grid."""
    s, shapes = sun(40.0, 8.0), library()
    rng = np.random.default_rng(2)
    m = 60
    sizes = np.array([0.3, 0.6, 1.0])
    size = rng.integers(0, 3, m).astype(np.int32)
    turn = rng.standard_normal((m, 4)) * [0.0, 0.0, 0.0, 1.0] + [1.0, 0.0, 0.0, 0.0]
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    xy = (np.stack(np.meshgrid(np.arange(8), np.arange(8)), -1).reshape(-1, 2)[:m] - 3.5) * 12.0
    rocks = Rocks(rng.integers(0, len(shapes), m).astype(np.int32), size,
                  np.column_stack([xy, 0.15 * sizes[size]]), turn, np.ones(m, np.float32), sizes)
    outlines = rock_shadow.silhouettes(rocks, shapes, s)
    coarse = HeightGrid(np.zeros((65, 65), np.float32), 1.6)
    fine = HeightGrid(np.zeros((2049, 2049), np.float32), 0.05)
    areas = [rock_shadow.share(grid, outlines, s, 0.0).sum() / 255.0 * grid.cell_m**2
             for grid in (coarse, fine)]
    clearance = np.full((2049, 2049), 1.0, np.float32)
    rock_shadow.stamp(clearance, np.full_like(clearance, 100.0), fine, outlines, s)
    true = np.count_nonzero(clearance < 0.0) * fine.cell_m**2
    assert areas[0] == pytest.approx(true, rel=0.2)
    assert areas[1] == pytest.approx(true, rel=0.2)


@pytest.mark.parametrize('azimuth_deg', [0.0, 130.0, 250.0])
@pytest.mark.parametrize('rise', [-0.06, 0.0, 0.1])
def test_shadows_on_slopes_and_over_the_edge_of_a_grid(azimuth_deg, rise):
    """Rocks on ground that rises towards the sun or falls; only what is on the grid is dark."""
    s, shapes = sun(azimuth_deg, 11.0), library()
    rng = np.random.default_rng(3)
    m = 40
    sizes = np.array([0.5, 0.9])
    turn = rng.standard_normal((m, 4)) * [0.0, 0.0, 0.0, 1.0] + [1.0, 0.0, 0.0, 0.0]
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    xy = rng.uniform(-26.0, 26.0, (m, 2))       # some beside the grid, with shadows on it
    size = (np.arange(m) % 2).astype(np.int32)
    position = np.column_stack([xy, rise * xy @ s.direction_xy + 0.15 * sizes[size]])
    outlines = rock_shadow.silhouettes(Rocks(
        rng.integers(0, len(shapes), m).astype(np.int32), size, position, turn,
        np.ones(m, np.float32), sizes), shapes, s)
    areas = []
    for n, cell_m in ((41, 1.2), (961, 0.05)):
        axis = (np.arange(n) - 0.5 * (n - 1)) * cell_m
        x, y = np.meshgrid(axis, axis)
        heights = rise * (x * s.direction_xy[0] + y * s.direction_xy[1])
        grid = HeightGrid(heights.astype(np.float32), cell_m)
        if n < 100:
            dark = rock_shadow.share(grid, outlines, s, 0.0) / 255.0
        else:
            clearance = np.full((n, n), 1.0, np.float32)
            rock_shadow.stamp(clearance, np.full_like(clearance, 100.0), grid, outlines, s)
            dark = clearance < 0.0
        areas.append(np.count_nonzero(dark) * cell_m**2 if n > 100 else dark.sum() * cell_m**2)
    assert areas[1] > 5.0
    assert areas[0] == pytest.approx(areas[1], rel=0.2)


def test_far_rocks_stand_in_the_light_of_their_own_level():
    """A wall on the coarse level shades a rock behind it, and leaves one before it lit."""
    far = np.zeros((129, 129), np.float32)
    far[:, 100:102] = 4.0                               # at x = 28.8 m
    world = scene.plane(n=129, cell_m=0.05, far=False)
    world = type(world)((*world.levels, HeightGrid(far, 0.8)), world.albedo, world.rocks,
                        world.rock_shapes, world.config, world.hash)
    both = scene.rocks([(20.0, 0.0, 0.5), (40.0, 0.0, 0.5)])
    seen = Sunlight(world, SunConfig(), ReflectanceConfig(), sun_direction(0.0, 10.0), True, both)
    light = seen.rock_light()
    assert light.shape == (2, 5)
    assert light[0, 0] < 0.0 < light[1, 0] and light[0, 2] < 0.0 < light[1, 2]
    assert light[1, 4] > 2.0 * light[0, 4]


def test_a_place_has_the_horizon_of_the_finest_level_around_it():
    """A wall on the fine level alone: 1 m high, 2 m towards the sun of places there."""
    fine = np.zeros((257, 257), np.float32)
    fine[:, 168:170] = 1.0                              # at x = 2 m
    world = scene.plane(n=257, cell_m=0.05, heights=fine)
    light = Sunlight(world, SunConfig(), ReflectanceConfig(), sun_direction(0.0, 10.0), False)
    places = [(0.0, y, z) for y in (-2.0, 0.0, 3.0) for z in (0.0, 0.5, 0.9)]
    above_deg = np.degrees(light.angle_above_horizon([*places, (-9.0, 0.0, 0.0)]))
    assert above_deg[:-1] == pytest.approx(
        [10.0 - np.degrees(np.arctan2(1.0 - z, 2.0)) for *_, z in places], abs=1.0)
    assert above_deg[-1] == pytest.approx(10.0, abs=0.5)


LIBRARY = shapes.library()
CELL, N = 0.05, 161


def sun_from(azimuth_deg, elevation_deg):
    return SunGeometry(np.radians(azimuth_deg), np.radians(elevation_deg))


def some_rocks(count=6, seed=0, spread=2.0, height=0.0):
    """Return rocks of 0.3 m and 0.8 m in random poses."""
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(count, 4))
    position = np.column_stack([rng.uniform(-spread, spread, (count, 2)), np.full(count, height)])
    return Rocks(rng.integers(0, len(LIBRARY), count).astype(np.int32),
                 (np.arange(count) % 2).astype(np.int32), position,
                 quat / np.linalg.norm(quat, axis=1, keepdims=True), np.ones(count, np.float32),
                 np.array([0.3, 0.8]))


def pieces(rocks, i):
    """Return the corners of the pieces of rock i in the world [m]."""
    R = matrix_from_wxyz(rocks.orientation_wxyz[i])
    return [rocks.position_m[i] + rocks.diameter_m[i] * piece.vertices @ R.T
            for piece in LIBRARY[rocks.shape[i]].convex()]


def is_hit(points, direction, rock):
    """Return which rays from (m, 3) points meet a rock of convex pieces, by their planes."""
    return np.any([meets(points, direction, piece) for piece in rock], axis=0)


def meets(points, direction, piece):
    planes = ConvexHull(piece).equations
    towards = planes[:, :3] @ direction
    height = points @ planes[:, :3].T + planes[:, 3]
    with np.errstate(divide='ignore'):
        crossing = -height / towards
    enter = np.where(towards < 0.0, crossing, -np.inf).max(axis=1)
    leave = np.where(towards > 0.0, crossing, np.inf).min(axis=1)
    return np.maximum(enter, 0.0) < leave


@pytest.mark.parametrize('azimuth_deg,elevation_deg', [(0.0, 10.0), (75.0, 3.0), (200.0, 40.0),
                                                       (310.0, 85.0)])
def test_axes_of_the_sun_are_square_and_look_at_it(azimuth_deg, elevation_deg):
    s = sun_from(azimuth_deg, elevation_deg)
    axes = rock_shadow.sun_axes(s)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    e = s.elevation_rad
    np.testing.assert_allclose(axes[2], [*(np.cos(e) * s.direction_xy), np.sin(e)], atol=1e-12)
    # The first is level, the second points up as far as it can.
    assert axes[0, 2] == 0.0 and axes[1, 2] == pytest.approx(np.cos(e))
    assert np.linalg.det(axes) == pytest.approx(1.0)


@pytest.mark.parametrize('azimuth_deg,elevation_deg', [(20.0, 6.0), (250.0, 50.0)])
def test_outlines_are_the_convex_hulls_of_the_projected_corners(azimuth_deg, elevation_deg):
    rocks = some_rocks(24)
    found = rock_shadow.silhouettes(rocks, LIBRARY, sun_from(azimuth_deg, elevation_deg))
    rng = np.random.default_rng(1)
    assert len(found.owner) > len(rocks) and set(found.owner) == set(range(len(rocks)))
    for k, i in enumerate(found.owner):
        whole = np.concatenate(pieces(rocks, i)) @ found.axes.T
        flat = pieces(rocks, i)[k - np.searchsorted(found.owner, i)] @ found.axes.T
        hull = ConvexHull(flat[:, :2])
        points = flat[:, :2].mean(axis=0) + rng.uniform(-0.8, 0.8, (200, 2))
        expected = (points @ hull.equations[:, :2].T + hull.equations[:, 2]).max(axis=1)
        distance = found.distance(np.full(200, k), *points.T.astype(np.float32))
        np.testing.assert_allclose(distance, expected, atol=2e-5)
        centre = rocks.position_m[i] @ found.axes.T
        np.testing.assert_allclose(found.centre[k], centre, atol=1e-9)
        assert found.top[k] == pytest.approx(whole[:, 1].max(), abs=1e-6)
        assert found.half_width[k] == pytest.approx(np.abs(whole[:, 0] - centre[0]).max(),
                                                    abs=1e-6)


@pytest.mark.parametrize('azimuth_deg, elevation_deg', [
    (0.0, 8.0), (33.0, 25.0), (60.0, 8.0), (90.0, 25.0), (147.0, 8.0), (220.0, 25.0),
    (305.0, 8.0)])
def test_cells_are_dark_where_their_ray_meets_a_rock(azimuth_deg, elevation_deg):
    """Every cell of level ground in the open; those that a rock stands on are left out."""
    s = sun_from(azimuth_deg, elevation_deg)
    # Some stand so near the border that their shadow leaves the grid on any side.
    rocks = some_rocks(10, seed=int(azimuth_deg), spread=3.9)
    grid = HeightGrid(np.zeros((N, N), np.float32), CELL)
    clearance, occluder = ShadowLevel(grid, s, None).clearance()
    outlines = rock_shadow.silhouettes(rocks, LIBRARY, s)
    rock_shadow.stamp(clearance, occluder, grid, outlines, s)
    axis = (np.arange(N) - (N - 1) / 2) * CELL
    points = np.stack([*np.meshgrid(axis, axis), np.zeros((N, N))], axis=-1).reshape(-1, 3)
    direction = outlines.axes[2]
    expected = np.zeros(len(points), bool)
    free = np.ones(len(points), bool)
    for i in range(len(rocks)):
        expected |= is_hit(points, direction, pieces(rocks, i))
        free &= np.linalg.norm(points[:, :2] - rocks.position_m[i, :2], axis=1) > 0.5
    dark = (clearance < 0.0).ravel()
    assert expected[free].sum() > 40
    assert np.array_equal(dark[free], expected[free])


@pytest.mark.parametrize('elevation_deg', [4.0, 30.0, 65.0])
@pytest.mark.parametrize('height_m', [-300.0, -20.0, 20.0, 300.0])
def test_shadows_of_rocks_do_not_depend_on_where_height_counts_from(height_m, elevation_deg):
    s = sun_from(140.0, elevation_deg)
    dark = []
    for base in (0.0, height_m):
        grid = HeightGrid(np.full((N, N), base, np.float32), CELL)
        outlines = rock_shadow.silhouettes(some_rocks(10, height=base), LIBRARY, s)
        clearance, occluder = ShadowLevel(grid, s, None).clearance()
        rock_shadow.stamp(clearance, occluder, grid, outlines, s)
        dark.append(np.stack([clearance < 0.0,
                              rock_shadow.share(grid, outlines, s, 0.0) > 127]))
    assert dark[0].sum() > 100
    # Single precision 300 m away from 0 is worth 0.03 mm.
    assert np.mean(dark[0] != dark[1]) < 1e-3 * np.mean(dark[0])


def test_nothing_is_stamped_for_a_sun_below_the_ground_or_without_rocks():
    grid = HeightGrid(np.zeros((N, N), np.float32), CELL)
    for s, rocks in ((sun_from(10.0, -2.0), some_rocks()), (sun_from(10.0, 5.0), some_rocks(0))):
        clearance, occluder = np.ones((N, N), np.float32), np.ones((N, N), np.float32)
        outlines = rock_shadow.silhouettes(rocks, LIBRARY, s)
        rock_shadow.stamp(clearance, occluder, grid, outlines, s)
        assert np.all(clearance == 1.0) and np.all(occluder == 1.0)


def test_a_darker_shadow_that_is_there_already_stays():
    s, rocks = sun_from(40.0, 10.0), some_rocks()
    grid = HeightGrid(np.zeros((N, N), np.float32), CELL)
    clearance = np.full((N, N), -500.0, np.float32)
    occluder = np.ones((N, N), np.float32)
    rock_shadow.stamp(clearance, occluder, grid, rock_shadow.silhouettes(rocks, LIBRARY, s), s)
    assert np.all(clearance == -500.0) and np.all(occluder == 1.0)


@pytest.mark.parametrize('azimuth_deg', [15.0, 100.0, 260.0])
def test_a_rock_is_darkened_by_the_rocks_before_it_and_not_by_itself(azimuth_deg):
    """Points on top of twelve rocks at different heights, judged ray by ray."""
    s = sun_from(azimuth_deg, 12.0)
    rocks = some_rocks(40, seed=3, spread=2.5)
    points = rocks.position_m + [0.0, 0.0, 0.12]
    outlines = rock_shadow.silhouettes(rocks, LIBRARY, s)
    lit = np.full(len(rocks), 0.5, np.float32), np.full(len(rocks), 1.0, np.float32)
    clearance, occluder = rock_shadow.darken(*lit, points, outlines)
    expected = np.zeros(len(rocks), bool)
    for i in range(len(rocks)):
        others = np.arange(len(rocks)) != i
        # Only what lies sunward of the point by its centre counts.
        sunward = (rocks.position_m[i] - points) @ outlines.axes[2] > 0.0
        hit = is_hit(points, outlines.axes[2], pieces(rocks, i))
        expected |= hit & others & sunward
    assert 4 < expected.sum() < 35
    np.testing.assert_array_equal(clearance < 0.0, expected)
    assert np.all(clearance / occluder <= 0.5)
    assert np.all(lit[0] == 0.5) and np.all(lit[1] == 1.0)
