"""Soil that varies over the map: loose on rims, ejecta and slopes."""

import dataclasses

import numpy as np
from physics_scene import make_world, ROVER, simulate
import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.ground.regolith.config import GroundConfig
from lunar_rover_sim.ground.regolith.law import looseness_factors
from lunar_rover_sim.ground.regolith.looseness import soil_map
from lunar_rover_sim.ground.regolith.soil import PRESETS
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.rover.physics.config import StartPose
from lunar_rover_sim.rover.physics.soft_ground import soil_record

SOIL = soil_record(PRESETS['highland'], ROVER, 0.001)[0]


def factors(varies, x, y):
    """Return the factors on bearing and friction at a position, as the law has them."""
    return looseness_factors(x, y, varies.varied, SOIL)


def cratered(age):
    """Return a plane that counts as one with a crater of 2 m around (2, 0)."""
    craters = Craters(np.array([[2.0, 0.0]]), np.array([2.0]), np.array([age]),
                      np.zeros(1, np.int32))
    return dataclasses.replace(make_world(), craters=craters)


def test_the_rim_of_a_fresh_crater_is_as_loose_as_loose_highland():
    varies = soil_map(cratered(0.0), 1.0)
    bearing, friction = factors(varies, 3.0, 0.0)
    assert bearing == pytest.approx(0.3, rel=0.02) and friction == pytest.approx(0.65 / 0.84, 0.01)
    # At two radii ejecta are an eighth as thick as at the rim.
    assert factors(varies, 4.0, 0.0)[0] == pytest.approx(0.3 ** 0.125, rel=0.02)
    assert factors(varies, -4.0, 0.0) == (1.0, 1.0)
    assert factors(varies, 9.0, 0.0) == (1.0, 1.0)        # beyond the world


def test_every_crater_around_counts_and_the_loosest_one_decides():
    """In any order, craters outside of the world among them."""
    x = np.array([40.0, 2.0, -2.0, -2.0, -60.0, 0.0])
    y = np.array([0.0, 0.0, 0.0, 0.0, 3.0, 3.0])
    ages = np.array([0.0, 0.0, 0.25, 0.4, 0.0, 0.1])
    world = make_world()

    def bearing(order, at):
        craters = Craters(np.stack([x, y], axis=1)[order], np.full(len(order), 2.0), ages[order],
                          np.zeros(len(order), np.int32))
        return factors(soil_map(dataclasses.replace(world, craters=craters), 1.0), *at)[0]

    for at, single in (((3.0, 0.0), 1), ((-3.0, 0.0), 2), ((0.0, 4.0), 5)):
        alone = bearing([single], at)
        assert alone < 0.9
        for order in (list(range(6)), list(reversed(range(6))), [0, 4, 3, 5, 2, 1]):
            assert bearing(order, at) == pytest.approx(alone, rel=1e-6)


@pytest.mark.parametrize('age', [0.0, 0.2, 0.49])
def test_looseness_around_a_crater_is_that_of_its_law(age):
    """0.3 of the rim's at the centre, in a parabola to the rim, then r^-3, 0 from 4 radii on."""
    radius, x0, y0 = 1.1, -0.7, 0.5
    craters = Craters(np.array([[x0, y0]]), np.array([2.0 * radius]), np.array([age]),
                      np.zeros(1, np.int32))
    grid = soil_map(dataclasses.replace(make_world(), craters=craters), 1.0).looseness
    assert grid.half_extent_m >= make_world().ground.half_extent_m
    axis = (np.arange(grid.n) - (grid.n - 1) / 2) * grid.cell_m
    rho = np.hypot(axis[None, :] - x0, axis[:, None] - y0) / radius
    law = np.where(rho < 1.0, 0.3 + 0.7 * rho**2, np.where(rho < 4.0, 1.0 / rho.clip(1.0)**3, 0.0))
    clear = np.abs(rho - 4.0) > 1e-6
    np.testing.assert_allclose(grid.heights_m[clear], ((1.0 - age / 0.5) * law)[clear], atol=1e-6)


