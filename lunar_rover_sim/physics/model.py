"""The compiled MuJoCo model: ground, rocks and rover."""

from __future__ import annotations

import mujoco
import numpy as np

from lunar_rover_sim.physics.config import PhysicsConfig
from lunar_rover_sim.physics.contact import set_contact
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mjcf import GROUND_BIT, ROCK_BIT, rover_spec
from lunar_rover_sim.world.model import World

GROUND_GEOM = 'ground'
BASE_THICKNESS_M = 1.0

_INTEGRATORS = {
    'implicitfast': mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    'discrete': mujoco.mjtIntegrator.mjINT_DISCRETE,
    'euler': mujoco.mjtIntegrator.mjINT_EULER,
}


def build_model(world: World, rover: RoverDescription, config: PhysicsConfig) -> mujoco.MjModel:
    """Return the model of the rover on the finest level of the world, with its rocks.

    The height field is the very grid of the world: its samples, its two triangles per cell.
    """
    spec = rover_spec(rover)
    option = spec.option
    option.timestep = config.step_ns * 1e-9
    option.gravity = [0.0, 0.0, -config.gravity_mps2]
    option.integrator = _INTEGRATORS[config.integrator]
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    # With this flag the poses of static geoms, thousands of rocks, are computed only once. The
    # rover itself never sleeps.
    option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    _add_ground(spec, world)
    _add_rocks(spec, world)
    model = spec.compile()
    rover_geoms = np.flatnonzero(model.geom_bodyid > 0)
    set_contact(model, config.contact, rover_geoms)
    return model


def _add_ground(spec: mujoco.MjSpec, world: World) -> None:
    grid = world.ground
    low, high = float(grid.heights_m.min()), float(grid.heights_m.max())
    elevation = high - low if high > low else 1.0
    half = grid.half_extent_m
    field = spec.add_hfield(name=GROUND_GEOM, nrow=grid.n, ncol=grid.n,
                            size=[half, half, elevation, BASE_THICKNESS_M])
    # The compiler scales the data from 0 (least) to 1 (greatest); a flat field becomes all 0.
    field.userdata = ((grid.heights_m - np.float32(low)) / np.float32(elevation)).ravel()
    spec.worldbody.add_geom(name=GROUND_GEOM, type=mujoco.mjtGeom.mjGEOM_HFIELD,
                            hfieldname=GROUND_GEOM, pos=[0.0, 0.0, low], contype=GROUND_BIT,
                            conaffinity=0)


def _add_rocks(spec: mujoco.MjSpec, world: World) -> None:
    """Add the rocks, one mesh per shape and size class that occurs."""
    rocks = world.rocks
    known: set[str] = set()
    for i in range(len(rocks)):
        shape, size = int(rocks.shape[i]), int(rocks.size[i])
        mesh = f'rock_{shape}_{size}'
        if mesh not in known:
            known.add(mesh)
            unit = world.rock_shapes[shape]
            vertices = unit.vertices * np.float32(rocks.size_classes_m[size])
            spec.add_mesh(name=mesh, uservert=vertices.ravel(), userface=unit.faces.ravel())
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh,
                                pos=rocks.position_m[i], quat=rocks.orientation_wxyz[i],
                                contype=ROCK_BIT, conaffinity=0)
