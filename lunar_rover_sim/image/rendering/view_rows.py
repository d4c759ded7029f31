"""How bright the relief below the grid is that pixels see at low views (relief_views.py)."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import inlined, vectorised
from lunar_rover_sim.base.fast_math import arc_cosine, exp2, log2
from lunar_rover_sim.image.rendering.relief_views import AZIMUTHS, FIRST_SINE, LEVELS, MOST
from lunar_rover_sim.image.rendering.row_math import (any_positive, CHUNK, NO_PIXELS, PAGE,
                                                      shape_share)

_N, _PAGE = CHUNK, PAGE
_FINE, _LEVEL, _HEIGHT, _U, _V = (k * _PAGE for k in range(5))
_LIGHT, _FALLS, _COARSER, _SECOND, _THIRD = (k * _PAGE for k in range(5, 10))
_WEIGHT, _OWN_U, _OWN_V, _SLANT, _ALONG_Y, _PART, _SHARE, _RANK, _A, _B, _C, _D = (
    k * _PAGE for k in range(10, 22))
_NODE, _AT = 0, _PAGE
_ZERO, _HALF, _ONE, _TWO, _FOUR = (np.float32(x) for x in (0.0, 0.5, 1.0, 2.0, 4.0))
_THREE_HALVES = np.float32(1.5)
_TINY, _LEAST_SINE = np.float32(1e-6), np.float32(1e-3)
_FIRST, _LAST = np.float32(np.log2(FIRST_SINE)), np.float32(len(AZIMUTHS) - 1)
_HIGH = np.float32(np.log2(0.32))       # above this sine of the view relief is drawn by its slopes
_OF_TURN = np.float32(0.5 / np.pi)
_PIXEL_M = np.float32(np.log2(0.35 / 554.0))    # of a pixel times the sine, see relief_views.py
_QUARTERS = np.float32(4 * max(AZIMUTHS))
_COARSEST = np.float32(LEVELS - 1)
_FINER = np.float32(-0.5)       # pixels smaller than texels, in octaves: with as much contrast
_LOWEST_SUN, _HIGHEST_SUN = np.float32(-2.0), np.float32(2.0)   # log2 of its tangent, over level
_OF_CODE = np.float32(MOST / 255.0**2)
_OF_SHARE = np.float32(1.0 / MOST)
_WITHIN = np.float32(0.75)      # of the elevation of a node: beyond, it has no weight
_GRAZING, _TINIEST = np.float32(0.02), np.float32(1e-20)


@inlined
def _of_next(part):  # type: ignore[no-untyped-def]
    """Return how much of the next azimuth a place between two has: mostly one is enough."""
    return min(max(_FOUR * part - _THREE_HALVES, _ZERO), _ONE)


@vectorised
def nodes_of(at, grid, centre, azimuths, number,  # type: ignore[no-untyped-def]
             views, wanted):
    """Find which textures pixels of a band see.

    Args:
        at, grid: As `ground_band.place` and `grid_rows.light_of_grid` fill them in; slopes with
            those of tracks.
        centre: Place of the middle of all cameras [m], reach of relief with shape [m].
        azimuths, number: As `ViewNodes` has them.
        views: (4, n) filled in: share of the light that textures have; depth where they have not
            all of it, elsewhere 0; elevation of the view, as a place between nodes or beyond
            them; azimuth of the view [turns], 0 to 1.
        wanted: (nodes,) those that are seen are set.

    Returns:
        Whether any is seen.
    """
    depth, x, y, vx, vy, vz, slope_x, slope_y = (at[0], at[1], at[2], at[4], at[5], at[6], grid[0],
                                                 grid[1])
    far, near, rank, turn = views[0], views[1], views[2], views[3]
    seen = False
    for c in range(len(depth) // _N):
        i = c * _N
        if not any_positive(depth, i):
            for j in range(i, i + _N):
                far[j], near[j] = _ZERO, _ZERO
            continue
        for j in range(i, i + _N):
            p, q = slope_x[j], slope_y[j]
            sine = (vz[j] - p * vx[j] - q * vy[j]) / np.sqrt(p * p + q * q + _ONE)
            high = log2(max(sine, _LEAST_SINE))
            rank[j] = _FIRST - high
            share = min(max((_HIGH - high) / (_HIGH - _FIRST), _ZERO), _ONE)
            shaped = shape_share(x[j] - centre[0], y[j] - centre[1], centre[2])
            far[j] = share * (_ONE - shaped) if depth[j] > _ZERO else _ZERO
            near[j] = depth[j] if far[j] < _ONE else _ZERO
        if not any_positive(far, i):
            continue
        for j in range(i, i + _N):
            across = max(vx[j] * vx[j] + vy[j] * vy[j], _TINY)
            angle = _OF_TURN * arc_cosine(min(max(vx[j] / np.sqrt(across), -_ONE), _ONE))
            turn[j] = min(angle if vy[j] >= _ZERO else _ONE - angle, _ONE - _TINY)
        last = -_ONE
        for j in range(i, i + _N):
            # Neighbours see the same: quarters of the narrowest steps of azimuth tell them apart.
            high = min(max(rank[j], _ZERO), _LAST)
            own = np.floor(high) * _QUARTERS + np.floor(turn[j] * _QUARTERS)
            own = own if far[j] > _ZERO else last
            if own != last:
                last = own
                seen = True
                first = int(high)
                for elevation in range(first, min(first + 2, len(azimuths))):
                    n = azimuths[elevation]
                    place = turn[j] * np.float32(n)
                    a = int(place)
                    share = _of_next(place - np.float32(a))
                    if share < _ONE:
                        wanted[number[elevation] + a] = True
                    if share > _ZERO:
                        wanted[number[elevation] + (a + 1) % n] = True
    return seen


@vectorised
def _add_node(s, place, which, count, codes, first, begins,  # type: ignore[no-untyped-def]
              lines, along, slant, spread, level):
    """Add the light of pixels by the nodes at _NODE, with the weights at _WEIGHT.

    Args:
        s, place: Scratch memory of float32 and int32; pixels are those of `which`.
        codes, first, slant, spread: As `ViewNodes`.
        begins, lines, along: Of the level that is read, as `ViewNodes.side` has them.
    """
    wide, high, stride = np.float32(along), np.float32(lines), np.int32(along + 2)
    for k in range(count):
        node = place[_NODE + k]
        s[_SLANT + k], s[_ALONG_Y + k] = slant[node, 0], slant[node, 1]
        place[_AT + k] = np.int32(first[node] + begins)
    for k in range(count):
        along_y = s[_ALONG_Y + k] > _HALF
        u, v = s[_OWN_U + k], s[_OWN_V + k]
        u, v = (v if along_y else u), (u if along_y else v)
        line = v - s[_SLANT + k] * u
        column, line = u * wide + _HALF, (line - np.floor(line)) * high + _HALF
        west, south = np.floor(column), np.floor(line)
        s[_PART + k], s[_SHARE + k] = column - west, line - south
        place[_AT + k] += np.int32(south) * stride + np.int32(west)
    for k in range(count):
        at = np.uint32(place[_AT + k])
        s[_A + k], s[_C + k] = codes[at], codes[at + np.uint32(1)]
        at = np.uint32(place[_AT + k] + stride)
        s[_B + k], s[_D + k] = codes[at], codes[at + np.uint32(1)]
    for k in range(count):
        # Of light, not of its roots: those would have less of it in the mean.
        a, b = s[_A + k] * s[_A + k], s[_C + k] * s[_C + k]
        a += s[_SHARE + k] * (s[_B + k] * s[_B + k] - a)
        b += s[_SHARE + k] * (s[_D + k] * s[_D + k] - b)
        s[_A + k] = a + s[_PART + k] * (b - a)
    for k in range(count):
        j, node, weight = which[k], place[_NODE + k], s[_WEIGHT + k]
        s[_LIGHT + j] += weight * s[_A + k]
        s[_FALLS + j] += weight * spread[node, level, 0]
        s[_COARSER + j] += weight * spread[node, level, 1]
        s[_SECOND + j] += weight * spread[node, level, 2]
        s[_THIRD + j] += weight * spread[node, level, 3]


@vectorised
def seen_relief(at, grid, relief, views, pixel, sun,  # type: ignore[no-untyped-def]
                codes, first, side, number, azimuths, slant, spread, unchanged, result):
    """Fill in the brightness of the relief that pixels see, over its mean.

    Args:
        at, grid, relief, views: As other loops fill them in.
        pixel: Size of one at depth 1.
        sun: As for `relief_brightness.relief_factor`.
        codes to unchanged: As `ViewNodes`.
        result: (n,).
    """
    depth, slope_x, slope_y, place_x, place_y = at[0], grid[0], grid[1], relief[6], relief[7]
    far, rank, turn = views[0], views[2], views[3]
    s, place = np.empty(22 * _PAGE, np.float32), np.empty(2 * _PAGE, np.int32)
    which, some = np.empty(_N, np.int64), np.empty(_N, np.int64)
    deepest = len(azimuths) - 1
    for c in range(len(depth) // _N):
        i = c * _N
        if not any_positive(far, i):
            for j in range(i, i + _N):
                result[j] = _ONE
            continue
        for j in range(_N):
            p, q = slope_x[i + j], slope_y[i + j]
            fine = log2(max(depth[i + j] * pixel, _TINY)) + _FIRST - rank[i + j] - _PIXEL_M
            s[_FINE + j] = max(fine, _FINER)
            s[_RANK + j] = min(max(rank[i + j], _ZERO), _LAST)
            s[_LEVEL + j] = min(max(np.rint(s[_FINE + j]), _ZERO), _COARSEST)
            height = (sun[5] - p * sun[3] - q * sun[4]) / sun[6]
            s[_HEIGHT + j] = min(max(log2(max(height, _TINY)), _LOWEST_SUN), _HIGHEST_SUN)
        for j in range(_N):
            u, v = place_x[i + j], place_y[i + j]
            s[_U + j], s[_V + j] = u - np.floor(u), v - np.floor(v)
            s[_LIGHT + j], s[_SECOND + j], s[_THIRD + j] = _ZERO, _ZERO, _ZERO
            s[_FALLS + j], s[_COARSER + j] = _ZERO, _ZERO
        low, high, least, most = deepest, 0, LEVELS, 0
        for j in range(_N):
            if far[i + j] > _ZERO:
                k, level = int(s[_RANK + j]), int(s[_LEVEL + j])
                low, high, least, most = min(low, k), max(high, k), min(least, level), max(most,
                                                                                           level)
        for elevation in range(low, min(high + 1, deepest) + 1):
            n, base = np.float32(azimuths[elevation]), number[elevation]
            for level in range(least, most + 1):
                few, own, of_level = NO_PIXELS, np.float32(elevation), np.float32(level)
                for j in range(_N):
                    which[few] = j
                    wanted = (abs(s[_RANK + j] - own) < _WITHIN) & (s[_LEVEL + j] == of_level)
                    few += wanted & (far[i + j] > _ZERO)
                for second in range(2):
                    number_of = NO_PIXELS
                    for k in range(few):
                        j = which[k]
                        at = turn[i + j] * n
                        a = np.floor(at)
                        share = _of_next(at - a)
                        share = share if second else _ONE - share
                        a += np.float32(second)
                        a = a - n if a >= n else a
                        some[number_of] = j
                        place[_NODE + number_of] = np.int32(base + np.int32(a))
                        s[_WEIGHT + number_of] = share * min(max(
                            _THREE_HALVES - _TWO * abs(s[_RANK + j] - own), _ZERO), _ONE)
                        s[_OWN_U + number_of], s[_OWN_V + number_of] = s[_U + j], s[_V + j]
                        number_of += share > _ZERO
                    _add_node(s, place, some, number_of, codes, first, side[elevation, level, 2],
                              side[elevation, level, 0], side[elevation, level, 1], slant, spread,
                              level)
        # A lower sun over the slope has more contrast; so have pixels smaller than texels.
        for j in range(_N):
            more = min(exp2(-s[_FALLS + j] * s[_HEIGHT + j]
                            - s[_COARSER + j] * (s[_FINE + j] - s[_LEVEL + j])), _FOUR) - _ONE
            light = s[_LIGHT + j] * _OF_CODE
            light = max(light + more * (light - unchanged), _ZERO)
            over = max(more, _ZERO)
            result[i + j] = light / (_ONE + over * over * (s[_SECOND + j] + s[_THIRD + j] * over))


@vectorised
def light_of_views(at, grid, views, prints, has_tracks, of_rover,  # type: ignore[no-untyped-def]
                   drawn_as, sun, whole, trodden, law, seen, upward):
    """Replace what the law takes of a pixel by that of the grid alone, as far as textures go.

    Args:
        at to drawn_as: As other loops fill them in.
        sun: Unit vector to it.
        whole: Tangent of the roughness of ground no relief of which is drawn.
        trodden: As for `shade_rows.shade`.
        law: (6, n) as that fills it in; replaced in place.
        seen: (n,) as `seen_relief` fills it in; replaced by the factor that makes, of this light,
            light of which the part of the textures is multiplied by that.
        upward: (n,) filled in: vertical part of the normal.
    """
    vx, vy, vz, slope_x, slope_y, of_grid = at[4], at[5], at[6], grid[0], grid[1], grid[2]
    far, beside, normal_z, kept = views[0], prints[7], drawn_as[2], drawn_as[4]
    cos_i, cos_e, theta, lit = law[0], law[1], law[3], law[5]
    for i in range(len(far)):
        share, p, q = far[i], slope_x[i], slope_y[i]
        slopes = _ONE - share
        open_sky = beside[i] if has_tracks else _ONE
        up = _ONE / np.sqrt(p * p + q * q + _ONE)
        incidence = max(up * (sun[2] - p * sun[0] - q * sun[1]), _ZERO)
        emission = max(up * (vz[i] - p * vx[i] - q * vy[i]), _GRAZING)
        rough = trodden[2] + kept[i] * (whole - trodden[2])
        by_slopes, by_views = slopes * lit[i], share * of_grid[i] * open_sky * of_rover[i]
        relief = _ONE + kept[i] * (seen[i] - _ONE)
        both = max(by_slopes + by_views, _TINIEST)
        seen[i] = (by_slopes + by_views * relief) / both
        lit[i] = by_slopes + by_views
        cos_i[i] = slopes * cos_i[i] + share * incidence
        cos_e[i] = slopes * cos_e[i] + share * emission
        theta[i] = slopes * theta[i] + share * rough
        upward[i] = slopes * normal_z[i] + share * up


@vectorised
def shares_of_views(grid, views, prints, has_tracks,  # type: ignore[no-untyped-def]
                    share, drawn_as):
    """Replace the share of the sun that is seen, and the normal, as far as textures go.

    Args:
        grid, views, prints, has_tracks: As for `light_of_views`.
        share: (n,) as `seen_relief` fills it in with `ReliefViews.shares`.
        drawn_as: As `shade_rows.shade` fills it in; replaced in place.
    """
    slope_x, slope_y, of_grid, far, beside = grid[0], grid[1], grid[2], views[0], prints[7]
    normal_x, normal_y, normal_z, sunlit, kept = (drawn_as[0], drawn_as[1], drawn_as[2],
                                                  drawn_as[3], drawn_as[4])
    for i in range(len(far)):
        part, p, q = far[i], slope_x[i], slope_y[i]
        slopes = _ONE - part
        up = _ONE / np.sqrt(p * p + q * q + _ONE)
        open_sky = beside[i] if has_tracks else _ONE
        seen = of_grid[i] * open_sky * (_ONE + kept[i] * (min(share[i] * _OF_SHARE, _ONE) - _ONE))
        sunlit[i] = slopes * sunlit[i] + part * seen
        normal_x[i] = slopes * normal_x[i] - part * up * p
        normal_y[i] = slopes * normal_y[i] - part * up * q
        normal_z[i] = slopes * normal_z[i] + part * up


@vectorised
def factor_of_views(seen, direct, whole):  # type: ignore[no-untyped-def]
    """Replace the factor on sunlight of the relief that pixels see by that on all their light.

    Args:
        seen: (n,) as `light_of_views` leaves it.
        direct, whole: (n,) radiance of sunlight, and of all light.
    """
    for i in range(len(seen)):
        seen[i] = _ONE + direct[i] / max(whole[i], _TINIEST) * (seen[i] - _ONE)
