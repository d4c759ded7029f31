"""Shadow heights against what can be written down: planes, steps, discs, and a walk to the sun."""

import numpy as np
import pytest

from lunar_rover_sim.ground.world.fine_relief import disc_share
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.image.illumination.horizon import (shadow_levels, ShadowLevel, split,
                                                        SunGeometry)

N, CELL = 65, 0.1
AZIMUTHS = [0.0, 17.0, 45.0, 73.0, 90.0, 118.0, 135.0, 161.0, 180.0, 208.0, 225.0, 251.0, 270.0,
            299.0, 315.0, 342.0]


def sun(azimuth_deg, elevation_deg=10.0):
    return SunGeometry(np.radians(azimuth_deg), np.radians(elevation_deg))


def grids(height, n=N):
    """Return a fine grid and a coarse one around it of a function height(x, y)."""
    result = []
    for cell in (CELL, 4.0 * CELL):
        axis = (np.arange(n) - 0.5 * (n - 1)) * cell
        result.append(HeightGrid(height(axis[None, :], axis[:, None]).astype(np.float32), cell))
    return result


def walk(height, xy, s, reach, step=0.002):
    """Return the shadow height at (m, 2) points for the sun's elevation, by walking sunward."""
    t = np.arange(0.5 * CELL, reach, step)
    points = xy[:, None] + t[None, :, None] * s.direction_xy
    above = height(points[..., 0], points[..., 1]) - t * np.tan(s.elevation_rad)
    return above.max(axis=1)


@pytest.mark.parametrize('azimuth_deg', [0.0, 31.0, 45.0, 90.0, 118.0, 180.0, 225.0, 299.0])
def test_shadow_heights_are_those_of_a_walk_to_the_sun(azimuth_deg):
    """Hills much longer than a cell, on the fine grid and beyond it, where the coarse one says."""
    rng = np.random.default_rng(3)
    waves = [(rng.uniform(-0.7, 0.7, 2), rng.uniform(0.0, 6.3)) for _ in range(8)]

    def height(x, y):
        return sum(0.2 * np.sin(k[0] * x + k[1] * y + phase) for k, phase in waves)

    s = sun(azimuth_deg, 12.0)
    levels = shadow_levels(grids(height), s)
    fine = levels[0]
    axis = (np.arange(N) - 0.5 * (N - 1)) * CELL
    xy = np.stack(np.meshgrid(axis[::4], axis[::4]), axis=-1).reshape(-1, 2)
    # 8 m leave the fine grid and end within the coarse one; hills are 3 m high at most.
    expected = walk(height, xy, s, 8.0).reshape(17, 17)
    found = fine.shadow_m[2, ::4, ::4]
    # Hills bend by 1 / (4 m) or less: bilinear cells of 0.4 m are off by 5 mm; the first step
    # sunward, whose ground does not count, by the slope of a cell.
    np.testing.assert_allclose(found[1:-1, 1:-1], expected[1:-1, 1:-1], atol=0.05)
    np.testing.assert_allclose(found, expected, atol=0.12)


