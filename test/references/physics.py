"""Physics: the model, short walks on rigid and on soft ground, sensors.

Contacts let small differences grow: walks are short, and have a tolerance of their own.
"""

from __future__ import annotations

import dataclasses
import math
import re
from typing import Any

import mujoco
import numpy as np
from physics_scene import trot
import pytest
from references.cases import reference
from references.scenes import hills, stones, stony_world
from references.summary import Within
from references.words import said

from lunar_rover_sim.frames import wxyz_from_rpy
from lunar_rover_sim.physics.config import (ContactConfig, ImuConfig, PhysicsConfig,
                                            PowerMonitorConfig, StartPose, WheelOdometryConfig)
from lunar_rover_sim.physics.divergence import diagnosis
from lunar_rover_sim.physics.foot_motion import FootMotion, FootObserver, SlipMeter
from lunar_rover_sim.physics.ground_contact import ContactObserver
from lunar_rover_sim.physics.imu import ImuNoise, noise_parameters, PRESETS
from lunar_rover_sim.physics.model import build_model
from lunar_rover_sim.physics.penetration import TipPenetration
from lunar_rover_sim.physics.power_monitor import PowerMonitors
from lunar_rover_sim.physics.ray_cast import reaches_sky
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.physics.soft_tip import SoftTip
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.physics.tip_over import TipOver
from lunar_rover_sim.physics.wall_slides import WallSlides
from lunar_rover_sim.physics.wheel_odometry import Rolling, RollingFeet, WheelOdometry
from lunar_rover_sim.regolith.config import GroundConfig
from lunar_rover_sim.regolith.fine_ground import FineGround
from lunar_rover_sim.regolith.footprint import press
from lunar_rover_sim.regolith.overlay import Overlay
from lunar_rover_sim.regolith.soil import PRESETS as SOILS
from lunar_rover_sim.rover.description import ImuMount, Legs, RoverDescription
from lunar_rover_sim.world import shapes
from lunar_rover_sim.world.config import WorldConfig
from lunar_rover_sim.world.model import World

WALK = 1e-4     # tolerance of walks


def _world(steepness: float = 0.05, rocks: int = 5, height_m: float = 0.02) -> World:
    ground = hills(161, 0.025, height_m, steepness)
    return World((ground,), np.ones_like(ground.heights_m), stones(ground, rocks, 9, 0.4),
                 shapes.library(), WorldConfig(), '')


def _soft(preset: str = 'highland', **values: Any) -> GroundConfig:
    return GroundConfig(model='regolith', preset=preset, **values)


def _numbers(model: Any) -> dict[str, Any]:
    """Return what the model consists of."""
    names = ('geom_type', 'geom_contype', 'geom_conaffinity', 'geom_condim', 'geom_priority',
             'geom_group', 'geom_solref', 'geom_solimp', 'geom_friction', 'geom_size', 'geom_pos',
             'body_mass', 'body_inertia', 'pair_dim', 'pair_solref', 'pair_solreffriction',
             'pair_solimp', 'pair_friction', 'hfield_size', 'dof_damping', 'dof_armature',
             'dof_frictionloss', 'actuator_gainprm', 'actuator_biasprm', 'actuator_forcerange')
    option = model.opt
    return {**{name: np.array(getattr(model, name)) for name in names},
            'heights': np.array(model.hfield_data[::37]),
            'options': [option.timestep, option.impratio, *map(float, option.gravity)],
            'flags': [int(option.cone), int(option.integrator), int(option.disableflags),
                      int(option.enableflags)]}


