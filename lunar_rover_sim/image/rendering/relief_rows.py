"""The look of the relief below the grid: two tiles, laid out in hexagonal cells of random shifts.

Cells are the hexagons of a triangular lattice, as in Heitz and Neyret, High-performance by-example
noise using a histogram-preserving blending operator, 2018. In place of blending, the more salient
copy is drawn where two cells meet, so that a pebble and its shadow stay whole.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import inlined, vectorised
from lunar_rover_sim.image.rendering.row_math import (any_positive, byte, CHUNK, NO_PIXELS,
                                                      packed_shape, PAGE)

F32 = NDArray[np.float32]

_N, _PAGE = CHUNK, PAGE
_X, _Y, _LEAD, _LEVEL, _U, _V, _PART, _WHOLE = (k * _PAGE for k in range(8))
_PLACES = 8 * _PAGE     # eight: in a and b, of the first cell, then of the second one
_FEW = 25 * _PAGE       # levels of the few pixels between two cells
_AT = 28 * _PAGE        # two
_OUT, _NEXT, _RAW = 17 * _PAGE, 21 * _PAGE, 30 * _PAGE  # four channels each
_OWN = 34 * _PAGE       # two: places of the first cell of those few
_FLOATS = 36 * _PAGE
_CELLS, _NEXT_CELL = 0, 2 * _PAGE   # two each
_INDEX, _EAST, _NORTH, _BOTH = (k * _PAGE for k in range(4, 8))

_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_BYTE = np.float32(1.0 / 255.0)
_SLANT, _UPRIGHT = np.float32(0.57735027), np.float32(1.15470054)
_BENT, _WAVE = np.float32(0.93), np.float32(0.2)
_FRACTION = np.float32(1.0 / 256.0)
_CODE_ZERO, _SLOPES = np.float32(0.501961), np.float32(3.0)     # see SLOPE_SCALE, relief_tiles.py
_EDGE = np.float32(20.0)        # how sharply a copy ends where the next one begins
_SOFT = np.float32(3.0)         # the same of shape, over some centimetres and without a step


def place_in_site(tile: F32, origin_m: tuple[float, float]) -> F32:
    """Return where a frame lies in the pattern of the relief, which is one for all of a site.

    Numbers are reduced in double precision: of a place in the site, float32 would lose the texels.

    Args:
        tile: (3,) 1 / periods of the tiles and 1 / side of the cells [1/m].
        origin_m: Of the frame, in the site.

    Returns:
        (10,) all 0 for the origin of the site: phases of the bends along x and y; place within a
        cell, and its column and row; phases in the coarse tile and in the fine one, x and y each.
    """
    a, b, cell = (float(scale) for scale in tile)
    x, y = origin_m
    q = cell * y
    p, q = cell * x - float(_SLANT) * q, float(_UPRIGHT) * q
    column, row = math.floor(p), math.floor(q)
    phases = [number % 1.0 for number in (float(_BENT) * x, float(_BENT) * y)]
    return np.array([*phases, p - column, q - row, column, row,
                     *(number % 1.0 for number in (a * x, a * y, b * x, b * y))], np.float32)


@inlined
def _shuffled(i, j):  # type: ignore[no-untyped-def]
    """Return 32 random bits of a cell."""
    h = np.uint32(np.uint32(i) * np.uint32(0x9e3779b9) + np.uint32(j) * np.uint32(0x85ebca6b))
    h = np.uint32(np.uint32(h ^ (h >> np.uint32(16))) * np.uint32(0x7feb352d))
    h = np.uint32(np.uint32(h ^ (h >> np.uint32(15))) * np.uint32(0x846ca68b))
    return np.uint32(h ^ (h >> np.uint32(16)))


@vectorised
def _find_cells(s, cells, tile, zone):  # type: ignore[no-untyped-def]
    """Find the nearest cell and the second nearest one of places, which are bent to _U and _V.

    _LEAD is how much nearer the first one is, over the zone in which the second one may be drawn.
    """
    cell_scale, bend_x, bend_y, first_p, first_q = tile[2], tile[3], tile[4], tile[5], tile[6]
    first_i, first_k = np.int32(tile[7]), np.int32(tile[8])
    for j in range(_N):
        # A bent lattice and bent relief: no homography maps one copy to another.
        u, v = _BENT * s[_Y + j] + bend_y, _BENT * s[_X + j] + bend_x
        u, v = u - np.floor(u) - _HALF, v - np.floor(v) - _HALF
        s[_U + j] = s[_X + j] + _WAVE * u * (_ONE - _TWO * abs(u))
        s[_V + j] = s[_Y + j] + _WAVE * v * (_ONE - _TWO * abs(v))
    for j in range(_N):
        p, q = s[_U + j] * cell_scale, s[_V + j] * cell_scale
        p, q = (p - _SLANT * q) + first_p, _UPRIGHT * q + first_q
        column, row = np.floor(p), np.floor(q)
        p, q = p - column, q - row
        upper = p + q > _ONE
        # Vertices: the corner (or its opposite), the one to the right, the one above.
        w0 = p + q - _ONE if upper else _ONE - p - q
        w1 = _ONE - q if upper else p
        w2 = _ONE - p if upper else q
        i, k, step = np.int32(column) + first_i, np.int32(row) + first_k, np.int32(upper)
        second_leads = w1 > w0
        most, next_most = max(w0, w1), min(w0, w1)
        i1 = i + np.int32(1) if second_leads else i + step
        k1 = k if second_leads else k + step
        i2 = i + step if second_leads else i + np.int32(1)
        k2 = k + step if second_leads else k
        leads, follows = w2 > most, w2 > next_most
        cells[_NEXT_CELL + j] = i1 if leads else (i if follows else i2)
        cells[_NEXT_CELL + _PAGE + j] = k1 if leads else (k + np.int32(1) if follows else k2)
        cells[_CELLS + j] = i if leads else i1
        cells[_CELLS + _PAGE + j] = k + np.int32(1) if leads else k1
        highest = max(most, w2)
        s[_LEAD + j] = (highest - max(min(most, w2), next_most)) / zone


@vectorised
def _place(s, cells, tile, copy, count):  # type: ignore[no-untyped-def]
    """Find where both tiles are read for a copy, the first cell or the second one, in periods."""
    a_scale, b_scale = tile[0], tile[1]
    cell, place = _CELLS + 2 * copy * _PAGE, _PLACES + 4 * copy * _PAGE
    for j in range(count):
        h = _shuffled(cells[cell + j], cells[cell + _PAGE + j])
        u, v = s[_U + j], s[_V + j]
        s[place + j] = u * a_scale + byte(h) * _FRACTION
        s[place + _PAGE + j] = v * a_scale + byte(h >> np.uint32(8)) * _FRACTION
        s[place + 2 * _PAGE + j] = u * b_scale + byte(h >> np.uint32(16)) * _FRACTION
        s[place + 3 * _PAGE + j] = v * b_scale + byte(h >> np.uint32(24)) * _FRACTION
    # Of the frame in the periods of the tiles.
    for page in range(4):
        own = tile[9 + page]
        for j in range(count):
            s[place + page * _PAGE + j] += own


@vectorised
def _at_levels(s, place, t, out, channels, count, words, side,  # type: ignore[no-untyped-def]
               first):
    """Interpolate a tile that wraps around, at whole mip levels.

    Places and levels are those at _AT and _WHOLE.

    Args:
        s, place, t: Scratch memory of float32, int32 and uint32.
        out: Page that the first channel goes to; the others follow.
        channels: Of four.
        count: Of pixels.
    """
    lowest, highest = np.int32(99), np.int32(0)
    for j in range(count):
        whole = np.int32(s[_WHOLE + j])
        lowest, highest = min(lowest, whole), max(highest, whole)
    # Of all levels of the chunk; mostly it is one.
    for k in range(lowest, highest + 1):
        own, chosen = min(k, len(side) - 1), np.float32(k)
        n, start = np.int32(side[own]), np.int32(first[own])
        wide, mask = np.float32(n), np.int32(n - 1)
        for j in range(count):
            u, v = s[_AT + j] * wide - _HALF, s[_AT + _PAGE + j] * wide - _HALF
            column, row = np.floor(u), np.floor(v)
            west, south = np.int32(np.int32(column) & mask), np.int32(np.int32(row) & mask)
            east = np.int32(np.int32(west + np.int32(1)) & mask)
            north = np.int32(np.int32(south + np.int32(1)) & mask)
            low, high = np.int32(start + south * n), np.int32(start + north * n)
            own_one = s[_WHOLE + j] == chosen
            s[_U + j] = u - column if own_one else s[_U + j]
            s[_V + j] = v - row if own_one else s[_V + j]
            place[_INDEX + j] = np.int32(low + west) if own_one else place[_INDEX + j]
            place[_EAST + j] = np.int32(low + east) if own_one else place[_EAST + j]
            place[_NORTH + j] = np.int32(high + west) if own_one else place[_NORTH + j]
            place[_BOTH + j] = np.int32(high + east) if own_one else place[_BOTH + j]
    for j in range(count):      # without a sign: an index below 0 would count from the end
        t[j] = words[np.uint32(place[_INDEX + j])]
        t[_PAGE + j] = words[np.uint32(place[_EAST + j])]
        t[2 * _PAGE + j] = words[np.uint32(place[_NORTH + j])]
        t[3 * _PAGE + j] = words[np.uint32(place[_BOTH + j])]
    for channel in range(channels):
        page, down = out + channel * _PAGE, np.uint32(8 * channel)
        for j in range(count):
            f, g = s[_U + j], s[_V + j]
            a, b = byte(t[j] >> down), byte(t[_PAGE + j] >> down)
            d, e = byte(t[2 * _PAGE + j] >> down), byte(t[3 * _PAGE + j] >> down)
            a += f * (b - a)
            d += f * (e - d)
            s[page + j] = _BYTE * (a + g * (d - a))


@vectorised
def _texels(s, place, t, which, at, out, channels, levels,  # type: ignore[no-untyped-def]
            finer, count, words, side, first):
    """Interpolate a tile between texels and between mip levels.

    Args:
        which: Scratch memory of int64.
        at: Page of the places in it; `out`: of its channels, 0 to 1; `levels`: of mip levels.
        finer: Subtracted from those.
    """
    few = NO_PIXELS
    for j in range(count):
        own = max(s[levels + j] - finer, _ZERO)
        whole = np.floor(own)
        s[_PART + j], s[_WHOLE + j] = own - whole, whole
    for j in range(2 * _PAGE):
        s[_AT + j] = s[at + j]
    _at_levels(s, place, t, out, channels, count, words, side, first)
    # A third of the pixels lie between two levels.
    for j in range(count):
        which[few] = j
        few += s[_PART + j] > _ZERO     # without a branch, which could not be foreseen
    if few:
        for k in range(few):
            j = which[k]
            s[_AT + k], s[_AT + _PAGE + k] = s[at + j], s[at + _PAGE + j]
            s[_WHOLE + k] = s[_WHOLE + j] + _ONE
        _at_levels(s, place, t, _RAW, channels, few, words, side, first)
        for k in range(few):
            j = which[k]
            for page in range(0, channels * _PAGE, _PAGE):
                own = s[out + page + j]
                s[out + page + j] = own + s[_PART + j] * (s[_RAW + page + k] - own)


@inlined
def _decode(s, i, horizon, slope_x, slope_y, tangent):  # type: ignore[no-untyped-def]
    """Write slopes and tangents of the horizon of the chunk that begins at i."""
    middle, half = horizon[0], horizon[1]
    for j in range(_N):
        slope_x[i + j] = (s[_OUT + j] - _CODE_ZERO) * _SLOPES
    for j in range(_N):
        slope_y[i + j] = (s[_OUT + _PAGE + j] - _CODE_ZERO) * _SLOPES
    for j in range(_N):
        tangent[i + j] = middle + (_TWO * s[_OUT + 2 * _PAGE + j] - _ONE) * half


@vectorised
def relief_of(at, near, grid, tile, zone, horizon,  # type: ignore[no-untyped-def]
              coarse, coarse_side, coarse_first, fine, fine_side, fine_first, relief):
    """Look up where each pixel of a band is in the relief, and its slopes and horizons there.

    Args:
        at, grid: As `ground_band.place` and `grid_rows.light_of_grid` fill them in.
        near: (n,) positive where slopes and horizons are wanted.
        tile: (13,) 1 / periods of the tiles and 1 / side of the cells [1/m]; `place_in_site`.
        zone: Of the way to the middle of a cell, where the next one may be drawn.
        horizon: Centre and half range of tangents.
        coarse, coarse_side, coarse_first: A tile as `surface.MipTexels`: slope x, slope y,
            tangent of the horizon, salience.
        fine, fine_side, fine_first: The other tile, two levels finer.
        relief: (8, n) filled in: slopes of the coarse tile along x and y, and of the fine one;
            tangents of the horizon of both; place along x and y in periods of the coarse tile.
    """
    depth, x, y, detail = at[0], at[1], at[2], grid[6]
    slope_ax, slope_ay, slope_bx, slope_by, horizon_a, horizon_b, place_x, place_y = (
        relief[0], relief[1], relief[2], relief[3], relief[4], relief[5], relief[6], relief[7])
    s, cells = np.empty(_FLOATS, np.float32), np.empty(8 * _PAGE, np.int32)
    t, which = np.empty(4 * _PAGE, np.uint32), np.empty(_N, np.int64)
    between = np.empty(_N, np.int64)
    for c in range(len(depth) // _N):
        i = c * _N
        if not any_positive(depth, i):
            continue
        for j in range(_N):
            s[_X + j], s[_Y + j], s[_LEVEL + j] = x[i + j], y[i + j], detail[i + j]
        _find_cells(s, cells, tile, zone)
        _place(s, cells, tile, 0, _N)
        # Few pixels lie between two cells.
        few = NO_PIXELS
        for j in range(_N):
            which[few] = j
            few += s[_LEAD + j] < _ONE
        for k in range(few):
            j = which[k]
            s[_U + k], s[_V + k], s[_FEW + k] = s[_U + j], s[_V + j], s[_LEVEL + j]
            cells[_NEXT_CELL + k] = cells[_NEXT_CELL + j]
            cells[_NEXT_CELL + _PAGE + k] = cells[_NEXT_CELL + _PAGE + j]
        _place(s, cells, tile, 1, few)
        sloping = any_positive(near, i)
        if sloping:
            _texels(s, cells, t, between, _PLACES, _OUT, 4, _LEVEL, _TWO,
                    _N, coarse, coarse_side, coarse_first)
        else:
            for k in range(few):
                j = which[k]
                s[_OWN + k], s[_OWN + _PAGE + k] = s[_PLACES + j], s[_PLACES + _PAGE + j]
            _texels(s, cells, t, between, _OWN, _OUT, 4, _FEW, _TWO, few,
                    coarse, coarse_side, coarse_first)
            for k in range(few - 1, -1, -1):    # from the last one: it is not overwritten
                s[_OUT + 3 * _PAGE + which[k]] = s[_OUT + 3 * _PAGE + k]
        if few:
            _texels(s, cells, t, between, _PLACES + 4 * _PAGE, _NEXT, 4, _FEW, _TWO, few,
                    coarse, coarse_side, coarse_first)
            # The coarse tile chooses for both.
            for k in range(few):
                j = which[k]
                lead = s[_LEAD + j] + s[_OUT + 3 * _PAGE + j] - s[_NEXT + 3 * _PAGE + k]
                other = min(max(_HALF - _EDGE * lead, _ZERO), _ONE)
                for page in range(0, 3 * _PAGE, _PAGE):
                    own = s[_OUT + page + j]
                    s[_OUT + page + j] = own + other * (s[_NEXT + page + k] - own)
                if other > _HALF:
                    for page in range(0, 4 * _PAGE, _PAGE):
                        s[_PLACES + page + j] = s[_PLACES + 4 * _PAGE + page + k]
        for j in range(_N):
            place_x[i + j], place_y[i + j] = s[_PLACES + j], s[_PLACES + _PAGE + j]
        if not sloping:
            continue
        _decode(s, i, horizon, slope_ax, slope_ay, horizon_a)
        _texels(s, cells, t, between, _PLACES + 2 * _PAGE, _OUT, 3, _LEVEL, _ZERO,
                _N, fine, fine_side, fine_first)
        _decode(s, i, horizon, slope_bx, slope_by, horizon_b)


@vectorised
def shape_of_block(corner_x, corner_y, texel, tile, zone,  # type: ignore[no-untyped-def]
                   coarse, coarse_side, coarse_first, coarse_shape, fine_shape, result):
    """Fill in a block of the shape of the relief: heights, and how steeply they rise.

    Args:
        corner_x, corner_y: Of the block; `texel` is the side of one [m].
        tile, zone, coarse, coarse_side, coarse_first: As for `relief_of`.
        coarse_shape, fine_shape: (n, n, 2) heights [m] and bounds of slopes of both tiles, with
            texels as long as those of the block.
        result: (m, m) a view of the map, of texels as `row_math.packed_shape` has them.
    """
    s, cells = np.empty(_FLOATS, np.float32), np.empty(8 * _PAGE, np.int32)
    t, between = np.empty(4 * _PAGE, np.uint32), np.empty(_N, np.int64)
    m = len(result)
    for j in range(_N):
        s[_LEVEL + j] = _ZERO
    for r in range(m):
        y = corner_y + (np.float32(r) + _HALF) * texel
        for start in range(0, m, _N):
            for j in range(_N):
                s[_X + j] = corner_x + (np.float32(start + j) + _HALF) * texel
                s[_Y + j] = y
            _find_cells(s, cells, tile, zone)
            _place(s, cells, tile, 0, _N)
            _place(s, cells, tile, 1, _N)
            _texels(s, cells, t, between, _PLACES, _OUT, 4, _LEVEL, _ZERO, _N, coarse,
                    coarse_side, coarse_first)
            _texels(s, cells, t, between, _PLACES + 4 * _PAGE, _NEXT, 4, _LEVEL, _ZERO, _N,
                    coarse, coarse_side, coarse_first)
            for j in range(min(_N, m - start)):
                lead = s[_LEAD + j] + s[_OUT + 3 * _PAGE + j] - s[_NEXT + 3 * _PAGE + j]
                other = min(max(_HALF - _SOFT * lead, _ZERO), _ONE)
                if s[_LEAD + j] >= _ONE:
                    other = _ZERO
                height, steep = _ZERO, _ZERO
                for copy in range(2):
                    share = other if copy else _ONE - other
                    if share > _ZERO:
                        page = _PLACES + 4 * _PAGE * copy + j
                        for texels, at in ((coarse_shape, page), (fine_shape, page + 2 * _PAGE)):
                            u, v = s[at], s[at + _PAGE]
                            height += share * _between(u, v, texels, 0)
                            steep += share * _between(u, v, texels, 1)
                result[r, start + j] = packed_shape(height, steep)


@vectorised
def _between(u, v, texels, k):  # type: ignore[no-untyped-def]
    """Return a channel of a texture that wraps around, at a place in periods of it."""
    n = len(texels)
    u, v = u * np.float32(n) - _HALF, v * np.float32(n) - _HALF
    column, row = np.floor(u), np.floor(v)
    u, v = u - column, v - row
    i, j = np.int64(column) % n, np.int64(row) % n
    east, north = (i + 1) % n, (j + 1) % n
    low = texels[j, i, k] + u * (texels[j, east, k] - texels[j, i, k])
    high = texels[north, i, k] + u * (texels[north, east, k] - texels[north, i, k])
    return low + v * (high - low)
