"""How deep the spoke tips are in what they touch."""

from __future__ import annotations

import mujoco
import numpy as np

from lunar_rover_sim.frames import Array
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.rover.description import LEG_NAMES
from lunar_rover_sim.rover.mjcf import tip_geom
from lunar_rover_sim.world.grid import HeightGrid

# No tip of the default rover sinks deeper under lunar gravity, save after a fall by over 0.3 m.
# At rest it is 0.5 mm, at a tip radius of 8 mm the ground is nearly rigid, and from about 10 mm on
# a tip would be caught in it (`physics/contact.py`).
SINKAGE_BOUND_M = 0.0095

_STENCIL = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])


class TipSinkage:
    """Looks at the tips of one simulation as it stands after its last step.

    MuJoCo's own contact depth holds for a tip whose middle is above the surface. Of a deeper one
    it is the way out of one prism of the height field, to the side; there the ground is asked.
    """

    def __init__(self, simulation: Simulation, ground: HeightGrid) -> None:
        self._simulation = simulation
        self._ground = ground
        model, legs = simulation.model, simulation.rover.legs
        self._radius_m = legs.tip_radius_m
        self._tips = np.array([
            mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, tip_geom(leg, spoke))
            for leg in LEG_NAMES for spoke in range(legs.spokes)])
        self._is_tip = np.zeros(model.ngeom, dtype=bool)
        self._is_tip[self._tips] = True

    def deepest_m(self) -> float:
        """Return the depth [m], along the normal, of the tip that is deepest in ground or rock.

        0 where none touches.
        """
        contact = self._simulation.data.contact
        distance = contact.dist[self._is_tip[contact.geom].any(axis=1)]
        depth = -float(distance.min()) if len(distance) else 0.0
        if depth < 0.5 * self._radius_m:
            return max(0.0, depth)
        return max(0.0, float(np.max(self._in_ground_m())), self._in_rocks_m())

    def _in_ground_m(self) -> Array:
        """Return the depth of each tip in the ground, negative above it."""
        centre = self._simulation.data.geom_xpos[self._tips]
        around = centre[:, None, :2] + self._radius_m * _STENCIL
        height = self._ground.height_at(around)
        slope = np.stack([height[:, 1] - height[:, 2], height[:, 3] - height[:, 4]], axis=-1)
        slope /= 2.0 * self._radius_m
        upright = 1.0 / np.sqrt(1.0 + np.sum(slope ** 2, axis=-1))
        depth: Array = self._radius_m - (centre[:, 2] - height[:, 0]) * upright
        return np.nan_to_num(depth)

    def _in_rocks_m(self) -> float:
        contact, model = self._simulation.data.contact, self._simulation.model
        geoms = contact.geom
        rock = (model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_MESH).any(axis=1)
        distance = contact.dist[rock & self._is_tip[geoms].any(axis=1)]
        return -float(distance.min()) if len(distance) else 0.0
