"""Physics: the model, short walks on rigid and on soft ground.

Contacts let small differences grow: walks are short, and have a tolerance of their own.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import mujoco
import numpy as np
from physics_scene import soft, trot
import pytest
from references.cases import reference
from references.scenes import hills, stones, stony_world
from references.summary import Within

from lunar_rover_sim.frames import wxyz_from_rpy
from lunar_rover_sim.physics.config import ContactConfig, PhysicsConfig, StartPose
from lunar_rover_sim.physics.divergence import diagnosis
from lunar_rover_sim.physics.foot_motion import SlipMeter
from lunar_rover_sim.physics.model import build_model
from lunar_rover_sim.physics.penetration import TipPenetration
from lunar_rover_sim.physics.ray_cast import reaches_sky
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.physics.soft_tip import SoftTip
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.physics.wall_slides import WallSlides
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


def rough_world(steepness: float = 0.05, rocks: int = 5, height_m: float = 0.02) -> World:
    ground = hills(161, 0.025, height_m, steepness)
    return World((ground,), np.ones_like(ground.heights_m), stones(ground, rocks, 9, 0.4),
                 shapes.library(), WorldConfig(), '')


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
            ('soft', PhysicsConfig(ground=soft('mare'), contact=contact))):
        with Simulation(rough_world(), rover, dataclasses.replace(
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
        with Simulation(rough_world(0.2, 9, 0.05), RoverDescription(),
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
    with Simulation(rough_world(), rover, config) as simulation:
        depth = TipPenetration(simulation, rough_world().ground)

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
    return _soft_walk(world, soft('highland_loose', variation=0.8), RoverDescription(), 1.0,
                      x_m=0.4, y_m=-0.6, yaw_deg=30.0)


@reference
def walk_that_digs_in() -> dict[str, Any]:
    """A heavy rover in very soft soil with cohesion: rods in the soil, walls that slide."""
    rover = dataclasses.replace(RoverDescription(), chassis=dataclasses.replace(
        RoverDescription().chassis, mass_kg=5.0))
    return _soft_walk(rough_world(0.1, 0), soft('highland_loose', bearing_mnpm3=0.05,
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
def deep_tips() -> dict[str, Any]:
    """Penetration of tips that were pressed into ground and rocks."""
    found: dict[str, Any] = {}
    world = rough_world(0.2, 9, 0.05)
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
