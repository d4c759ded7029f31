"""How pixels of the ground are lit: what the grid, relief, tracks and the rover leave of the sun.
"""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import vectorised
from lunar_rover_sim.image.rendering.row_math import any_positive, CHUNK, disc, PAGE, shape_share

_N, _PAGE = CHUNK, PAGE
_ZERO, _HALF, _ONE, _FAR = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(1e9)
_GRAZING, _LIFTED, _BESIDE, _NEAREST = (np.float32(x) for x in (0.02, 0.08, 0.6, 1e-3))


@vectorised
def may_shade(at, sun, place, bounds):  # type: ignore[no-untyped-def]
    """Return whether the rover may shade any pixel of a band.

    Args:
        at, sun, place: As for `rover_shadow`.
        bounds: As `CastShadow.bounds`.
    """
    depth, x, y, z = at[0], at[1], at[2], at[3]
    ax, ay, az, bx, by, bz = place[0], place[1], place[2], place[3], place[4], place[5]
    middle_x, middle_y, middle_z, sx, sy, sz = place[6], place[7], place[8], sun[0], sun[1], sun[2]
    low_p, high_p, low_q, high_q, foremost, wider = (bounds[0], bounds[1], bounds[2], bounds[3],
                                                     bounds[4], bounds[5])
    count = 0
    for i in range(len(depth)):
        a, b, d = x[i] - middle_x, y[i] - middle_y, z[i] - middle_z
        p, q = a * ax + b * ay + d * az, a * bx + b * by + d * bz
        behind = foremost - (a * sx + b * sy + d * sz)
        beside = max(max(low_p - p, p - high_p), max(low_q - q, q - high_q))
        beside = beside if behind >= _ZERO else _FAR
        count += (beside if depth[i] > _ZERO else _FAR) <= wider * behind
    return count > 0


@vectorised
def rover_shadow(at, view, sun, silhouette, place, lit):  # type: ignore[no-untyped-def]
    """Fill in the share of the sun that the rover leaves.

    Args:
        at: (4 or more, n) depth [m], place as `ground_band.place` has it.
        view: As `ViewNumbers.numbers`.
        sun: Unit vector to it; radius of its disc [rad].
        silhouette: (m, m, 2) as `RoverShadow.silhouette`.
        place: Axes of that map, over its half extent; position of the rover over the camera [m].
        lit: (n,).
    """
    depth, x, y, z = at[0], at[1], at[2], at[3]
    m = len(silhouette)
    wide, last = np.float32(m), np.float32(m - 1)
    pixel = view[15]
    for i in range(len(depth)):
        lit[i] = _ONE
        if depth[i] <= _ZERO:
            continue
        a, b, d = x[i] - place[6], y[i] - place[7], z[i] - place[8]
        p = a * place[0] + b * place[1] + d * place[2]
        q = a * place[3] + b * place[4] + d * place[5]
        if max(abs(p), abs(q)) > _ONE:
            continue
        p = min(max((_HALF + _HALF * p) * wide - _HALF, _ZERO), last)
        q = min(max((_HALF + _HALF * q) * wide - _HALF, _ZERO), last)
        column, row = np.int32(p), np.int32(q)
        p, q = p - np.float32(column), q - np.float32(row)
        east, north = min(column + 1, m - 1), min(row + 1, m - 1)
        away = np.float32(0.0)
        along = np.float32(0.0)
        for k in range(2):
            low = silhouette[row, column, k] + p * (silhouette[row, east, k]
                                                    - silhouette[row, column, k])
            high = silhouette[north, column, k] + p * (silhouette[north, east, k]
                                                       - silhouette[north, column, k])
            low += q * (high - low)
            if k:
                along = low
            else:
                away = low
        behind = along - (a * sun[0] + b * sun[1] + d * sun[2])
        if behind < _ZERO:
            continue
        behind = max(behind, _NEAREST)
        # A pixel shows the mean of its light.
        lit[i] = disc(away / behind, sun[3] + _HALF * pixel * depth[i] / behind)


