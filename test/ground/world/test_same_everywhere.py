"""One seed, one world: on every machine, processor and version of NumPy.

`test/test_portability.py` runs these as on an old processor.
"""

import numpy as np
import pytest

from lunar_rover_sim.ground.world.build import build_world, drop_m
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.grid import ALBEDO_STEP, height_step_m, on_lattice, significant
from lunar_rover_sim.ground.world.levels import axis_m
from lunar_rover_sim.ground.world.world_folder import load_world, RECIPE, save_world

SMALL = {'size_m': 12.8, 'surroundings': {'samples': 129}}
SEED = 3
# The same on Debian 12 and 13, Python 3.10 to 3.13, NumPy 1.26 to 2.5, with and without AVX-512.
# Where one changes, the recipe has changed: raise `RECIPE` and put the new hashes here.
KNOWN = 9, '488898a459852593f35d9d9bf64cf267'
# Of all options of craters, rocks, albedo and relief.
OTHERS = {
    'craters': ('e0eb2a2a672acf06f62cceab3bbd95c0', {
        'craters': {'irregularity': 0.0, 'density': 0.1, 'slope': 2.6, 'fresh_depth': 0.15,
                    'oldest_depth': 0.05, 'max_diameter_m': 9.0, 'age_exponent': 0.7},
        'rocks': {'abundance': 0.06, 'min_diameter_m': 0.05}, 'albedo': {'variation': 0.0}}),
    'rocks': ('a6580af64d37ec77be121c587bcbc6b9', {
        'clear_radius_m': 1.7, 'albedo': {'grain': 0.0}, 'craters': {'density': 0.1},
        'rocks': {'max_per_m2': 0.2, 'abundance': 0.2, 'decay_per_m': 3.0, 'tilt_deg': 40.0,
                  'near_craters': 30.0, 'burial': 0.6, 'size_classes': 5}}),
    'relief': ('ed5677916bcb5593c1855ca362762639', {
        'size_m': 12.8, 'cell_m': 0.1, 'albedo': {'fresh_crater': 0.0},
        'relief': {'rms_slope_deg': 6.0, 'far_rms_slope_deg': 0.0,
                   'longest_wavelength_m': 20.0}})}


@pytest.fixture(scope='module')
def world():
    return build_world(WorldConfig.from_mapping(SMALL, 'world'), SEED)


def test_the_world_is_the_published_one(world):
    assert (RECIPE, world.hash) == KNOWN


@pytest.mark.parametrize('name', OTHERS)
def test_other_recipes_give_the_published_worlds(name):
    known, recipe = OTHERS[name]
    small = {'size_m': 6.4, 'surroundings': {'samples': 65, 'extent_m': 40.0}, **recipe}
    assert build_world(WorldConfig.from_mapping(small), SEED).hash == known


def test_heights_and_albedo_lie_on_their_lattice(world):
    for level in world.levels:
        step = height_step_m(level.cell_m)
        x = axis_m(level.n, level.cell_m)
        curve = drop_m(x**2 + x[:, None]**2, 0.5**0.5 * world.config.size_m)
        inner = (level.heights_m + (0.0 if level is world.ground else curve))[1:-1, 1:-1]
        # Coarse levels show the heights of the finer ones within them.
        share = np.mean(np.abs(inner - on_lattice(inner, step)) < 2e-6)
        assert share == 1.0 if level is world.ground else share > 0.5
        # Slopes of the rounding alone, from cell to cell, are invisible: below 0.2 mrad RMS.
        assert step / np.sqrt(6.0) / level.cell_m < 0.0005
    np.testing.assert_array_equal(world.albedo, on_lattice(world.albedo, ALBEDO_STEP))


def test_orientations_are_unit_quaternions(world):
    norm = np.linalg.norm(world.rocks.orientation_wxyz, axis=1)
    np.testing.assert_allclose(norm, 1.0, atol=1e-15)


def test_rounding():
    assert on_lattice([0.3, -0.3, 0.125], 0.25).tolist() == [0.25, -0.25, 0.0]
    assert significant(1.0 / 3.0) == float(np.float32(1.0 / 3.0))
    assert height_step_m(0.025) == 2.0**-17 and height_step_m(1.6) == 2.0**-11


def test_the_folder_names_the_recipe(world, tmp_path):
    folder = save_world(world, tmp_path / 'world')
    assert f'recipe: {RECIPE}\n' in (folder / 'world.yaml').read_text()
    assert load_world(folder).hash == world.hash
