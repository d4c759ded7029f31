"""Where the rover is put: at its start, and by hand."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.errors import brief, ConfigError, PhysicsError
from lunar_rover_sim.base.frames import Array, length, matrix_from_wxyz, wxyz_from_matrix
from lunar_rover_sim.ground.world.follower import Follower
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mjcf import BASE_BODY
from lunar_rover_sim.rover.physics.config import StartPose


def is_on(ground: HeightGrid, x: float, y: float) -> bool:
    """Return whether a place in the frame of the site lies on a ground."""
    (middle_x, middle_y), limit = ground.middle_m, ground.half_extent_m
    return abs(x - middle_x) <= limit and abs(y - middle_y) <= limit


# A pose that lies deeper in the ground is refused: contact would throw the rover out.
MAX_DEPTH_M = 0.003
MAX_GIVEN_SPEED = 10.0    # [m/s] and [rad/s]


def relocate(model: mujoco.MjModel, data: mujoco.MjData, ground: HeightGrid,
             position_m: ArrayLike | None, orientation_wxyz: ArrayLike | None,
             linear_mps: ArrayLike | None, angular_radps: ArrayLike | None, end: str) -> None:
    """Write pose (world frame) and velocity (world axes) of base_link into `data`.

    What is None stays, and so do the legs.

    Args:
        end: Where the site ends, in words.

    Raises:
        PhysicsError: If that is not a pose above the ground with the legs free of it, or a
            velocity of MAX_GIVEN_SPEED and more; nothing is changed then.
    """
    qpos, qvel = data.qpos.copy(), data.qvel.copy()
    if position_m is not None:
        qpos[:3] = finite('position', position_m, 3)
    if orientation_wxyz is not None:
        qpos[3:7] = finite('orientation', orientation_wxyz, 4)
    norm = float(np.linalg.norm(qpos[3:7]))
    if abs(norm - 1.0) > 1e-3:
        raise PhysicsError(f'orientation: {qpos[3:7].tolist()} is not valid; valid is a unit '
                           'quaternion')
    qpos[3:7] /= norm
    x, y, z = qpos[:3].tolist()
    if not is_on(ground, x, y):
        raise PhysicsError(f'position: x = {x:g} m, y = {y:g} m is not on the ground; {end}')
    if linear_mps is not None:
        qvel[:3] = finite('linear velocity', linear_mps, 3)
    if angular_radps is not None:
        qvel[3:6] = finite('angular velocity', angular_radps, 3) @ matrix_from_wxyz(qpos[3:7])
    if max(np.linalg.norm(qvel[:3]), np.linalg.norm(qvel[3:6])) >= MAX_GIVEN_SPEED:
        raise PhysicsError(f'velocity: {qvel[:6].tolist()} is not valid; valid is less than '
                           f'{MAX_GIVEN_SPEED:g} m/s and rad/s')
    before = data.qpos.copy()
    data.qpos[:] = qpos
    mujoco.mj_fwdPosition(model, data)
    depth_m = max(-float(np.min(data.contact.dist, initial=0.0)),
                  ground.height_at_point(x, y) - z)
    if depth_m > MAX_DEPTH_M:
        data.qpos[:] = before
        mujoco.mj_fwdPosition(model, data)
        raise PhysicsError(f'position: x = {x:.3f} m, y = {y:.3f} m, z = {z:.3f} m lies '
                           f'{depth_m:.3f} m in the ground or in a rock; raise it')
    data.qvel[:] = qvel
    mujoco.mj_forward(model, data)


def finite(name: str, values: ArrayLike, count: int) -> Array:
    """Return an array (count,); PhysicsError with the name unless it is finite numbers."""
    array = np.asarray(values, dtype=float)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise PhysicsError(f'{name}: {brief(values)} is not valid; valid is {count} finite '
                           'numbers')
    return array


CLEARANCE_M = 0.001
MARGIN_M = 1.0   # least distance of the start from the border of the ground
RAISE_M = 0.005  # step by which the rover is raised until it touches nothing


def check_start(start: StartPose, follower: Follower) -> None:
    """Raise ConfigError if a start is not on the site."""
    for name, value, (low, high) in zip(('start.x_m', 'start.y_m'), (start.x_m, start.y_m),
                                        follower.bounds_m):
        if not low + MARGIN_M <= value <= high - MARGIN_M:
            raise ConfigError(f'{name}: {value} is not valid; valid is {low + MARGIN_M:g} to '
                              f'{high - MARGIN_M:g} [m] on this world')


def check_joint_angles(start: StartPose, rover: RoverDescription) -> None:
    """Raise ConfigError if they are neither one for all legs nor one for each."""
    given, legs = len(start.joint_angle_rad), len(rover.legs.each)
    if given not in (1, legs):
        raise ConfigError(f'start.joint_angle_rad: {given} elements given; valid is one for all '
                          f'legs, or {legs}')


def place(model: mujoco.MjModel, data: mujoco.MjData, ground: HeightGrid, rover: RoverDescription,
          start: StartPose) -> None:
    """Put the rover at the start pose, clear of the ground and of rocks; writes `data.qpos`.

    Raises:
        ConfigError: If there is no room for the rover.
    """
    rotation = _level_rotation(ground, rover, start)
    data.qpos[:3] = start.x_m, start.y_m, 0.0
    data.qpos[3:7] = wxyz_from_matrix(rotation)
    legs = len(rover.legs.each)
    check_joint_angles(start, rover)
    data.qpos[7:7 + legs] = start.joint_angle_rad
    data.qvel[:] = 0.0
    mujoco.mj_kinematics(model, data)
    # The tips; soft ground has balls on the chassis, too.
    on_legs = model.geom_bodyid > mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, BASE_BODY)
    spheres = np.flatnonzero(on_legs & (model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE))
    centres = data.geom_xpos[spheres]
    lowest = centres[:, 2] - model.geom_size[spheres, 0]
    # Steep ground touches a sphere beside its lowest point: look at a disc below each.
    offsets = model.geom_size[spheres, 0].max() * _DISC
    under = ground.height_at(centres[:, None, :2] + offsets)
    data.qpos[2] = np.max(under.max(axis=1) - lowest) + CLEARANCE_M
    for _ in range(400):
        mujoco.mj_fwdPosition(model, data)
        if data.ncon == 0:
            return
        data.qpos[2] += RAISE_M
    raise ConfigError(f'start: no room for the rover at x_m = {start.x_m}, y_m = {start.y_m}')


_ANGLES = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
_DISC = np.concatenate([np.zeros((1, 2)), np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], -1)])


def _level_rotation(ground: HeightGrid, rover: RoverDescription, start: StartPose) -> Array:
    """Return R_world_base whose z axis is the normal of the plane through the footholds.

    The plane is that of least squares. Sums of plain numbers round alike on every processor.
    """
    yaw = math.radians(start.yaw_deg)
    cos, sin = math.cos(yaw), math.sin(yaw)
    feet = [position[:2] for position in rover.legs.axle_positions_m()]
    heights = [ground.height_at_point(start.x_m + x * cos - y * sin, start.y_m + x * sin + y * cos)
               for x, y in feet]
    mid_x, mid_y, mid_z = (sum(values) / len(feet) for values in (*zip(*feet), heights))
    xx = xy = yy = xz = yz = 0.0
    for (x, y), z in zip(feet, heights):
        x, y, z = x - mid_x, y - mid_y, z - mid_z
        xx, xy, yy, xz, yz = xx + x * x, xy + x * y, yy + y * y, xz + x * z, yz + y * z
    area = xx * yy - xy * xy        # > 0: the centre of mass is between the axles
    slope_x, slope_y = (xz * yy - yz * xy) / area, (yz * xx - xz * xy) / area
    # The heading along the plane, and its cross product with what is to the left of it.
    along = math.sqrt(1.0 + slope_x * slope_x)
    x_axis = np.array([cos / along, sin / along, slope_x / along])
    z_axis = np.cross(x_axis, [-sin, cos, slope_y])
    z_axis /= length(z_axis.tolist())
    return np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis])
