"""Drawing craters into a height field and into an albedo map, oldest first.

Rays of fresh craters are narrow sectors in which ejected rocks and bright soil lie farther out.
Those of lunar craters reach several radii and are narrow and irregular. Their number, width and
reach here are choices that look like those of metre- to decametre-sized craters in orbital images.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.ground.world.config import CraterConfig
from lunar_rover_sim.ground.world.craters import Craters, profile_table, RADII, REACH
from lunar_rover_sim.ground.world.grid import ALBEDO_STEP, on_lattice, window_of
from lunar_rover_sim.ground.world.relief import smoothstep

# A crater erases the relief up to the first radius and leaves it unchanged from the second on.
_ERASED, _UNTOUCHED = 0.85, 1.45
# Below this radius [cells] the ground under a crater is smooth anyway.
_LEAST_FLATTENED = 5.0
_PLANE_STEP_M = 2.0**-20  # lattice of the plane's height, and of its rise over a radius


def stamp(heights: NDArray[np.float32], cell_m: float, craters: Craters, config: CraterConfig,
          rng: np.random.Generator) -> None:
    """Draw craters into heights [m] (row 0 south, centred on the origin), in order of time.

    Within its rim a crater erases the previous relief: the ground is drawn towards its best-fit
    plane, which keeps the large-scale slope, and the profile for its age is added. The older the
    crater, the less of the relief it erases, since new relief has formed.
    """
    table = profile_table(config)
    order = np.argsort(-craters.time, kind='stable')
    # Two to four lobes with random phases shape the outline; their power falls with the order.
    weights = config.irregularity * np.array([0.75, 0.5, 0.43])
    lobes = (rng.standard_normal((len(craters), 3)) + 1j * rng.standard_normal((len(craters), 3))
             ) * weights
    half = 0.5 * (heights.shape[0] - 1)
    per_radius = np.float32(1.0 / RADII[1])
    for i in order:
        radius = 0.5 * craters.diameter_m[i] / cell_m  # in cells
        x0, y0 = craters.position_m[i] / cell_m + half
        window = window_of(x0, y0, REACH * radius, heights.shape[0])
        if window is None:
            continue
        rows, columns = window
        dx = (np.arange(columns.start, columns.stop, dtype=np.float32) - np.float32(x0))
        dy = (np.arange(rows.start, rows.stop, dtype=np.float32) - np.float32(y0))
        dx, dy = dx / np.float32(radius), dy / np.float32(radius)
        rho = np.sqrt(dx * dx + (dy * dy)[:, None])
        shaped = _irregular(rho, dx, dy, lobes[i]) if config.irregularity else rho
        patch = heights[rows, columns]
        if radius > _LEAST_FLATTENED:
            _flatten(patch, dx, dy, shaped, 1.0 - 0.7 * craters.age[i])
        index = np.minimum(shaped * per_radius, np.float32(len(RADII) - 2))
        lower = index.astype(np.int32)
        index -= lower
        profile = (table.at(craters.age[i]) * craters.diameter_m[i]).astype(np.float32)
        patch += profile[lower] + index * (profile[1:] - profile[:-1])[lower]


def _irregular(rho: NDArray, dx: NDArray, dy: NDArray, lobes: NDArray) -> NDArray:
    """Return the radii relative to the lobed outline."""
    inverse = 1.0 / np.maximum(rho, np.float32(1e-3))
    c, s = dx * inverse, dy[:, None] * inverse
    c2, s2 = c * c - s * s, 2.0 * c * s
    a, b, d = (np.complex64(lobe) for lobe in lobes)
    lobed = a.real * c2 + a.imag * s2
    lobed += b.real * (c2 * c - s2 * s) + b.imag * (s2 * c + c2 * s)
    lobed += d.real * (c2 * c2 - s2 * s2) + d.imag * (2.0 * c2 * s2)
    # Not np.clip, which takes longer to look at its bounds than at most craters.
    np.minimum(lobed, np.float32(0.3), out=lobed)
    np.maximum(lobed, np.float32(-0.3), out=lobed)
    lobed += np.float32(1.0)
    lobed *= rho
    return lobed


def _flatten(patch: NDArray, dx: NDArray, dy: NDArray, rho: NDArray, amount: float) -> None:
    """Draw the patch towards its best-fit plane within the rim, by a share `amount`; in place."""
    inner_x, inner_y = np.abs(dx) < 1.2, np.abs(dy) < 1.2
    if inner_x.sum() < 2 or inner_y.sum() < 2:
        return
    columns = slice(int(inner_x.argmax()), len(dx) - int(inner_x[::-1].argmax()))
    rows = slice(int(inner_y.argmax()), len(dy) - int(inner_y[::-1].argmax()))
    core, x, y = patch[rows, columns], dx[columns], dy[rows]
    mx, my = 0.5 * (float(x[0]) + float(x[-1])), 0.5 * (float(y[0]) + float(y[-1]))
    from_mx, from_my = x.astype(np.float64) - mx, y.astype(np.float64) - my
    by_column, by_row = core.sum(axis=0, dtype=np.float64), core.sum(axis=1, dtype=np.float64)
    sx = (by_column * from_mx).sum() / ((from_mx * from_mx).sum() * len(y))
    sy = (by_row * from_my).sum() / ((from_my * from_my).sum() * len(x))
    fit = np.array([by_column.sum() / core.size - sx * mx - sy * my, sx, sy])
    middle, sx, sy = on_lattice(fit, _PLANE_STEP_M).astype(np.float32)
    outer_x, outer_y = np.abs(dx) < 1.8, np.abs(dy) < 1.8
    columns = slice(int(outer_x.argmax()), len(dx) - int(outer_x[::-1].argmax()))
    rows = slice(int(outer_y.argmax()), len(dy) - int(outer_y[::-1].argmax()))
    ground, x, y = patch[rows, columns], dx[columns], dy[rows]
    plane = (middle + sx * x) + (sy * y)[:, None]
    t = (_UNTOUCHED - rho[rows, columns]) / (_UNTOUCHED - _ERASED)
    np.minimum(t, np.float32(1.0), out=t)
    np.maximum(t, np.float32(0.0), out=t)
    ground += np.float32(amount) * t * t * (3.0 - 2.0 * t) * (plane - ground)


def brighten(albedo: NDArray[np.float32], cell_m: float, craters: Craters,
             amount: float) -> None:
    """Brighten the surroundings of fresh craters in an albedo map, fading with age."""
    half = 0.5 * (albedo.shape[0] - 1)
    fresh = np.flatnonzero((craters.age < 0.2) & (craters.diameter_m > 6.0 * cell_m))
    for i in fresh[np.argsort(-craters.time[fresh], kind='stable')]:
        radius = 0.5 * craters.diameter_m[i] / cell_m
        x0, y0 = craters.position_m[i] / cell_m + half
        window = window_of(x0, y0, 3.5 * radius, albedo.shape[0])
        if window is None:
            continue
        dx = (np.arange(window[1].start, window[1].stop) - x0) / radius
        dy = (np.arange(window[0].start, window[0].stop) - y0) / radius
        rho = np.sqrt(dx * dx + (dy * dy)[:, None])
        strength = amount * (1.0 - craters.age[i] / 0.2) ** 2
        fall = np.exp(-0.5 * (np.maximum(rho - 0.8, 0.0) / 0.9) ** 2)
        albedo[window] += on_lattice(strength * fall * smoothstep(3.5 - rho),
                                     ALBEDO_STEP).astype(np.float32)


F32 = NDArray[np.float32]

FRESH = 0.25            # greatest age of a crater with rays, in lifetimes
RAY_REACH = 6.0         # radii that rays reach
_LEAST_M = 3.0          # least diameter of a crater with rays
_FEWEST, _MOST = 5, 9   # rays of one crater
_WIDTH_RAD = (0.05, 0.14)
_FALL = (1.4, 3.0)      # radii over which rays fade to 1 / e
_HEADINGS = 512


def add_rays(field: NDArray[np.floating], cell_m: float, craters: Craters, amount: float) -> None:
    """Add the rays of all craters to an (n, n) field centred on the origin, in place.

    Args:
        cell_m: Distance of its samples.
        amount: What is added at the rim of a fresh crater, where a ray begins. The rays depend on
            the crater alone, so that all fields show the same ones.
    """
    n = len(field)
    for i in np.flatnonzero((craters.age < FRESH) & (craters.diameter_m > _LEAST_M)):
        radius = 0.5 * craters.diameter_m[i] / cell_m
        x, y = craters.position_m[i] / cell_m + 0.5 * (n - 1)
        window = window_of(x, y, RAY_REACH * radius, n)
        if window is None:
            continue
        dx = ((np.arange(window[1].start, window[1].stop) - x) / radius).astype(np.float32)
        dy = ((np.arange(window[0].start, window[0].stop) - y) / radius).astype(np.float32)
        dy = dy[:, None]
        strength, fall = _star(craters.position_m[i])
        rho = np.hypot(dx, dy)
        turn = np.arctan2(dy, dx) * np.float32(0.5 * _HEADINGS / np.pi) + _HEADINGS // 2
        rays = strength[turn.astype(np.int32) % _HEADINGS]
        rays *= np.exp(np.minimum((np.float32(1.2) - rho) / fall, np.float32(0.0)))
        rays *= np.clip(rho - np.float32(0.8), 0.0, 1.0)
        rays *= np.clip(np.float32(RAY_REACH) - rho, 0.0, 1.0)
        field[window] += np.float32(amount * (1.0 - craters.age[i] / FRESH)) * rays


def _star(position_m: NDArray[np.float64]) -> tuple[F32, np.float32]:
    """Return the strength of a crater's rays over the headings from -pi, and their fall."""
    x, y = np.rint(1e3 * position_m).astype(np.int64)
    rng = np.random.default_rng([int(x) & 0xFFFFFFFF, int(y) & 0xFFFFFFFF, 5])
    heading = np.linspace(-np.pi, np.pi, _HEADINGS, endpoint=False)
    strength = np.zeros(_HEADINGS)
    for middle in rng.uniform(-np.pi, np.pi, int(rng.integers(_FEWEST, _MOST + 1))):
        turn = np.remainder(heading - middle + np.pi, 2.0 * np.pi) - np.pi
        strength += np.exp(-0.5 * (turn / rng.uniform(*_WIDTH_RAD)) ** 2)
    return strength.astype(np.float32), np.float32(rng.uniform(*_FALL))
