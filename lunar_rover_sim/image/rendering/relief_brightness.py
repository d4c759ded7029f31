"""Residual roughness below drawn relief, by mip level, and a factor that keeps the mean.

Hapke's law with the macroscopic roughness theta of a parameter set holds for ground whose relief
is not drawn. Where a part of the relief is drawn, with slope variance V of both directions, the
rest has

    tan^2 theta_rest = tan^2 theta - (pi / 4) V

since the mean slope of a Gaussian surface is tan theta = sqrt(pi V) / 2. The mean of the drawn
ground still differs from the law: what turns away from the camera should look smaller, and shadows
are in the law too. Both are taken out by a factor, law over mean of what is drawn, which depends
only on the mip level and on the directions of sun and view over the local plane of the grid.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.compiled import vectorised
from lunar_rover_sim.base.fast_math import log2
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.fine_relief import disc_share
from lunar_rover_sim.ground.world.kept_arrays import kept
from lunar_rover_sim.image.illumination import hapke
from lunar_rover_sim.image.illumination.config import ReflectanceConfig
from lunar_rover_sim.image.rendering.relief_tiles import (FINER, ReliefTile, ReliefTiles,
                                                          SLOPE_SCALE)
from lunar_rover_sim.image.rendering.row_math import any_positive, byte, CHUNK, PAGE

# Rises with every change of what `relief_brightness` returns, of tiles or of the law.
_RECIPE = 7
LEVELS = 9              # mip levels of the fine tile; coarser ones are not used
AZIMUTHS, COSINES = 8, 16       # nodes of the factor
# Nodes: tangent of the sun's elevation over the local plane, over that over level ground. Below 1
# light changes faster.
HEIGHTS = (0.25, 0.5, 1.0, 4.0)
LEAST_FACTOR, MOST_FACTOR = (128.0 / 255.0)**2, 8.0     # a factor of 1 has an exact code
LEAST_SCALES = (0.05, 0.0, 0.0, 1.0)
_LEAST_TANGENT = 0.01   # of the sun's elevation
_SAMPLES = 40_000
_COARSE = [max(k - FINER, 0) for k in range(LEVELS)]     # levels of the coarse tile
_NODES = (LEVELS, COSINES, AZIMUTHS, len(HEIGHTS))
_MOST_GAIN = 20.0
_LEAST_SHARE = 0.7      # least brightness of drawn ground before the factor, over the law
_ACROSS = np.array([0.0, 0.97, 0.243])      # direction of a view across the sun
_EDGES = np.array([-0.6, -0.33, -0.2, -0.12, -0.06, -0.02, 0.02, 0.06, 0.12, 0.2, 0.33, 0.6])


@dataclasses.dataclass(frozen=True)
class ReliefBrightness:
    """How ground with drawn relief is lit, by the mip level of the fine tile.

    Attributes:
        scales: (4, 4) coefficients of cubics in the level, constants first, of: tangent of the
            roughness left to the law, half width of the edge of shadows of the coarse and of the
            fine tile (as tangents), gain of lit shares.
        factor: (LEVELS, COSINES, AZIMUTHS, 4) factor on sunlight; nodes are those of `_views` and
            the tangent of the sun over the local plane, `tangent` times HEIGHTS. Its inverse is
            interpolated: it falls to 0 where the sun sets behind relief.
        tangent: That of the sun over level ground.
    """

    scales: NDArray[np.float32]
    factor: NDArray[np.float32]
    tangent: float


def relief_brightness(tiles: ReliefTiles, reflectance: ReflectanceConfig, elevation_rad: float,
                      sun_radius_rad: float) -> ReliefBrightness:
    """Return how tiles are lit by a sun of this elevation and angular radius."""
    tangent = max(math.tan(elevation_rad), _LEAST_TANGENT)
    if tiles.flat:
        return ReliefBrightness(
            _polynomials(_wanted_scales(tiles, hapke.parameter_set(reflectance.ground))),
            np.ones(_NODES, np.float32), tangent)
    return _of_relief(tiles, reflectance, tangent, sun_radius_rad)


def _wanted_scales(tiles: ReliefTiles, ground: hapke.HapkeParameters) -> Array:
    """Return (LEVELS, 4) values of `ReliefBrightness.scales`, with gains of 1."""
    variance = tiles.coarse.slope_variance[_COARSE] + tiles.fine.slope_variance[:LEVELS]
    left = np.sqrt(np.maximum(math.tan(math.radians(ground.theta_deg))**2
                              - 0.25 * math.pi * variance, 0.0))
    return np.column_stack([left, tiles.coarse.spread[_COARSE], tiles.fine.spread[:LEVELS],
                            np.ones(LEVELS)])


@functools.lru_cache(maxsize=2)     # for the next renderer of the same scene
def _of_relief(tiles: ReliefTiles, reflectance: ReflectanceConfig, tangent: float,
               sun_radius_rad: float) -> ReliefBrightness:
    def rows() -> NDArray[np.float32]:
        made = _made(tiles, reflectance, tangent, sun_radius_rad)
        return np.concatenate([made.scales.ravel(), made.factor.ravel()])
    ground = dataclasses.asdict(hapke.parameter_set(reflectance.ground))
    values = kept('relief_brightness', [_RECIPE, tiles.recipe, ground, reflectance.albedo_scale,
                                        tangent, sun_radius_rad], rows)
    return ReliefBrightness(values[:16].reshape(4, 4), values[16:].reshape(_NODES), tangent)


def _made(tiles: ReliefTiles, reflectance: ReflectanceConfig, tangent: float,
          sun_radius_rad: float) -> ReliefBrightness:
    ground = hapke.parameter_set(reflectance.ground)
    rng = np.random.default_rng(0)
    levels = list(range(LEVELS))
    wanted = _wanted_scales(tiles, ground)
    factor = np.empty(_NODES, np.float32)
    samples = [(_sample(tiles, tiles.coarse, _COARSE[k], rng),
                _sample(tiles, tiles.fine, k, rng)) for k in levels]

    def facets(k: int, scales: Array) -> _Facets:
        law = _Law(ground, reflectance.albedo_scale, math.degrees(math.atan(scales[0])))
        return _Facets(law, *samples[k], scales[1:3], sun_radius_rad)

    scales = _values(_polynomials(wanted))
    wanted[:, 3] = [_gain(facets(k, scales[k]), tangent) for k in levels]
    polynomials = _polynomials(wanted)
    scales = _values(polynomials)       # what the rows draw with
    for k in levels:
        for j, sun in enumerate(tangent * np.array(HEIGHTS)):
            factor[k, :, :, j] = _factor(facets(k, scales[k]), sun, float(scales[k, 3]))
    return ReliefBrightness(polynomials, factor, tangent)


def _polynomials(scales: Array) -> NDArray[np.float32]:
    """Return (4, 4) coefficients of cubics in the level that come close to (LEVELS, 4) values."""
    powers = np.arange(LEVELS)[:, None]**np.arange(4.0)
    return np.linalg.lstsq(powers, scales, rcond=None)[0].astype(np.float32)


def _values(polynomials: NDArray[np.float32]) -> Array:
    """Return (LEVELS, 4) values, as `shade_rows.shade` has them."""
    powers = np.arange(LEVELS)[:, None]**np.arange(4.0)
    return np.maximum(powers @ polynomials, LEAST_SCALES)


@dataclasses.dataclass(frozen=True)
class _Law:
    """Hapke's law of the ground, and the roughness that drawn relief leaves to it."""

    ground: hapke.HapkeParameters
    albedo: float
    rest_deg: float

    def far(self, cos_i: ArrayLike, cos_e: ArrayLike, cos_g: ArrayLike) -> Array:
        return hapke.reflectance(cos_i, cos_e, cos_g, self.ground, albedo=self.albedo)

    def drawn(self, slope: Array, tangent: float, view: Array) -> Array:
        """Return the reflectance of (m, 2) slopes to (..., 3) views, as `shade_rows.shade`."""
        sun = np.array([1.0, 0.0, tangent]) / math.hypot(1.0, tangent)
        normal = np.column_stack([-slope, np.ones(len(slope))])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        least = np.clip(view[..., 2:], 0.02, 0.08)
        lift = np.maximum(least - view @ normal.T, 0.0)[..., None]
        normal = normal + lift * view[..., None, :]
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        seen = np.maximum(np.sum(normal * view[..., None, :], axis=-1), 0.02)
        return hapke.reflectance(normal @ sun, seen, (view @ sun)[..., None], self.ground,
                                 albedo=self.albedo, theta_deg=self.rest_deg)


