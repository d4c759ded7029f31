"""The compiled MuJoCo model: ground, rocks and rover."""

from __future__ import annotations

import mujoco
import numpy as np

from lunar_rover_sim.base.errors import one_line, PhysicsError
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mjcf import GROUND_BIT, IMU_SITE, ROCK_BIT, rover_spec
from lunar_rover_sim.rover.physics.config import PhysicsConfig
from lunar_rover_sim.rover.physics.contact import set_contact
from lunar_rover_sim.rover.physics.soil_contact import add_soil

WORLD_PREFIX = 'world_'
BASE_THICKNESS_M = 1.0

_INTEGRATORS = {
    'implicitfast': mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    'discrete': mujoco.mjtIntegrator.mjINT_DISCRETE,
    'euler': mujoco.mjtIntegrator.mjINT_EULER,
}


def build_model(world: World, rover: RoverDescription, config: PhysicsConfig) -> mujoco.MjModel:
    """Return the model of the rover on the finest level of the world, with its rocks.

    The height field has the samples of the world's grid, and the same two triangles per cell.

    Raises:
        PhysicsError: If MuJoCo cannot simulate such a rover.
    """
    spec = rover_spec(rover)
    option = spec.option
    option.timestep = config.step_ns * 1e-9
    option.gravity = [0.0, 0.0, -config.gravity_mps2]
    option.integrator = _INTEGRATORS[config.integrator]
    option.tolerance = 1e-14
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    # With this flag MuJoCo computes the poses of static geoms, thousands of rocks, only once. The
    # rover itself never sleeps.
    option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    _add_ground(spec, world.ground)
    _add_rocks(spec, world)
    if config.ground.deforms:
        add_soil(spec, rover)
    # Nothing reads this sensor. MuJoCo computes `cfrc_ext`, the contact force on each body, only
    # for a model that has such a one.
    spec.add_sensor(name='acceleration', type=mujoco.mjtSensor.mjSENS_ACCELEROMETER,
                    objtype=mujoco.mjtObj.mjOBJ_SITE, objname=IMU_SITE)
    try:
        model = spec.compile()
    except ValueError as error:     # of MuJoCo: a mass or an inertia below 1e-15, for instance
        reason = one_line(str(error).removeprefix('Error:'))
        raise PhysicsError(f'the rover cannot be simulated: {reason}; are its masses in kg and '
                           'its lengths in m?') from None
    _fill_ground(model, world.ground)
    of_rover = (model.geom_bodyid > 0) & (model.body_mocapid[model.geom_bodyid] < 0)
    rover_geoms = np.flatnonzero(of_rover)
    set_contact(model, config.contact, rover_geoms, rover.legs.tip_radius_m)
    return model


def _add_ground(spec: mujoco.MjSpec, grid: HeightGrid) -> None:
    """Add a height field without data.

    It is written as XML because only there a field may lack data. So its samples, up to hundreds
    of millions, do not pass through the compiler.
    """
    low, elevation = _height_range(grid)
    half = grid.half_extent_m
    ground = mujoco.MjSpec.from_string(f"""
        <mujoco>
          <asset>
            <hfield name="ground" nrow="{grid.n}" ncol="{grid.n}"
                    size="{half!r} {half!r} {elevation!r} {BASE_THICKNESS_M!r}"/>
          </asset>
          <worldbody>
            <geom name="ground" type="hfield" hfield="ground" pos="0 0 {low!r}"
                  contype="{GROUND_BIT}" conaffinity="0"/>
          </worldbody>
        </mujoco>""")
    spec.attach(ground, prefix=WORLD_PREFIX, frame=spec.worldbody.add_frame())


def _fill_ground(model: mujoco.MjModel, grid: HeightGrid) -> None:
    """Write the heights, scaled to 0 (least) to 1 (greatest), row 0 in the south."""
    low, elevation = _height_range(grid)
    data = model.hfield_data.reshape(grid.n, grid.n)
    np.subtract(grid.heights_m, np.float32(low), out=data)
    data /= np.float32(elevation)


def _height_range(grid: HeightGrid) -> tuple[float, float]:
    """Return the least height and the range of heights [m], which must be > 0 in MuJoCo."""
    low, high = float(grid.heights_m.min()), float(grid.heights_m.max())
    return low, high - low if high > low else 1.0


def _add_rocks(spec: mujoco.MjSpec, world: World) -> None:
    """Add the rocks, with one mesh for each shape and size class that occurs."""
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