@pytest.mark.parametrize('diameter_m,counts', [(0.5, True), (0.4999, False)])
def test_small_craters_are_left_out(diameter_m, counts):
    craters = Craters(np.array([[1.0, -2.0]]), np.array([diameter_m]), np.zeros(1),
                      np.zeros(1, np.int32))
    varies = soil_map(dataclasses.replace(make_world(), craters=craters), 1.0)
    assert (factors(varies, 1.0, -2.0)[0] < 1.0) == counts


@pytest.mark.parametrize('slope_x,slope_y', [(0.3, 0.0), (0.0, -0.4), (0.25, 0.25), (-0.1, 0.05)])
def test_looseness_of_a_plane_is_linear_in_the_tangent(slope_x, slope_y):
    """Of 10 to 30 deg; towards the border the slope over half a metre is cut short."""
    x = (np.arange(401) - 200) * 0.025
    world = make_world(slope_x * x[None, :] + slope_y * x[:, None])
    tangent, (low, high) = np.hypot(slope_x, slope_y), np.tan(np.radians([10.0, 30.0]))
    loose = float(np.clip((tangent - low) / (high - low), 0.0, 1.0))
    varies = soil_map(world, 1.0)
    for at in ((0.0, 0.0), (3.1, -4.2), (-4.5, 0.7)):
        assert varies.looseness.height_at_point(*at) == pytest.approx(loose, abs=1e-4)
        bearing, friction = factors(varies, *at)
        assert bearing == pytest.approx(0.3 ** loose, rel=1e-3)
        assert friction == pytest.approx((0.65 / 0.84) ** loose, rel=1e-3)
    # A crater on a slope: what is firm of each is multiplied.
    craters = Craters(np.array([[0.0, 0.0]]), np.array([2.0]), np.zeros(1), np.zeros(1, np.int32))
    both = soil_map(dataclasses.replace(world, craters=craters), 1.0)
    assert both.looseness.height_at_point(2.0, 0.0) == pytest.approx(
        1.0 - (1.0 - loose) * (1.0 - 1.0 / 8.0), abs=0.01)


def test_old_craters_do_not_count_and_half_the_variation_is_half_in_logarithm():
    assert factors(soil_map(cratered(0.6), 1.0), 3.0, 0.0) == (1.0, 1.0)
    half = factors(soil_map(cratered(0.0), 0.5), 3.0, 0.0)
    assert half[0] == pytest.approx(0.3 ** 0.5, rel=0.02)


def test_steep_ground_is_loose():
    x = (np.arange(401) - 200) * 0.025
    heights = np.tile(np.where(x > 0.0, np.tan(np.radians(30.0)) * x, 0.0), (401, 1))
    varies = soil_map(make_world(heights), 1.0)
    assert factors(varies, -2.0, 0.0) == (1.0, 1.0)
    assert factors(varies, 3.0, 0.0)[0] == pytest.approx(0.3, rel=0.02)


def test_a_rover_stands_deeper_on_a_rim_than_on_the_plain():
    world, sinkage = cratered(0.0), []
    for variation, x_m in ((1.0, -3.0), (1.0, 3.0), (0.0, 3.0)):
        ground = GroundConfig(model='regolith', variation=variation)
        with simulate(world, ground=ground, start=StartPose(x_m=x_m)) as simulation:
            sinkage.append(float(simulation.ground_contact.sinkage_m.mean()))
    assert sinkage[0] == pytest.approx(sinkage[2], abs=2e-4)
    assert sinkage[1] > 1.5 * sinkage[0]


def test_a_variation_without_meaning_is_refused():
    with pytest.raises(ConfigError, match='variation: -1.0 is not valid; valid is 0 to 2'):
        GroundConfig(variation=-1.0)