@dataclasses.dataclass(frozen=True)
class _Facets:
    """Samples of a level: slopes and horizons of the coarse and the fine tile, and their law."""

    law: _Law
    coarse: tuple[Array, Array]
    fine: tuple[Array, Array]
    spreads: Array
    sun_radius_rad: float

    @property
    def slope(self) -> Array:
        """Slopes towards the sun and to its left, (m, 2)."""
        return self.coarse[0] + self.fine[0]

    def lit(self, tangent: float) -> Array:
        """Return the share of light that each sample gets, (m,)."""
        width = self.sun_radius_rad * (1.0 + tangent**2)
        return disc_share((tangent - self.coarse[1]) / (width + self.spreads[0])) \
            * disc_share((tangent - self.coarse[0][:, 0] - self.fine[1])
                         / (width + self.spreads[1]))

    def grouped(self, tangent: float, gain: float) -> tuple[Array, Array]:
        """Return the slopes of groups of samples, (g, 2), and the light that each stands for."""
        lit, slope = gained(self.lit(tangent), gain), self.slope
        bins = len(_EDGES) + 1
        index = np.digitize(slope[:, 0], _EDGES) * bins + np.digitize(slope[:, 1], _EDGES)
        share = np.bincount(index, lit, bins * bins)
        some = share > 0.0
        sums = [np.bincount(index, lit * slope[:, k], bins * bins)[some] for k in (0, 1)]
        return np.stack(sums, axis=1) / share[some, None], share[some] / len(lit)


