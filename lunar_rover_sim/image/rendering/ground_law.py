"""The reflectance of the ground pixel by pixel, and the factor that keeps its mean.

The formulae of Hapke's law are those of `image/illumination/hapke.py`, which gives their sources.
"""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import inlined, vectorised
from lunar_rover_sim.image.rendering.row_math import any_positive, byte, CHUNK, log2, PAGE

_N, _PAGE = CHUNK, PAGE
_ZERO, _HALF, _ONE, _TWO = (np.float32(x) for x in (0.0, 0.5, 1.0, 2.0))
_LEAST, _TINY, _SMOOTHEST = np.float32(1e-6), np.float32(1e-9), np.float32(1e-4)
_MOST_W = np.float32(0.999)
_PI, _ONE_OVER_PI, _TWO_OVER_PI = (np.float32(x) for x in (np.pi, 1.0 / np.pi, 2.0 / np.pi))
_FOUR_PI = np.float32(0.25 / np.pi)
_LOG2_E, _HALF_LOG_2 = np.float32(1.44269504), np.float32(0.34657359)
_LOWEST = np.float32(-126.0)
_E1, _E2, _E3, _E4, _E5 = (np.float32(x) for x in (
    0.69315136, 0.24016415, 0.05580047, 0.00901666, 0.0018672))
_A0, _A1, _A2, _A3, _A4, _A5, _A6, _A7 = (np.float32(x) for x in (
    1.5707963050, -0.2145988016, 0.0889789874, -0.0501743046, 0.0308918810, -0.0170881256,
    0.0066700901, -0.0012624911))
_BIAS = np.int32(127)
_BRIGHTEST = np.float32(0.125)
_BYTE2 = np.float32((255.0 / 128.0)**2 / 255.0**2)


@inlined
def _exp(x):  # type: ignore[no-untyped-def]
    """Return e to a power of 0 and less; error < 3e-6."""
    x = max(x * _LOG2_E, _LOWEST)
    whole = np.floor(x)
    f = x - whole
    part = _ONE + f * (_E1 + f * (_E2 + f * (_E3 + f * (_E4 + f * _E5))))
    return part * np.int32((np.int32(whole) + _BIAS) << np.int32(23)).view(np.float32)


@inlined
def _arc_cosine(x):  # type: ignore[no-untyped-def]
    """Return the angle of a cosine (Abramowitz and Stegun, 4.4.46, error < 2e-8)."""
    a = abs(x)
    angle = np.sqrt(max(_ONE - a, _ZERO)) * (_A0 + a * (_A1 + a * (_A2 + a * (_A3 + a * (
        _A4 + a * (_A5 + a * (_A6 + a * _A7)))))))
    return _PI - angle if x < _ZERO else angle


