"""What the gait controller and its parameters refuse, and what may change live."""

import dataclasses
import math

import numpy as np
import pytest

from lunar_rover_sim.errors import ConfigError, GaitError
from lunar_rover_sim.gait.config import GaitConfig
from lunar_rover_sim.gait.controller import GaitController
from lunar_rover_sim.rover.description import RoverDescription


@pytest.mark.parametrize(('values', 'message'), [
    ({'duty_factor': 1.0}, 'duty_factor: 1'),
    ({'duty_factor': -0.1}, 'duty_factor: -0.1'),
    ({'foot_width_deg': 120.0}, 'foot_width_deg: 120 .*120'),
    ({'foot_width_deg': 100.0, 'spokes': 4}, 'foot_width_deg: 100 .*90'),
    ({'phase_offsets': (0.0, 0.5, 0.5, 1.0)}, 'phase_offsets: 1'),
    ({'gait': 'gallop'}, "gait: 'gallop'"),
])
def test_parameters_that_do_not_fit_are_refused(values, message):
    with pytest.raises(ConfigError, match=message):
        GaitConfig(**values)


def test_custom_offsets_are_one_for_each_leg():
    few = GaitConfig(gait='custom', phase_offsets=(0.0, 0.5, 0.5))
    with pytest.raises(ConfigError, match='phase_offsets: 3 elements given; .* one for each leg'):
        GaitController(few)
    controller = GaitController()
    with pytest.raises(ConfigError, match='phase_offsets: 3 elements'):
        controller.configure(few)


def test_the_number_of_spokes_cannot_change_while_walking():
    with pytest.raises(ConfigError, match='spokes: 5'):
        GaitController().configure(GaitConfig(spokes=5))


def test_the_gait_must_have_the_spokes_of_the_rover():
    six = RoverDescription.from_mapping({'legs': {'spokes': 6}})
    assert GaitConfig(foot_width_deg=40.0).for_rover(six).spokes == 6
    with pytest.raises(ConfigError, match='spokes: 3 is not valid for the gait; valid is 6'):
        GaitConfig(spokes=3).for_rover(six)
    with pytest.raises(ConfigError, match='foot_width_deg: 60 .*60'):
        GaitConfig().for_rover(six)
    with pytest.raises(ConfigError, match='spokes: 1 is not valid'):
        GaitConfig(spokes=1)


@pytest.mark.parametrize('bad', [[0.0, math.nan, 0.0, 0.0], [0.0] * 3, [math.inf] * 4, 'none'])
def test_joint_states_that_are_none_are_refused(bad):
    with pytest.raises(GaitError, match='joint angle: .*4 finite'):
        GaitController().update(0, bad, np.zeros(4))
    with pytest.raises(GaitError, match='joint velocity'):
        GaitController().update(0, np.zeros(4), bad)


def test_all_but_structure_is_live():
    fixed = {name for name, _value, info, _kind in GaitConfig().flatten() if not info.live}
    assert fixed == {'spokes', 'calibration'}
    assert dataclasses.is_dataclass(GaitConfig)