def gained(lit: Array, gain: float) -> Array:
    """Return lit shares with a gain that leaves 0 and 1 as they are."""
    return gain * lit / (1.0 + (gain - 1.0) * lit)


def _gain(facets: _Facets, tangent: float) -> float:
    """Return the gain, at least 1, with which a view across the sun is bright enough."""
    sun = np.array([1.0, 0.0, tangent]) / math.hypot(1.0, tangent)
    wanted = _LEAST_SHARE * float(facets.law.far(sun[2], _ACROSS[2], _ACROSS @ sun))
    light = facets.law.drawn(facets.slope, tangent, _ACROSS)
    lit = facets.lit(tangent)
    low, high = 0.0, math.log(_MOST_GAIN)
    for _ in range(12):
        middle = 0.5 * (low + high)
        if np.mean(light * gained(lit, math.exp(middle))) < wanted:
            low = middle
        else:
            high = middle
    return math.exp(low)


def _sample(tiles: ReliefTiles, tile: ReliefTile, level: int,
            rng: np.random.Generator) -> tuple[Array, Array]:
    """Return slopes and tangents of the horizon at random places of a level.

    (m, 2) towards the sun and to its left, (m,)
    """
    codes = tile.codes[level]
    n = len(codes)
    words = codes.view(np.uint32)[..., 0]   # whole texels are gathered faster
    at = rng.random((2, _SAMPLES)) * n
    whole = at.astype(int)
    part = (at - whole)[..., None]
    texel = np.zeros((_SAMPLES, 3))
    for i in (0, 1):
        for j in (0, 1):
            weight = (part[0] if i else 1.0 - part[0]) * (part[1] if j else 1.0 - part[1])
            corner = words[(whole[0] + i) % n, (whole[1] + j) % n].view(np.uint8)
            texel += weight * corner.reshape(-1, 4)[:, :3]
    slope = (texel[:, :2] - 128.0) * (SLOPE_SCALE / 255.0)
    along = tiles.heading
    return (np.column_stack([slope @ along, slope @ (-along[1], along[0])]),
            tiles.centre + (texel[:, 2] / 127.5 - 1.0) * tiles.half_range)


def _factor(facets: _Facets, tangent: float, gain: float) -> Array:
    """Return (COSINES, AZIMUTHS) of the law over the mean of groups of facets."""
    slope, share = facets.grouped(tangent, gain)
    if not len(slope):
        return np.ones((COSINES, AZIMUTHS))
    # Equal steps of the root of the cosine, and of the sine of half the azimuth.
    cosine, azimuth = np.meshgrid(np.maximum(np.linspace(0.0, 1.0, COSINES)**2, 0.004),
                                  2.0 * np.arcsin(np.linspace(0.0, 1.0, AZIMUTHS)), indexing='ij')
    sine = np.sqrt(1.0 - cosine**2)
    view = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=-1)
    sun = np.array([1.0, 0.0, tangent]) / math.hypot(1.0, tangent)
    drawn = facets.law.drawn(slope, tangent, view) @ share
    law = facets.law.far(sun[2], cosine, view @ sun)
    return np.clip(law / np.maximum(drawn, 1e-9), LEAST_FACTOR, MOST_FACTOR)


_N, _PAGE = CHUNK, PAGE
_ZERO, _HALF, _ONE, _TWO = (np.float32(x) for x in (0.0, 0.5, 1.0, 2.0))
_LEAST, _BRIGHTEST = np.float32(1e-6), np.float32(0.125)
_BYTE2 = np.float32((255.0 / 128.0)**2 / 255.0**2)


