"""Gait, walks on rigid ground and the sensors of the body: numbers that are choices."""

from collections.abc import Callable
import dataclasses
from typing import Any

import numpy as np
from physics_scene import trot
from regression.conftest import DOUBLE
from regression.scenes import hills, stones

from lunar_rover_sim.ground.world import shapes
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.rover.description import ImuMount, Legs, RoverDescription
from lunar_rover_sim.rover.gait.calibration import GaitCalibration, STAND, Stride
from lunar_rover_sim.rover.gait.config import GaitConfig, GAITS
from lunar_rover_sim.rover.gait.controller import GaitController, LegPhases
from lunar_rover_sim.rover.gait.shaping import ShapingFunction
from lunar_rover_sim.rover.physics.config import PhysicsConfig, StartPose
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoise, noise_parameters, PRESETS
from lunar_rover_sim.sensors.power_monitor import PowerMonitorConfig, PowerMonitors
from lunar_rover_sim.sensors.wheel_odometry import Rolling, WheelOdometry, WheelOdometryConfig

Unchanged = Callable[..., None]
# Contacts on rigid ground do not let rounding grow: 1e-15 m are 1e-14 m after seconds.
WALK = 1e-6


def rough_world() -> World:
    ground = hills(161, 0.025, 0.02, 0.05)
    return World((ground,), np.ones_like(ground.heights_m), stones(ground, 5, 9, 0.4),
                 shapes.library(), WorldConfig(), '')


def test_shaping_of_stance_and_flight(unchanged: Unchanged) -> None:
    phase = np.linspace(-1.3, 1.4, 109)
    arrays = {}
    for name, values in (('usual', (0.6, 1.05, 0.05, 1.0)), ('abrupt', (0.3, 0.5, 1.0, 0.0)),
                         ('smooth', (0.5, 1.0, 0.6, 0.7)), ('long', (0.9, 0.1, 0.3, 1.0))):
        shaping = ShapingFunction(*values, 2.0 * np.pi / 3.0)
        arrays |= {f'{name}_angle': shaping.angle(phase), f'{name}_slope': shaping.slope(phase),
                   f'{name}_phase': shaping.phase(np.linspace(-3.0, 3.3, 11))}
    unchanged(DOUBLE, **arrays)


def test_phases_of_each_gait_array(unchanged: Unchanged) -> None:
    """Start, walk, turn, turn on the spot, reverse, stand."""
    orders = [(Stride(1.2), 70), (Stride.turning(1.8, 0.8), 60), (Stride.turning(1.1, -1.0), 40),
              (Stride(1.5).reversed(), 50), (STAND, 60), (Stride(0.4), 30)]
    arrays = {}
    for name in (*GAITS, 'custom'):
        config = GaitConfig(gait=name, phase_offsets=(0.1, 0.85, 0.3, 0.62))
        legs, rows = LegPhases(Legs().on_left), []
        legs.start([0.3, -0.4, 0.12, 2.7])
        for stride, count in orders:
            for _ in range(count):
                legs.advance(0.02, config, stride, config.offsets(Legs()))
                rows.append([*legs.phase, *legs.rate])
        arrays[name] = np.array(rows)
    unchanged(DOUBLE, **arrays)


def test_commands_to_the_legs(unchanged: Unchanged) -> None:
    """A start, curves, a leg that is held, other parameters, a time-out."""
    config = GaitConfig()
    controller = GaitController(config)
    other = dataclasses.replace(config, duty_factor=0.7, foot_width_deg=45.0,
                                stance_smoothing=0.3, velocity_gain=0.4, position_gain=6.0)
    orders: dict[int, Any] = {5: (0.1, 0.0), 60: (0.08, 0.25), 120: (-0.05, 0.1),
                              170: (0.3, -0.9), 200: other, 230: (0.06, 0.0)}
    angle, velocity, rows = np.array([0.2, -0.3, 1.4, -4.0]), np.zeros(4), []
    for k in range(300):
        stamp = 7 * 10**9 + k * 10_000_000
        order = orders.get(k)
        if isinstance(order, GaitConfig):
            controller.configure(order)
        elif order is not None:
            controller.set_velocity(*order, stamp)
        command = controller.update(stamp, angle, velocity)
        rows.append([*command.velocity_radps, *command.angle_rad, *command.phase])
        velocity = velocity + 0.3 * (command.velocity_radps - velocity)
        if 130 < k < 190:
            velocity[2] = 0.0
        angle = angle + 0.01 * velocity
    unchanged(DOUBLE, commands=rows, velocity=np.array(rows)[:, :4], phase=np.array(rows)[:, 8:])


def test_strides_of_velocities(unchanged: Unchanged) -> None:
    """The analytic table, and one with dents that is interpolated."""
    dented = GaitCalibration(
        (0.5, 1.0, 2.0), (0.0, 0.3, 0.7, 1.0),
        ((0.05, 0.045, 0.03, 0.001), (0.1, 0.11, 0.05, -0.004), (0.19, 0.15, 0.1, 0.0)),
        ((0.0, 0.12, 0.1, 0.3), (-0.01, 0.2, 0.4, 0.5), (0.0, 0.3, 0.6, 0.9)), 0.55, 50.0)
    other = GaitConfig(duty_factor=0.7, foot_width_deg=45.0, max_phase_rate_hz=1.3,
                       max_yaw_rate_radps=0.4)
    arrays = {}
    for name, table in (('analytic', GaitCalibration.default()), ('dented', dented)):
        for k, config in enumerate((None, other)):
            arrays[f'{name}_strides_{k}'] = [
                [*dataclasses.astuple(stride), scale] for v in (-0.3, 1.5e-4, 0.02, 0.11, 0.4)
                for w in (-0.8, 0.0, 7e-4, 0.05, 0.5)
                for stride, scale in (table.stride(v, w, config),)]
            arrays[f'{name}_velocities_{k}'] = [
                table.velocity(rate, turn, config) for rate in (0.2, 0.9, 2.4)
                for turn in (-1.0, 0.0, 0.15, 0.8)]
    unchanged(DOUBLE, **arrays)


