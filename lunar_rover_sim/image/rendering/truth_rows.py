"""What is true of pixels of the ground; relief below the grid counts where it has shape."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.image.rendering.row_math import disc, of_half, shape_at, shape_share

_ZERO, _HALF, _ONE, _TWO = (np.float32(x) for x in (0.0, 0.5, 1.0, 2.0))
_BESIDE, _BYTES = np.float32(0.6), np.float32(255.0)
_TEXEL = np.float32(0.003125)           # of the shape of the relief [m]


@compiled
def _height(x, y, shape, scale, centre):  # type: ignore[no-untyped-def]
    """Return the height of the relief as far as it has shape."""
    share = shape_share(x - centre[0], y - centre[1], centre[2])
    return share * shape_at(x, y, shape, scale)[0]


@compiled
def shape_of(at, levels, ground, side, prints, has_tracks,  # type: ignore[no-untyped-def]
             shape, relief, centre, cells, entries, label, crater, normal):
    """Fill in label, crater and normal of each pixel of a band.

    Args:
        at: (7, n) as `ground_band.place` fills it in.
        levels, ground: As for `grid_rows.light_of_grid`; `side` of the finest mip level.
        prints: As `track_map.prints_of` fills it in, of the finest level; it counts with
            `has_tracks`.
        shape, relief, centre: As for `ground.cast`; (0, 0) where relief has none.
        cells, entries: As `crater_map.CraterLists`; (0, 0, 0, 2) where craters are not asked for.
        label, crater: (n,) filled in.
        normal: (3 or more, n) of which three are filled in.
    """
    depth, x, y = at[0], at[1], at[2]
    print_x, print_y, pressed, loose = prints[0], prints[1], prints[5], prints[6]
    normal_x, normal_y, normal_z = normal[0], normal[1], normal[2]
    low = np.uint64(0xffffffff)
    for k in range(len(depth)):
        label[k] = crater[k] = 0
        normal_x[k] = normal_y[k] = normal_z[k] = _ZERO
        if depth[k] <= _ZERO:
            continue
        reach, layer = max(abs(x[k]), abs(y[k])), 0
        for n in range(1, len(levels)):
            if reach > levels[n - 1, 3]:
                layer = n
        wide = np.float32(side)
        u = min(max((x[k] * levels[layer, 0] + levels[layer, 1]) * wide - _HALF, _ZERO),
                wide - _ONE)
        v = min(max((y[k] * levels[layer, 0] + levels[layer, 1]) * wide - _HALF, _ZERO),
                wide - _ONE)
        i, j = np.int64(u), np.int64(v)
        u, v = u - np.float32(i), v - np.float32(j)
        east, north = min(i + 1, side - 1), min(j + 1, side - 1)
        base = layer * side * side
        a, b = ground[base + j * side + i], ground[base + j * side + east]
        d, e = ground[base + north * side + i], ground[base + north * side + east]
        slope_x, slope_y = _ZERO, _ZERO
        for n in range(2):
            shift = np.uint64(16 * n)
            p = of_half(np.uint32((a >> shift) & low))
            q = of_half(np.uint32((b >> shift) & low))
            r = of_half(np.uint32((d >> shift) & low))
            s = of_half(np.uint32((e >> shift) & low))
            p += u * (q - p)
            r += u * (s - r)
            p += v * (r - p)
            if n:
                slope_y = p
            else:
                slope_x = p
        if len(shape):
            h = _HALF * _TEXEL
            rise_x = (_height(x[k] + h, y[k], shape, relief[0], centre)
                      - _height(x[k] - h, y[k], shape, relief[0], centre)) / _TEXEL
            rise_y = (_height(x[k], y[k] + h, shape, relief[0], centre)
                      - _height(x[k], y[k] - h, shape, relief[0], centre)) / _TEXEL
            left = _ONE - max(pressed[k], _BESIDE * loose[k]) if has_tracks else _ONE
            slope_x += rise_x * left
            slope_y += rise_y * left
        label[k] = 1
        if has_tracks:
            slope_x += print_x[k]
            slope_y += print_y[k]
            if max(pressed[k], loose[k]) > _HALF:
                label[k] = 3
        up = _ONE / np.sqrt(slope_x * slope_x + slope_y * slope_y + _ONE)
        normal_x[k], normal_y[k], normal_z[k] = -slope_x * up, -slope_y * up, up
        if len(cells):
            n = cells.shape[1]
            half = levels[layer, 3]
            u, v = _HALF + _HALF * x[k] / half, _HALF + _HALF * y[k] / half
            column = int(min(max(np.floor(u * np.float32(n)), 0.0), n - 1.0))
            line = int(min(max(np.floor(v * np.float32(n)), 0.0), n - 1.0))
            span = cells[layer, line, column]
            for m in range(int(span[0]), int(span[1])):
                p, q = x[k] - entries[m, 0], y[k] - entries[m, 1]
                if p * p + q * q < entries[m, 2]:
                    crater[k] = np.uint16(entries[m, 3])
                    break


@compiled
def light_of(depth, sunlit, of_rover, normal_x, normal_y, normal_z,  # type: ignore[no-untyped-def]
             sun, shines, seen, hidden, partly):
    """Fill in the shares of the sun of each pixel of a band, as bytes.

    Args:
        sunlit, of_rover: (n,) shares that all but the rover leave, and that it leaves.
        normal_x, normal_y, normal_z: (n,) of what is lit.
        sun: Unit vector to it, three unused, radius of its disc [rad].
        seen, hidden, partly: (n,) seen; hidden by the rover alone; how far from all or none.
    """
    for k in range(len(depth)):
        seen[k] = hidden[k] = partly[k] = 0
        if depth[k] <= _ZERO:
            continue
        share = _ZERO
        if shines:
            mu0 = normal_x[k] * sun[0] + normal_y[k] * sun[1] + normal_z[k] * sun[2]
            share = min(sunlit[k], disc(mu0, sun[6]))
        both = share * of_rover[k]
        seen[k] = np.uint8(both * _BYTES + _HALF)
        hidden[k] = np.uint8((share - both) * _BYTES + _HALF)
        partly[k] = np.uint8((_ONE - abs(_TWO * both - _ONE)) * _BYTES + _HALF)
