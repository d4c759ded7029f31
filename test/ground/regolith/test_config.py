"""Soils: presets, overrides, gravity, and what is refused."""

import dataclasses

import numpy as np
from physics_scene import depth_m
import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.ground.regolith.config import GroundConfig
from lunar_rover_sim.ground.regolith.soil import PRESETS


def test_presets_are_soils_under_the_gravity_of_the_simulation():
    for name, soil in PRESETS.items():
        assert GroundConfig(preset=name).soil(soil.gravity_mps2) == soil
    assert not GroundConfig().deforms and GroundConfig(model='regolith').deforms


def test_every_number_of_a_preset_can_be_set():
    ground = GroundConfig(bearing_mnpm3=2.0, friction=0.7, cohesion_kpa=0.5, compacted=0.1,
                          repose_deg=31.0, shear_mm=7.0, elastic_npm=3000.0, damping_nspm=70.0)
    soil = ground.soil(1.62)
    assert (soil.zeta_npm3, soil.friction, soil.cohesion_pa, soil.compacted, soil.repose_deg,
            soil.shear_m, soil.elastic_npm, soil.damping_nspm) == (
                2e6, 0.7, 500.0, 0.1, 31.0, 0.007, 3000.0, 70.0)


@pytest.mark.parametrize('name', PRESETS)
def test_the_numbers_of_a_preset_are_valid_when_they_are_set_one_by_one(name):
    soil = PRESETS[name]
    ground = GroundConfig(
        preset=name, bearing_mnpm3=soil.zeta_npm3 / 1e6, friction=soil.friction,
        cohesion_kpa=soil.cohesion_pa / 1e3, compacted=soil.compacted, repose_deg=soil.repose_deg,
        shear_mm=soil.shear_m * 1e3, elastic_npm=soil.elastic_npm, damping_nspm=soil.damping_nspm)
    assert dataclasses.astuple(ground.soil(soil.gravity_mps2))[:9] == pytest.approx(
        dataclasses.astuple(soil)[:9])


@pytest.mark.parametrize('names', [('highland_loose', 'highland', 'highland_dense'),
                                   ('poppy_loose', 'poppy_close')])
def test_the_denser_a_soil_the_stronger(names):
    """It bears more, its grains lock, and it has less room to be compacted."""
    for looser, denser in zip(*(map(PRESETS.get, part) for part in (names, names[1:]))):
        assert looser.zeta_npm3 < denser.zeta_npm3 and looser.compacted > denser.compacted
        assert looser.friction <= denser.friction and looser.repose_deg <= denser.repose_deg
        assert looser.shear_m > denser.shear_m


@pytest.mark.parametrize('gravity', [1.62, 3.71, 9.81])
def test_without_cohesion_the_sinkage_does_not_depend_on_gravity(gravity):
    soil = PRESETS['highland'].under(gravity)
    assert depth_m(0.56 * gravity, soil.zeta_npm3) == pytest.approx(
        depth_m(0.56 * 1.62, PRESETS['highland'].zeta_npm3))
    # Equal Froude number: damping over the root of stiffness and mass stays.
    assert soil.damping_nspm / np.sqrt(soil.elastic_npm) == pytest.approx(
        PRESETS['highland'].damping_nspm / np.sqrt(PRESETS['highland'].elastic_npm))


def test_cohesion_bears_by_the_bearing_capacity_of_prandtl():
    """N_c = 46.1 and N_q = 33.3 at 35 deg (tables of Vesic 1975), on a round footing."""
    ground = GroundConfig(friction=float(np.tan(np.radians(35.0))), cohesion_kpa=1.0)
    assert ground.soil(1.62).cohesive_bearing_pa == pytest.approx(1e3 * (46.1 + 33.3), rel=0.01)
    assert PRESETS['highland'].cohesive_bearing_pa == 0.0
    for cohesion_pa in (1e-3, 1.0, 50.0):
        soil = dataclasses.replace(ground.soil(1.62), cohesion_pa=cohesion_pa)
        assert soil.cohesive_bearing_pa == pytest.approx(
            1e-3 * cohesion_pa * ground.soil(1.62).cohesive_bearing_pa)


@pytest.mark.parametrize('values, message', [
    ({'model': 'sand'}, "model: 'sand' is not valid"),
    ({'preset': 'higland'}, "preset: 'higland' is not valid; did you mean highland"),
    ({'preset': 'mud'}, "preset: 'mud' is not valid; valid are highland, "),
    ({'bearing_mnpm3': 0.0}, 'bearing_mnpm3: 0 is not valid; valid is 0.02 to 50, or -1'),
    ({'compacted': 1.5}, 'compacted: 1.5 is not valid'),
    ({'variation': 2.1}, 'variation: 2.1 is not valid; valid is 0 to 2')])
def test_soils_that_do_not_exist_are_refused(values, message):
    with pytest.raises(ConfigError, match=message):
        GroundConfig.from_mapping(values)


def test_grains_need_gravity():
    with pytest.raises(ConfigError, match='gravity_mps2: 0 is not valid on ground.model'):
        GroundConfig(model='regolith').soil(0.0)
