"""The light of the rover's lamp on pixels of the ground, with its shadow map."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.rendering.row_math import shape_at, shape_share

_ZERO, _HALF, _ONE = (np.float32(x) for x in (0.0, 0.5, 1.0))
_LEAST, _GRAZING, _SLACK, _OFF = (np.float32(x) for x in (1e-6, 0.04, 0.004, 0.01))
_COSINE, _RISE, _STEEPEST, _FLAT = (np.float32(x) for x in (1e-3, 0.01, 1e-4, 0.02))
_EDGE = np.float32(4e-4)                # height over which a shadow of relief sets in [m]
_TEXEL = np.float32(0.003125)           # of the shape of the relief [m]
_STEPS = 20


class LampLight(NamedTuple):
    """The lamp in one pose, for `lamp_on`.

    Attributes:
        T_world_lamp: (4, 4).
        beam: Peak intensity [W/sr], exponent of the cosine, angle of a pixel of the map.
        clip, shadow: As there.
    """

    T_world_lamp: Array
    beam: tuple[float, float, float]
    clip: NDArray[np.float32]
    shadow: NDArray[np.float32]

    def numbers(self, camera: Array) -> NDArray[np.float32]:
        """Return (9,) `lamp` there; camera: its world position [m]."""
        place = self.T_world_lamp[:3, 3] - [0.0, 0.0, camera[2]]
        return np.array([*place, *self.T_world_lamp[:3, 2], *self.beam], np.float32)


@compiled
def _over_relief(x, y, rise, tx, ty, shape, scale, highest, share):  # type: ignore[no-untyped-def]
    """Return the share of the lamp's light that passes over the relief.

    Steps towards it are as long as the slopes around a point allow.
    """
    rise = max(rise, _RISE)
    flat = max(np.sqrt(tx * tx + ty * ty), _LEAST)
    tx, ty = tx / flat, ty / flat
    tangent = rise / np.sqrt(max(_ONE - rise * rise, _STEEPEST))
    own = shape_at(x, y, shape, scale)[0] * share
    clear, along = _ONE, _HALF * _TEXEL
    for _ in range(_STEPS):
        ray = own + tangent * along
        if ray > highest or clear <= _ZERO:
            break
        height, steep = shape_at(x + along * tx, y + along * ty, shape, scale)
        over = ray - height * share
        clear = min(clear, _HALF + over / _EDGE)
        along += max(over / max(steep * share - tangent, _FLAT), _HALF * _TEXEL)
    return min(max(clear, _ZERO), _ONE)


@compiled
def _beam(a, b, c, square, facing, lamp, clip, shadow):  # type: ignore[no-untyped-def]
    """Return the normal irradiance at a place [W/m2].

    Args:
        a, b, c: From the lamp to the place; `square` is that of its length [m].
        facing: Cosine of incidence on the coarse surface.
        lamp, clip, shadow: As for `lamp_on`.
    """
    m = len(shadow)
    wide = np.float32(m)
    q = a * clip[0, 3] + b * clip[1, 3] + c * clip[2, 3] + clip[3, 3]
    if q <= _ZERO:
        return _ZERO
    ahead = a * lamp[3] + b * lamp[4] + c * lamp[5]
    cosine = max(ahead / np.sqrt(square), _COSINE)
    u = (a * clip[0, 0] + b * clip[1, 0] + c * clip[2, 0] + clip[3, 0]) / max(q, _LEAST)
    v = (a * clip[0, 1] + b * clip[1, 1] + c * clip[2, 1] + clip[3, 1]) / max(q, _LEAST)
    u = min(max((_HALF + _HALF * u) * wide - _HALF, -wide), wide + wide)
    v = min(max((_HALF + _HALF * v) * wide - _HALF, -wide), wide + wide)
    # A pixel of the map covers a range of depths, which is the wider the more grazing the light
    # is.
    own = ahead * (_ONE - _SLACK - lamp[8] / max(facing, _GRAZING)) - _OFF
    column, row = np.floor(u), np.floor(v)
    u, v = u - column, v - row
    lit = _ZERO
    for n in range(4):
        i, j = np.int64(column) + (n & 1), np.int64(row) + (n >> 1)
        stored = abs(shadow[min(max(j, 0), m - 1), min(max(i, 0), m - 1)])
        if stored == _ZERO or own < stored:
            lit += (u if n & 1 else _ONE - u) * (v if n >> 1 else _ONE - v)
    return lit * lamp[6] * np.float32(math.pow(cosine, lamp[7])) / square


@compiled
def lamp_on(at, grid, drawn_as, lamp, clip, shadow,  # type: ignore[no-untyped-def]
            shape, relief, centre, light):
    """Fill in the light of the lamp on each pixel of a band.

    Args:
        at, drawn_as: As `ground_band.place` and `shade_rows.shade` fill them in.
        grid: As `grid_rows.light_of_grid` fills it in; slopes with those of tracks.
        lamp: Its position relative to the camera, with z over it, as x and y are in the world;
            its axis; peak intensity [W/sr], exponent of the cosine, angle of a pixel of the map.
        clip: (4, 4) from axes of the world around the lamp to its map, transposed.
        shadow: (m, m) depth of ground and rocks along the axis of the lamp, 0 where there is none,
            negative for rocks [m].
        shape, relief, centre: As for `ground.cast`; (0, 0) where relief has none.
        light: (3, n) filled in: normal irradiance [W/m2], cosines of incidence and phase.
    """
    depth, x, y, z, vx, vy, vz = at[0], at[1], at[2], at[3], at[4], at[5], at[6]
    slope_x, slope_y, kept = grid[0], grid[1], drawn_as[4]
    normal_x, normal_y, normal_z = drawn_as[0], drawn_as[1], drawn_as[2]
    irradiance, cos_i, cos_g = light[0], light[1], light[2]
    for k in range(len(depth)):
        irradiance[k] = cos_i[k] = cos_g[k] = _ZERO
        if depth[k] <= _ZERO:
            continue
        a, b, c = x[k] - lamp[0], y[k] - lamp[1], z[k] - lamp[2]
        square = a * a + b * b + c * c
        shrink = -_ONE / np.sqrt(square)
        tx, ty, tz = a * shrink, b * shrink, c * shrink
        cos_i[k] = normal_x[k] * tx + normal_y[k] * ty + normal_z[k] * tz
        cos_g[k] = tx * vx[k] + ty * vy[k] + tz * vz[k]
        if cos_i[k] <= _ZERO:
            continue
        p, g = slope_x[k], slope_y[k]
        facing = (tz - p * tx - g * ty) / np.sqrt(p * p + g * g + _ONE)
        value = _beam(a, b, c, square, facing, lamp, clip, shadow)
        if len(shape) and value > _ZERO:
            share = kept[k] * shape_share(x[k] - centre[0], y[k] - centre[1], centre[2])
            if share > _ZERO:
                value *= _over_relief(x[k], y[k], facing, tx, ty, shape, relief[0], relief[1],
                                      share)
        irradiance[k] = value


@compiled
def lamp_on_objects(at, normal, lamp, clip, shadow, out):  # type: ignore[no-untyped-def]
    """Fill in the light of the lamp on each pixel of rocks or the rover.

    Args:
        at: (10, n) as `object_rows.find` fills it in.
        normal: (3, n) of what is lit.
        lamp, clip, shadow: As for `lamp_on`.
        out: (6, n) normal irradiance [W/m2], unit vector to the lamp, cosines of incidence and
            phase.
    """
    for k in range(at.shape[1]):
        a, b, c = at[1, k] - lamp[0], at[2, k] - lamp[1], at[3, k] - lamp[2]
        square = a * a + b * b + c * c
        shrink = -_ONE / np.sqrt(square)
        tx, ty, tz = a * shrink, b * shrink, c * shrink
        out[1, k], out[2, k], out[3, k] = tx, ty, tz
        facing = at[7, k] * tx + at[8, k] * ty + at[9, k] * tz
        out[0, k] = _beam(a, b, c, square, facing, lamp, clip, shadow)
        out[4, k] = normal[0, k] * tx + normal[1, k] * ty + normal[2, k] * tz
        out[5, k] = tx * at[4, k] + ty * at[5, k] + tz * at[6, k]


@compiled
def add_lamp(reflectance, irradiance, lamp, whole):  # type: ignore[no-untyped-def]
    """Fill in the radiance of the lamp, (n,), and add it to the whole."""
    for k in range(len(lamp)):
        lamp[k] = reflectance[k] * irradiance[k]
        whole[k] += lamp[k]
