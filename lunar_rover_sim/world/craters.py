"""Craters that a world shows: their catalogue, and how many, how large, how old and where."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses

import numpy as np
from numpy.typing import NDArray
import scipy  # its parts when they are used

from lunar_rover_sim.errors import WorldError
from lunar_rover_sim.frames import Array
from lunar_rover_sim.world.config import CraterConfig
from lunar_rover_sim.world.crater_profile import profile_table
from lunar_rover_sim.world.grid import on_lattice, significant


@dataclasses.dataclass(frozen=True)
class Craters:
    """A catalogue of craters: arrays of equal length m, read-only.

    Attributes:
        position_m: (m, 2) centre.
        diameter_m: (m,) from rim to rim when the crater was fresh.
        age: (m,) fraction of the crater's lifetime, 0 = fresh.
        level: (m,) index of the height level on which it is drawn (finer levels show it too).
    """

    position_m: Array
    diameter_m: Array
    age: Array
    level: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.diameter_m)

    @property
    def time(self) -> Array:
        """(m,) time since formation, in lifetimes of a 1 m crater.

        Diffusion erases a crater in a time that grows with its area (Fassett & Thomson 2014).
        """
        return self.age * self.diameter_m ** 2

    def select(self, chosen: NDArray) -> Craters:
        """Return the craters at the chosen indices, or where a mask is true."""
        return Craters(self.position_m[chosen], self.diameter_m[chosen], self.age[chosen],
                       self.level[chosen])

    @staticmethod
    def join(parts: Sequence[Craters]) -> Craters:
        """Return all craters of several catalogues."""
        if not parts:
            return Craters(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0, np.int32))
        return Craters(*(np.concatenate([getattr(part, field.name) for part in parts])
                         for field in dataclasses.fields(Craters)))


GEOMETRIC_SATURATION = 1.54  # N(>D) D^2 (Gault, 1970)
REFERENCE_DIAMETER_M = 10.0
_POSITION_STEP_M = 2.0**-16
_MAX_CRATERS = 500_000       # on one level


def density_per_m2(config: CraterConfig, diameter_m: float) -> float:
    """Return the cumulative number N(>D) per m2 of the power law without an upper limit."""
    d0 = REFERENCE_DIAMETER_M
    return config.density * GEOMETRIC_SATURATION / d0 ** 2 * (diameter_m / d0) ** -config.slope


def populate(config: CraterConfig, half_extent_m: float, low_m: float, high_m: float,
             level: int, rng: np.random.Generator) -> Craters:
    """Return craters with diameters in [low, high) whose centres lie in [-h, h]^2.

    In equilibrium, where formation balances erasure at every size, ages are uniform from 0 to the
    end of the lifetime.

    Raises:
        WorldError: If there would be too many craters.
    """
    low_m, high_m = max(low_m, config.min_diameter_m), min(high_m, config.max_diameter_m)
    if low_m >= high_m or config.density == 0.0:
        return Craters.join([])
    per_m2 = density_per_m2(config, low_m) - density_per_m2(config, high_m)
    expected = per_m2 * (2.0 * half_extent_m) ** 2
    if expected > _MAX_CRATERS:
        raise WorldError(f'world.craters: {expected:.3g} from {low_m:.3g} m to {high_m:.3g} m are '
                         f'more than {_MAX_CRATERS} on one level; raise '
                         'world.craters.min_diameter_m or lower world.craters.density or '
                         'world.craters.slope')
    count = rng.poisson(expected)
    u = rng.random(count)
    b = -config.slope
    diameter = (low_m ** b + u * (high_m ** b - low_m ** b)) ** (1.0 / b)
    position = rng.uniform(-half_extent_m, half_extent_m, (count, 2))
    age = rng.random(count) ** (1.0 / config.age_exponent)
    return Craters(on_lattice(position, _POSITION_STEP_M), significant(diameter),
                   significant(age), np.full(count, level, np.int32))


def keep_clear(craters: Craters, config: CraterConfig, radius_m: float,
               steepest_deg: float = 5.0) -> Craters:
    """Return the craters without those whose steep parts reach within a radius of the origin."""
    table = profile_table(config)
    slope = np.interp(craters.age, table.ages, table.steepest)
    distance = np.linalg.norm(craters.position_m, axis=1)
    near = distance < 0.8 * craters.diameter_m + radius_m
    return craters.select(~(near & (slope > np.tan(np.radians(steepest_deg)))))


def survivors(craters: Craters, coarser: Craters) -> Craters:
    """Return the craters that no younger crater of a coarser level has erased."""
    alive = np.ones(len(craters), bool)
    if len(craters) and len(coarser):
        younger = coarser.select(coarser.time < craters.time.max())
        tree = scipy.spatial.cKDTree(craters.position_m)
        inside = tree.query_ball_point(younger.position_m, 0.55 * younger.diameter_m)
        for time, near in zip(younger.time, inside):
            alive[near] &= craters.time[near] <= time
    return craters.select(alive)
