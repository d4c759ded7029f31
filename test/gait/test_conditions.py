"""The conditions of a gait table against those of a rover and a ground."""

import dataclasses

from lunar_rover_sim.files.paths import config_folder
from lunar_rover_sim.gait.calibration import GaitCalibration
from lunar_rover_sim.gait.conditions import differences, ground_conditions, rover_conditions
from lunar_rover_sim.physics.config import ContactConfig, PhysicsConfig
from lunar_rover_sim.regolith.config import GroundConfig
from lunar_rover_sim.rover.description import Chassis, Legs, rectangle, RoverDescription

PACKAGED = GaitCalibration.load(config_folder() / 'gait_calibrations/rigid.yaml').conditions
ANALYTIC = GaitCalibration.default().conditions


def test_other_conditions_are_named():
    assert differences(PACKAGED, rover_conditions(RoverDescription())) == []
    assert differences(PACKAGED, ground_conditions(PhysicsConfig())) == []
    heavy = rover_conditions(RoverDescription(chassis=Chassis(mass_kg=4.0)))
    assert differences(PACKAGED, heavy) == ['rover_mass_kg 2.24, here 4.24']
    legs = RoverDescription(legs=Legs(spokes=4, each=rectangle(x=0.2)))
    assert differences(PACKAGED, rover_conditions(legs)) == ['spokes 3, here 4',
                                                             'axle_x_m 0.115, here 0.2']
    assert differences(PACKAGED, ground_conditions(PhysicsConfig(gravity_mps2=9.81))) == \
        ['gravity_mps2 1.62, here 9.81']
    assert differences(ANALYTIC, {**heavy, **ground_conditions(PhysicsConfig())}) == []


def test_a_table_of_another_ground_is_named():
    """The packaged one is of rigid ground; one of soft ground names soil, not contact."""
    soft = PhysicsConfig(ground=GroundConfig(model='regolith', preset='highland_loose'),
                         contact=ContactConfig(stiffness_npm=9000.0))
    here = ground_conditions(soft)
    assert differences(PACKAGED, here) == ['ground rigid, here highland_loose']
    assert differences({'gravity_mps2': 1.62}, here) == ['ground rigid, here highland_loose']
    assert differences(here, here) == []
    firmer = dataclasses.replace(soft, ground=dataclasses.replace(soft.ground, bearing_mnpm3=0.6))
    assert differences(here, ground_conditions(firmer)) == ['bearing_mnpm3 0.3, here 0.6']
    assert differences(here, ground_conditions(PhysicsConfig())) == \
        ['ground highland_loose, here rigid']
    assert differences(ANALYTIC, here) == []
