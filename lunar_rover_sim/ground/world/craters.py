"""Craters that a world shows: their catalogue, how many, how large, how old and where; profiles.

The radial profile of a crater goes from fresh to degraded by diffusion.
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.config import CraterConfig
from lunar_rover_sim.ground.world.grid import on_lattice, significant
from lunar_rover_sim.ground.world.rocks import numbered


@dataclasses.dataclass(frozen=True)
class Craters:
    """A catalogue of craters: arrays of equal length m, read-only.

    Attributes:
        position_m: (m, 2) centre.
        diameter_m: (m,) from rim to rim when the crater was fresh.
        age: (m,) fraction of the crater's lifetime, 0 = fresh.
        level: (m,) index of the height level on which it is drawn (finer levels show it too).
        key: (m,) uint64 that a crater keeps in all windows of its site. Craters made without keys
            are numbered.
    """

    position_m: Array
    diameter_m: Array
    age: Array
    level: NDArray[np.int32]
    key: NDArray[np.uint64] = dataclasses.field(default_factory=lambda: np.zeros(0, np.uint64))

    def __post_init__(self) -> None:
        if len(self.key) != len(self.diameter_m):
            object.__setattr__(self, 'key', numbered(len(self.diameter_m)))

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
                       self.level[chosen], self.key[chosen])

    @staticmethod
    def join(parts: Sequence[Craters]) -> Craters:
        """Return all craters of several catalogues."""
        if not parts:
            return Craters(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0, np.int32))
        return Craters(*(np.concatenate([getattr(part, field.name) for part in parts])
                         for field in dataclasses.fields(Craters)))


GEOMETRIC_SATURATION = 1.54  # N(>D) D^2 (Gault, 1970)
REFERENCE_DIAMETER_M = 10.0
POSITION_STEP_M = 2.0**-16
_MAX_CRATERS = 500_000      # on one level


def density_per_m2(config: CraterConfig, diameter_m: float) -> float:
    """Return the cumulative number N(>D) per m2 of the power law without an upper limit."""
    d0 = REFERENCE_DIAMETER_M
    return config.density * GEOMETRIC_SATURATION / d0 ** 2 * (diameter_m / d0) ** -config.slope


def expected_number(config: CraterConfig, area_m2: float, low_m: float, high_m: float) -> float:
    """Return how many craters with diameters in [low, high) an area has on average.

    Raises:
        WorldError: If they are too many.
    """
    low_m, high_m = max(low_m, config.min_diameter_m), min(high_m, config.max_diameter_m)
    expected = (density_per_m2(config, low_m) - density_per_m2(config, high_m)) * area_m2
    if expected > _MAX_CRATERS:
        raise WorldError(f'world.craters: {expected:.3g} from {low_m:.3g} m to {high_m:.3g} m are '
                         f'more than {_MAX_CRATERS} on one level; raise '
                         'world.craters.min_diameter_m or lower world.craters.density or '
                         'world.craters.slope')
    return expected


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
    expected = expected_number(config, (2.0 * half_extent_m) ** 2, low_m, high_m)
    count = rng.poisson(expected)
    u = rng.random(count)
    b = -config.slope
    diameter = (low_m ** b + u * (high_m ** b - low_m ** b)) ** (1.0 / b)
    position = rng.uniform(-half_extent_m, half_extent_m, (count, 2))
    age = rng.random(count) ** (1.0 / config.age_exponent)
    return Craters(on_lattice(position, POSITION_STEP_M), significant(diameter),
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
    # Here, because SciPy takes time to import, and most programs make no craters.
    from scipy.spatial import cKDTree
    alive = np.ones(len(craters), bool)
    if len(craters) and len(coarser):
        younger = coarser.select(coarser.time < craters.time.max())
        tree = cKDTree(craters.position_m)
        inside = tree.query_ball_point(younger.position_m, 0.55 * younger.diameter_m)
        for time, near in zip(younger.time, inside):
            alive[near] &= craters.time[near] <= time
    return craters.select(alive)


RADII = np.linspace(0.0, 5.0, 401)  # of the profile table, in crater radii
REACH = 2.6                         # radii beyond which a crater is not drawn
_AGES = np.linspace(0.0, 1.0, 33) ** 2


@dataclasses.dataclass(frozen=True)
class ProfileTable:
    """Radial profiles by age: heights over the plain in crater diameters.

    Attributes:
        ages: (a,) fractions of the lifetime.
        heights: (a, r) over RADII.
        depth: (a,) from rim crest to floor.
        rim: (a,) height of the crest over the plain.
        steepest: (a,) greatest slope.
    """

    ages: Array
    heights: Array
    depth: Array
    rim: Array
    steepest: Array

    def at(self, age: float) -> Array:
        """Return the profile (r,) of that age."""
        index = min(max(int(np.searchsorted(self.ages, age)) - 1, 0), len(self.ages) - 2)
        part = (age - self.ages[index]) / (self.ages[index + 1] - self.ages[index])
        return (1.0 - part) * self.heights[index] + part * self.heights[index + 1]


def fresh_profile(config: CraterConfig) -> Array:
    """Return the fresh profile over RADII in diameters: parabolic bowl, ejecta as r^-3.

    Depth and rim after Pike (1977), the fall of the ejecta after McGetchin et al. (1973).
    """
    r = RADII
    bowl = config.fresh_rim - config.fresh_depth * (1.0 - r ** 2)
    return np.where(r < 1.0, bowl, config.fresh_rim * np.maximum(r, 1.0) ** -3.0)


@functools.lru_cache(maxsize=8)
def profile_table(config: CraterConfig) -> ProfileTable:
    """Return the profiles of a crater from fresh to its oldest depth, to which it diffuses.

    dh/dt = kappa (h'' + h' / r), in units of the radius (Fassett & Thomson 2014), solved by
    implicit finite volumes, which conserve volume.
    """
    from scipy.linalg import solve_banded  # as in `survivors`
    step = RADII[1]
    n = len(RADII)
    # Finite volumes on rings: faces at r +- step/2; no flux through the centre and the far end.
    face = RADII[:-1] + 0.5 * step
    area = RADII * step
    area[0] = 0.125 * step ** 2
    area[-1] *= 0.5
    conductance = face / step
    h = fresh_profile(config)
    heights, times = [h], [0.0]
    dt = 2e-4
    while h[:n // 2].max() - h[0] > config.oldest_depth and len(times) < 2000:
        band = np.zeros((3, n))
        band[1] = area
        band[1, :-1] += dt * conductance
        band[1, 1:] += dt * conductance
        band[0, 1:] = -dt * conductance
        band[2, :-1] = -dt * conductance
        h = solve_banded((1, 1), band, area * h)
        heights.append(h)
        times.append(times[-1] + dt)
        dt *= 1.03
    if len(times) == 1:
        heights, times = [h, h], [0.0, 1.0]
    table = np.array(heights)
    at = _AGES * times[-1]
    ages = np.array([np.interp(at, times, column) for column in table.T]).T
    # The profile fades to zero at the reach of the crater.
    ages *= np.clip((REACH - RADII) / (0.3 * REACH), 0.0, 1.0) ** 2
    ages = on_lattice(ages, 2.0**-23)
    steepest = 2.0 * np.abs(np.gradient(ages, step, axis=1)).max(axis=1)
    rim = ages.max(axis=1)
    return ProfileTable(_AGES, ages, rim - ages[:, 0], rim, steepest)
