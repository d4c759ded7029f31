"""Feet and leg wrenches of random motions, against their definitions and differences in time."""

import dataclasses

import mujoco
import numpy as np
from physics_scene import make_world, ROVER, simulate
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.errors import PhysicsError
from lunar_rover_sim.rover.description import Legs
from lunar_rover_sim.rover.physics.config import StartPose
from lunar_rover_sim.rover.physics.foot_motion import FootObserver
from lunar_rover_sim.rover.physics.observation import Observer
from lunar_rover_sim.rover.physics.state import RoverState, TipOver
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoise

SLOPE_X, SLOPE_Y = 0.12, -0.07
LEGS = ROVER.legs
STEP_S = 1e-6


def plane():
    axis = (np.arange(401) - 200) * 0.025
    return make_world(SLOPE_X * axis[None, :] + SLOPE_Y * axis[:, None])


def state_of(seed):
    """Return a rover anyhow over a plane, every leg loaded but the second."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_euler('ZYX', rng.uniform([-3.0, -0.3, -0.3], [3.0, 0.3, 0.3]))
    force = rng.uniform(0.5, 1.0, (4, 3))
    force[1] = 0.0
    zeros = np.zeros(4)
    return RoverState(0, np.array([0.4, -0.3, 0.05]), turn.as_quat()[[3, 0, 1, 2]],
                      rng.normal(0.0, 0.2, 3), rng.normal(0.0, 1.0, 3),
                      rng.uniform(-9.0, 9.0, 4), rng.normal(0.0, 3.0, 4), zeros, zeros, force,
                      np.zeros((4, 3)), np.zeros(3), np.zeros(3))


def later(state, time_s):
    """Return rotation, position and leg angles a little later, by the motion of a state."""
    quat = state.orientation_wxyz[[1, 2, 3, 0]]
    turn = Rotation.from_quat(quat)
    return (turn * Rotation.from_rotvec(state.angular_velocity_radps * time_s),
            state.position_m + turn.apply(state.linear_velocity_mps) * time_s,
            state.joint_angle_rad + state.joint_velocity_radps * time_s)


@pytest.mark.parametrize('seed', range(4))
def test_sweep_and_slip_are_differences_of_points_on_the_legs(seed):
    """The point on which the lowest tip stands is marked on its leg; its way is followed."""
    state = state_of(seed)
    motion = FootObserver(ROVER, plane().ground, 1.62).observe(state)
    normal = np.array([-SLOPE_X, -SLOPE_Y, 1.0]) / np.sqrt(1.0 + SLOPE_X**2 + SLOPE_Y**2)
    turn, position, angles = later(state, 0.0)
    ahead = turn.apply([1.0, 0.0, 0.0])
    ahead -= normal * (normal @ ahead)
    ahead /= np.linalg.norm(ahead)
    assert motion.loaded.tolist() == [True, False, True, True]
    for leg, axle in enumerate(np.array(LEGS.axle_positions_m())):
        # Spokes turn about y: at angle 0 the first one points down, and forward is positive.
        tips = []
        for k in range(LEGS.spokes):
            spoke = Rotation.from_rotvec([0.0, angles[leg] + k * LEGS.spoke_pitch_rad, 0.0])
            length = LEGS.spoke_length_m - LEGS.tip_radius_m
            tips.append(turn.apply(axle + spoke.apply([0.0, 0.0, -length])) + position)
        lowest = min(tips, key=lambda p: p[2] - SLOPE_X * p[0] - SLOPE_Y * p[1])
        mark = turn.inv().apply(lowest - LEGS.tip_radius_m * normal - position) - axle

        def place(time_s):
            turned, moved, at = later(state, time_s)
            leg_turn = Rotation.from_rotvec([0.0, at[leg] - angles[leg], 0.0])
            return (turned.apply(axle + leg_turn.apply(mark)) + moved,
                    turned.apply(axle) + moved)

        (point_a, axle_a), (point_b, axle_b) = place(-STEP_S), place(STEP_S)
        speed = (point_b - point_a) / (2.0 * STEP_S) @ ahead
        axle_speed = (axle_b - axle_a) / (2.0 * STEP_S) @ ahead
        assert motion.axle_mps[leg] == pytest.approx(axle_speed, abs=2e-6)
        loaded = float(motion.loaded[leg])
        assert motion.sweep_mps[leg] == pytest.approx(loaded * (axle_speed - speed), abs=2e-6)
        assert motion.slip_mps[leg] == pytest.approx(-loaded * speed, abs=2e-6)


@pytest.mark.parametrize('seed', range(3))
def test_wrenches_are_moved_from_the_centre_of_mass_to_the_axles(seed):
    """Torque about an axle = torque about the centre of mass + (centre - axle) x force."""
    rng = np.random.default_rng(seed)
    with simulate(start=StartPose(yaw_deg=37.0)) as simulation:
        model, data = simulation.model, simulation.data
        data.qpos[:] = [0.3, -0.2, 0.4, *Rotation.random(random_state=seed).as_quat(),
                        *rng.uniform(-3.0, 3.0, 4)]
        data.qvel[:] = rng.normal(size=10)
        mujoco.mj_forward(model, data)
        observer = Observer(model, data, ROVER, 1.62)
        wrench, torque = rng.normal(size=(4, 6)), rng.normal(size=4)
        state = observer.observe(7, 0.01, wrench, torque)
        centre = data.subtree_com[1].copy()
        axles = [data.body(leg).xpos.copy() for leg in Legs().names]
    for leg in range(4):
        expected = wrench[leg, :3] + np.cross(centre - axles[leg], wrench[leg, 3:])
        np.testing.assert_allclose(state.contact_torque_nm[leg], expected, atol=1e-12)
    np.testing.assert_array_equal(state.contact_force_n, wrench[:, 3:])
    np.testing.assert_allclose(state.motor_current_a * ROVER.motor.gear_ratio
                               * ROVER.motor.motor_constant, torque)
    turn = Rotation.from_quat(state.orientation_wxyz[[1, 2, 3, 0]])
    np.testing.assert_allclose(turn.apply(state.linear_velocity_mps), data.qvel[:3], atol=1e-12)
    assert state.stamp_ns == 7


def test_pulling_at_the_chassis_moves_the_rover_that_way():
    """A tenth of the weight is held by friction, and shows in the forces of the feet."""
    with simulate() as simulation:
        weight = ROVER.total_mass_kg * 1.62
        simulation.apply_force([0.1 * weight, -0.05 * weight, 0.2 * weight])
        total = simulation.advance(1500).contact_force_n.sum(axis=0)
        assert total == pytest.approx(np.array([-0.1, 0.05, 0.8]) * weight, abs=0.01 * weight)
        assert not simulation.data.xfrc_applied[:, 3:].any()
        simulation.apply_force([0.0, 0.0, 0.0])
        total = simulation.advance(1500).contact_force_n.sum(axis=0)
        assert total == pytest.approx(np.array([0.0, 0.0, 1.0]) * weight, abs=0.01 * weight)
        simulation.apply_force([0.0, 0.0, weight])
        simulation.reset()
        assert not simulation.data.xfrc_applied.any()
        for bad in ([1.0, 2.0], [1.0, 2.0, np.nan], [[1.0, 2.0, 3.0]]):
            with pytest.raises(PhysicsError, match='apply_force: .* three finite'):
                simulation.apply_force(bad)
        for bad in ([1.0] * 3, [1.0] * 5, [[1.0] * 4], 1.0, 'fast', [1.0, 2.0, 3.0, np.inf]):
            with pytest.raises(PhysicsError, match='command: .* 4 finite velocities'):
                simulation.command(bad)


@pytest.mark.parametrize('config', [ImuConfig(), ImuConfig(
    accel_scale_error=(0.01, -0.02, 0.03), gyro_misalignment_deg=(2.0, -1.0, 3.0),
    accel_resolution_mps2=0.01, gyro_range_radps=0.5)])
def test_many_samples_go_on_where_those_before_ended(config):
    """Two pieces at once, and the rest one by one, are the samples of one generator."""
    rng = np.random.default_rng(3)
    force, rate = rng.normal(size=(2, 40, 3))
    one, other = (ImuNoise(config, 200.0, np.random.default_rng(9)) for _ in range(2))
    parts = [one.measure_many(force[:15], rate[:15]), one.measure_many(force[15:30], rate[15:30])]
    parts += [one.measure(f, r) for f, r in zip(force[30:], rate[30:])]
    single = [other.measure(f, r) for f, r in zip(force, rate)]
    for name in (field.name for field in dataclasses.fields(single[0])):
        joined = np.concatenate([np.atleast_2d(getattr(part, name)) for part in parts])
        np.testing.assert_allclose(joined, [getattr(sample, name) for sample in single],
                                   atol=1e-12)


def test_the_tilt_has_two_bounds():
    """Over at more than 70 deg, upright again at 45 deg; told once."""
    over = TipOver()
    for tilt_deg, begins, lies in ((69.9, False, False), (70.1, True, True), (120.0, False, True),
                                   (45.1, False, True), (44.9, False, False), (46.0, False, False),
                                   (180.0, True, True)):
        turn = Rotation.from_rotvec(np.radians(tilt_deg) * np.array([0.6, 0.8, 0.0]))
        quat = (Rotation.from_euler('z', 1.0) * turn).as_quat()[[3, 0, 1, 2]]
        assert over.has_begun(quat) == begins and over.lies == lies
        assert over.tilt_deg == pytest.approx(tilt_deg, abs=1e-6)


def test_imu_velocity_after_a_jump_is_that_of_its_place():
    """The IMU sits off the origin of base_link: a turn moves it."""
    rover = dataclasses.replace(ROVER, imu=dataclasses.replace(
        ROVER.imu, position_m=(0.1, -0.2, 0.05)))
    with simulate() as simulation:
        model, data = simulation.model, simulation.data
        data.qvel[:6] = [0.3, -0.1, 0.2, 0.5, -0.6, 0.7]
        observer = Observer(model, data, rover, 1.62)
        observer.after_jump()
        quat, velocity = observer.motion
        turn = Rotation.from_quat(data.qpos[[4, 5, 6, 3]])
        swing = np.cross([0.5, -0.6, 0.7], [0.1, -0.2, 0.05])
        np.testing.assert_allclose(velocity, turn.apply(swing) + [0.3, -0.1, 0.2], atol=1e-12)
        np.testing.assert_array_equal(quat, data.qpos[3:7])
        # Going on at the same motion it feels gravity alone, upwards.
        state = observer.observe(0, 1e-3, np.zeros((4, 6)), np.zeros(4))
        np.testing.assert_allclose(turn.apply(state.specific_force_mps2), [0.0, 0.0, 1.62],
                                   atol=1e-9)
        np.testing.assert_allclose(state.imu_rate_radps, 0.0, atol=1e-9)


def test_a_body_that_turns_feels_it():
    """The rate is that of the turn between two attitudes, the acceleration that of the velocity.
    """
    with simulate() as simulation:
        model, data = simulation.model, simulation.data
        observer = Observer(model, data, ROVER, 1.62)
        before = Rotation.from_quat(data.qpos[[4, 5, 6, 3]])
        observer.after_jump()
        rate, interval_s = np.array([0.4, -0.7, 1.1]), 0.02
        after = before * Rotation.from_rotvec(rate * interval_s)
        data.qpos[[4, 5, 6, 3]] = after.as_quat()
        data.qvel[:6] = [0.02, -0.01, 0.03, 0.0, 0.0, 0.0]
        state = observer.observe(0, interval_s, np.zeros((4, 6)), np.zeros(4))
    mount = Rotation.from_euler('xyz', ROVER.imu.rpy_deg, degrees=True)
    np.testing.assert_allclose(state.imu_rate_radps, mount.inv().apply(rate), atol=1e-9)
    middle = before * Rotation.from_rotvec(rate * 0.5 * interval_s)
    force = np.array([0.02, -0.01, 0.03]) / interval_s + [0.0, 0.0, 1.62]
    np.testing.assert_allclose(state.specific_force_mps2,
                               mount.inv().apply(middle.inv().apply(force)), atol=1e-6)


def rolled(angle_deg: float, heading_deg: float = 0.0) -> np.ndarray:
    """Return an orientation wxyz: heading about z, then roll about the own x axis."""
    c, s = np.cos(np.radians(heading_deg) / 2), np.sin(np.radians(heading_deg) / 2)
    cr, sr = np.cos(np.radians(angle_deg) / 2), np.sin(np.radians(angle_deg) / 2)
    return np.array([c * cr, c * sr, s * sr, s * cr])


@pytest.mark.parametrize('heading_deg', [0.0, 130.0, -75.0])
@pytest.mark.parametrize('roll_deg', [0.0, 30.0, -69.0, 75.0, 120.0, 180.0])
def test_the_tilt_is_that_of_the_vertical_axis(roll_deg: float, heading_deg: float) -> None:
    """It does not depend on the heading."""
    tip_over = TipOver()
    assert tip_over.has_begun(rolled(roll_deg, heading_deg)) == (abs(roll_deg) > 70.0)
    assert tip_over.tilt_deg == pytest.approx(abs(roll_deg), abs=1e-5)
    assert tip_over.lies == (abs(roll_deg) > 70.0)


def test_rocking_on_the_side_is_one_tip_over() -> None:
    """Only a rover that stood again can tip over again."""
    tip_over = TipOver()
    begun = [tip_over.has_begun(rolled(deg)) for deg in (60, 95, 65, 95, 50, 71, 20, 60, 71)]
    assert begun == [False, True, False, False, False, False, False, False, True]
