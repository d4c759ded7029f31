"""Depth by which spoke tips penetrate what they touch."""

from __future__ import annotations

import mujoco
import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.rover.mjcf import tip_geom
from lunar_rover_sim.rover.physics.simulation import Simulation

_STENCIL = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])


class TipPenetration:
    """Measures the penetration of the tips in the present state of one simulation.

    MuJoCo's contact depth is valid for a tip whose centre is above the surface. For a deeper one
    it is the distance to the side of one prism of the height field; the depth is then computed
    from the height of the ground.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._radius_m = simulation.rover.legs.tip_radius_m
        self._find_tips()

    def _find_tips(self) -> None:
        """Find the geoms of the tips in the model, which is another one in another window."""
        self._model, legs = self._simulation.model, self._simulation.rover.legs
        self._tips = np.array([
            mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_GEOM, tip_geom(leg, spoke))
            for leg in legs.names for spoke in range(legs.spokes)])
        self._is_tip = np.zeros(self._model.ngeom, dtype=bool)
        self._is_tip[self._tips] = True

    def deepest_m(self) -> float:
        """Return the greatest penetration [m] of a tip into ground or rock, along the normal.

        It is 0 where no tip touches anything.
        """
        if self._model is not self._simulation.model:
            self._find_tips()
        contact = self._simulation.data.contact
        distance = contact.dist[self._is_tip[contact.geom].any(axis=1)]
        depth = -float(distance.min()) if len(distance) else 0.0
        if depth < 0.5 * self._radius_m:
            return max(0.0, depth)
        return max(0.0, float(np.max(self._in_ground_m())), self._in_rocks_m())

    def _in_ground_m(self) -> Array:
        """Return the (n,) depth [m] of each tip in the ground, negative above it."""
        centre = self._simulation.data.geom_xpos[self._tips]
        around = centre[:, None, :2] + self._radius_m * _STENCIL
        height = self._simulation.world.ground.height_at(around)
        slope = np.stack([height[:, 1] - height[:, 2], height[:, 3] - height[:, 4]], axis=-1)
        slope /= 2.0 * self._radius_m
        upright = 1.0 / np.sqrt(1.0 + np.sum(slope ** 2, axis=-1))
        depth: Array = self._radius_m - (centre[:, 2] - height[:, 0]) * upright
        return np.nan_to_num(depth)

    def _in_rocks_m(self) -> float:
        """Return the greatest depth of a tip in a rock, 0 where none touches one."""
        contact, model = self._simulation.data.contact, self._simulation.model
        geoms = contact.geom
        rock = (model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_MESH).any(axis=1)
        distance = contact.dist[rock & self._is_tip[geoms].any(axis=1)]
        return -float(distance.min()) if len(distance) else 0.0
