"""Pixels of rocks and the rover, one after the other: where they are, and how they are lit.

Rocks follow the law of the ground, the rover Lambert's law with gloss (GGX; Walter et al., 2007).
"""

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
        view: As `ViewNumbers.numbers`.
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


@compiled   # inlined, it would count references to its arrays for each pixel
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


@compiled
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


_FOUR, _TENTH = np.float32(4.0), np.float32(0.1)
_OVER_PI, _TINY = np.float32(0.318309886), np.float32(1e-9)
_CRUMPLE_M = np.float32(0.011)  # size of the facets of crumpled foil
_METAL = np.float32(0.2)    # reflectance beyond which a surface is a metal: it tints its gloss
_MAP_OFF, _LIFT, _SAMPLES_APART = np.float32(0.0015), np.float32(0.003), np.float32(0.65)


@inlined
def _crumple(x, y, z):  # type: ignore[no-untyped-def]
    """Return a tilt: that of facets around random points.

    Worley, A cellular texture basis function, 1996.
    """
    left, near, low = np.floor(x - _HALF), np.floor(y - _HALF), np.floor(z - _HALF)
    nearest, tx, ty, tz = np.float32(1e9), _ZERO, _ZERO, _ZERO
    for k in range(8):
        u, v, w = left + np.float32(k & 1), near + np.float32(k >> 1 & 1), low + np.float32(k >> 2)
        h = (np.uint32(np.uint32(np.int32(u)) * np.uint32(0x9e3779b9))
             ^ np.uint32(np.uint32(np.int32(v)) * np.uint32(0x85ebca6b))
             ^ np.uint32(np.uint32(np.int32(w)) * np.uint32(0xc2b2ae35)))
        h = np.uint32((h ^ (h >> np.uint32(15))) * np.uint32(0x846ca68b))
        h = np.uint32(h ^ (h >> np.uint32(16)))
        p = np.float32(h & np.uint32(0x3ff)) / np.float32(1023.0) - _HALF
        q = np.float32((h >> np.uint32(10)) & np.uint32(0x3ff)) / np.float32(1023.0) - _HALF
        r = np.float32((h >> np.uint32(20)) & np.uint32(0x3ff)) / np.float32(1023.0) - _HALF
        a = u + _HALF + np.float32(0.9) * p - x
        b = v + _HALF + np.float32(0.9) * q - y
        c = w + _HALF + np.float32(0.9) * r - z
        square = a * a + b * b + c * c
        if square < nearest:
            nearest, tx, ty, tz = square, r, p, q
    return tx, ty, tz


@inlined
def _own_share(x, y, z, from_sun, seen):  # type: ignore[no-untyped-def]
    """Return the share of the sun that the rover itself leaves; a mean over more than a texel."""
    n = len(seen)
    u = from_sun[0, 0] * x + from_sun[0, 1] * y + from_sun[0, 2] * z + from_sun[0, 3]
    v = from_sun[1, 0] * x + from_sun[1, 1] * y + from_sun[1, 2] * z + from_sun[1, 3]
    w = from_sun[2, 0] * x + from_sun[2, 1] * y + from_sun[2, 2] * z + from_sun[2, 3]
    own = _HALF + _HALF * w - _MAP_OFF
    u = (_HALF + _HALF * u) * np.float32(n) - _HALF
    v = (_HALF + _HALF * v) * np.float32(n) - _HALF
    lit = _ZERO
    for k in range(4):
        p = u + (_SAMPLES_APART if k & 1 else -_SAMPLES_APART)
        q = v + (_SAMPLES_APART if k >> 1 else -_SAMPLES_APART)
        column, row = np.floor(p), np.floor(q)
        p, q = p - column, q - row
        for m in range(4):
            i = min(max(np.int64(column) + (m & 1), 0), n - 1)
            j = min(max(np.int64(row) + (m >> 1), 0), n - 1)
            if own <= seen[j, i]:
                lit += (p if m & 1 else _ONE - p) * (q if m >> 1 else _ONE - q)
    return np.float32(0.25) * lit


@inlined
def _gloss(nx, ny, nz, vx, vy, vz, lx, ly, lz, rough, base):  # type: ignore[no-untyped-def]
    """Return the radiance of an irradiance of one, without the cosine of incidence."""
    mx, my, mz = vx + lx, vy + ly, vz + lz
    length = _ONE / np.sqrt(max(mx * mx + my * my + mz * mz, _TINY))
    mx, my, mz = mx * length, my * length, mz * length
    alpha2 = rough * rough
    nm = max(nx * mx + ny * my + nz * mz, _ZERO)
    lm = max(lx * mx + ly * my + lz * mz, _TENTH)
    wide = nm * nm * (alpha2 - _ONE) + _ONE
    away = _ONE - lm
    fresnel = base + (_ONE - base) * away * away * away * away * away
    # Visibility after Kelemen and Szirmay-Kalos, 2001.
    return alpha2 * _OVER_PI / (wide * wide) * fresnel / (_FOUR * lm * lm)


