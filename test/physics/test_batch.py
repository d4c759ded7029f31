"""A batch walks as its simulations would alone."""

import numpy as np
from physics_scene import make_world, rough_heights, simulate, soft
import pytest

from lunar_rover_sim.errors import PhysicsError
from lunar_rover_sim.physics.batch import SimulationBatch
from lunar_rover_sim.physics.config import StartPose

WORLD = make_world(rough_heights())
COMMANDS = np.array([[4.0, 3.0, 3.0, 4.0], [2.0, 5.0, 4.0, 1.0], [0.0, 6.0, 0.0, 6.0]])


def several():
    return [simulate(WORLD, ground=soft(), start=StartPose(x_m=0.3 * k, settle_s=0.2))
            for k in range(3)]


def test_rovers_of_a_batch_walk_as_they_would_alone():
    alone = []
    for simulation, command in zip(several(), COMMANDS):
        with simulation:
            for turn in range(20):
                simulation.command(command * (1.0 + 0.1 * turn))
                state = simulation.advance(5)
            alone.append(np.concatenate([state.position_m, state.joint_angle_rad]))
    with SimulationBatch(several(), threads=3) as batch:
        for turn in range(20):
            states = batch.advance(COMMANDS * (1.0 + 0.1 * turn), 5)
        found = [np.concatenate([state.position_m, state.joint_angle_rad]) for state in states]
    np.testing.assert_array_equal(found, alone)
    assert np.ptp(np.array(alone)[:, 3], axis=0) > 0.1


def test_one_that_diverges_ends_alone():
    with SimulationBatch(several()) as batch:
        batch.simulations[1].data.qvel[7] = np.nan
        states = batch.advance(COMMANDS, 5)
        assert isinstance(states[1], PhysicsError) and 'diverged' in str(states[1])
        assert np.isfinite([states[k].position_m for k in (0, 2)]).all()


def test_what_a_batch_refuses():
    with pytest.raises(PhysicsError, match='simulations: none is not valid'):
        SimulationBatch([])
    with pytest.raises(PhysicsError, match='threads: 0 is not valid; valid is >= 1'):
        SimulationBatch(several()[:1], threads=0)
    with SimulationBatch(several()) as batch:
        with pytest.raises(PhysicsError, match='valid are 3 commands'):
            batch.advance(COMMANDS[:2], 5)