@reference
def models() -> dict[str, Any]:
    """Compiled models on rigid and on soft ground."""
    contact = ContactConfig(sliding_friction=0.7, stiffness_npm=1500.0, damping_nspm=50.0,
                            shear_damping_nspm=20000.0, torsional_friction_m=0.003)
    rover = RoverDescription(legs=Legs(spokes=4))
    found = {}
    for name, config in (
            ('rigid', PhysicsConfig(contact=contact, step_s=0.0007, integrator='euler')),
            ('default', PhysicsConfig(gravity_mps2=3.7)),
            ('soft', PhysicsConfig(ground=_soft('mare'), contact=contact))):
        with Simulation(_world(), rover, dataclasses.replace(
                config, start=StartPose(settle_s=0.0))) as simulation:
            found[name] = _numbers(simulation.model)
    flat = hills(41, 0.1, 0.0)
    world = World((flat,), np.ones_like(flat.heights_m), stones(flat, 0), (), WorldConfig(), '')
    found['flat'] = np.array(build_model(world, rover, PhysicsConfig()).hfield_size)
    return found


@reference
def start_poses() -> dict[str, Any]:
    """Where the rover is put, at rocks and on slopes."""
    found = {}
    for x, y, yaw in ((0.0, 0.0, 0.0), (0.61, -0.43, 65.0), (-0.8, 0.9, -130.0)):
        start = StartPose(x_m=x, y_m=y, yaw_deg=yaw, settle_s=0.0,
                          joint_angle_rad=(0.1, -0.2, 0.4, 0.9))
        with Simulation(_world(0.2, 9, 0.05), RoverDescription(),
                        PhysicsConfig(start=start)) as simulation:
            found[f'{x} {y} {yaw}'] = Within(np.array(simulation.data.qpos), 1e-6)
    return found


def _seen(*states: RoverState) -> Within:
    """Return the numbers of states, each quantity for itself."""
    return Within({field.name: np.array([getattr(state, field.name) for state in states], float)
                   for field in dataclasses.fields(RoverState)}, WALK)


@reference
def walk_on_rigid_ground() -> dict[str, Any]:
    """A few steps on waves and rocks: states, feet, penetration; a pull; another place."""
    rover = RoverDescription(imu=ImuMount(position_m=(0.05, -0.03, 0.04),
                                          rpy_deg=(10.0, -20.0, 170.0)))
    config = PhysicsConfig(start=StartPose(x_m=0.2, y_m=-0.1, yaw_deg=20.0, settle_s=0.4))
    meter, states, motions, depths = SlipMeter(), [], [], []
    with Simulation(_world(), rover, config) as simulation:
        depth = TipPenetration(simulation, _world().ground)

        def look(state: RoverState) -> None:
            motion = simulation.foot_motion
            meter.add(motion, 0.005)
            if state.stamp_ns % 25_000_000 == 0:
                states.append(state)
                depths.append(depth.deepest_m())
                motions.append([*motion.sweep_mps, *motion.slip_mps, *motion.axle_mps])

        start = _seen(simulation.state)
        trot(simulation, 0.5, observe=look)
        simulation.apply_force([0.3, -0.2, 0.1])
        pulled = simulation.advance(20)
        rays = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.05], [0.3, -0.9, 0.02], [0.0, 0.0, -1.0]])
        sky = reaches_sky(simulation, np.array([0.1, 0.4, 0.3]), rays)
        moved = simulation.move([0.3, 0.2, 0.4], wxyz_from_rpy(0.1, -0.1, 0.7), [0.1, 0.0, -0.05],
                                [0.0, 0.3, 0.2])
        moved_and_on = simulation.advance(10)
        text = diagnosis(simulation.model, simulation.data, 0.1234)
        again = simulation.reset()
        return {'start': start, 'states': _seen(*states), 'depths': Within(depths, 10 * WALK),
                'feet': Within(np.array(motions), WALK), 'pulled': _seen(pulled),
                'ratio': Within(meter.ratio, WALK), 'total': Within(meter.total, WALK),
                'ways': Within([*meter.swept_m, *meter.slipped_m, meter.driven_m, meter.way_m],
                               WALK),
                'moved': _seen(moved), 'on': _seen(moved_and_on),
                'text': text.partition(' (speed')[0], 'sky': sky,
                'reset': _seen(again)}


