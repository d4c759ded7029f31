"""The sun from places on the rover, while it moves, and what hides it."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.moon_place import reported_site
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.illumination.sun_of_date import earth_of_date, sun_of_date, SunPath
from lunar_rover_sim.image.illumination.sun_view import SeenSun, SunView
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
        middle_m = np.array([x, y, 0.0])

        def clear(point_m: Array, directions: Array) -> NDArray[np.bool_]:
            return reaches_sky(self._simulation, point_m + middle_m, directions)

        place_m = T[:3, :3] @ np.asarray(position_m) + T[:3, 3]
        return self._view.seen_from(place_m - middle_m, clear)

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
