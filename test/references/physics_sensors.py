"""Physics: IMUs, sensors, the odometry of the legs, motions of the feet."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from references.cases import reference
from references.scenes import hills

from lunar_rover_sim.frames import wxyz_from_rpy
from lunar_rover_sim.physics.foot_motion import FootMotion, FootObserver, SlipMeter
from lunar_rover_sim.physics.ground_contact import ContactObserver
from lunar_rover_sim.physics.soft_tip import SoftTip
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.physics.tip_over import TipOver
from lunar_rover_sim.rover.description import Legs, RoverDescription
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoise, noise_parameters, PRESETS
from lunar_rover_sim.sensors.power_monitor import PowerMonitorConfig, PowerMonitors
from lunar_rover_sim.sensors.wheel_odometry import (Rolling, RollingFeet, WheelOdometry,
                                                    WheelOdometryConfig)


@reference
def imus() -> dict[str, Any]:
    """Errors of IMUs, one by one and many at a time."""
    rng = np.random.default_rng(1)
    force, rate = rng.normal(size=(60, 3)) + [0.0, 0.0, 1.6], 0.3 * rng.normal(size=(60, 3))
    found: dict[str, Any] = {'presets': {name: noise_parameters(ImuConfig(preset=name))
                                         for name in PRESETS}}
    for name, config in (
            ('default', ImuConfig()), ('off', ImuConfig(enabled=False)),
            ('all', ImuConfig(
                preset='bmi160', gyro_noise_density=3e-4,
                accel_initial_bias_mps2=(0.1, -0.2, 0.05),
                gyro_initial_bias_radps=(0.01, 0.0, -0.02),
                accel_scale_error=(0.01, 0.0, -0.02),
                gyro_scale_error=(0.0, 0.03, 0.01), accel_misalignment_deg=(1.0, -2.0, 0.5),
                gyro_misalignment_deg=(0.0, 3.0, 1.0), accel_range_mps2=2.5, gyro_range_radps=0.5,
                accel_resolution_mps2=0.01, gyro_resolution_radps=0.002))):
        one, many = (ImuNoise(config, 190.0, np.random.default_rng(3)) for _ in range(2))
        samples = [one.measure(f, r) for f, r in zip(force, rate)]
        first, second = many.measure_many(force[:25], rate[:25]), many.measure_many(
            force[25:], rate[25:])
        found[name] = {'one': {field.name: np.array([getattr(s, field.name) for s in samples])
                               for field in dataclasses.fields(samples[0])},
                       'many': [first, second], 'variance': list(one.white_noise_variances())}
    return found


@reference
def sensors() -> dict[str, Any]:
    """Power monitors; whether the rover has tipped over; sinkage and slip."""
    rover, rng = RoverDescription(), np.random.default_rng(5)
    found: dict[str, Any] = {}
    for name, config in (('default', PowerMonitorConfig()), ('off', PowerMonitorConfig(
            enabled=False)), ('coarse', PowerMonitorConfig(
                shunt_step_v=0.003, bus_step_v=0.5, gain_error=0.1, shunt_range_v=0.02,
                shunt_offset_v=0.002, bus_offset_v=0.3)), ('no steps', PowerMonitorConfig(
                    shunt_step_v=0.0, bus_step_v=0.0))):
        monitors = PowerMonitors(rover.motor, config, np.random.default_rng(2))
        found[name] = [monitors.measure(2.0 * rng.normal(size=4), 5.0 * rng.normal(size=4))
                       for _ in range(3)]
    over, told = TipOver(), []
    for roll in (0.0, 0.7, 1.5, 1.7, 1.2, 0.81, 0.77, 1.6, 3.1, 0.2):
        told.append(f'{over.has_begun(wxyz_from_rpy(roll, 0.05, 1.0))} {over.lies} '
                    f'{over.tilt_deg:.6f}')
    found['tipped'] = told
    observer, seen = ContactObserver(0.08, 0.001), []
    tips = [SoftTip(k, k // 3, np.zeros(3), np.zeros(4), np.zeros(5), np.zeros(2))
            for k in range(12)]
    for k, deep in enumerate((0.01, 0.055, 0.0561, 0.02)):
        for tip in tips[:5]:
            tip.in_ground, tip.sinkage = tip.row != 1, deep * (1.0 + 0.01 * tip.row)
        observer.add_slip(k % 4, 0.002 * k + 0.001)
        seen.append(observer.observe(tips, 25 * (k + 1)))
    found['contact'] = seen
    return found


@reference
def odometry_of_legs() -> dict[str, Any]:
    """Poses and their covariances by the encoders, forward, in curves, and back."""
    rover, found = RoverDescription(), {}
    for ground in ('rigid', 'highland', 'highland_loose', 'mare'):
        rolling = Rolling.of(WheelOdometryConfig(yaw_stddev=0.2 if ground == 'mare' else -1.0),
                             ground)
        odometry, rows = WheelOdometry(rover, 512, rolling), []
        angle = np.array([0.1, -0.2, 0.3, 1.9])
        for k in range(60):
            angle = angle + 0.05 * np.array([1.0, 1.4, 0.9, 1.5]) * (1.0 if k < 40 else -0.6)
            odometry.add(angle, 0.02)
            rows.append((odometry.pose, odometry.covariance, odometry.twist,
                         odometry.twist_variance))
        found[ground] = {'rolling': rolling, 'rows': list(map(np.array, zip(*rows)))}
    feet = RollingFeet(RoverDescription(legs=Legs(spokes=4, axle_x_m=0.2)), 64)
    found['rolled'] = [feet.resolution_m, *(feet.add(np.array([0.4, 0.1, -0.3, 2.0]) * k)
                                            for k in range(5))]
    return found


@reference
def motions_of_feet() -> dict[str, Any]:
    """Sweep and slip from states, on a slope and beyond the ground."""
    rover, ground = RoverDescription(), hills(41, 0.1, 0.05, 0.2)
    observer, rng, found = FootObserver(rover, ground, 1.62), np.random.default_rng(4), []
    for k, x in enumerate((0.1, -0.7, 1.95, 5.0)):
        state = RoverState(
            0, np.array([x, 0.3, 0.1]), wxyz_from_rpy(0.1 * k, -0.2, 0.5 * k),
            rng.normal(size=3), rng.normal(size=3), rng.normal(size=4), rng.normal(size=4),
            np.zeros(4), np.zeros(4),
            np.abs(rng.normal(size=(4, 3))) * [[0.0], [1.0], [0.005], [1.0]],
            np.zeros((4, 3)), np.zeros(3), np.zeros(3))
        found.append(observer.observe(state))
    meter = SlipMeter()
    empty = [meter.ratio, meter.total]
    still = FootMotion(np.zeros(4, bool), np.zeros(4), np.zeros(4), np.full(4, 0.1))
    meter.add(still, 0.3)
    return {'motions': found, 'nothing': empty, 'carried': [meter.way_m, meter.driven_m]}
