"""Pixels of rocks and the rover, one after the other: where they are, and how a rock is lit."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import compiled, inlined
from lunar_rover_sim.base.fast_math import log2
from lunar_rover_sim.image.lidar.ray_march import meet_rock
from lunar_rover_sim.image.rendering.row_math import byte, disc

_ZERO, _HALF, _ONE, _TWO = (np.float32(x) for x in (0.0, 0.5, 1.0, 2.0))
_CODE, _LEAST = np.float32(1.0 / 65535.0), np.float32(1e-3)
_BYTE = np.float32(1.0 / 255.0)
# Grain has one period on all rocks, lumps and pits scale with the rock: 1 / period and strength.
# Seen from near, they tilt faces by 8 and 15 degrees RMS, a choice after AS17-137-20905.
_GRAIN, _GRAIN_TILT, _LUMPS, _LUMPS_TILT = (np.float32(x) for x in (1.0 / 3.1, 3.0, 0.26, 5.6))
_GRAIN_APART, _LUMPS_APART, _APART = (np.float32(x) for x in (0.381966, 0.6180339, 0.37))
_OFF = np.float32(0.002)        # of a ray to the sun from the face, in diameters
_MIDDLE, _GRAZING = np.float32(0.501961), np.float32(0.02)


@compiled
def count(first, last, depth, surface):  # type: ignore[no-untyped-def]
    """Return how many pixels of rocks, and how many of the rover, some rows show."""
    rocks, rover = 0, 0
    for r in range(first, last):
        for c in range(depth.shape[1]):
            if depth[r, c] < _ZERO:
                if np.int32(surface[r, c, 1]) < 0:
                    rover += 1
                else:
                    rocks += 1
    return rocks, rover


@compiled
def find(first, last, depth, surface, view, of_rover, places,  # type: ignore[no-untyped-def]
         numbers, out):
    """Fill in pixels of rocks, or of the rover, of some rows.

    Args:
        depth: (h, w), negative for both [m].
        surface: (h, w, 2) packed normal and number.
        view: As `view.numbers`.
        places: (n,) of pixels in the image.
        numbers: (n,) of rocks, or of parts of the rover.
        out: (10, n) depth; place, x and y in the world, z over the camera; unit vector to the
            camera; normal.
    """
    w, k = depth.shape[1], 0
    for r in range(first, last):
        for c in range(w):
            number = np.int32(surface[r, c, 1])
            if depth[r, c] >= _ZERO or (number < 0) != of_rover:
                continue
            places[k], numbers[k] = r * w + c, -1 - number if of_rover else number
            column, row, far = np.float32(c), np.float32(r), -depth[r, c]
            x = view[0] + view[3] * column + view[6] * row
            y = view[1] + view[4] * column + view[7] * row
            z = view[2] + view[5] * column + view[8] * row
            shrink = -_ONE / np.sqrt(x * x + y * y + z * z)
            out[0, k] = far
            out[1, k], out[2, k], out[3, k] = x * far + view[9], y * far + view[10], z * far
            out[4, k], out[5, k], out[6, k] = x * shrink, y * shrink, z * shrink
            # As shaders/surface.frag packs it.
            code = surface[r, c, 0]
            p = np.float32(code & np.uint32(0xffff)) * _CODE * _TWO - _ONE
            q = np.float32(code >> np.uint32(16)) * _CODE * _TWO - _ONE
            up = _ONE - abs(p) - abs(q)
            if up < _ZERO:
                a, b = _ONE - abs(q), _ONE - abs(p)
                p, q = a if p >= _ZERO else -a, b if q >= _ZERO else -b
            length = _ONE / np.sqrt(p * p + q * q + up * up)
            out[7, k], out[8, k], out[9, k] = p * length, q * length, up * length
            k += 1


@inlined
def _texel(words, start, n, u, v):  # type: ignore[no-untyped-def]
    """Return two channels of a mip level between its texels, which wrap around; u, v: places."""
    u = (u - np.floor(u)) * np.float32(n) - _HALF
    v = (v - np.floor(v)) * np.float32(n) - _HALF
    column, row = np.floor(u), np.floor(v)
    u, v = u - column, v - row
    i, j = (np.int64(column) + n) % n, (np.int64(row) + n) % n
    east, north = (i + 1) % n, (j + 1) % n
    a, b = words[start + j * n + i], words[start + j * n + east]
    d, e = words[start + north * n + i], words[start + north * n + east]
    low, high = byte(a) + u * (byte(b) - byte(a)), byte(d) + u * (byte(e) - byte(d))
    x = _BYTE * (low + v * (high - low))
    a, b, d, e = a >> np.uint32(8), b >> np.uint32(8), d >> np.uint32(8), e >> np.uint32(8)
    low, high = byte(a) + u * (byte(b) - byte(a)), byte(d) + u * (byte(e) - byte(d))
    return x, _BYTE * (low + v * (high - low))


@inlined
def _tile(words, side, first, u, v, level):  # type: ignore[no-untyped-def]
    """Return two channels of a tile at a place over its period, between two mip levels."""
    level = min(max(level, _ZERO), np.float32(len(side) - 1))
    k = int(level)
    part = level - np.float32(k)
    x, y = _texel(words, first[k], side[k], u, v)
    if part > _ZERO:
        p, q = _texel(words, first[k + 1], side[k + 1], u, v)
        x += part * (p - x)
        y += part * (q - y)
    return x, y


@inlined
def _step(low, high, x):  # type: ignore[no-untyped-def]
    """Return how far x has come from low to high, 0 to 1, without edges."""
    t = min(max((x - low) / (high - low), _ZERO), _ONE)
    return t * t * (np.float32(3.0) - _TWO * t)


@compiled
def rock_surface(numbers, at, table, hulls, words, side, first,  # type: ignore[no-untyped-def]
                 sun, constants, normal, out):
    """Fill in what the light of pixels of rocks follows from.

    Args:
        numbers: (n,) of rocks.
        at: (10, n) as `find` fills it in.
        table: (m, 21) as `rock_pass.rock_table`.
        hulls: As `RockHulls.arrays`, of the same rocks.
        words, side, first: Tile of the relief below the grid, as `MipTexels`.
        sun: (4,) unit vector to it, radius of its disc [rad].
        constants: Size of a pixel at depth 1; roughness, 1 is usual; height of the camera [m].
        normal: (3, n) of the lumps, filled in.
        out: (4, n) filled in: share of the sun that the world leaves, albedo, exitance of the
            ground around, share of soil.
    """
    rough, most = constants[1], np.float32(side[0])
    for k in range(len(numbers)):
        number = numbers[k]
        rock = table[number]
        index = rock[20]
        a, b, d = at[1, k] - rock[0], at[2, k] - rock[1], at[3, k] + constants[2] - rock[2]
        p = a * rock[3] + b * rock[4] + d * rock[5]
        q = a * rock[6] + b * rock[7] + d * rock[8]
        r = a * rock[9] + b * rock[10] + d * rock[11]
        diameter = rock[12]
        nx, ny, nz = at[7, k], at[8, k], at[9, k]
        off_x, off_y, off_z = diameter * _OFF * nx, diameter * _OFF * ny, diameter * _OFF * nz
        # Texture lies across the axis of the rock that the face looks along: none is drawn out.
        e = abs(nx * rock[3] + ny * rock[4] + nz * rock[5])
        f = abs(nx * rock[6] + ny * rock[7] + nz * rock[8])
        if abs(nx * rock[9] + ny * rock[10] + nz * rock[11]) > max(e, f):
            u, v = p, q
        elif e > f:
            u, v = q, r
        else:
            u, v = p + _APART, r + _APART
        texels = log2(max(at[0, k] * constants[0] * most, _LEAST * _LEAST)) + _HALF
        scale = _LUMPS / diameter
        shift = index * _LUMPS_APART
        shift -= np.floor(shift)
        lump_x, lump_y = _tile(words, side, first, u * scale + shift, v * scale + shift,
                               texels + log2(scale))
        shift = index * _GRAIN_APART
        shift -= np.floor(shift)
        grain_x, grain_y = _tile(words, side, first, u * _GRAIN + shift, v * _GRAIN + shift,
                                 texels + log2(_GRAIN))
        tilt_x = _LUMPS_TILT * (lump_x - _MIDDLE) + _GRAIN_TILT * (grain_x - _MIDDLE)
        tilt_y = _LUMPS_TILT * (lump_y - _MIDDLE) + _GRAIN_TILT * (grain_y - _MIDDLE)
        # Soil lies banked up at the foot, and thinly on what faces up.
        bank = diameter * (np.float32(0.1) + np.float32(0.25) * (lump_x - np.float32(0.35)))
        high = d + rock[2] - rock[14]
        soil = _ONE - _step(np.float32(0.4) * bank, bank, high)
        soil = max(soil, _HALF * _step(np.float32(0.7), np.float32(0.95),
                                       nz + np.float32(0.6) * (lump_y - _HALF)))
        soil *= min(rough, _ONE)
        facing = nx * sun[0] + ny * sun[1] + nz * sun[2]
        x, y = nx - _HALF * soil * nx, ny - _HALF * soil * ny
        z = nz + soil * (np.float32(0.87) - nz)
        length = _ONE / np.sqrt(x * x + y * y + z * z)
        x, y, z = x * length, y * length, z * length
        # Two directions across the normal.
        e, f, g = (y * np.float32(0.6) - z * np.float32(0.71),
                   z * np.float32(0.37) - x * np.float32(0.6),
                   x * np.float32(0.71) - y * np.float32(0.37))
        length = _ONE / np.sqrt(max(e * e + f * f + g * g, _LEAST * _LEAST))
        e, f, g = e * length, f * length, g * length
        nx = x + tilt_x * e + tilt_y * (y * g - z * f)
        ny = y + tilt_x * f + tilt_y * (z * e - x * g)
        nz = z + tilt_x * g + tilt_y * (x * f - y * e)
        length = _ONE / np.sqrt(nx * nx + ny * ny + nz * nz)
        normal[0, k], normal[1, k], normal[2, k] = nx * length, ny * length, nz * length
        up = min(max(_HALF + d / (np.float32(0.7) * diameter), _ZERO), _ONE)
        clearance = rock[15] + up * (rock[17] - rock[15])
        occluder = rock[16] + up * (rock[18] - rock[16])
        # Lumps beyond the terminator lie in the shadow of the rock itself.
        out[0, k] = disc(clearance / max(occluder, _LEAST), sun[3]) * min(max(
            np.float32(0.4) + np.float32(5.0) * facing, _ZERO), _ONE)
        # One piece of a rock may shade another.
        shape = hulls.shape[number]
        if out[0, k] > _ZERO and hulls.piece_first[shape + 1] - hulls.piece_first[shape] > 1:
            if meet_rock(hulls, number, at[1, k] + off_x, at[2, k] + off_y, at[3, k] + constants[2]
                         + off_z, sun[0], sun[1], sun[2])[0] < np.inf:
                out[0, k] = _ZERO
        out[1, k], out[2, k], out[3, k] = rock[13], rock[19], soil


@compiled
def angles(at, normal, sun, lit, out):  # type: ignore[no-untyped-def]
    """Fill in cosines of incidence, emission and phase, (3, n); incidence is 0 in the dark."""
    for k in range(len(lit)):
        towards = normal[0, k] * sun[0] + normal[1, k] * sun[1] + normal[2, k] * sun[2]
        out[0, k] = towards if lit[k] > _ZERO else _ZERO
        out[1, k] = max(normal[0, k] * at[4, k] + normal[1, k] * at[5, k]
                        + normal[2, k] * at[6, k], _GRAZING)
        out[2, k] = at[4, k] * sun[0] + at[5, k] * sun[1] + at[6, k] * sun[2]


@compiled
def mixed(soil, of_rock, of_soil, result):  # type: ignore[no-untyped-def]
    """Fill in the reflectance of rock, a share of which lies under soil."""
    for k in range(len(soil)):
        result[k] = of_rock[k] + soil[k] * (of_soil[k] - of_rock[k])


@compiled
def rock_radiance(reflectance, lit, around, albedo, normal_z,  # type: ignore[no-untyped-def]
                  irradiance, diffuse, direct, whole):
    """Fill in the radiance of the sun, and that together with what the ground scatters."""
    for k in range(len(lit)):
        direct[k] = irradiance * reflectance[k] * lit[k]
        whole[k] = direct[k] + (irradiance * diffuse * albedo[k] * around[k] * _HALF
                                * (_ONE - normal_z[k]))


@compiled
def scatter(places, values, image, add):  # type: ignore[no-untyped-def]
    """Write values to their pixels of a flat image, or add them."""
    for k in range(len(places)):
        if add:
            image[places[k]] += values[k]
        else:
            image[places[k]] = values[k]