@vectorised
def shade(at, near, grid, relief, prints, has_tracks,  # type: ignore[no-untyped-def]
          factor, of_rover, sun, centre, scales, least_scales, trodden, law, drawn_as):
    """Fill in what the law and truth take of pixels, from all that has been looked up.

    Args:
        at, grid, relief: As `ground_band.place`, `grid_rows.light_of_grid` and
            `relief_rows.relief_of` fill them in. Albedo is replaced by that of tracks.
        near: (n,) chunks without any that is positive have no slopes; the light of their grid is
            left to `view_rows.light_of_views`.
        prints: As `track_map.prints_of` fills it in; it counts with `has_tracks`.
        factor, of_rover: (n,) of `relief_brightness.relief_factor` and `rover_shadow`.
        sun: Unit vector to it; to it over level ground; radius of its disc [rad].
        centre: Place of the middle of all cameras [m], reach of relief with shape [m].
        scales, least_scales: (4, 4) and (4,) of `ReliefBrightness`.
        trodden: Albedo lost where soil is compacted, where loose; tangent of the roughness where
            compacted; what is added to c there.
        law: (6, n) filled in: cosines of incidence (0 in the dark), emission and phase; tangent of
            the roughness that is left; what is added to c; share of the sun that lights it.
        drawn_as: (5, n) filled in: normal of what is drawn; share of the sun that is seen but for
            the rover; share of the relief below the grid that tracks have left.
    """
    depth, x, y, vx, vy, vz = at[0], at[1], at[2], at[4], at[5], at[6]
    slope_x, slope_y, of_grid, albedo, detail = grid[0], grid[1], grid[2], grid[3], grid[6]
    slope_ax, slope_ay, slope_bx, slope_by, horizon_a, horizon_b = (
        relief[0], relief[1], relief[2], relief[3], relief[4], relief[5])
    pressed, loose, beside = prints[5], prints[6], prints[7]
    cos_i, cos_e, cos_g, theta, more_c, lit = law[0], law[1], law[2], law[3], law[4], law[5]
    normal_x, normal_y, normal_z, sunlit, kept = (drawn_as[0], drawn_as[1], drawn_as[2],
                                                  drawn_as[3], drawn_as[4])
    s = np.empty(22 * _PAGE, np.float32)
    gx, gy, ax, ay, bx, by = 0, _PAGE, 2 * _PAGE, 3 * _PAGE, 4 * _PAGE, 5 * _PAGE
    ha, hb, wx, wy, wz = 6 * _PAGE, 7 * _PAGE, 8 * _PAGE, 9 * _PAGE, 10 * _PAGE
    tangent, cosine, drawn, seen = 11 * _PAGE, 12 * _PAGE, 13 * _PAGE, 14 * _PAGE
    gain, left, open_sky, shaped = 15 * _PAGE, 16 * _PAGE, 17 * _PAGE, 18 * _PAGE
    edge_a, edge_b, rest = 19 * _PAGE, 20 * _PAGE, 21 * _PAGE
    sx, sy, sz, hx, hy, hz, radius = sun[0], sun[1], sun[2], sun[3], sun[4], sun[5], sun[6]
    middle_x, middle_y, reach = centre[0], centre[1], centre[2]
    for c in range(len(depth) // _N):
        i = c * _N
        if not any_positive(depth, i):
            for j in range(_N):
                cos_i[i + j] = _ZERO
            continue
        for j in range(_N):
            s[left + j] = _ONE
            s[open_sky + j] = _ONE
        if has_tracks:
            # Relief below the grid is pressed flat in prints, and partly buried beside them.
            for j in range(_N):
                s[left + j] = _ONE - max(pressed[i + j], _BESIDE * loose[i + j])
            for j in range(_N):
                s[open_sky + j] = beside[i + j]
            for j in range(_N):
                albedo[i + j] *= _ONE - trodden[0] * pressed[i + j] - trodden[1] * loose[i + j]
            for j in range(_N):
                more_c[i + j] = trodden[3] * pressed[i + j]
        else:
            for j in range(_N):
                more_c[i + j] = _ZERO
        for j in range(_N):
            kept[i + j] = s[left + j]
        for j in range(_N):
            cos_g[i + j] = vx[i + j] * sx + vy[i + j] * sy + vz[i + j] * sz
        if not any_positive(near, i):
            for j in range(_N):
                cos_i[i + j], cos_e[i + j] = _ZERO, _ONE
                theta[i + j], normal_z[i + j], lit[i + j] = _ZERO, _ONE, _ZERO
            continue
        for j in range(_N):
            s[gx + j] = slope_x[i + j]
        for j in range(_N):
            s[gy + j] = slope_y[i + j]
        for j in range(_N):
            s[wx + j] = vx[i + j]
        for j in range(_N):
            s[wy + j] = vy[i + j]
        for j in range(_N):
            s[wz + j] = vz[i + j]
        for j in range(_N):
            s[ax + j] = slope_ax[i + j]
        for j in range(_N):
            s[ay + j] = slope_ay[i + j]
        for j in range(_N):
            s[bx + j] = slope_bx[i + j]
        for j in range(_N):
            s[by + j] = slope_by[i + j]
        for j in range(_N):
            s[ha + j] = horizon_a[i + j]
        for j in range(_N):
            s[hb + j] = horizon_b[i + j]
        for j in range(_N):
            d = detail[i + j]
            s[rest + j] = max(scales[0, 0] + d * (scales[1, 0] + d * (
                scales[2, 0] + d * scales[3, 0])), least_scales[0])
            s[edge_a + j] = max(scales[0, 1] + d * (scales[1, 1] + d * (
                scales[2, 1] + d * scales[3, 1])), least_scales[1])
            s[edge_b + j] = max(scales[0, 2] + d * (scales[1, 2] + d * (
                scales[2, 2] + d * scales[3, 2])), least_scales[2])
            s[gain + j] = max(scales[0, 3] + d * (scales[1, 3] + d * (
                scales[2, 3] + d * scales[3, 3])), least_scales[3])
        for j in range(_N):
            p, q = x[i + j] - middle_x, y[i + j] - middle_y
            s[shaped + j] = shape_share(p, q, reach)
        if has_tracks:
            for j in range(_N):
                share = s[left + j]
                s[ax + j] *= share
                s[ay + j] *= share
                s[bx + j] *= share
                s[by + j] *= share
                s[rest + j] = trodden[2] + share * (s[rest + j] - trodden[2])
        for j in range(_N):
            theta[i + j] = s[rest + j]
        for j in range(_N):
            p, q = s[gx + j], s[gy + j]
            up = _ONE / np.sqrt(p * p + q * q + _ONE)
            s[cosine + j] = up * (s[wz + j] - p * s[wx + j] - q * s[wy + j])
            s[tangent + j] = hz - p * hx - q * hy
        # Faces of the fine relief that turn away from the camera are hidden by those that face it.
        for j in range(_N):
            p, q = (-s[gx + j] - s[ax + j] - s[bx + j], -s[gy + j] - s[ay + j] - s[by + j])
            up = _ONE / np.sqrt(p * p + q * q + _ONE)
            facing = up * (p * s[wx + j] + q * s[wy + j] + s[wz + j])
            lift = max(min(max(s[cosine + j], _GRAZING), _LIFTED) - facing, _ZERO)
            p, q, r = (up * p + lift * s[wx + j], up * q + lift * s[wy + j],
                       up + lift * s[wz + j])
            up = _ONE / np.sqrt(p * p + q * q + r * r)
            s[bx + j], s[by + j], s[ha + j] = (up * p, up * q,
                                               s[tangent + j] - s[ha + j])
            s[hb + j] = s[tangent + j] - s[ax + j] * hx - s[ay + j] * hy - s[hb + j]
            s[ax + j] = up * r
        for j in range(_N):
            normal_x[i + j] = s[bx + j]
        for j in range(_N):
            normal_y[i + j] = s[by + j]
        for j in range(_N):
            normal_z[i + j] = s[ax + j]
        for j in range(_N):
            width = radius * (_ONE + s[tangent + j] * s[tangent + j])
            share = (disc(s[ha + j], width + s[edge_a + j])
                     * disc(s[hb + j], width + s[edge_b + j]))
            s[seen + j] = share
            # Gain and factor are of brightness, not of what is seen.
            s[drawn + j] = share * s[gain + j] / (_ONE + (s[gain + j] - _ONE) * share)
        for j in range(_N):
            s[drawn + j] *= factor[i + j] + s[shaped + j] * (_ONE - factor[i + j])
        for j in range(_N):
            s[drawn + j] = (_ONE + s[left + j] * (s[drawn + j] - _ONE)) * s[open_sky + j]
            s[seen + j] = (_ONE + s[left + j] * (s[seen + j] - _ONE)) * s[open_sky + j]
        for j in range(_N):
            sunlit[i + j] = s[seen + j] * of_grid[i + j]
        for j in range(_N):
            lit[i + j] = of_grid[i + j] * (s[drawn + j] * of_rover[i + j])
        for j in range(_N):
            towards = s[bx + j] * sx + s[by + j] * sy + s[ax + j] * sz
            cos_i[i + j] = towards if lit[i + j] > _ZERO else _ZERO
        for j in range(_N):
            cos_e[i + j] = max(s[bx + j] * s[wx + j] + s[by + j] * s[wy + j]
                               + s[ax + j] * s[wz + j], _GRAZING)


@vectorised
def radiance_of(reflectance, lit, grid, upward,  # type: ignore[no-untyped-def]
                irradiance, diffuse, direct, whole):
    """Fill in the radiance of the sun, and that together with what is scattered around.

    Args:
        reflectance: (n,) of the sun [1/sr]; `lit` share of it.
        grid: As `grid_rows.light_of_grid` fills it in.
        upward: (n,) vertical part of the normal.
        irradiance: Of the sun, normal [W/m2].
        diffuse: Diffuse albedo over pi.
        direct, whole: (n,).
    """
    albedo, below, around = grid[3], grid[4], grid[5]
    scattering = np.float32(0.25) * irradiance * diffuse
    for j in range(len(direct)):
        direct[j] = irradiance * reflectance[j] * lit[j]
    for j in range(len(whole)):
        whole[j] = (direct[j] + scattering * albedo[j]
                    * (below[j] + around[j] * _HALF * (_ONE - upward[j])))
