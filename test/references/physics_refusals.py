"""Physics: what is refused at which bound."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
from physics_scene import soft
from references.cases import reference
from references.physics import rough_world
from references.words import said

from lunar_rover_sim.physics.config import ContactConfig, PhysicsConfig, StartPose
from lunar_rover_sim.physics.model import build_model
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoise
from lunar_rover_sim.sensors.wheel_odometry import WheelOdometryConfig


@reference
def refused_simulations() -> dict[str, Any]:
    """Steps that are too long, starts off the ground, commands and places that are none."""
    rover, world = RoverDescription(), rough_world(rocks=0)
    steps = [said(build_model, world, rover, PhysicsConfig(step_s=step, contact=ContactConfig(
        stiffness_npm=k, damping_nspm=b))) for step, k, b in (
            (0.001, 2000.0, 60.0), (0.005, 2000.0, 60.0), (0.005, 10.0, 60.0), (0.002, 20.0, 0.1),
            (0.005, 2000.0, 1.0))]

    def begun(**values: Any) -> str:
        start = {'settle_s': 0.0, **values.pop('start', {})}
        return said(Simulation, world, rover, PhysicsConfig(start=StartPose(**start), **values))

    starts = [begun(start={'x_m': 1.0}), begun(start={'x_m': 1.001}), begun(start={'y_m': -1.1}),
              begun(ground=soft(), step_s=0.005), begun(ground=soft(elastic_npm=1e6)),
              begun(ground=soft(), gravity_mps2=0.0)]
    with Simulation(world, rover, PhysicsConfig()) as simulation:
        z = float(simulation.state.position_m[2])
        words = [said(simulation.command, value) for value in (
            [0.0] * 4, [0.0] * 3, [math.nan] * 4, 'a', [1e9] * 4)]
        words += [said(simulation.apply_force, value) for value in ([0.0] * 3, [0.0] * 4, [
            math.inf] * 3)]
        words += [said(simulation.advance, n) for n in (1, 0, 1.5)]
        words += [said(simulation.move, **values) for values in (
            {'position_m': [2.0, 0.0, 3.0]}, {'position_m': [2.001, 0.0, 3.0]},
            {'position_m': [0.0, 0.0, z - 0.05]}, {'orientation_wxyz': [1.0009, 0.0, 0.0, 0.0]},
            {'orientation_wxyz': [1.0011, 0.0, 0.0, 0.0]}, {'linear_mps': [9.9, 0.0, 0.0]},
            {'linear_mps': [10.0, 0.0, 0.0]}, {'angular_radps': [0.0, 8.0, 8.0]},
            {'linear_mps': [0.0, 0.0]})]
        control = np.array(simulation.data.ctrl)
    with Simulation(world, rover, PhysicsConfig(ground=soft())) as simulation:
        words.append(said(simulation.move, [0.0, 0.0, 1.0]))
    words.append(said(lambda: simulation.model))
    imus_ = [said(ImuConfig, accel_noise_density=value) for value in (-1.0, -0.5, 0.0)]
    return {'steps': steps, 'starts': starts, 'words': [_rounded(word) for word in words],
            'control': control, 'imu': imus_, 'rate': said(
                ImuNoise, ImuConfig(), 0.0, np.random.default_rng(0)),
            'odometry': [said(WheelOdometryConfig, yaw_scale=value) for value in (
                -1.0, 0.0, 0.1, 0.099, 2.0)],
            'soils': [said(soft, **{name: value}) for name, value in (
                ('friction', 0.1), ('friction', 0.099), ('repose_deg', 60.0), ('repose_deg', 9.9),
                ('bearing_mnpm3', 0.02), ('bearing_mnpm3', 0.0199), ('compacted', -0.1))]}


def _rounded(text: str) -> str:
    """Return a text with the last digits of its numbers left out."""
    return re.sub(r'(\.\d{2})\d+', r'\1', text)
