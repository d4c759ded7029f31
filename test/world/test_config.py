"""The recipe: what is refused."""

import pytest

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.world.build import build_world
from lunar_rover_sim.world.cache import cached
from lunar_rover_sim.world.config import WorldConfig

FLAT = Scenario.load('flat').world


@pytest.mark.parametrize('mapping, message', [
    ({'size_m': 50.1}, r'size_m: 50.1 is not a multiple of 16 cells .* nearest is 50$'),
    ({'size_m': 51.3}, r'size_m: 51.3 .* nearest is 51.2$'),
    ({'sice_m': 51.2}, r'world.sice_m: no such parameter; did you mean size_m'),
    ({'relief': {'hurst': 1.5}}, r'world.relief.hurst: 1.5 is not valid; valid is >= 0.05'),
    ({'relief': {'longest_wavelength_m': 0.0}}, 'longest_wavelength_m: 0.0 is not valid'),
    ({'rocks': {'min_diameter_m': 2.0, 'max_diameter_m': 1.0}},
     r'^world\.rocks\.min_diameter_m: 2 is not valid; valid is <= max_diameter_m = 1 \[m\]$'),
    ({'source': 'dem'}, 'world.path: empty; source dem needs a file'),
    ({'source': 'dme', 'path': 'x'}, "'dme' is not valid; did you mean dem"),
    ({'dem': {'center': [1.0]}}, r'world.dem.center: 1 elements given; valid is 2 elements'),
    ({'rocks': 3}, 'world.rocks: 3 is not a mapping'),
])
def test_mistakes_are_named(mapping, message):
    with pytest.raises(ConfigError, match=message):
        WorldConfig.from_mapping(mapping, 'world')


def test_mapping_round_trip():
    config = WorldConfig.from_mapping({'rocks.abundance': 0.01, 'seed': 5})
    assert WorldConfig.from_mapping(config.to_mapping()) == config
    assert config.samples == 2049


@pytest.mark.parametrize('seed, message', [
    (-1, r'^seed: -1 is not valid; valid is >= 0$'),
    (1.5, r'^seed: 1\.5 is not a whole number$'),
    ('one', r"^seed: 'one' is not a whole number$"),
])
def test_a_seed_is_a_whole_number_from_0_on(seed, message):
    with pytest.raises(ConfigError, match=message):
        build_world(FLAT, seed)
    with pytest.raises(ConfigError, match=message):
        cached(FLAT, seed)


@pytest.mark.parametrize('seed', [-2, -7, 0.5, 'one'])
def test_the_seed_of_a_recipe_is_a_whole_number_or_that_of_the_scenario(seed):
    assert WorldConfig.from_mapping({'seed': -1}).with_seed(4).seed == 4
    with pytest.raises(ConfigError, match='seed: .* is not'):
        WorldConfig.from_mapping({'seed': seed})


def test_the_seed_of_the_recipe_wins():
    assert FLAT.with_seed(7).seed == 7
    assert FLAT.with_seed(0).seed == 0
    assert WorldConfig(seed=3).with_seed(7).seed == 3