@vectorised
def relief_factor(at, near, grid, sun, nodes, result):  # type: ignore[no-untyped-def]
    """Fill in the law over the mean of drawn ground; nodes as in relief_brightness.py.

    Args:
        at, grid: As `ground_band.place` and `grid_rows.light_of_grid` fill them in.
        near: (n,) positive where the factor is wanted.
        sun: Unit vector to it; to it over level ground; tangent of its elevation over such ground
            that it may be compared with.
        nodes: (levels, cosines, azimuths) codes of four heights of the sun, as uint32: roots of
            the inverse, over LEAST_FACTOR.
        result: (n,).
    """
    vx, vy, vz, slope_x, slope_y, detail = at[4], at[5], at[6], grid[0], grid[1], grid[6]
    s, place = np.empty(8 * _PAGE, np.float32), np.empty(2 * _PAGE, np.int32)
    t = np.empty(8 * _PAGE, np.uint32)
    sx, sy, sz, hx, hy, hz, level_ground = sun[0], sun[1], sun[2], sun[3], sun[4], sun[5], sun[6]
    levels, cosines, azimuths = nodes.shape
    flat = nodes.ravel()
    m, a, e = (np.float32(levels - 1), np.float32(cosines - 1), np.float32(azimuths - 1))
    row, layer = np.int32(azimuths), np.int32(azimuths * cosines)
    one, north, deeper = np.uint32(1), np.uint32(azimuths), np.uint32(azimuths * cosines)
    u, v, w, high, out = 0, _PAGE, 2 * _PAGE, 3 * _PAGE, 4 * _PAGE
    cos, sun_cos, phase = 5 * _PAGE, 6 * _PAGE, 7 * _PAGE
    for c in range(len(near) // _N):
        i = c * _N
        if not any_positive(near, i):
            continue
        for j in range(_N):
            x, y = slope_x[i + j], slope_y[i + j]
            s[u + j] = _ONE / np.sqrt(x * x + y * y + _ONE)
        for j in range(_N):
            s[cos + j] = s[u + j] * (vz[i + j] - slope_x[i + j] * vx[i + j]
                                     - slope_y[i + j] * vy[i + j])
        for j in range(_N):
            s[sun_cos + j] = s[u + j] * (sz - slope_x[i + j] * sx - slope_y[i + j] * sy)
        for j in range(_N):
            s[high + j] = hz - slope_x[i + j] * hx - slope_y[i + j] * hy
        for j in range(_N):
            s[phase + j] = vx[i + j] * sx + vy[i + j] * sy + vz[i + j] * sz
        for j in range(_N):
            s[out + j] = min(detail[i + j], m)
        for j in range(_N):
            cosine = min(max(s[cos + j], _ZERO), _ONE)
            other = s[sun_cos + j]
            across = max((_ONE - cosine * cosine) * (_ONE - other * other), _LEAST)
            turn = (s[phase + j] - cosine * other) / np.sqrt(across)
            turn = min(max(turn, -_ONE), _ONE)
            at = e * np.sqrt(_HALF - _HALF * turn)
            up, deep = a * np.sqrt(cosine), s[out + j]
            i0 = min(np.floor(at), e - _ONE)
            j0, k0 = min(np.floor(up), a - _ONE), min(np.floor(deep), m - _ONE)
            s[u + j], s[v + j], s[w + j] = at - i0, up - j0, deep - k0
            place[j] = (np.int32(k0) * layer + np.int32(j0) * row) + np.int32(i0)
        for j in range(_N):
            k = np.uint32(place[j])
            t[j], t[_PAGE + j] = flat[k], flat[k + one]
            t[2 * _PAGE + j], t[3 * _PAGE + j] = flat[k + north], flat[k + north + one]
            k = np.uint32(k + deeper)
            t[4 * _PAGE + j], t[5 * _PAGE + j] = flat[k], flat[k + one]
            t[6 * _PAGE + j], t[7 * _PAGE + j] = flat[k + north], flat[k + north + one]
        # The four lie 1/4, 1/2, 1 and 4 times as high as over level ground.
        for j in range(_N):
            height = log2(max(s[high + j] / level_ground, _LEAST))
            height = height if height < _ZERO else _HALF * height
            s[high + j] = min(max(height, -_TWO), _ONE)
            s[out + j] = _ZERO
        for channel in range(4):
            node, down = np.float32(channel - 2), np.uint32(8 * channel)
            for j in range(_N):
                f, g, d = s[u + j], s[v + j], s[w + j]
                p = byte(t[j] >> down)
                p += f * (byte(t[_PAGE + j] >> down) - p)
                q = byte(t[2 * _PAGE + j] >> down)
                q += f * (byte(t[3 * _PAGE + j] >> down) - q)
                p += g * (q - p)
                q = byte(t[4 * _PAGE + j] >> down)
                q += f * (byte(t[5 * _PAGE + j] >> down) - q)
                z = byte(t[6 * _PAGE + j] >> down)
                z += f * (byte(t[7 * _PAGE + j] >> down) - z)
                q += g * (z - q)
                p += d * (q - p)
                s[out + j] += max(_ONE - abs(s[high + j] - node), _ZERO) * p * p
        for j in range(_N):
            result[i + j] = _ONE / max(_BYTE2 * s[out + j], _BRIGHTEST)
