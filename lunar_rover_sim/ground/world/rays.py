"""Bright soil around fresh craters, and rays: narrow sectors in which ejected rocks and soil lie
farther out.

Rays of lunar craters reach several radii and are narrow and irregular. Their number, width and
reach here are choices that look like those of metre- to decametre-sized craters in orbital images.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.ground.world import streams
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.grid import ALBEDO_STEP, on_lattice, part_of
from lunar_rover_sim.ground.world.relief import smoothstep
from lunar_rover_sim.ground.world.spline import Area

F32 = NDArray[np.float32]

FRESH = 0.25            # greatest age of a crater with rays, in lifetimes
RAY_REACH = 6.0         # radii that rays reach
_LEAST_M = 3.0          # least diameter of a crater with rays
_FEWEST, _MOST = 5, 9   # rays of one crater
_WIDTH_RAD = (0.05, 0.14)
_FALL = (1.4, 3.0)      # radii over which rays fade to 1 / e
_HEADINGS = 512


def brighten(albedo: Area, craters: Craters, amount: float) -> None:
    """Brighten the surroundings of fresh craters in an albedo map, fading with age; in place."""
    cell_m = albedo.cell_m
    fresh = np.flatnonzero((craters.age < 0.2) & (craters.diameter_m > 6.0 * cell_m))
    for i in fresh[np.lexsort((craters.key[fresh], -craters.time[fresh]))]:
        radius = 0.5 * craters.diameter_m[i] / cell_m
        x0, y0 = craters.position_m[i] / cell_m
        window = part_of(x0, y0, 3.5 * radius, albedo.first, albedo.values.shape)
        if window is None:
            continue
        dx = (np.arange(window[1].start, window[1].stop) + albedo.first[0] - x0) / radius
        dy = (np.arange(window[0].start, window[0].stop) + albedo.first[1] - y0) / radius
        rho = np.sqrt(dx * dx + (dy * dy)[:, None])
        strength = amount * (1.0 - craters.age[i] / 0.2) ** 2
        fall = np.exp(-0.5 * (np.maximum(rho - 0.8, 0.0) / 0.9) ** 2)
        albedo.values[window] += on_lattice(strength * fall * smoothstep(3.5 - rho),
                                            ALBEDO_STEP).astype(np.float32)


def add_rays(field: Area, craters: Craters, amount: float) -> None:
    """Add the rays of all craters to a field, in place.

    Args:
        amount: What is added at the rim of a fresh crater, where a ray begins. The rays depend on
            the crater's key alone, so that all fields show the same ones.
    """
    cell_m = field.cell_m
    for i in np.flatnonzero((craters.age < FRESH) & (craters.diameter_m > _LEAST_M)):
        radius = 0.5 * craters.diameter_m[i] / cell_m
        x, y = craters.position_m[i] / cell_m
        window = part_of(x, y, RAY_REACH * radius, field.first, field.values.shape)
        if window is None:
            continue
        dx = (np.arange(window[1].start, window[1].stop) + field.first[0] - x) / radius
        dy = (np.arange(window[0].start, window[0].stop) + field.first[1] - y) / radius
        field.values[window] += (np.float32(amount * (1.0 - craters.age[i] / FRESH))
                                 * strength(craters, i, dx, dy[:, None]))


def strength(craters: Craters, i: int | np.integer, dx: NDArray[np.floating],
             dy: NDArray[np.floating]) -> F32:
    """Return the strength of the rays of crater i, about 1 where one begins if it is fresh.

    Args:
        dx, dy: Offsets from its middle in radii; shapes that go together.
    """
    dx, dy = dx.astype(np.float32), dy.astype(np.float32)
    of_heading, fall = _star(int(craters.key[i]))
    rho = np.hypot(dx, dy)
    turn = np.arctan2(dy, dx) * np.float32(0.5 * _HEADINGS / np.pi) + _HEADINGS // 2
    rays = of_heading[turn.astype(np.int32) % _HEADINGS]
    rays *= np.exp(np.minimum((np.float32(1.2) - rho) / fall, np.float32(0.0)))
    rays *= np.clip(rho - np.float32(0.8), 0.0, 1.0)
    rays *= np.clip(np.float32(RAY_REACH) - rho, 0.0, 1.0)
    return rays


def _star(key: int) -> tuple[F32, np.float32]:
    """Return the strength of a crater's rays over the headings from -pi, and their fall."""
    rng = streams.generator(key, 'rays', 0, 0)
    heading = np.linspace(-np.pi, np.pi, _HEADINGS, endpoint=False)
    result = np.zeros(_HEADINGS)
    for middle in rng.uniform(-np.pi, np.pi, int(rng.integers(_FEWEST, _MOST + 1))):
        turn = np.remainder(heading - middle + np.pi, 2.0 * np.pi) - np.pi
        result += np.exp(-0.5 * (turn / rng.uniform(*_WIDTH_RAD)) ** 2)
    return result.astype(np.float32), np.float32(rng.uniform(*_FALL))
