"""Motors: torque-speed limit, current limit, stall, velocity control, against the data sheet."""

import dataclasses

import mujoco
import numpy as np
from physics_scene import ROVER, simulate, trot
import pytest

from lunar_rover_sim.base.errors import ConfigError, LunarRoverSimError
from lunar_rover_sim.rover.description import leg_inertia, Motor, RoverDescription
from lunar_rover_sim.rover.physics.config import StartPose

MOTOR = ROVER.motor


def floating(rover: RoverDescription = ROVER):
    """Return the rover in free space, where legs turn without load."""
    simulation = simulate(rover=rover, gravity_mps2=0.0, start=StartPose(settle_s=0.0))
    simulation.data.qpos[2] = 5.0
    return simulation


def torque_limit_nm(motor: Motor, speed_radps: float) -> float:
    """Return the greatest driving torque at the leg [N m] at a speed >= 0, by the data sheet."""
    voltage_bound = motor.gear_ratio * motor.stall_torque_nm * (
        1.0 - speed_radps / motor.leg_no_load_speed_radps)
    return max(0.0, min(motor.leg_stall_torque_nm, voltage_bound))


def test_a_free_leg_starts_with_stall_torque_and_ends_at_no_load_speed():
    with floating() as simulation:
        simulation.command([100.0, -100.0, 100.0, -100.0])
        first = simulation.advance(1)
        np.testing.assert_allclose(np.abs(first.motor_torque_nm), MOTOR.leg_stall_torque_nm)
        np.testing.assert_allclose(np.abs(first.motor_current_a), MOTOR.current_limit_a)
        inertia = MOTOR.rotor_inertia_kgm2 * MOTOR.gear_ratio ** 2 + leg_inertia(ROVER.legs)[1, 1]
        torque = MOTOR.leg_stall_torque_nm - MOTOR.coulomb_friction_nm
        # Opposite legs cancel on the chassis, so each leg accelerates by itself.
        np.testing.assert_allclose(np.abs(first.joint_velocity_radps), torque / inertia * 0.001,
                                   rtol=0.02)
        simulation.advance(1000)
        last = simulation.advance(1)
    speed = np.abs(last.joint_velocity_radps)
    assert np.all(speed < MOTOR.leg_no_load_speed_radps)
    assert np.all(speed > 0.95 * MOTOR.leg_no_load_speed_radps)
    # What is left of the torque is the friction of the gear.
    np.testing.assert_allclose(
        np.abs(last.motor_torque_nm),
        MOTOR.coulomb_friction_nm + MOTOR.viscous_friction_nms * speed, rtol=0.02)


@pytest.mark.parametrize('speed', [0.0, 4.0, 8.0, 12.0])
def test_the_torque_follows_the_data_sheet(speed):
    with floating() as simulation:
        simulation.data.qvel[6:10] = speed
        simulation.command([100.0] * 4)
        state = simulation.advance(1)
    np.testing.assert_allclose(state.motor_torque_nm, torque_limit_nm(MOTOR, speed), rtol=1e-6)


@pytest.mark.parametrize('speed', [1e3, 1e30, -1e300])
def test_a_command_out_of_all_reason_asks_for_full_torque(speed):
    with floating() as simulation:
        simulation.command([speed, -speed, speed, -speed])
        state = simulation.advance(1)
    np.testing.assert_allclose(state.motor_torque_nm / MOTOR.leg_stall_torque_nm,
                               np.sign(speed) * np.array([1.0, -1.0, 1.0, -1.0]))


def test_the_velocity_is_tracked_in_the_air():
    with floating() as simulation:
        command = np.array([2.0, -1.0, 0.5, 3.0])
        simulation.command(command)
        state = simulation.advance(500)
    # The loop is proportional: it is off by the friction over the gain.
    friction = MOTOR.coulomb_friction_nm + MOTOR.viscous_friction_nms * 3.0
    np.testing.assert_allclose(state.joint_velocity_radps, command,
                               atol=1.1 * friction / MOTOR.velocity_gain_nms)


