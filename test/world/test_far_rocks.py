"""Rocks and albedo beyond the fine ground: the law of sizes, the edge, the ground, the seed."""

import dataclasses

import numpy as np
import pytest
import worlds

from lunar_rover_sim.world import ejecta
from lunar_rover_sim.world.craters import Craters
from lunar_rover_sim.world.far_albedo import far_albedo, RECIPE
from lunar_rover_sim.world.far_rocks import far_rocks, least_diameter_m
from lunar_rover_sim.world.rockfield import number_per_m2

REACH_M = 300.0


@pytest.fixture(scope='module')
def world():
    return worlds.small()


@pytest.fixture(scope='module')
def rocks(world):
    return far_rocks(world, REACH_M)


def test_sizes_follow_the_law_of_the_ground_up_to_300_m(world, rocks):
    away = np.abs(rocks.position_m[:, :2]).max(axis=1)
    assert away.min() > world.ground.half_extent_m and away.max() > 0.99 * REACH_M
    for inner, outer in ((100.0, 200.0), (200.0, 300.0)):
        ring = (away >= inner) & (away < outer)
        for least_m in (0.35, 0.6, 1.0):
            expected = number_per_m2(world.config.rocks, least_m) * 4.0 * (outer**2 - inner**2)
            # Diameters are rounded to classes 16 % apart; rocks gather around craters.
            found = np.count_nonzero(ring & (rocks.diameter_m >= least_m))
            assert found == pytest.approx(expected, rel=0.25)


def test_rocks_do_not_end_at_the_edge_of_the_ground(world, rocks):
    """Just outside, there are as many rocks of 0.1 m as the law has, and no gap."""
    half = world.ground.half_extent_m
    away = np.abs(rocks.position_m[:, :2]).max(axis=1)
    assert away.min() < half + 0.5
    near = (away < half + 14.0) & (rocks.diameter_m > 0.1)
    expected = number_per_m2(world.config.rocks, 0.1) * 4.0 * ((half + 14.0)**2 - half**2)
    assert np.count_nonzero(near) == pytest.approx(expected, rel=0.35)
    assert np.all(rocks.diameter_m > 0.9 * least_diameter_m(rocks.position_m[:, :2]))


def test_rocks_stand_in_the_ground(world, rocks):
    ground = world.height_at(rocks.position_m[:, :2])
    above = (rocks.position_m[:, 2] - ground) / rocks.diameter_m
    assert np.all(np.isfinite(above)) and np.abs(above).max() < 0.8
    assert 0.0 < np.median(above) < 0.3


def test_the_recipe_gives_the_rocks(world, rocks):
    again = far_rocks(world, REACH_M)
    assert np.array_equal(again.position_m, rocks.position_m)
    other = dataclasses.replace(world, config=world.config.with_seed(1))
    other = dataclasses.replace(other, config=dataclasses.replace(other.config, seed=2))
    assert len(far_rocks(other, REACH_M)) != len(rocks)
    for empty in (dataclasses.replace(world.config, seed=-1),
                  dataclasses.replace(world.config, rocks=dataclasses.replace(
                      world.config.rocks, abundance=0.0))):
        assert len(far_rocks(dataclasses.replace(world, config=empty), REACH_M)) == 0
    assert len(far_rocks(world, 0.0)) == 0


def test_albedo_varies_beyond_the_ground_and_has_no_step_at_its_edge(world):
    grid = world.levels[1]
    factor = far_albedo(world, 1)
    away = np.abs(np.arange(grid.n) - 0.5 * (grid.n - 1)) * grid.cell_m
    away = np.maximum(away[:, None], away) - world.ground.half_extent_m
    assert np.all(factor[away <= 0.0] == 1.0)
    assert np.abs(factor[(away > 0.0) & (away < 1.1 * grid.cell_m)] - 1.0).max() < 0.02
    outer = factor[away > 5.0]
    assert outer.std() > 0.5 * world.config.albedo.variation
    assert outer.mean() == pytest.approx(1.0, abs=0.05)


def test_the_albedo_has_bounds_however_much_it_varies(world):
    wild = dataclasses.replace(world.config, seed=5, albedo=dataclasses.replace(
        world.config.albedo, variation=0.3, fresh_crater=1.0))
    factor = far_albedo(dataclasses.replace(world, config=wild), 2)
    assert factor.min() == np.float32(0.4) and factor.max() == np.float32(1.8)


def test_the_far_albedo_is_the_published_one(world):
    """Where this changes, the recipe has changed: raise `RECIPE` and put the new factors here."""
    known = {1: (0.9817, 1.0395, 1.0218, 0.9964), 2: (1.0315, 1.0315, 1.0083, 0.9754),
             3: (1.0, 1.0, 1.0446, 1.0)}
    assert RECIPE == 1
    for k, factors in known.items():
        np.testing.assert_allclose(far_albedo(world, k)[20, [10, 80, 128, 200]], factors,
                                   atol=5e-4)


def test_levels_show_the_same_patches(world):
    fine, coarse = far_albedo(world, 1), far_albedo(world, 2)
    ratio = round(world.levels[2].cell_m / world.levels[1].cell_m)
    middle, half = world.levels[2].n // 2, (world.levels[1].n // 2) // ratio
    inner = coarse[middle - half:middle + half + 1, middle - half:middle + half + 1]
    both = np.corrcoef(fine[::ratio, ::ratio][:inner.shape[0], :inner.shape[1]].ravel(),
                       inner.ravel())[0, 1]
    assert both > 0.4


def test_rays_are_narrow_and_reach_beyond_the_rim():
    crater = Craters(np.array([[3.0, -2.0]]), np.array([20.0]), np.array([0.0]),
                     np.zeros(1, np.int32))
    field = np.zeros((401, 401))
    ejecta.add_rays(field, 0.5, crater, 1.0)
    angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    column = (3.0 + 25.0 * np.cos(angle)) / 0.5 + 200
    row = (-2.0 + 25.0 * np.sin(angle)) / 0.5 + 200
    ring = field[np.rint(row).astype(int), np.rint(column).astype(int)]
    assert ring.max() > 0.15 and np.median(ring) < 0.1 * ring.max()
    old = dataclasses.replace(crater, age=np.array([0.5]))
    before = field.copy()
    ejecta.add_rays(field, 0.5, old, 1.0)
    assert np.array_equal(field, before)