def test_model_of_the_rover(unchanged: Unchanged) -> None:
    """Masses, inertias, motors and contacts, as MuJoCo has compiled them."""
    with Simulation(rough_world(), RoverDescription(),
                    PhysicsConfig(start=StartPose(settle_s=0.0))) as simulation:
        model = simulation.model
        unchanged(DOUBLE, options=[model.opt.timestep, model.opt.impratio, *model.opt.gravity], **{
            name: np.array(getattr(model, name)) for name in (
                'body_mass', 'body_inertia', 'geom_size', 'geom_pos', 'geom_solref',
                'geom_solimp', 'geom_friction', 'dof_damping', 'dof_armature',
                'dof_frictionloss', 'actuator_gainprm', 'actuator_biasprm',
                'actuator_forcerange')})


def test_walk_on_rigid_ground(unchanged: Unchanged) -> None:
    """Half a second on waves and rocks, and a pull."""
    rover = RoverDescription(imu=ImuMount(position_m=(0.05, -0.03, 0.04),
                                          rpy_deg=(10.0, -20.0, 170.0)))
    start = StartPose(x_m=0.2, y_m=-0.1, yaw_deg=20.0, settle_s=0.4)
    states = []
    with Simulation(rough_world(), rover, PhysicsConfig(start=start)) as simulation:
        states.append(simulation.state)
        trot(simulation, 0.5, observe=states.append)
        simulation.apply_force([0.3, -0.2, 0.1])
        states.append(simulation.advance(20))
    unchanged(WALK, **{field.name: [getattr(state, field.name) for state in states[::9]]
                       for field in dataclasses.fields(states[0])})


def test_errors_of_an_imu(unchanged: Unchanged) -> None:
    """The presets, and every error at once, sample by sample and many at a time."""
    config = ImuConfig(
        preset='bmi160', gyro_noise_density=3e-4, accel_initial_bias_mps2=(0.1, -0.2, 0.05),
        gyro_initial_bias_radps=(0.01, 0.0, -0.02), accel_scale_error=(0.01, 0.0, -0.02),
        gyro_scale_error=(0.0, 0.03, 0.01), accel_misalignment_deg=(1.0, -2.0, 0.5),
        gyro_misalignment_deg=(0.0, 3.0, 1.0), accel_range_mps2=2.5, gyro_range_radps=0.5,
        accel_resolution_mps2=0.01, gyro_resolution_radps=0.002)
    rng = np.random.default_rng(1)
    force, rate = rng.normal(size=(60, 3)) + [0.0, 0.0, 1.6], 0.3 * rng.normal(size=(60, 3))
    one, many = (ImuNoise(config, 190.0, np.random.default_rng(3)) for _ in range(2))
    samples = [one.measure(f, r) for f, r in zip(force, rate)]
    fields = [field.name for field in dataclasses.fields(samples[0])]
    unchanged(DOUBLE, variances=one.white_noise_variances(),
              many=dataclasses.astuple(many.measure_many(force, rate)),
              **{name: [getattr(sample, name) for sample in samples] for name in fields},
              **{name: list(dataclasses.astuple(noise_parameters(ImuConfig(preset=name))))
                 for name in PRESETS})


def test_odometry_of_the_legs(unchanged: Unchanged) -> None:
    """Poses, velocities and covariances by the encoders, forward, in curves, and back."""
    arrays = {}
    for ground in ('rigid', 'highland', 'mare'):
        rolling = Rolling.of(WheelOdometryConfig(), ground)
        odometry = WheelOdometry(RoverDescription(), 512, rolling)
        angle, rows = np.array([0.1, -0.2, 0.3, 1.9]), []
        for k in range(60):
            angle = angle + 0.05 * np.array([1.0, 1.4, 0.9, 1.5]) * (1.0 if k < 40 else -0.6)
            odometry.add(angle, 0.02)
            rows.append([*odometry.pose, *odometry.twist, *odometry.twist_variance,
                         *np.ravel(odometry.covariance)])
        arrays[ground] = rows[::4]
    unchanged(DOUBLE, **arrays)


def test_power_of_the_motors(unchanged: Unchanged) -> None:
    arrays = {}
    for name, config in (('default', PowerMonitorConfig()), ('coarse', PowerMonitorConfig(
            shunt_ohm=0.5, gain_error=0.1))):
        monitors = PowerMonitors(RoverDescription().motor, 4, config, np.random.default_rng(2))
        rng = np.random.default_rng(5)
        arrays[name] = [dataclasses.astuple(monitors.measure(2.0 * rng.normal(size=4),
                                                             5.0 * rng.normal(size=4)))
                        for _ in range(3)]
    unchanged(DOUBLE, **arrays)
