"""A simulation goes on from a file as the one that was saved, bit for bit."""

from pathlib import Path

import numpy as np
from physics_scene import everything, make_world, rough_heights, same, simulate, soft, trot
import pytest
from windows_scene import CutSite, window

from lunar_rover_sim.base.errors import ConfigError, PhysicsError
from lunar_rover_sim.rover.physics.config import GroundConfig, StartPose
from lunar_rover_sim.rover.physics.simulation import Simulation

AT = (-0.25, 12.75)     # beside a corner of four tiles
GROUNDS = (GroundConfig(), soft(variation=1.0))
SAVED_AT = 430      # of 600 states: in the third window


def begun(ground: GroundConfig) -> Simulation:
    """Return a simulation on a site whose windows are a hand apart."""
    site = CutSite(AT, step_m=0.1, half_m=14.4)
    return simulate(window((-0.3, 12.8), 14.4, AT), site=site, ground=ground,
                    start=StartPose(x_m=AT[0], y_m=AT[1], yaw_deg=20.0, settle_s=0.3))


@pytest.mark.parametrize('ground', GROUNDS, ids=lambda ground: ground.model)
def test_another_simulation_goes_on_as_the_saved_one(ground, tmp_path, monkeypatch):
    file, states, commands = tmp_path / 'walk.npz', [], []
    middles = []
    with begun(ground) as simulation:
        command = simulation.command
        monkeypatch.setattr(simulation, 'command', lambda value: (
            commands.append(np.array(value)), command(value)))

        def observe(_: object) -> None:
            states.append(everything(simulation))
            middles.append(simulation.world.ground.middle_m)
            if len(states) == SAVED_AT:
                simulation.save(file)

        trot(simulation, 3.0, observe=observe)
        tracks = simulation.overlay.snapshot() if ground.deforms else None
        changes = simulation.overlay.take_changes() if ground.deforms else None
    assert len(set(middles[:SAVED_AT])) >= 2 <= len(set(middles[SAVED_AT:]))
    with begun(ground) as other:
        trot(other, 0.5)        # what it has done before does not matter
        state = other.restore(file)
        assert state.stamp_ns == other.time_ns == SAVED_AT * 5_000_000
        assert other.world.ground.middle_m == middles[SAVED_AT - 1]
        found = []
        for velocity in commands[SAVED_AT:]:
            other.command(velocity)
            other.advance(round(0.005 / other.config.step_s))
            found.append(everything(other))
        np.testing.assert_array_equal(found, states[SAVED_AT:])
        if tracks is not None:
            assert len(tracks) > 500 and same(other.overlay.snapshot(), tracks)
            assert same(other.overlay.take_changes(), changes)


def test_what_does_not_belong_together_is_refused(tmp_path):
    file, world = tmp_path / 'state.npz', make_world(rough_heights())
    with simulate(world) as simulation:
        simulation.save(file)
        simulation.advance(10)
        before = simulation.state
        assert simulation.restore(file).stamp_ns == 0
        assert before.stamp_ns > 0
    with simulate(world, ground=soft()) as other, pytest.raises(
            PhysicsError, match='restore: the state is of another ground; valid is GroundConfig'):
        other.restore(file)
    with simulate(make_world()) as other, pytest.raises(
            PhysicsError, match=r'restore: the state is of another site: .* valid is 0 m'):
        other.restore(file)
    file.write_bytes(file.read_bytes()[:-300])
    with simulate(world) as other, pytest.raises(ConfigError, match='is no state that can be'):
        other.restore(file)
    with simulate(world) as other, pytest.raises(ConfigError, match='No such file'):
        other.restore(Path('nowhere.npz'))
