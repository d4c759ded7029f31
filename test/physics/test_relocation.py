"""The rover put elsewhere by hand: it stands there, the IMU feels no jump, nonsense is refused."""

import numpy as np
from physics_scene import GRAVITY, simulate
import pytest

from lunar_rover_sim.errors import PhysicsError
from lunar_rover_sim.frames import wxyz_from_rpy
from lunar_rover_sim.physics.config import GroundConfig

YAW_90 = wxyz_from_rpy(0.0, 0.0, np.pi / 2)


def test_the_rover_stands_where_it_was_put() -> None:
    """It rests there at its height; the IMU reads gravity alone, also across the jump."""
    with simulate() as simulation:
        height_m = simulation.state.position_m[2]
        state = simulation.move([1.5, -2.0, height_m], YAW_90)
        assert np.allclose(state.position_m, [1.5, -2.0, height_m])
        after = simulation.advance(5)
        assert np.linalg.norm(after.specific_force_mps2) == pytest.approx(GRAVITY, abs=0.2)
        assert np.abs(after.imu_rate_radps).max() < 0.1
        for _ in range(100):
            after = simulation.advance(5)
        assert np.allclose(after.position_m, [1.5, -2.0, height_m], atol=2e-3)
        assert abs(after.orientation_wxyz @ YAW_90) == pytest.approx(1.0, abs=1e-4)


def test_velocities_are_in_world_axes() -> None:
    """A rover in flight that looks to the left and moves east moves to its own right."""
    with simulate() as simulation:
        state = simulation.move([0.0, 0.0, 5.0], YAW_90, [1.0, 0.0, 0.0], [0.0, 0.0, 0.5])
        assert np.allclose(state.linear_velocity_mps, [0.0, -1.0, 0.0], atol=1e-12)
        flown = simulation.advance(500)
        assert flown.position_m[0] == pytest.approx(0.5, abs=0.02)
        assert flown.position_m[2] == pytest.approx(5.0 - 0.5 * GRAVITY * 0.25, abs=0.02)
        assert flown.angular_velocity_radps[2] == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(('given', 'said'), [
    ({'position_m': [0.0, 0.0, -1.0]}, 'in the ground or in a rock; raise it'),
    ({'position_m': [0.0, 0.0, 0.03]}, 'in the ground or in a rock; raise it'),
    ({'position_m': [99.0, 0.0, 1.0]}, 'is not on the ground; it ends at'),
    ({'position_m': [np.nan, 0.0, 1.0]}, 'valid is 3 finite numbers'),
    ({'orientation_wxyz': [0.0] * 4}, 'valid is a unit quaternion'),
    ({'linear_mps': [1e3, 0.0, 0.0]}, 'valid is less than'),
])
def test_nonsense_is_refused_and_changes_nothing(given: dict[str, list[float]],
                                                 said: str) -> None:
    """The next states are those of an untouched simulation."""
    with simulate() as simulation, simulate() as untouched:
        with pytest.raises(PhysicsError, match=said):
            simulation.move(**given)
        assert np.array_equal(simulation.advance(20).position_m,
                              untouched.advance(20).position_m)


def test_soft_ground_is_refused() -> None:
    """It remembers where each leg stood."""
    with simulate(ground=GroundConfig(model='regolith')) as simulation:
        with pytest.raises(PhysicsError, match='valid is rigid ground'):
            simulation.move([0.0, 0.0, 1.0])
