"""Sinkage and slip of the feet."""

import math

import numpy as np
from physics_scene import make_world, simulate, trot

from lunar_rover_sim import topics
from lunar_rover_sim.illumination.config import SunConfig
from lunar_rover_sim.regolith.config import GroundConfig
from lunar_rover_sim.sensors.feet import FootSlip, Sinkage
from lunar_rover_sim.sensors.sensor import Platform


def platform(simulation):
    return Platform(simulation, make_world(), SunConfig(), 1, 0.005)


def test_slip_over_sweep_is_the_slip_ratio():
    """Each foot is on the ground in a good half of the time, as the rover goes on above it."""
    with simulate(ground=GroundConfig(model='regolith')) as simulation:
        slip, sinkage = FootSlip(None, platform(simulation)), Sinkage(None, platform(simulation))
        ways = []
        trot(simulation, 3.0, observe=lambda state: ways.append(
            slip.measure(state, state.stamp_ns)[topics.FOOT_SLIP.name].position))
        slipped, swept = np.reshape(ways[-1], (2, 4))
        went = math.hypot(*simulation.state.position_m[:2])
        assert 0.4 * went < np.mean(swept - slipped) < went
        assert np.all(np.abs(slipped / swept) < 0.5)
        depths = sinkage.measure(simulation.state, 0)[topics.SINKAGE.name]
        assert list(depths.position) == simulation.ground_contact.sinkage_m.tolist()
        slip.restart()
        again = slip.measure(simulation.state, 0)[topics.FOOT_SLIP.name]
        assert max(np.abs(again.position)) < 0.005


def test_on_rigid_ground_nothing_sinks():
    with simulate() as simulation:
        assert Sinkage(None, platform(simulation)).measure(simulation.state, 0) == {}
