"""The sun from places on the rover, while it moves, and what hides it."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.moon_place import reported_site
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.illumination.sun_of_date import earth_of_date, sun_of_date, SunPath
from lunar_rover_sim.image.illumination.sun_view import SeenSun, SunView
from lunar_rover_sim.image.lidar.ray_arrays import HeightPyramid, RockHulls
from lunar_rover_sim.image.lidar.ray_caster import RayCaster
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.rover.physics.state import RoverState


class SunFromRover:
    """The sun past relief, rocks and the rover itself, and the Earth."""

    def __init__(self, simulation: Simulation, sun: SunConfig) -> None:
        """Look from a rover.

        Args:
            sun: As a parameter gives it, perhaps with a date.
        """
        self._simulation, self._window = simulation, simulation.world
        self._sky = SkyRays(simulation)
        self._path = SunPath(sun_of_date(sun, reported_site(simulation.world.report)))
        self._step = -1

    def follow(self, sun: SunConfig) -> None:
        """Show another sun, one without a date."""
        self._path, self._step = SunPath(sun), -1

    def seen(self, state: RoverState, position_m: tuple[float, ...],
             stamp_ns: int) -> SeenSun | None:
        """Return what a (3,) place in base_link sees of the sun, None if nothing."""
        self._follow(stamp_ns)
        T, (x, y) = state.T_world_base, self._window.ground.middle_m
        place_m = T[:3, :3] @ np.asarray(position_m) + T[:3, 3]
        return self._view.seen_from(place_m - np.array([x, y, 0.0]), self._sky.reached)

    def earth(self, stamp_ns: int) -> Array | None:
        """Return the (3,) unit vector to the Earth, as `earth_of_date`."""
        self._follow(stamp_ns)
        return self._earth

    def _follow(self, stamp_ns: int) -> None:
        step, window = self._path.step(stamp_ns), self._simulation.world
        if step != self._step or window is not self._window:
            self._step, self._window, sun = step, window, self._path.of_step(step)
            self._view, self._earth = SunView(window.local(), sun), earth_of_date(sun)


_NO_BODY = -1
_GEOM = np.zeros(1, np.int32)   # which geom is hit; nobody asks
_ROVER = np.array([0, 1, 0, 0, 0, 0], np.uint8)     # its group among those of geoms


class SkyRays:
    """Rays from the rover that may hit ground, rocks or the rover.

    The ground is the fine one that the rover walks on, before it has changed it; nothing beyond it
    is looked at. MuJoCo looks at the rover alone: of a height field it tests all triangles under a
    ray, tens of milliseconds for the sun.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._world: World | None = None

    def reached(self, point_m: Array, directions: Array) -> NDArray[np.bool_]:
        """Return which rays hit nothing.

        Args:
            point_m: (3,) where they begin, from the middle of the window.
            directions: (n, 3) unit vectors.

        Raises:
            PhysicsError: After the simulation was closed.
        """
        model, data, world = self._simulation.model, self._simulation.data, self._simulation.world
        if world is not self._world:
            self._world, local = world, world.local()
            hulls = RockHulls(local.rocks, local.rock_shapes)
            self._caster = RayCaster([HeightPyramid(local.ground, hulls)], hulls)
            self._far_m = 4.0 * local.ground.half_extent_m
        hits = self._caster.cast(np.tile(point_m, (len(directions), 1)), directions, self._far_m,
                                 from_one_place=False)
        free = np.isinf(hits.distance_m)
        place_m = point_m + np.array([*world.ground.middle_m, 0.0])
        free[free] = [mujoco.mj_ray(model, data, place_m, ray, _ROVER, 1, _NO_BODY, _GEOM) < 0.0
                      for ray in directions[free]]
        return free
