"""Drawing craters into heights, oldest first, and their bright soil into an albedo map."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
import scipy  # its parts when they are used

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world import streams
from lunar_rover_sim.ground.world.config import CraterConfig
from lunar_rover_sim.ground.world.craters import Craters, profile_table, RADII, REACH
from lunar_rover_sim.ground.world.grid import ALBEDO_STEP, on_lattice, part_of
from lunar_rover_sim.ground.world.relief import smoothstep
from lunar_rover_sim.ground.world.spline import Area

COARSER = 4             # the lattice on which planes are fitted, in cells of the heights
# A crater erases the relief up to the first radius and leaves it unchanged from the second on.
_ERASED, _UNTOUCHED = 0.85, 1.45
_FITTED = 1.2           # radii, of the square to which a plane is fitted
# Below this diameter [cells] the ground under a crater is smooth anyway.
FLATTENED_CELLS = 10.0   # diameter
_PLANE_STEP_M = 2.0**-20  # lattice of the plane's height, and of its rise over a radius


def plane_margin_m(largest_m: Any) -> Any:
    """Return how far beyond an area craters and ground decide its planes.

    The plane of a crater is fitted where those of the next larger band lie, and so on: 0.85
    diameters from the middle to a corner, `REACH` radii of the larger one, each band twice the
    other.
    """
    return 2.0 * (0.85 + 0.5 * REACH) * largest_m


def stamp(ground: Area, craters: Craters, config: CraterConfig,
          coarse: Area | None = None) -> None:
    """Draw craters into heights [m], in place, in order of time.

    Within its rim a crater erases the previous relief: the ground is drawn towards its best-fit
    plane, which keeps the large-scale slope, and the profile for its age is added. The older the
    crater, the less of the relief it erases, since new relief has formed. The plane is that of the
    ground with all craters of twice the size or more.

    Args:
        ground: To draw into.
        craters: In the frame of the site.
        config: Of their profiles.
        coarse: The ground before craters on a lattice `COARSER` times as wide, with a margin, see
            `plane_margin_m`; it is changed. By default it is `ground`, smoothed.
    """
    low = np.array(ground.first) * ground.cell_m
    high = low + (np.array(ground.values.shape[::-1]) - 1) * ground.cell_m
    beyond = np.maximum(low - craters.position_m, craters.position_m - high).max(axis=1,
                                                                                 initial=-np.inf)
    # Those that decide planes within it.
    craters = craters.select(beyond <= plane_margin_m(2.0 * craters.diameter_m))
    order = np.lexsort((craters.key, -craters.time))
    craters = craters.select(order)
    if coarse is None:
        smooth = ground.values
        for _ in range(2):
            smooth = scipy.ndimage.uniform_filter(smooth, COARSER + 1, mode='nearest')
        first = [-(-f // COARSER) for f in ground.first]
        start = [COARSER * c - f for c, f in zip(first, ground.first)]
        coarse = Area(smooth[start[1]::COARSER, start[0]::COARSER].copy(),
                      (first[0], first[1]), COARSER * ground.cell_m)
    # Two to four lobes with random phases shape the outline; their power falls with the order.
    drawn = streams.normals(craters.key, 'outline', 6)
    lobes = np.asarray((drawn[:, :3] + 1j * drawn[:, 3:])
                       * (config.irregularity * np.array([0.75, 0.5, 0.43])), np.complex128)
    planes = _planes(coarse, ground.cell_m, craters, config, lobes)
    for i in range(len(craters)):
        _stamp_one(ground, craters, i, config, lobes[i], planes[i])


def _planes(coarse: Area, cell_m: float, craters: Craters, config: CraterConfig,
            lobes: NDArray[np.complex128]) -> Array:
    """Return middle and rises of the plane of each crater, (m, 3); NaN where none is fitted."""
    planes = np.full((len(craters), 3), np.nan)
    large = craters.diameter_m > FLATTENED_CELLS * cell_m
    _, band = np.frexp(craters.diameter_m)      # the power of two above it
    bands = np.unique(band[large])[::-1]
    for number in bands:
        here = np.flatnonzero((band == number) & large).tolist()
        for i in here:
            planes[i] = _plane(coarse, craters, i)
        if number > bands[-1]:
            for i in here:
                _stamp_one(coarse, craters, i, config, lobes[i], planes[i])
    return planes


def _plane(coarse: Area, craters: Craters, i: int) -> Array:
    """Return the least-squares plane of the ground around a crater: its middle, and rises."""
    radius = 0.5 * craters.diameter_m[i] / coarse.cell_m
    x0, y0 = craters.position_m[i] / coarse.cell_m
    part = part_of(x0, y0, _FITTED * radius, coarse.first, coarse.values.shape)
    if part is None or min(s.stop - s.start for s in part) < 2:
        return np.full(3, np.nan)
    rows, columns = part
    # A copy, so that no layout of memory decides in which order it is summed.
    core = np.array(coarse.values[rows, columns], np.float64)
    x = (np.arange(columns.start, columns.stop) + coarse.first[0] - x0) / radius
    y = (np.arange(rows.start, rows.stop) + coarse.first[1] - y0) / radius
    mx, my = 0.5 * (x[0] + x[-1]), 0.5 * (y[0] + y[-1])
    from_mx, from_my = x - mx, y - my
    by_column, by_row = core.sum(axis=0), core.sum(axis=1)
    sx = (by_column * from_mx).sum() / ((from_mx * from_mx).sum() * len(y))
    sy = (by_row * from_my).sum() / ((from_my * from_my).sum() * len(x))
    return on_lattice([by_column.sum() / core.size - sx * mx - sy * my, sx, sy], _PLANE_STEP_M)


def _stamp_one(ground: Area, craters: Craters, i: int, config: CraterConfig,
               lobes: NDArray[np.complex128], plane: Array) -> None:
    """Draw one crater."""
    radius = 0.5 * craters.diameter_m[i] / ground.cell_m      # in cells
    x0, y0 = craters.position_m[i] / ground.cell_m
    part = part_of(x0, y0, REACH * radius, ground.first, ground.values.shape)
    if part is None:
        return
    rows, columns = part
    # Places count from the crater, so that all windows round alike.
    dx = (np.arange(columns.start, columns.stop) + ground.first[0] - x0).astype(np.float32)
    dy = (np.arange(rows.start, rows.stop) + ground.first[1] - y0).astype(np.float32)
    dx, dy = dx / np.float32(radius), dy / np.float32(radius)
    rho = np.sqrt(dx * dx + (dy * dy)[:, None])
    shaped = _irregular(rho, dx, dy, lobes) if config.irregularity else rho
    patch = ground.values[rows, columns]
    if np.isfinite(plane[0]):
        _flatten(patch, dx, dy, shaped, plane, 1.0 - 0.7 * craters.age[i])
    per_radius = np.float32(1.0 / RADII[1])
    index = np.minimum(shaped * per_radius, np.float32(len(RADII) - 2))
    lower = index.astype(np.int32)
    index -= lower
    profile = profile_table(config).at(craters.age[i]) * craters.diameter_m[i]
    profile = profile.astype(np.float32)
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


def _flatten(patch: NDArray, dx: NDArray, dy: NDArray, rho: NDArray, plane: Array,
             amount: float) -> None:
    """Draw the patch towards a plane within the rim, by a share `amount`; in place."""
    near_x, near_y = np.flatnonzero(np.abs(dx) < 1.8), np.flatnonzero(np.abs(dy) < 1.8)
    if not (len(near_x) and len(near_y)):
        return
    columns = slice(int(near_x[0]), int(near_x[-1]) + 1)
    rows = slice(int(near_y[0]), int(near_y[-1]) + 1)
    middle, sx, sy = plane.astype(np.float32)
    ground, x, y = patch[rows, columns], dx[columns], dy[rows]
    flat = (middle + sx * x) + (sy * y)[:, None]
    t = (_UNTOUCHED - rho[rows, columns]) / (_UNTOUCHED - _ERASED)
    np.minimum(t, np.float32(1.0), out=t)
    np.maximum(t, np.float32(0.0), out=t)
    ground += np.float32(amount) * t * t * (3.0 - 2.0 * t) * (flat - ground)


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
