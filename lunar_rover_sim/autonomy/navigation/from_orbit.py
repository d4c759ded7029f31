"""What ground costs by maps from orbit: given ones, or those of a world, made where one drives."""

from __future__ import annotations

from collections.abc import Sequence
import pathlib

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.autonomy.navigation.config import GlobalPlanConfig
from lunar_rover_sim.autonomy.navigation.global_plan import GroundCosts
from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.orbital_making import orbital_map
from lunar_rover_sim.ground.world.orbital_map import OrbitalConfig, OrbitalMap
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.ground.world.world_folder import load_world

_BEYOND_M = 60.0        # a photo reaches beyond start and goals: a way may lead around something
_LEAST_SUN_DEG = 1.0    # elevation: below it all is dark


class CostsFromOrbit:
    """Costs of the ground around places, by maps that are read or made when they are asked for.

    Of a world heights are those of all of its site. The photo, which shows the shadows, is of the
    part where one drives: to make it takes a minute or two for each square kilometre. One that was
    made serves as well for places a little beside, such as where the rover believes to be.
    """

    def __init__(self, world: str, maps: str, config: GlobalPlanConfig,
                 sun_deg: tuple[float, float] | None) -> None:
        """Begin.

        Args:
            world: Folder of the world; '': `maps` alone is known.
            maps: Folder of `world export --orbital`; '': they are made of the world.
            config: Side of a cell, and the steepest slope.
            sun_deg: Azimuth and elevation of the sun; None: it does not shine.

        Raises:
            WorldError: If `maps` cannot be read: that is said now, not on the way.
        """
        self._world, self._config, self._sun_deg = world, config, sun_deg
        self._given: OrbitalMap | None = None
        if maps:
            try:
                self._given = OrbitalMap.load(pathlib.Path(maps))
            except WorldError as error:
                raise WorldError(f'maps: {error}') from None
        self._made: GroundCosts | None = None
        # Least and greatest x and y (2, 2) of places that have enough photo around them.
        self._covered: Array | None = None

    def __call__(self, places_m: Sequence[ArrayLike]) -> GroundCosts:
        """Return the costs, with shadows by the photo around places (n, 2)."""
        places = np.array([np.asarray(place, float)[:2] for place in places_m])
        low, high = places.min(axis=0), places.max(axis=0)
        if self._made is not None and (self._covered is None or bool(
                (low >= self._covered[0]).all() and (high <= self._covered[1]).all())):
            return self._made
        margin = 0.0
        if self._world:
            world = load_world(self._world, verify=False)
            margin = Site.of(world).hole_margin_m
        if self._given is not None:
            maps = self._given
        elif self._sun_deg is None or self._sun_deg[1] < _LEAST_SUN_DEG:
            maps = orbital_map(world, OrbitalConfig(photo_pixel_m=0.0), coarse=True)
        else:
            self._covered = np.array([low - 0.5 * _BEYOND_M, high + 0.5 * _BEYOND_M])
            (west, south), (east, north) = low - _BEYOND_M, high + _BEYOND_M
            azimuth, elevation = self._sun_deg
            maps = orbital_map(
                world, OrbitalConfig(sun_azimuth_deg=azimuth, sun_elevation_deg=elevation),
                coarse=True, photo_box=(west, east, south, north))
        self._made = GroundCosts.of(maps, self._config, self._sun_deg, margin)
        return self._made
