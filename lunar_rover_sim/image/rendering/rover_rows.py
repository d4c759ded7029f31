"""How pixels of the rover are lit: Lambert's law, and gloss (GGX; Walter et al., 2007)."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import compiled, inlined
from lunar_rover_sim.image.rendering.row_math import disc

_ZERO, _HALF, _ONE, _TWO, _FOUR = (np.float32(x) for x in (0.0, 0.5, 1.0, 2.0, 4.0))
_LEAST, _GRAZING, _TENTH = np.float32(1e-3), np.float32(0.02), np.float32(0.1)
_OVER_PI, _TINY = np.float32(0.318309886), np.float32(1e-9)
_CRUMPLE_M = np.float32(0.011)  # size of the facets of crumpled foil
_METAL = np.float32(0.2)    # reflectance beyond which a surface is a metal: it tints its gloss
_OFF, _LIFT, _APART = np.float32(0.0015), np.float32(0.003), np.float32(0.65)


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
    own = _HALF + _HALF * w - _OFF
    u = (_HALF + _HALF * u) * np.float32(n) - _HALF
    v = (_HALF + _HALF * v) * np.float32(n) - _HALF
    lit = _ZERO
    for k in range(4):
        p = u + (_APART if k & 1 else -_APART)
        q = v + (_APART if k >> 1 else -_APART)
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
