"""The rover put elsewhere by hand, or given another velocity."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.arguments import brief
from lunar_rover_sim.errors import PhysicsError
from lunar_rover_sim.frames import Array, matrix_from_wxyz
from lunar_rover_sim.world.grid import HeightGrid

# A pose that lies deeper in the ground is refused: contact would throw the rover out.
MAX_DEPTH_M = 0.003
MAX_SPEED = 10.0    # [m/s] and [rad/s]


def relocate(model: mujoco.MjModel, data: mujoco.MjData, ground: HeightGrid,
             position_m: ArrayLike | None, orientation_wxyz: ArrayLike | None,
             linear_mps: ArrayLike | None, angular_radps: ArrayLike | None) -> None:
    """Write pose (world frame) and velocity (world axes) of base_link into `data`.

    What is None stays, and so do the legs.

    Raises:
        PhysicsError: If that is not a pose above the ground with the legs free of it, or a
            velocity of MAX_SPEED and more; nothing is changed then.
    """
    qpos, qvel = data.qpos.copy(), data.qvel.copy()
    if position_m is not None:
        qpos[:3] = _finite('position', position_m, 3)
    if orientation_wxyz is not None:
        qpos[3:7] = _finite('orientation', orientation_wxyz, 4)
    norm = float(np.linalg.norm(qpos[3:7]))
    if abs(norm - 1.0) > 1e-3:
        raise PhysicsError(f'orientation: {qpos[3:7].tolist()} is not valid; valid is a unit '
                           'quaternion')
    qpos[3:7] /= norm
    x, y, z = qpos[:3].tolist()
    if max(abs(x), abs(y)) > ground.half_extent_m:
        raise PhysicsError(f'position: x = {x:g} m, y = {y:g} m is not on the ground; it ends at '
                           f'{ground.half_extent_m:g} m')
    if linear_mps is not None:
        qvel[:3] = _finite('linear velocity', linear_mps, 3)
    if angular_radps is not None:
        qvel[3:6] = _finite('angular velocity', angular_radps, 3) @ matrix_from_wxyz(qpos[3:7])
    if max(np.linalg.norm(qvel[:3]), np.linalg.norm(qvel[3:6])) >= MAX_SPEED:
        raise PhysicsError(f'velocity: {qvel[:6].tolist()} is not valid; valid is less than '
                           f'{MAX_SPEED:g} m/s and rad/s')
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


def _finite(name: str, values: ArrayLike, count: int) -> Array:
    array = np.asarray(values, dtype=float)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise PhysicsError(f'{name}: {brief(values)} is not valid; valid is {count} finite '
                           'numbers')
    return array
