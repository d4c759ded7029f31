"""The compiled MuJoCo model: ground, rocks and rover."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import one_line, PhysicsError
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mjcf import GROUND_BIT, IMU_SITE, ROCK_BIT, rover_spec
from lunar_rover_sim.rover.physics.config import PhysicsConfig
from lunar_rover_sim.rover.physics.contact import set_contact
from lunar_rover_sim.rover.physics.soil_contact import add_soil, set_soil

WORLD_PREFIX = 'world_'
BASE_THICKNESS_M = 1.0
TILE_M = 12.8               # width of a height field
_LEAST_CELLS = 64           # of a tile, along one side
_HALF_ELEVATION_M = 16.0    # of a tile, unless it is steeper

_INTEGRATORS = {
    'implicitfast': mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    'discrete': mujoco.mjtIntegrator.mjINT_DISCRETE,
    'euler': mujoco.mjtIntegrator.mjINT_EULER,
}


def build_model(world: World, rover: RoverDescription, config: PhysicsConfig) -> mujoco.MjModel:
    """Return the model of the rover on the finest level of the world, with its rocks.

    Height fields have the samples of the world's grid, and the same two triangles per cell.

    Raises:
        PhysicsError: If MuJoCo cannot simulate such a rover.
    """
    spec = _rover_alone(rover, config)
    tiles = _tiles(world.ground)
    _add_ground(spec, tiles)
    _add_rocks(spec, world)
    model = _compiled(spec, rover, config)
    _fill_ground(model, tiles)
    return model


def check_contacts(rover: RoverDescription, config: PhysicsConfig) -> None:
    """Check, without a world, that a rover can be simulated and its contacts stepped.

    Raises:
        ConfigError: If the time step is too long for them, or soil is without gravity.
        PhysicsError: If MuJoCo cannot simulate such a rover.
    """
    model = _compiled(_rover_alone(rover, config), rover, config)
    if config.ground.deforms:
        set_soil(model, rover, config.ground, config.ground.soil(config.gravity_mps2))


def _rover_alone(rover: RoverDescription, config: PhysicsConfig) -> mujoco.MjSpec:
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
    return spec


def _compiled(spec: mujoco.MjSpec, rover: RoverDescription,
              config: PhysicsConfig) -> mujoco.MjModel:
    """Return the model of a rover with what is around it, and with its contacts."""
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
    of_rover = (model.geom_bodyid > 0) & (model.body_mocapid[model.geom_bodyid] < 0)
    rover_geoms = np.flatnonzero(of_rover)
    set_contact(model, config.contact, rover_geoms, rover.legs.tip_radius_m)
    return model


@dataclasses.dataclass(frozen=True)
class _Tile:
    """A part of the ground that has a height field of its own.

    What it is follows from its place in the site and from its own heights. So contact on it has
    the same bits in every window that holds it.
    """

    heights_m: NDArray[np.float32]
    middle_m: tuple[float, float]
    half_m: tuple[float, float]
    low_m: float            # whole metres, so that single precision holds what is above it
    elevation_m: float      # a power of two, for the same reason


def _tiles(grid: HeightGrid) -> list[_Tile]:
    """Return the tiles of a ground, from south to north, each row from west to east.

    They lie between multiples of TILE_M in the site, and end where the ground ends.
    """
    cells = max(round(TILE_M / grid.cell_m), _LEAST_CELLS)
    columns, rows = (_cuts(first, grid.n, cells) for first in grid.first)
    return [_tile(grid, x, y) for y in rows for x in columns]


def _cuts(first: float, n: int, cells: int) -> list[slice]:
    """Return the samples of each tile along an axis; neighbours share one."""
    inner = range(-math.floor(first) % cells, n - 1, cells)
    ends = [0, *(i for i in inner if i > 0), n - 1]
    return [slice(a, b + 1) for a, b in zip(ends, ends[1:])]


def _tile(grid: HeightGrid, x: slice, y: slice) -> _Tile:
    heights, cell = grid.heights_m[y, x], grid.cell_m
    ny, nx = heights.shape
    # The border of the ground depends on the window; the middle of a tile is far from it.
    middle = float(heights[ny // 2, nx // 2])
    half = _HALF_ELEVATION_M
    while max(middle - float(heights.min()), float(heights.max()) - middle) >= half - 1.0:
        half *= 2.0
    places = (first + part.start + 0.5 * (part.stop - 1 - part.start)
              for first, part in zip(grid.first, (x, y)))
    middle_x, middle_y = places
    return _Tile(heights, (middle_x * cell, middle_y * cell),
                 (0.5 * (nx - 1) * cell, 0.5 * (ny - 1) * cell), math.floor(middle) - half,
                 2.0 * half)


def _add_ground(spec: mujoco.MjSpec, tiles: list[_Tile]) -> None:
    """Add height fields without data.

    They are written as XML because only there a field may lack data. So the samples, up to
    hundreds of millions, do not pass through the compiler.
    """
    fields = ''.join(f"""
            <hfield name="ground_{k}" nrow="{tile.heights_m.shape[0]}"
                    ncol="{tile.heights_m.shape[1]}" size="{tile.half_m[0]!r} {tile.half_m[1]!r}
                    {tile.elevation_m!r} {BASE_THICKNESS_M!r}"/>"""
                     for k, tile in enumerate(tiles))
    geoms = ''.join(f"""
            <geom name="ground_{k}" type="hfield" hfield="ground_{k}"
                  pos="{tile.middle_m[0]!r} {tile.middle_m[1]!r} {tile.low_m!r}"
                  contype="{GROUND_BIT}" conaffinity="0"/>"""
                    for k, tile in enumerate(tiles))
    ground = mujoco.MjSpec.from_string(
        f'<mujoco><asset>{fields}</asset><worldbody>{geoms}</worldbody></mujoco>')
    spec.attach(ground, prefix=WORLD_PREFIX, frame=spec.worldbody.add_frame())


def _fill_ground(model: mujoco.MjModel, tiles: list[_Tile]) -> None:
    """Write the heights of the tiles as parts of their elevations, row 0 in the south."""
    for start, tile in zip(model.hfield_adr.tolist(), tiles):
        data = model.hfield_data[start:start + tile.heights_m.size].reshape(tile.heights_m.shape)
        np.subtract(tile.heights_m, np.float32(tile.low_m), out=data)
        data /= np.float32(tile.elevation_m)


def _add_rocks(spec: mujoco.MjSpec, world: World) -> None:
    """Add the rocks, with one mesh for each convex piece and size class that occurs."""
    rocks, pieces, _ = world.rocks.in_pieces(world.rock_shapes)
    known: set[str] = set()
    # The order of contacts, which their forces depend on, is that of keys in every window.
    for i in np.argsort(rocks.key, kind='stable').tolist():
        shape, size = int(rocks.shape[i]), int(rocks.size[i])
        mesh = f'rock_{shape}_{size}'
        if mesh not in known:
            known.add(mesh)
            unit = pieces[shape]
            vertices = unit.vertices * np.float32(rocks.size_classes_m[size])
            spec.add_mesh(name=mesh, uservert=vertices.ravel(), userface=unit.faces.ravel())
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh,
                                pos=rocks.position_m[i], quat=rocks.orientation_wxyz[i],
                                contype=ROCK_BIT, conaffinity=0)
