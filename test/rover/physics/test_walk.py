"""Walking: convergence with the step, determinism, the IMU's truth against the trajectory."""

import dataclasses

import numpy as np
from physics_scene import GRAVITY, make_world, rough_heights, ROVER, simulate, STATE_S, trot
import pytest

from lunar_rover_sim.base.errors import PhysicsError
from lunar_rover_sim.base.frames import matrix_from_wxyz, wxyz_from_matrix
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import imu_pose
from lunar_rover_sim.rover.physics.config import StartPose

G = np.array([0.0, 0.0, -GRAVITY])
MOUNTED = dataclasses.replace(ROVER, imu=dataclasses.replace(
    ROVER.imu, position_m=(0.03, -0.02, 0.05), rpy_deg=(20.0, -35.0, 80.0)))


def rotation(vector: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a small rotation vector, by its series."""
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + cross + cross @ cross / 2 + cross @ cross @ cross / 6


@pytest.mark.parametrize('frequency_hz', [0.5, 1.0])
def test_halving_the_step_hardly_changes_the_distance(frequency_hz):
    """The bound of 2 % is half of what slip changes between firm and soft ground."""
    paths = []
    for step_s in (0.001, 0.0005):
        with simulate(step_s=step_s) as simulation:
            state = trot(simulation, 10.0, frequency_hz)
            paths.append(np.linalg.norm(state.position_m[:2]))
    # A trial of such a rover made 0.14 m/s at 1 Hz, in proportion to the frequency.
    assert paths[0] == pytest.approx(10.0 * 0.14 * frequency_hz, rel=0.15)
    assert paths[1] == pytest.approx(paths[0], rel=0.02)


def test_the_same_commands_give_the_same_states():
    def states(simulation):
        record = [simulation.state]
        trot(simulation, 2.0, observe=record.append)
        return np.array([np.concatenate([np.ravel(v) for v in vars(s).values()])
                         for s in record])

    world = make_world(rough_heights())
    with simulate(world) as simulation:
        first = states(simulation)
        simulation.reset()
        again = states(simulation)
    with simulate(world) as simulation:
        other = states(simulation)
    assert np.array_equal(first, again)
    assert np.array_equal(first, other)


def test_time_is_whole_steps():
    with simulate(step_s=0.0005) as simulation:
        assert simulation.state.stamp_ns == 0
        assert simulation.advance(7).stamp_ns == 3_500_000
        assert simulation.advance(1).stamp_ns == 4_000_000
        assert simulation.reset().stamp_ns == 0


def test_imu_at_rest_feels_gravity_upwards():
    with simulate(rover=MOUNTED) as simulation:
        state = simulation.advance(5)
    up = matrix_from_wxyz(state.orientation_wxyz) @ imu_pose(MOUNTED)[:3, :3] \
        @ state.specific_force_mps2
    np.testing.assert_allclose(up, -G, atol=1e-3)
    np.testing.assert_allclose(state.imu_rate_radps, 0.0, atol=1e-3)


@pytest.mark.parametrize('terrain', ['flat', 'rough'])
def test_integrating_the_true_imu_gives_the_trajectory(terrain):
    """Within 1 cm and 0.1 deg over 10 s; only the start is given."""
    T_base_imu = imu_pose(MOUNTED)
    R_base_imu, lever = T_base_imu[:3, :3], T_base_imu[:3, 3]
    world = make_world(rough_heights() if terrain == 'rough' else None)
    with simulate(world, MOUNTED, start=StartPose(yaw_deg=30.0)) as simulation:
        start = trot(simulation, 1.0)
        record = []
        trot(simulation, 10.0, observe=record.append)

    R_world_base = matrix_from_wxyz(start.orientation_wxyz)
    attitude = R_world_base @ R_base_imu
    position = start.position_m + R_world_base @ lever
    velocity = R_world_base @ (start.linear_velocity_mps
                               + np.cross(start.angular_velocity_radps, lever))
    for state in record:
        half = rotation(state.imu_rate_radps * STATE_S / 2)
        acceleration = attitude @ half @ state.specific_force_mps2 + G
        position = position + velocity * STATE_S + acceleration * STATE_S ** 2 / 2
        velocity = velocity + acceleration * STATE_S
        attitude = attitude @ half @ half
        R_world_base = matrix_from_wxyz(state.orientation_wxyz)
        offset = position - (state.position_m + R_world_base @ lever)
        assert np.linalg.norm(offset) < 0.01
        quat = wxyz_from_matrix((R_world_base @ R_base_imu).T @ attitude)
        assert 2.0 * np.linalg.norm(quat[1:]) < np.radians(0.1)
    assert np.linalg.norm(record[-1].position_m - start.position_m) > 0.8


def test_mean_contact_forces_are_the_impulse_that_moves_the_rover():
    """Sum of forces and weight = change of momentum: nothing lost between the states."""
    with simulate() as simulation:
        trot(simulation, 1.0)
        forces = []
        trot(simulation, 6.0, observe=lambda s: forces.append(s.contact_force_n.sum(axis=0)))
    mean = np.mean(forces, axis=0)
    # Momentum changes by less than m x 0.3 m/s over 6 s.
    np.testing.assert_allclose(mean, -ROVER.total_mass_kg * G, atol=ROVER.total_mass_kg * 0.05)


def test_velocity_is_that_of_the_origin_in_base_axes():
    with simulate() as simulation:
        trot(simulation, 2.0)
        first = simulation.advance(1)
        second = simulation.advance(1)
    # MuJoCo moves by the new velocity: the difference quotient is exact.
    world = (second.position_m - first.position_m) / 0.001
    own = matrix_from_wxyz(second.orientation_wxyz).T @ world
    np.testing.assert_allclose(second.linear_velocity_mps, own, atol=1e-9)


def test_the_pose_maps_points_of_the_base_to_the_world():
    with simulate(start=StartPose(x_m=1.0, y_m=-2.0, yaw_deg=90.0)) as simulation:
        T = simulation.state.T_world_base
    ahead = T @ [1.0, 0.0, 0.0, 1.0]
    np.testing.assert_allclose(ahead[:2], [1.0, -1.0], atol=0.02)


def test_a_rover_too_light_for_mujoco_is_refused_in_one_line():
    rover = RoverDescription.from_mapping({'legs': {'mass_kg': 1e-14}})
    with pytest.raises(PhysicsError, match='the rover cannot be simulated: .* masses in kg'):
        simulate(make_world(), rover=rover)
