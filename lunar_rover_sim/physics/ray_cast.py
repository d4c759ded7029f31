"""Obstacles between a place and the sky, by MuJoCo's rays."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.physics.simulation import Simulation

_NO_BODY = -1
_GEOM = np.zeros(1, np.int32)   # which geom is hit; nobody asks


def reaches_sky(simulation: Simulation, point_m: Array, directions: Array) -> NDArray[np.bool_]:
    """Return which rays from a (3,) place in (n, 3) directions hit no ground, rock or rover.

    The ground is the fine one that the rover walks on, before it has changed it; nothing beyond it
    is looked at.

    Raises:
        PhysicsError: After the simulation was closed.
    """
    model, data = simulation.model, simulation.data
    return np.array([mujoco.mj_ray(model, data, point_m, ray, None, 1, _NO_BODY, _GEOM) < 0.0
                     for ray in directions], bool)
