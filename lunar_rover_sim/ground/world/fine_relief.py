"""Relief below the grid: periodic tiles of millimetre relief, pits and pebbles.

A tile holds slope and, towards one sun azimuth, the tangent of the horizon over its own mean
plane. Its salience says where pits and pebbles are, and how high they stand over what is around
them: where two copies of a tile meet, the more salient one is drawn, so that these stay whole. It
does not depend on the sun, since the shape of the ground follows from it. What coarser mip levels
average away is known as the variance of the slope and the deviation of the horizon of each level.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.ground.world.config import CraterConfig
from lunar_rover_sim.ground.world.craters import profile_table, RADII, REACH

F32 = NDArray[np.float32]

RECIPE = 4              # rises with every change of what `relief` or `rises` returns
SPREAD = 1.8            # a uniform distribution has 3**0.5
_SALIENCE_TEXELS = 5    # over which salience is smoothed
_RISE_TEXELS = 128      # as far as `rises` looks
# Fresh craters in weak soil are 0.1 to 0.2 diameters deep (Sun, Yue and Di, Icarus 309, 2018).
_PITS = CraterConfig(fresh_depth=0.15, fresh_rim=0.03)


@dataclasses.dataclass(frozen=True)
class TileRecipe:
    """The recipe of a tile.

    Attributes:
        n: Texels along a side.
        period_m: Side length [m].
        rms_slope: Of its fractal relief, between wavelengths of two texels and `longest_m`.
        pits: Share of the area under craters, with their diameters [m].
        pebbles: Share of the area under stones, with their diameters [m].
    """

    n: int
    period_m: float
    rms_slope: float
    longest_m: float
    hurst: float
    pit_cover: float
    pit_m: tuple[float, float]
    pebble_cover: float
    pebble_m: tuple[float, float]


def relief(recipe: TileRecipe, rng: np.random.Generator) -> F32:
    """Return (n, n) float32 periodic heights [m]."""
    n, texel = recipe.n, recipe.period_m / recipe.n
    height = _fractal(recipe, rng)
    if recipe.pit_cover > 0.0:
        for x, y, d in _population(recipe.pit_cover, recipe.pit_m, recipe.period_m, rng):
            _pit(height, texel, x, y, d, float(rng.random()))
    if recipe.pebble_cover > 0.0:
        top = np.zeros((n, n), np.float32)
        for x, y, d in _population(recipe.pebble_cover, recipe.pebble_m, recipe.period_m, rng):
            _pebble(top, texel, x, y, d, rng)
        height += top
    return height - height.mean()


def slopes(height: F32, texel_m: float) -> F32:
    """Return (n, n, 2) slopes dz/dx, dz/dy of periodic heights."""
    result = np.empty((*height.shape, 2), np.float32)
    for k, axis in enumerate((1, 0)):
        np.subtract(np.roll(height, -1, axis), np.roll(height, 1, axis), out=result[..., k])
    result *= np.float32(0.5 / texel_m)
    return result


def rises(height: F32, texel_m: float, over_m: float = 0.0) -> F32:
    """Return (n, n) bounds of the slope at which periodic heights rise in any direction.

    No line that starts `over_m` above a texel and is steeper meets the heights, as far as
    `_RISE_TEXELS` texels away. The bound is at most twice too high.
    """
    padded = np.pad(height, _RISE_TEXELS, mode='wrap')
    highest = cv2.dilate(padded, np.ones((3, 3), np.uint8))
    floor = padded + np.float32(over_m)
    result = np.maximum((highest - floor) / np.float32(texel_m), 0.0)
    reach = 1
    while reach < _RISE_TEXELS:     # what is between `reach` and twice that away
        highest = cv2.dilate(highest, np.ones((2 * reach + 1,) * 2, np.uint8))
        np.maximum(result, (highest - floor) / np.float32(reach * texel_m), out=result)
        reach *= 2
    inner = slice(_RISE_TEXELS, -_RISE_TEXELS)
    return np.ascontiguousarray(result[inner, inner], np.float32)


def horizon(height: F32, texel_m: float, azimuth_rad: float, tangents: NDArray[np.float64]) -> F32:
    """Return the (n, n) tangent of the horizon of periodic heights towards an azimuth.

    Values are clipped to the range of `tangents` (increasing), between which they interpolate.
    """
    sx, sy = np.cos(azimuth_rad), np.sin(azimuth_rad)
    swap = abs(sx) > abs(sy)
    along, across = (sx, sy) if swap else (sy, sx)
    z = height.T if swap else height
    z = z[::-1] if along < 0.0 else z
    z = np.ascontiguousarray(z[:, ::-1] if across < 0.0 else z)
    n = z.shape[0]
    z = np.hstack([z, z, z[:, :1]])     # periodic
    shear = abs(across) / abs(along)
    drop = (texel_m * np.hypot(1.0, shear) * tangents).astype(np.float32)[:, None]
    current = np.full((len(tangents), n), -1e6, np.float32)
    out = np.empty((n, n), np.float32)
    lift = np.empty_like(current)
    step = np.float32(tangents[1] - tangents[0])
    columns = np.arange(n)
    for row in range(n + n // 4, -1, -1):
        # Line j lies at column j + shift.
        shift = shear * row
        whole, fraction = int(np.floor(shift)) % n, np.float32(shift - np.floor(shift))
        ground = z[row % n, whole:whole + n]
        ground = ground + fraction * (z[row % n, whole + 1:whole + n + 1] - ground)
        current -= drop
        if row < n:
            np.subtract(ground, current, out=lift)  # increases with the tangent
            dark = np.sum(lift < 0.0, axis=0, dtype=np.uint8)   # faster than whole words
            k = np.clip(dark, 1, len(tangents) - 1).astype(int)
            high = k * n + columns
            low, high = lift.take(high - n), lift.take(high)
            # Extrapolate the zero from below, where distant relief limits the view.
            before = lift.take(np.maximum(k - 2, 0) * n + columns)
            rise = np.where(dark > 1, low - before, high - low)
            part = np.minimum(np.maximum(-low / np.maximum(rise, 1e-9), 0.0), 1.0)
            tangent = np.float32(tangents[0]) + step * (k - 1 + part)
            # Back from lines to columns.
            tangent = tangent + fraction * (np.append(tangent[-1:], tangent[:-1]) - tangent)
            out[row, whole:], out[row, :whole] = tangent[:n - whole], tangent[n - whole:]
        np.maximum(current, ground, out=current)
    out = out[::-1] if along < 0.0 else out
    out = out[:, ::-1] if across < 0.0 else out
    return np.ascontiguousarray(out.T if swap else out)


@dataclasses.dataclass(frozen=True)
class TileLevels:
    """The mip levels of a tile, the finest first.

    Attributes:
        codes: RGBA8 of each level, (n, n, 4): slope / scale + 1/2, horizon in its range, salience.
        slope_variance: (levels,) of both slopes together.
        spread: (levels,) half width of the edge of shadows, as a tangent: `SPREAD` times the RMS
            of the tangent of the horizon within a texel.
    """

    codes: list[NDArray[np.uint8]]
    slope_variance: NDArray[np.float64]
    spread: NDArray[np.float64]


def mip_levels(slope: F32, tangent: F32, rise: F32, slope_scale: float, centre: float,
               half_range: float) -> TileLevels:
    """Return the levels of a tile, for (n, n, 2) slopes and (n, n) tangents of the horizon.

    Args:
        rise: (n, n) as `rises` has it, for the salience.
        centre: Tangent of the sun's elevation.
        half_range: Of the horizon around it. The horizon of a coarser level is its mean, moved so
            that as much of level ground is lit as on the finest one, by half a spread at most: few
            shadows would move it to just below the sun, and slopes that turn away from the sun
            would be dark.
    """
    channels = [slope, tangent, salience(slope, rise)]
    square, lit = float(np.mean(tangent * tangent)), float(np.mean(tangent < centre))
    codes, variance, spreads = [], [], []
    for level in range(int(np.log2(len(tangent))) + 1):
        if level:
            channels = [_halved(channel) for channel in channels]
        slope, tangent, salient = channels
        spread = SPREAD * max(square - float(np.mean(tangent * tangent)), 0.0)**0.5
        shift = _shift(tangent, centre, spread, lit) if level else 0.0
        code = np.empty((*tangent.shape, 4), np.uint8)
        code[..., :2] = _coded(slope, 255.0 / slope_scale, 128.0)
        code[..., 2] = _coded(tangent, 127.5 / half_range,
                              127.5 * (1.0 - (centre - shift) / half_range))
        code[..., 3] = _coded(salient, 255.0, 0.0)
        codes.append(code)
        variance.append(2.0 * float(np.mean(slope * slope)))
        spreads.append(spread)
    return TileLevels(codes, np.array(variance), np.array(spreads))


def _shift(tangent: F32, sun: float, spread: float, lit: float) -> float:
    """Return what to add to horizons so that this share of the ground is lit, by bisection.

    It is at most half of `spread`.
    """
    above = sun - tangent.ravel()[::max(tangent.size // 20_000, 1)]
    low, high = -0.5 * spread, 0.5 * spread
    for _ in range(8):
        middle = 0.5 * (low + high)
        if np.mean(disc_share((above - middle) / max(spread, 1e-6))) > lit:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high) if spread > 1e-6 else 0.0


def disc_share(angle: NDArray[Any]) -> NDArray[Any]:
    """Return the visible share of a disc whose centre lies this many radii above an edge.

    The same as `disc` in shaders/common.glsl; its error is below 0.01.
    """
    x = np.clip(angle, -1.0, 1.0)
    return np.asarray(0.5 + x * (0.6366 - 0.1366 * x * x))


def salience(slope: F32, rise: F32) -> F32:
    """Return (n, n) values from 0 to 1 that are high on pits and pebbles and close to them."""
    energy = np.square(slope[..., 0]) + np.square(slope[..., 1])
    energy += np.square(rise)
    edge = 3 * _SALIENCE_TEXELS
    padded = np.pad(energy, edge, mode='wrap')
    smooth = cv2.GaussianBlur(padded, (0, 0), _SALIENCE_TEXELS)[edge:-edge, edge:-edge]
    return np.asarray(smooth / (smooth + max(float(np.median(smooth)), 1e-9)), np.float32)


def _halved(values: F32) -> F32:
    size = (values.shape[1] // 2, values.shape[0] // 2)
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)


def _coded(values: F32, factor: float, offset: float) -> NDArray[np.uint8]:
    """Return factor values + offset, rounded, within 0 to 255."""
    coded = cv2.addWeighted(values, factor, values, 0.0, offset, dtype=cv2.CV_8U)
    return np.asarray(coded, np.uint8).reshape(values.shape)


def _fractal(recipe: TileRecipe, rng: np.random.Generator) -> F32:
    """Return self-affine relief: power of the height ~ k^(-2 - 2 hurst) in two dimensions."""
    n = recipe.n
    frequency = np.fft.fftfreq(n, recipe.period_m / n).astype(np.float32)
    square = frequency[:, None]**2 + frequency[None, :n // 2 + 1]**2
    square[0, 0] = 1.0
    amplitude = square**np.float32(-0.5 - 0.5 * recipe.hurst)
    # The spectrum falls softly at the long end, where the relief of the grid takes over.
    soft = (square * np.float32(recipe.longest_m**2))**2
    amplitude *= soft / (1.0 + soft)
    amplitude[0, 0] = 0.0
    # The spectrum of white noise is white noise: draw it there.
    noise = rng.standard_normal((n, n // 2 + 1, 2), dtype=np.float32).view(np.complex64)[..., 0]
    noise *= amplitude
    height = np.fft.irfft2(noise, s=(n, n)).astype(np.float32)
    gradient = slopes(height, recipe.period_m / n)
    return height * np.float32(recipe.rms_slope * n / np.linalg.norm(gradient.ravel()))


def _population(cover: float, span_m: tuple[float, float], period_m: float,
                rng: np.random.Generator) -> NDArray[np.float64]:
    """Return (m, 3) x, y, diameter [m] of a power law N(>D) ~ D^-2.4, largest first."""
    low, high = span_m
    q = 2.4
    mean_area = np.pi / 4 * q / (q - 2.0) * (low**(2.0 - q) - high**(2.0 - q)) \
        / (low**-q - high**-q)
    count = int(cover * period_m**2 / mean_area)
    u = rng.random(count)
    size = (low**-q - u * (low**-q - high**-q))**(-1.0 / q)
    size = np.sort(size)[::-1]
    return np.column_stack([rng.random((count, 2)) * period_m, size])


def _window(n: int, texel: float, x: float, y: float, radius: float) -> tuple[Any, F32, F32]:
    """Return the index of the texels around a place, and their distances from it [m]."""
    cx, cy = x / texel, y / texel
    reach = int(np.ceil(radius / texel)) + 1
    left, low, side = int(cx) - reach, int(cy) - reach, 2 * reach + 2
    ix, iy = np.arange(left, left + side), np.arange(low, low + side)
    dx = ((ix - cx) * texel).astype(np.float32)
    dy = ((iy - cy) * texel).astype(np.float32)
    if min(left, low) >= 0 and max(left, low) + side <= n:
        at: Any = slice(low, low + side), slice(left, left + side)     # a faster index
    else:
        at = iy[:, None] % n, ix % n
    return at, dx[None, :], dy[:, None]


def _pit(height: F32, texel: float, x: float, y: float, diameter: float, age: float) -> None:
    """Add a small crater, as `profile_table` has it at an age [lifetimes].

    In equilibrium ages are uniform (Fassett and Thomson, J. Geophys. Res. Planets 119, 2014): a
    tenth have a crisp rim, half are shallow bowls without one.
    """
    radius = 0.5 * diameter
    at, dx, dy = _window(height.shape[0], texel, x, y, REACH * radius)
    profile = profile_table(_PITS).at(age)
    height[at] += diameter * np.interp(np.hypot(dx, dy) / radius, RADII, profile)


def _pebble(top: F32, texel: float, x: float, y: float, diameter: float,
            rng: np.random.Generator) -> None:
    """Add a pebble: a rounded stone, partly buried, from which planes have cut flakes."""
    radius = 0.5 * diameter
    at, dx, dy = _window(top.shape[0], texel, x, y, radius)
    turn = rng.uniform(0.0, 2.0 * np.pi)
    flat = rng.uniform(0.6, 1.0)
    u = (np.cos(turn) * dx + np.sin(turn) * dy) / radius
    v = (-np.sin(turn) * dx + np.cos(turn) * dy) / (flat * radius)
    # A superellipsoid has steep flanks and a broad top: its shadow is as broad as itself.
    power = rng.uniform(2.4, 4.0)
    inside = np.maximum(1.0 - np.abs(u)**power - np.abs(v)**power, 0.0)
    crown = rng.uniform(0.3, 0.65) * diameter * flat**0.5
    height = crown * inside**(1.0 / power)
    sides = int(rng.integers(3, 7))
    angle = 2.0 * np.pi * (np.arange(sides) + rng.uniform(-0.4, 0.4, sides)) / sides
    # Cuts begin far enough out to leave a blunt top, whose shadow is blunt too.
    steep = crown * rng.uniform(0.2, 3.0, sides)
    edge = crown * rng.uniform(0.85, 1.0, sides) + steep * rng.uniform(0.35, 0.8, sides)
    angle, steep, edge = (side[:, None, None] for side in (angle, steep, edge))
    cuts = edge - steep * (np.cos(angle) * u + np.sin(angle) * v)
    height = np.minimum(height, cuts.min(axis=0))
    top[at] = np.maximum(top[at], height)
