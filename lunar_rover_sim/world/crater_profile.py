"""The radial profile of a crater, from fresh to degraded by diffusion."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import scipy  # its parts when they are used

from lunar_rover_sim.frames import Array
from lunar_rover_sim.world.config import CraterConfig
from lunar_rover_sim.world.grid import on_lattice

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
        h = scipy.linalg.solve_banded((1, 1), band, area * h)
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