@inlined        # called, it gave other last bits in the process that compiled it
def _reflectance(cos_i, cos_e, cos_g, tan_theta,  # type: ignore[no-untyped-def]
                 albedo, more_c, law, result):
    """As `reflectance`, whether anything is lit or not."""
    w_all, b, c_all, b_s0, h_s = law[0], law[1], law[2], law[3], law[4]
    bb = _ONE + b * b
    outer = _HALF * (_ONE - b * b)
    # Divisions take most of the time: those that can be are done together.
    for j in range(len(result)):
        mu0, mu = min(max(cos_i[j], _LEAST), _ONE), min(max(cos_e[j], _LEAST), _ONE)
        cosine = min(max(cos_g[j], -_ONE), _ONE)
        w = min(max(w_all * albedo[j], _ZERO), _MOST_W)
        theta = max(tan_theta[j], _SMOOTHEST)
        chi = _ONE / np.sqrt(_ONE + _PI * theta * theta)
        sin_i, sin_e = np.sqrt(_ONE - mu0 * mu0), np.sqrt(_ONE - mu * mu)
        cos_psi = (cosine - mu0 * mu) / max(sin_i * sin_e, _LEAST)
        cos_psi = min(max(cos_psi, -_ONE), _ONE)
        psi = _arc_cosine(cos_psi) * _ONE_OVER_PI
        half2 = _HALF * (_ONE - cos_psi)
        f = _exp(-_TWO * np.sqrt(half2 / max(_ONE - half2, _TINY)))
        ti, te = sin_i * theta, sin_e * theta
        over_i, over_e = max(ti, _LEAST), max(te, _LEAST)
        both = _ONE / (over_i * over_e)
        ci, ce = mu0 * over_e * both, mu * over_i * both
        e1_i, e1_e = _exp(-_TWO_OVER_PI * ci), _exp(-_TWO_OVER_PI * ce)
        e2_i, e2_e = _exp(-_ONE_OVER_PI * ci * ci), _exp(-_ONE_OVER_PI * ce * ce)
        both = _ONE / ((_TWO - e1_i) * (_TWO - e1_e))
        eta_i = mu0 + ti * e2_i * (_TWO - e1_e) * both      # over chi
        eta_e = mu + te * e2_e * (_TWO - e1_i) * both
        low = mu0 >= mu
        e1_max, e1_min = e1_e if low else e1_i, e1_i if low else e1_e
        e2_max, e2_min = e2_e if low else e2_i, e2_i if low else e2_e
        below = _ONE / (_TWO - e1_max - psi * e1_min)
        facing = (cos_psi * e2_max + half2 * e2_min) * below
        away = (e2_max - half2 * e2_min) * below
        mu0e = max(chi * (mu0 + ti * (facing if low else away)), _LEAST)
        mue = max(chi * (mu + te * (away if low else facing)), _LEAST)
        own_eta, other_eta = eta_i if low else eta_e, eta_e if low else eta_i
        shadowed = chi * other_eta * (own_eta * (_ONE - f) + f * (mu0 if low else mu))
        seen = mue * mu0 * mu0e / (shadowed * (mu0e + mue))
        gamma = np.sqrt(_ONE - w)
        r0 = (_ONE - gamma) / (_ONE + gamma)
        both = _ONE / (mu0e * mue)
        log_i = log2((_ONE + mu0e) * mue * both)
        log_e = log2((_ONE + mue) * mu0e * both)
        h_i = _ONE - w * mu0e * (r0 + _HALF_LOG_2 * (_ONE - _TWO * r0 * mu0e) * log_i)
        h_e = _ONE - w * mue * (r0 + _HALF_LOG_2 * (_ONE - _TWO * r0 * mue) * log_e)
        multiple = _ONE / (h_i * h_e) - _ONE
        back, forth = bb - _TWO * b * cosine, bb + _TWO * b * cosine
        back, forth = back * np.sqrt(back), forth * np.sqrt(forth)
        c = c_all + more_c[j]
        lobes = outer * ((_ONE + c) * forth + (_ONE - c) * back) / (back * forth)
        wide = h_s * (_ONE + cosine)
        sine = np.sqrt(max(_ONE - cosine * cosine, _ZERO))
        single = (_ONE + b_s0 * wide / max(wide + sine, _TINY)) * lobes
        value = w * _FOUR_PI * seen * (single + multiple)
        result[j] = value if min(cos_i[j], cos_e[j]) > _ZERO else _ZERO


@vectorised
def reflectance(cos_i, cos_e, cos_g, tan_theta,  # type: ignore[no-untyped-def]
                albedo, more_c, law, result):
    """Fill in Hapke's reflectance [1/sr]; 0 where either cosine is <= 0.

    Args:
        cos_i, cos_e, cos_g: (n,) cosines of incidence, emission and phase.
        tan_theta: (n,) tangent of the mean slope of what is not drawn.
        albedo: (n,) factor on w.
        more_c: (n,) what is added to c.
        law: w, b, c, b_s0, h_s.
        result: (n,).
    """
    for start in range(0, len(result), _N):
        end, lit = min(start + _N, len(result)), 0
        for j in range(start, end):
            lit += cos_i[j] > _ZERO
        if lit == 0:
            result[start:end] = _ZERO
        else:
            _reflectance(cos_i[start:end], cos_e[start:end], cos_g[start:end],
                         tan_theta[start:end], albedo[start:end], more_c[start:end], law,
                         result[start:end])


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
