"""Shadows of rocks on coarse cells: length, area and brightness, and the light of far rocks."""

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.frames import sun_direction
from lunar_rover_sim.illumination import rock_shadow
from lunar_rover_sim.illumination.config import ReflectanceConfig, SunConfig
from lunar_rover_sim.illumination.horizon import SunGeometry
from lunar_rover_sim.illumination.sunlight import Sunlight
from lunar_rover_sim.world.grid import HeightGrid
from lunar_rover_sim.world.rocks import Rocks
from lunar_rover_sim.world.shapes import library


def sun(azimuth_deg, elevation_deg):
    return SunGeometry.towards(sun_direction(azimuth_deg, elevation_deg))


@pytest.mark.parametrize('cell_m', [0.2, 0.4])
@pytest.mark.parametrize('elevation_deg', [3.0, 6.0, 15.0])
@pytest.mark.parametrize('azimuth_deg', [0.0, 30.0, 230.0])
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
    rocks = Rocks(rng.integers(0, 16, m).astype(np.int32), size,
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
        rng.integers(0, 16, m).astype(np.int32), size, position, turn, np.ones(m, np.float32),
        sizes), shapes, s)
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