def _soft_walk(world: World, ground: GroundConfig, rover: RoverDescription, seconds: float,
               **start: float) -> dict[str, Any]:
    if int(mujoco.__version__.partition('.')[0]) < 4:
        pytest.skip('MuJoCo 3 differs by a millimetre once a tip has yielded')
    config = PhysicsConfig(ground=ground, start=StartPose(settle_s=0.3, **start))
    states, contacts, sums = [], [], []
    with Simulation(world, rover, config) as simulation:
        overlay = simulation.overlay
        assert overlay is not None

        def look(state: RoverState) -> None:
            contact = simulation.ground_contact
            assert contact is not None
            if state.stamp_ns % 50_000_000 == 0:
                states.append(state)
                contacts.append(contact)
                sums.append(overlay.sums_m())

        trot(simulation, seconds, 1.3, observe=look)
        solref = np.array(simulation.model.pair_solref)
        changed = overlay.snapshot()
        simulation.reset()
        return {'states': _seen(*states), 'sums': Within(np.array(sums), WALK),
                'sinkage': Within(np.array([c.sinkage_m for c in contacts]), WALK),
                'slip': Within(np.array([c.slip_mps for c in contacts]), WALK),
                'dug in': [c.dug_in for c in contacts], 'solref': Within(solref, WALK),
                'prints': len(changed), 'height': Within(changed.height_m, 10 * WALK),
                'compaction': Within(changed.compaction_m, 10 * WALK),
                'reset': Within(np.array(simulation.data.qpos), WALK),
                'at start': Within(list(overlay.sums_m()), WALK)}


@reference
def walk_on_soft_ground() -> dict[str, Any]:
    """Several strides on a slope of loose soil that varies."""
    world = stony_world((hills(161, 0.05, 0.01, 0.15),), 0)
    return _soft_walk(world, _soft('highland_loose', variation=0.8), RoverDescription(), 1.0,
                      x_m=0.4, y_m=-0.6, yaw_deg=30.0)


@reference
def walk_that_digs_in() -> dict[str, Any]:
    """A heavy rover in very soft soil with cohesion: rods in the soil, walls that slide."""
    rover = dataclasses.replace(RoverDescription(), chassis=dataclasses.replace(
        RoverDescription().chassis, mass_kg=5.0))
    return _soft_walk(_world(0.1, 0), _soft('highland_loose', bearing_mnpm3=0.05,
                                            cohesion_kpa=0.05), rover, 0.8)


@reference
def tips_in_soil() -> dict[str, Any]:
    """The plane of a tip, what a slope leaves of the strength, its lean and its slip."""
    found: dict[str, Any] = {}
    for k, (nx, ny) in enumerate(((0.0, 0.0), (0.3, -0.2), (-0.5, 0.1))):
        tip = SoftTip(3, 1, np.zeros(3), np.zeros(4), np.zeros(5), np.zeros(2))
        tip.nx, tip.ny, tip.nz = nx, ny, math.sqrt(1.0 - nx * nx - ny * ny)
        tip.x, tip.y, tip.h, tip.plastic = 0.4, -0.3, 0.05, 0.011
        tip.weaken(SOILS['highland'], 0.2 * k, (0.7, 0.9))
        tip.place()
        tip.turn_plane()
        found[f'{k}'] = {
            'plane': tip.plane.copy(), 'turn': tip.turn.copy(),
            'strength': [tip.firm_mu, tip.reserve, tip.bearing],
            'lean': [tip.lean((0.4 + dx, -0.3, dz), (0.4, -0.3, 0.04))
                     for dx, dz in ((0.0, 0.1), (0.03, 0.1), (0.2, 0.1), (0.05, 0.04),
                                    (0.1, -0.1))],
            'slip': [tip.slip_mps(0.008, (0.1, 0.2, 0.0), motion, (0.0, 0.05, 0.1)) for motion in (
                [0.0] * 6, [0.3, -0.4, 0.2, 0.1, 0.05, -0.2], [0.0, 2.0, 0.0, 0.0, 0.0, 0.0])]}
        tip.park()
        found[f'{k}']['parked'] = tip.plane
    return found


