"""Light from the ground around: exitance of planes, halves in shadow, and slopes facing others."""

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.image.illumination.config import ReflectanceConfig, SunConfig
from lunar_rover_sim.image.illumination.hapke import hemispherical_albedo, SETS
from lunar_rover_sim.image.illumination.sunlight import indirect_light, Sunlight

ALBEDO = hemispherical_albedo(SETS['highland'])


def visibility(world, azimuth_deg, elevation_deg, albedo_scale=1.0):
    return Sunlight(world, SunConfig(azimuth_deg=azimuth_deg, elevation_deg=elevation_deg),
                    ReflectanceConfig(albedo_scale=albedo_scale),
                    sun_direction(azimuth_deg, elevation_deg))


@pytest.mark.parametrize('elevation_deg', [2.0, 10.0, 60.0])
@pytest.mark.parametrize('albedo_scale', [1.0, 0.5])
def test_a_plane_sends_back_its_albedo_of_what_falls_on_it(elevation_deg, albedo_scale):
    seen = visibility(scene.plane(n=257), 40.0, elevation_deg, albedo_scale)
    expected = ALBEDO * albedo_scale * np.sin(np.radians(elevation_deg))
    assert seen.surroundings_at((0.5, -1.0)) == pytest.approx(expected, rel=1e-3)
    # And none of it falls on the plane itself.
    assert all(np.abs(irradiance).max() < 1e-4 * expected for irradiance, _ in seen.scattered)


def test_places_of_any_shape_have_their_exitance():
    """A single one, a list, a picture; beyond all levels there is none."""
    seen = visibility(scene.plane(n=129), 40.0, 30.0)
    places = np.random.default_rng(1).uniform(-1.0, 1.0, (4, 3, 2))
    found = seen.surroundings_at(places)
    assert found.shape == (4, 3) and seen.surroundings_at(places[0]).shape == (3,)
    assert seen.surroundings_at(places[0, 0]).shape == ()
    np.testing.assert_array_equal(found[1], seen.surroundings_at(places[1]))
    assert found.min() > 0.0 and seen.surroundings_at((1e9, 0.0)) == 0.0


@pytest.mark.parametrize('elevation_deg', [0.1, 0.2])
def test_a_sun_that_stands_half_in_the_horizon_lights_by_its_share(elevation_deg):
    """Linear over the disc of 0.533 deg, as narrow as the strip between two samples is."""
    seen = visibility(scene.plane(n=257), 40.0, elevation_deg)
    share = 0.5 + elevation_deg / 0.533
    expected = ALBEDO * share * np.sin(np.radians(elevation_deg))
    # The horizon is extrapolated from sweeps 0.3 deg lower, in float32.
    assert seen.surroundings_at((0.0, 0.0)) == pytest.approx(expected, rel=0.05)


def test_ground_behind_a_wall_is_dark_and_ground_before_it_bright():
    heights = np.zeros((257, 257), np.float32)
    heights[:, 140:144] = 2.0              # a wall along y, 0.3 m east of the middle
    seen = visibility(scene.plane(n=257, heights=heights), 0.0, 20.0)
    lit = ALBEDO * np.sin(np.radians(20.0))
    assert seen.surroundings_at((-2.0, 0.0)) < 0.1 * lit
    assert seen.surroundings_at((2.9, 0.0)) == pytest.approx(lit, rel=0.1)
    # The wall's lit side shines on the ground at its foot, more the nearer.
    irradiance = seen.scattered[0][0]
    row = irradiance[len(irradiance) // 2]
    east = row[int(0.6 * len(row)):]
    # Of the last cell only the first sample lies on the grid.
    assert east[0] > 2.0 * east[-2] > 0.0


@pytest.mark.parametrize('irradiance,elevation_deg,indirect', [
    (0.0, 20.0, True), (1361.0, -1.0, True), (1361.0, 20.0, False)])
def test_without_a_sun_or_when_it_is_switched_off_nothing_is_scattered(irradiance, elevation_deg,
                                                                       indirect):
    sun = SunConfig(elevation_deg=elevation_deg, irradiance=irradiance)
    seen = Sunlight(scene.plane(n=129), sun, ReflectanceConfig(),
                    sun_direction(60.0, elevation_deg), indirect)
    assert all(not values.any() for pair in seen.scattered for values in pair)


@pytest.mark.parametrize('axis', ['x', 'y', '-x', '-y'])
def test_a_lit_slope_shines_on_the_plane_before_it_whichever_way_it_faces(axis):
    """The same slope, turned: the same light, turned."""
    n, cell = 129, 0.1
    ramp = np.clip((np.arange(n) - 80) * cell, 0.0, 2.0)
    heights = np.tile(ramp, (n, 1)).astype(np.float32)
    direction = np.array([-np.cos(0.3), 0.0, np.sin(0.3)])
    lit = np.ones((n, n), np.float32)
    lit[:, :78] = 0.0
    base, _ = indirect_light(heights, cell, lit, direction, 0.2)
    turns = {'x': 0, 'y': 1, '-x': 2, '-y': 3}[axis]
    angle = np.pi / 2.0 * turns
    turned = np.array([np.cos(angle) * direction[0], np.sin(angle) * direction[0], direction[2]])
    # Row 0 lies south: a turn to the left is one of the array to the right.
    found, _ = indirect_light(np.ascontiguousarray(np.rot90(heights, -turns)), cell,
                              np.ascontiguousarray(np.rot90(lit, -turns)), turned, 0.2)
    np.testing.assert_allclose(np.rot90(found, turns), base, atol=1e-5)
    assert base[n // 2, 70] > base[n // 2, 50] > base[n // 2, 30] > 0.0
