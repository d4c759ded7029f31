"""The start pose of the rover: just above the ground, tilted as the ground is."""

from __future__ import annotations

import mujoco
import numpy as np

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.frames import Array, wxyz_from_matrix
from lunar_rover_sim.physics.config import StartPose
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mjcf import BASE_BODY
from lunar_rover_sim.world.grid import HeightGrid

CLEARANCE_M = 0.001
MARGIN_M = 1.0   # least distance of the start from the border of the ground
RAISE_M = 0.005  # step by which the rover is raised until it touches nothing


def place(model: mujoco.MjModel, data: mujoco.MjData, ground: HeightGrid, rover: RoverDescription,
          start: StartPose) -> None:
    """Put the rover at the start pose, clear of the ground and of rocks; writes `data.qpos`.

    Raises:
        ConfigError: If the start is not on the ground, or if there is no room for the rover.
    """
    limit = ground.half_extent_m - MARGIN_M
    for name, value in (('start.x_m', start.x_m), ('start.y_m', start.y_m)):
        if abs(value) > limit:
            raise ConfigError(f'{name}: {value} is not valid; valid is -{limit:g} to {limit:g} [m]'
                              ' on this world')
    rotation = _level_rotation(ground, rover, start)
    data.qpos[:3] = start.x_m, start.y_m, 0.0
    data.qpos[3:7] = wxyz_from_matrix(rotation)
    legs = len(rover.legs.each)
    if len(start.joint_angle_rad) not in (1, legs):
        raise ConfigError(f'start.joint_angle_rad: {len(start.joint_angle_rad)} elements given; '
                          f'valid is one for all legs, or {legs}')
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
    """Return R_world_base whose z axis is the normal of the plane through the footholds."""
    yaw = np.radians(start.yaw_deg)
    forward = np.array([np.cos(yaw), np.sin(yaw)])
    left = np.array([-forward[1], forward[0]])
    feet = np.array(rover.legs.axle_positions_m())
    xy = np.array([start.x_m, start.y_m]) + feet[:, :1] * forward + feet[:, 1:2] * left
    basis = np.column_stack([feet[:, :2], np.ones(len(feet))])
    slope_x, slope_y, _ = np.linalg.lstsq(basis, ground.height_at(xy), rcond=None)[0]
    x_axis = np.append(forward, slope_x)
    x_axis /= np.linalg.norm(x_axis)
    z_axis = np.cross(x_axis, np.append(left, slope_y))
    z_axis /= np.linalg.norm(z_axis)
    return np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis])