def test_a_blocked_leg_shows_as_such():
    with floating() as simulation:
        model = simulation.model
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, 'front_left_joint')
        model.dof_frictionloss[model.jnt_dofadr[joint]] = 50.0
        simulation.command([3.0] * 4)
        state = simulation.advance(500)
    assert abs(state.joint_velocity_radps[0]) < 0.05
    assert state.motor_current_a[0] == pytest.approx(MOTOR.current_limit_a)
    assert np.all(np.abs(state.motor_current_a[1:]) < 0.1 * MOTOR.current_limit_a)


def test_unpowered_legs_are_held_by_the_gear():
    start = StartPose(joint_angle_rad=(0.2, 0.2, 0.2, 0.2))
    with simulate(start=start) as simulation:
        before = simulation.state.joint_angle_rad
        after = simulation.advance(5000).joint_angle_rad
    # 0.9 N on each tip, 15 mm behind the axle: less than the dry friction.
    np.testing.assert_allclose(after, before, atol=0.01)


def test_electric_energy_covers_mechanical_energy():
    with simulate() as simulation:
        trot(simulation, 1.0)
        electric, mechanical = [], []

        def observe(state):
            electric.append(MOTOR.electric_power_w(state.motor_torque_nm,
                                                   state.joint_velocity_radps).sum())
            mechanical.append((state.motor_torque_nm * state.joint_velocity_radps).sum())

        trot(simulation, 4.0, observe=observe)
    assert np.mean(electric) > np.mean(mechanical) > 0.0
    # Walking with 3.6 N of weight at 0.14 m/s takes some watts at most.
    assert np.mean(electric) < 5.0


def test_stall_and_no_load_come_from_the_bare_motor():
    motor = Motor(supply_voltage_v=6.0, stall_torque_nm=0.01, no_load_speed_radps=600.0,
                  gear_ratio=50.0, current_limit_a=100.0)
    assert motor.motor_constant == pytest.approx(0.01)
    assert motor.resistance_ohm == pytest.approx(6.0)
    assert motor.leg_stall_torque_nm == pytest.approx(0.5)
    assert motor.leg_no_load_speed_radps == pytest.approx(12.0)
    assert torque_limit_nm(motor, 6.0) == pytest.approx(0.25)
    assert torque_limit_nm(motor, 20.0) == 0.0
    assert motor.current_a(0.5) == pytest.approx(1.0)
    assert motor.electric_power_w(0.5, 0.0) == pytest.approx(6.0)


@pytest.mark.parametrize('name', [f.name for f in dataclasses.fields(Motor)])
def test_negative_motor_parameters_are_refused(name):
    with pytest.raises(ConfigError, match=f'motor.{name}: -1.0 is not valid; valid is'):
        RoverDescription.from_mapping({'motor': {name: -1.0}})


@pytest.mark.parametrize('field', dataclasses.fields(Motor), ids=lambda field: field.name)
@pytest.mark.parametrize('end', ['low', 'high'])
def test_any_motor_that_is_valid_moves_or_is_refused_in_words(field, end):
    """At the ends of the ranges: beyond them a parameter is not valid."""
    value = getattr(field.metadata['info'], end)
    for beyond in (1e30, 1e300, np.inf, np.nan):
        with pytest.raises(ConfigError, match=f'{field.name}: '):
            dataclasses.replace(MOTOR, **{field.name: beyond})
    motor = dataclasses.replace(MOTOR, **{field.name: value})
    try:
        with simulate(rover=dataclasses.replace(ROVER, motor=motor)) as simulation:
            simulation.command(np.full(4, 5.0))
            assert np.isfinite(simulation.advance(300).position_m).all()
    except LunarRoverSimError as error:
        assert '\n' not in str(error)
