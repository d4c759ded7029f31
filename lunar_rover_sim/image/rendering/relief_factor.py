"""The factor that keeps the mean of the ground, pixel by pixel."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import vectorised
from lunar_rover_sim.base.fast_math import log2
from lunar_rover_sim.image.rendering.row_math import any_positive, byte, CHUNK, PAGE

_N, _PAGE = CHUNK, PAGE
_ZERO, _HALF, _ONE, _TWO = (np.float32(x) for x in (0.0, 0.5, 1.0, 2.0))
_LEAST = np.float32(1e-6)
_BRIGHTEST = np.float32(0.125)
_BYTE2 = np.float32((255.0 / 128.0)**2 / 255.0**2)


@vectorised
def relief_factor(depth, slope_x, slope_y, vx, vy, vz, detail,  # type: ignore[no-untyped-def]
                  sun, nodes, result):
    """Fill in the law over the mean of drawn ground; nodes as in relief_brightness.py.

    Args:
        depth, slope_x, slope_y, vx, vy, vz, detail: (n,), slopes of the grid.
        sun: Unit vector to it; to it over level ground; tangent of its elevation over such ground
            that it may be compared with.
        nodes: (levels, cosines, azimuths) codes of four heights of the sun, as uint32: roots of
            the inverse, over LEAST_FACTOR.
        result: (n,).
    """
    s, place = np.empty(8 * _PAGE, np.float32), np.empty(2 * _PAGE, np.int32)
    t = np.empty(8 * _PAGE, np.uint32)
    sx, sy, sz, hx, hy, hz, level_ground = sun[0], sun[1], sun[2], sun[3], sun[4], sun[5], sun[6]
    levels, cosines, azimuths = nodes.shape
    flat = nodes.ravel()
    m, a, e = (np.float32(levels - 1), np.float32(cosines - 1), np.float32(azimuths - 1))
    row, layer = np.int32(azimuths), np.int32(azimuths * cosines)
    u, v, w, high, out = 0, _PAGE, 2 * _PAGE, 3 * _PAGE, 4 * _PAGE
    cos, sun_cos, phase = 5 * _PAGE, 6 * _PAGE, 7 * _PAGE
    for c in range(len(depth) // _N):
        i = c * _N
        if not any_positive(depth, i):
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
            k = place[j]
            t[j], t[_PAGE + j] = flat[k], flat[k + 1]
            t[2 * _PAGE + j], t[3 * _PAGE + j] = flat[k + row], flat[k + row + 1]
            k += layer
            t[4 * _PAGE + j], t[5 * _PAGE + j] = flat[k], flat[k + 1]
            t[6 * _PAGE + j], t[7 * _PAGE + j] = flat[k + row], flat[k + row + 1]
        # The four lie 1/4, 1/2, 1 and 4 times as high as over level ground.
        for j in range(_N):
            height = log2(max(s[high + j] / level_ground, _LEAST))
            height = height if height < _ZERO else _HALF * height
            s[high + j] = min(max(height, -_TWO), _ONE)
            s[out + j] = _ZERO
        for channel in range(4):
            node = np.float32(channel - 2)
            for j in range(_N):
                f, g, d = s[u + j], s[v + j], s[w + j]
                p = byte(t[j])
                p += f * (byte(t[_PAGE + j]) - p)
                q = byte(t[2 * _PAGE + j])
                q += f * (byte(t[3 * _PAGE + j]) - q)
                p += g * (q - p)
                q = byte(t[4 * _PAGE + j])
                q += f * (byte(t[5 * _PAGE + j]) - q)
                z = byte(t[6 * _PAGE + j])
                z += f * (byte(t[7 * _PAGE + j]) - z)
                q += g * (z - q)
                p += d * (q - p)
                s[out + j] += max(_ONE - abs(s[high + j] - node), _ZERO) * p * p
            for j in range(len(t)):
                t[j] = t[j] >> np.uint32(8)
        for j in range(_N):
            result[i + j] = _ONE / max(_BYTE2 * s[out + j], _BRIGHTEST)