@pytest.mark.parametrize('azimuth_deg', AZIMUTHS)
def test_without_anything_outside_rays_from_outside_bring_no_shadow(azimuth_deg):
    """On level ground one grid alone: sunward of the border there is nothing."""
    s = sun(azimuth_deg)
    level = ShadowLevel(HeightGrid(np.zeros((N, N), np.float32), CELL), s, None)
    step = CELL / np.abs(s.direction_xy).max()
    assert level.shadow_m.max() <= -step * np.tan(s.sweep_rad[0]) + 1e-6
    # Where the sun comes in nothing shadows; far inside it is the neighbour, one step away.
    inward = level.shadow_m[2, N // 2, N // 2]
    assert inward == pytest.approx(-step * np.tan(s.elevation_rad), abs=1e-6)
    corner = [0 if c < -1e-9 else N - 1 for c in s.direction_xy]
    assert level.shadow_m[2, corner[1], corner[0]] < -1e5


@pytest.mark.parametrize('elevation_deg', [4.0, 20.0, 60.0, 79.0])
@pytest.mark.parametrize('distance,height', [(3.0, 1.0), (10.0, 0.2), (1.0, 2.0)])
def test_one_occluder_is_split_into_clearance_and_distance(elevation_deg, distance, height):
    """The ray passes a point h above and t away at (t tan e - h) cos e, after t / cos e."""
    s = sun(0.0, elevation_deg)
    above = np.array([distance * np.tan(angle) - height for angle in s.sweep_rad], np.float32)
    clearance, occluder = split(above, s)
    e = s.elevation_rad
    # Differences of float32 tangents over 0.3 deg: 1e-3.
    assert clearance == pytest.approx((distance * np.tan(e) - height) * np.cos(e), rel=4e-3)
    assert occluder == pytest.approx(distance / np.cos(e), rel=2e-3)


@pytest.mark.parametrize('elevation_deg', [2.0, 30.0, 75.0])
@pytest.mark.parametrize('angle_deg', [-0.25, -0.1, 0.1, 0.25])
def test_near_the_horizon_their_quotient_is_the_angle_to_it(elevation_deg, angle_deg):
    s = sun(0.0, elevation_deg)
    distance = 5.0
    height = distance * np.tan(np.radians(elevation_deg - angle_deg))
    above = np.array([distance * np.tan(angle) - height for angle in s.sweep_rad], np.float32)
    clearance, occluder = split(above, s)
    # The tangent bends by tan e times the square of the angle.
    assert np.degrees(clearance / occluder) == pytest.approx(angle_deg, rel=0.03)


@pytest.mark.parametrize('elevation_deg', [5.0, 40.0, 80.0, 85.0, 89.0])
def test_the_horizon_of_level_ground_lies_below_any_sun(elevation_deg):
    """On a plane the angle between sun and horizon is the sun's elevation.

    Only the quotient counts; beyond some degrees the disc is seen whole, so 60 deg suffice.
    """
    s = sun(40.0, elevation_deg)
    clearance, occluder = shadow_levels(grids(lambda x, y: 0.0 * x + 0.0 * y), s)[0].clearance()
    angle = (clearance / occluder)[2:-2, 2:-2]
    assert angle.min() > 0.4 * np.sin(np.radians(2.0 * elevation_deg))
    assert np.isfinite(angle).all() and np.ptp(angle) < 0.02 * angle.max()


def test_huge_distances_are_scaled_together():
    """Quotients stay, and both numbers stay within what half floats hold (65504)."""
    s = sun(0.0, 5.0)
    above = np.array([-4000.0 + t for t in (0.0, 100.0, 210.0)], np.float32)
    clearance, occluder = split(above, s)
    assert abs(clearance) <= 100.0 + 1e-3 and occluder <= 5000.0 + 1e-2
    tangent = np.tan(s.sweep_rad)
    t = 110.0 / (tangent[2] - tangent[1])
    assert clearance / occluder == pytest.approx(above[2] * np.cos(s.elevation_rad)**2 / t,
                                                 rel=2e-3)


def test_the_visible_share_of_a_disc_is_its_area_above_the_edge():
    """Against counting: points of a disc that lie above a chord."""
    rng = np.random.default_rng(0)
    disc = rng.uniform(-1.0, 1.0, (400_000, 2))
    disc = disc[np.hypot(disc[:, 0], disc[:, 1]) < 1.0]
    for height in (-0.9, -0.4, 0.0, 0.25, 0.8):
        share = np.mean(disc[:, 1] > -height)
        assert disc_share(np.array([height]))[0] == pytest.approx(share, abs=0.01)
    np.testing.assert_allclose(disc_share(np.array([-215.0, 215.0])), [0.0, 1.0], atol=1e-12)