@reference
def sliding_walls() -> dict[str, Any]:
    """When the walls of prints slide, leg by leg."""
    fine, overlay = FineGround(hills(41, 0.05, 0.0)), Overlay()
    slides = WallSlides(fine, 20.0, 0.002)
    found: dict[str, Any] = {}
    for k, (leg, x) in enumerate(((0, 0.1), (2, -0.3), (0, 0.13), (0, 0.4), (1, 0.7))):
        window = press(overlay, fine, (x, 0.02, 0.006), (x, 0.03, -0.03), 0.008, 0.2)
        slides.add(overlay, leg, window, 10 * k)
        found[f'next {k}'] = slides.next_step
        found[f'sums {k}'] = list(overlay.sums_m())
    for step in (49, 50, 60, 79, 80, 91):
        slides.slide_due(overlay, step)
        found[f'due {step}'] = [float(slides.next_step), float(overlay.writes)]
        found[f'at {step}'] = overlay.snapshot().height_m
    return found


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


@reference
def refused_simulations() -> dict[str, Any]:
    """Steps that are too long, starts off the ground, commands and places that are none."""
    rover, world = RoverDescription(), _world(rocks=0)
    steps = [said(build_model, world, rover, PhysicsConfig(step_s=step, contact=ContactConfig(
        stiffness_npm=k, damping_nspm=b))) for step, k, b in (
            (0.001, 2000.0, 60.0), (0.005, 2000.0, 60.0), (0.005, 10.0, 60.0), (0.002, 20.0, 0.1),
            (0.005, 2000.0, 1.0))]

    def begun(**values: Any) -> str:
        start = {'settle_s': 0.0, **values.pop('start', {})}
        return said(Simulation, world, rover, PhysicsConfig(start=StartPose(**start), **values))

    starts = [begun(start={'x_m': 1.0}), begun(start={'x_m': 1.001}), begun(start={'y_m': -1.1}),
              begun(ground=_soft(), step_s=0.005), begun(ground=_soft(elastic_npm=1e6)),
              begun(ground=_soft(), gravity_mps2=0.0)]
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
    with Simulation(world, rover, PhysicsConfig(ground=_soft())) as simulation:
        words.append(said(simulation.move, [0.0, 0.0, 1.0]))
    words.append(said(lambda: simulation.model))
    imus_ = [said(ImuConfig, accel_noise_density=value) for value in (-1.0, -0.5, 0.0)]
    return {'steps': steps, 'starts': starts, 'words': [_rounded(word) for word in words],
            'control': control, 'imu': imus_, 'rate': said(
                ImuNoise, ImuConfig(), 0.0, np.random.default_rng(0)),
            'odometry': [said(WheelOdometryConfig, yaw_scale=value) for value in (
                -1.0, 0.0, 0.1, 0.099, 2.0)],
            'soils': [said(_soft, **{name: value}) for name, value in (
                ('friction', 0.1), ('friction', 0.099), ('repose_deg', 60.0), ('repose_deg', 9.9),
                ('bearing_mnpm3', 0.02), ('bearing_mnpm3', 0.0199), ('compacted', -0.1))]}


def _rounded(text: str) -> str:
    """Return a text with the last digits of its numbers left out."""
    return re.sub(r'(\.\d{2})\d+', r'\1', text)


@reference
def deep_tips() -> dict[str, Any]:
    """Penetration of tips that were pressed into ground and rocks."""
    found: dict[str, Any] = {}
    world = _world(0.2, 9, 0.05)
    with Simulation(world, RoverDescription(), PhysicsConfig(
            start=StartPose(x_m=0.61, y_m=-0.43, settle_s=0.1))) as simulation:
        depth = TipPenetration(simulation, world.ground)
        place = np.array(simulation.data.qpos[:3])
        for dx in (0.0, 0.11, -0.23, 0.37):
            for down in (-0.05, 0.002, 0.006, 0.012, 0.03):
                simulation.data.qpos[:3] = place + [dx, 0.5 * dx, -down]
                mujoco.mj_forward(simulation.model, simulation.data)
                found[f'{dx} {down}'] = Within(depth.deepest_m(), WALK)
    return found