@compiled
def light_rover(numbers, at, parts, links, body, from_sun, seen,  # type: ignore[no-untyped-def]
                sun, irradiance, camera_z, lamp, out, shares):
    """Fill in the light of pixels of the rover.

    Args:
        numbers: (n,) of parts.
        at: (10, n) as `object_rows.find` fills it in.
        parts: As `RoverPass.parts`.
        links: (links, 4, 4) world poses.
        body, from_sun, seen: As `BodyLight`.
        sun: (4,) unit vector to it, radius of its disc [rad].
        irradiance: Normal [W/m2].
        camera_z: Height of the camera [m].
        lamp: (4, n) irradiance of the lamp and unit vector to it; (4, 0) without one.
        out: (4, n) filled in: radiance; what is white gloss of it, and of the sun and the ground;
            what came from the ground; what came from the lamp.
        shares: (2, n) filled in: of the sun that the world leaves, and that the rover leaves.
    """
    for k in range(len(numbers)):
        part = parts[numbers[k]]
        albedo, rough, base, crumpled = part[1], part[4], part[5], part[6]
        x, y, z = at[1, k], at[2, k], at[3, k] + camera_z
        vx, vy, vz = at[4, k], at[5, k], at[6, k]
        face_x, face_y, face_z = at[7, k], at[8, k], at[9, k]
        nx, ny, nz = face_x, face_y, face_z
        if crumpled > _ZERO:
            link = links[int(part[0])]
            a, b, c = x - link[0, 3], y - link[1, 3], z - link[2, 3]
            tx, ty, tz = _crumple(
                (a * link[0, 0] + b * link[1, 0] + c * link[2, 0]) / _CRUMPLE_M,
                (a * link[0, 1] + b * link[1, 1] + c * link[2, 1]) / _CRUMPLE_M,
                (a * link[0, 2] + b * link[1, 2] + c * link[2, 2]) / _CRUMPLE_M)
            nx, ny, nz = (nx + _TWO * crumpled * tx, ny + _TWO * crumpled * ty,
                          nz + _TWO * crumpled * tz)
            length = _ONE / np.sqrt(nx * nx + ny * ny + nz * nz)
            nx, ny, nz = nx * length, ny * length, nz * length
        lift = max(_GRAZING - (nx * vx + ny * vy + nz * vz), _ZERO)
        nx, ny, nz = nx + lift * vx, ny + lift * vy, nz + lift * vz
        length = _ONE / np.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx * length, ny * length, nz * length
        up = min(max((z - body[0]) / max(body[1] - body[0], _LEAST), _ZERO), _ONE)
        clearance, occluder = (body[2] + up * (body[4] - body[2]),
                               body[3] + up * (body[5] - body[3]))
        lit = disc(clearance / max(occluder, _LEAST), sun[3])
        own = _ZERO
        if face_x * sun[0] + face_y * sun[1] + face_z * sun[2] > _ZERO:
            own = _own_share(x + _LIFT * face_x, y + _LIFT * face_y, z + _LIFT * face_z,
                             from_sun, seen)
        shares[0, k], shares[1, k] = lit, own
        sunlight = irradiance * lit * own * max(nx * sun[0] + ny * sun[1] + nz * sun[2], _ZERO)
        metal = _ONE if base > _METAL else _ZERO
        diffuse = _OVER_PI * albedo * (_ONE - metal * base)
        facing = nx * vx + ny * vy + nz * vz
        # What a surface mirrors of the ground; the sky is black.
        down = vz - _TWO * facing * nz
        below = min(max((down + rough) / (_TWO * rough), _ZERO), _ONE)
        below = below * below * (np.float32(3.0) - _TWO * below)
        away = _ONE - max(facing, _ZERO)
        grazing = base + (_ONE - base) * away * away * away * away * away * (_ONE - rough)
        of_ground = diffuse * body[6] * _HALF * (_ONE - nz)
        shine = _gloss(nx, ny, nz, vx, vy, vz, sun[0], sun[1], sun[2], rough, base) * sunlight
        shine_ground = grazing * below * _OVER_PI * body[6]
        of_lamp = _ZERO
        if lamp.shape[1]:
            # The rover casts no shadow in this light.
            lx, ly, lz = lamp[1, k], lamp[2, k], lamp[3, k]
            of_lamp = (lamp[0, k] * max(nx * lx + ny * ly + nz * lz, _ZERO)
                       * (diffuse + _gloss(nx, ny, nz, vx, vy, vz, lx, ly, lz, rough, base)))
        out[0, k] = diffuse * sunlight + of_ground + shine + shine_ground + of_lamp
        out[1, k] = (_ONE - metal) * (shine + shine_ground)
        out[2, k], out[3, k] = of_ground + shine_ground, of_lamp
