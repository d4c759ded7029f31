"""The loops that light the ground, piece by piece, against plain NumPy."""

import os
import subprocess
import sys

import numpy as np
import pytest
from relief_place import bilinear, places

from lunar_rover_sim.base.workers import ONE_THREAD
from lunar_rover_sim.ground.world.fine_relief import disc_share
from lunar_rover_sim.image.camera.development import LitImage
from lunar_rover_sim.image.rendering import (grid_rows, relief_brightness, relief_rows, tint_rows,
                                             track_map)
from lunar_rover_sim.image.rendering.ground_band import GroundImage
from lunar_rover_sim.image.rendering.ground_picture import cover, far_ground
from lunar_rover_sim.image.rendering.surface import mip_texels, packed_levels

N = 1280                # pixels
PIXEL, RADIUS, FINE = 1.0 / 500.0, 0.00465, 9.0
SUN = (0.6, -0.8)       # heading
F32 = np.float32


def arrays(count, size=N):
    return [np.zeros(size, F32) for _ in range(count)]


@pytest.fixture(scope='module')
def pixels():
    """Depth and place of pixels from 0.5 to 30 m away, and unit vectors to a camera above 0, 0."""
    rng = np.random.default_rng(3)
    away, angle = np.exp(rng.uniform(np.log(0.5), np.log(30.0), N)), rng.uniform(-3.0, 3.0, N)
    x, y = away * np.cos(angle), away * np.sin(angle)
    view = np.stack([-x, -y, np.full(N, 0.4)]) / np.hypot(away, 0.4)
    return [array.astype(F32) for array in (away, x, y, *view)]


def mip(level):
    whole = np.floor(level)
    return np.maximum(whole + np.clip((level - whole - 0.35) / 0.3, 0.0, 1.0), 0.0)


def at_edges(values, u, v):
    """Return (n, n, c) values at places in texels, which end at the edges."""
    last = len(values) - 1
    u, v = np.clip(u, 0.0, last), np.clip(v, 0.0, last)
    i, j = np.floor(u).astype(int), np.floor(v).astype(int)
    i1, j1 = np.minimum(i + 1, last), np.minimum(j + 1, last)
    f, g = (u - i)[:, None], (v - j)[:, None]
    return ((values[j, i] * (1 - f) + values[j, i1] * f) * (1 - g)
            + (values[j1, i] * (1 - f) + values[j1, i1] * f) * g)


def levels_of(texels, side):
    """Return the mip levels of one texture, as numbers."""
    words, sides, first = mip_texels([texels], side)
    kind = texels.dtype
    return [words[start:start + n * n].view(kind).reshape(n, n, 4).astype(float)
            for n, start in zip(sides, first)]


def test_mip_levels_are_means():
    rng = np.random.default_rng(0)
    texels = rng.integers(0, 256, (12, 12, 4)).astype(np.uint8)
    levels = levels_of(texels, 12)
    assert [len(level) for level in levels] == [12, 6, 3, 1]
    mean = texels.astype(float).reshape(6, 2, 6, 2, 4).mean(axis=(1, 3))
    assert np.abs(levels[1] - mean).max() <= 0.5
    # A level of an odd number of texels lies over all of those before it, too.
    ramp = np.repeat(np.arange(9.0)[:, None, None], 9, 1).repeat(4, 2).astype(np.float16)
    np.testing.assert_allclose(levels_of(ramp, 9)[1][:, 0, 0], (np.arange(4) + 0.5) * 2.25 - 0.5,
                               atol=0.01)


@pytest.mark.parametrize('smooth', [False, True])
def test_what_is_known_of_the_grid(pixels, smooth):
    depth, x, y, vx, vy, vz = pixels
    rng = np.random.default_rng(1)
    cells, sizes = (0.1, 0.8), (65, 65)
    ground = [rng.uniform(-1.0, 1.0, (n, n, 4)) * [0.5, 0.5, 0.02, 1.0] + [0.0, 0.0, 0.0, 2.5]
              for n in sizes]
    ground = [texels.astype(np.float16) for texels in ground]
    matter = [rng.integers(0, 256, (n, n, 4)).astype(np.uint8) for n in sizes]
    places_of = np.array([[1.0 / (65 * cell), 0.5, -np.log2(cell), 32 * cell] for cell in cells])
    own, texels = mip_texels(ground, 65), mip_texels(matter, 65)
    out = arrays(8)
    grid_rows.light_of_grid(
        depth, x, y, vx, vy, vz, places_of.astype(F32), own.words, texels.words, own.side,
        own.first, np.array([PIXEL, RADIUS, 0.0, 0.0, 1.5, FINE, 8.0, *SUN], F32), smooth, *out)
    slope_x, slope_y, lit, albedo, below, around, detail, level = out
    layer = (np.maximum(abs(x), abs(y)) > 3.2).astype(int)
    assert 0.2 < layer.mean() < 0.9
    size = depth * PIXEL
    along = np.log2(np.minimum(size / np.maximum(abs(vz), 0.02), 2.0 * size))
    np.testing.assert_allclose(level, along, atol=1e-4)
    log = -np.log2(np.array(cells))[layer]
    coarse = np.minimum(mip(along + log), len(own.side) - 1)
    expected, bytes_of = np.zeros((N, 4)), np.zeros((N, 4))
    nearest = np.where(layer > 0, np.maximum(np.log2(size) + log, 0.0), coarse)
    for k in range(2):
        mips = [levels_of(part, 65) for part in (ground[k], matter[k])]
        u, v = x / (65 * cells[k]) + 0.5, y / (65 * cells[k]) + 0.5
        for m, (texel, byte) in enumerate(zip(*mips)):
            n = len(texel)
            share = np.maximum(1.0 - abs(coarse - m), 0.0) * (layer == k)
            expected += share[:, None] * at_edges(texel, u * n - 0.5, v * n - 0.5)
            chosen = (np.ceil(nearest - 0.5) == m) & (layer == k)
            bytes_of[chosen] = at_edges(byte, u * n - 0.5, v * n - 0.5)[chosen] / 255.0
    np.testing.assert_allclose(slope_x, expected[:, 0], atol=2e-4)
    np.testing.assert_allclose(slope_y, expected[:, 1], atol=2e-4)
    np.testing.assert_allclose(albedo, 2.0 * bytes_of[:, 0], atol=1e-4)
    np.testing.assert_allclose(below, bytes_of[:, 1]**2, atol=1e-4)
    np.testing.assert_allclose(around, bytes_of[:, 2]**2, atol=1e-4)
    normal = np.stack([-expected[:, 0], -expected[:, 1], np.ones(N)])
    facing = (normal * [vx, vy, vz]).sum(axis=0) / np.linalg.norm(normal, axis=0)
    shaped = np.clip(5.0 - 5.0 * np.hypot(x, y) / 1.5, 0.0, 1.0)
    foot = np.minimum(size / np.maximum(np.maximum(facing, shaped), 0.02), 12.0 * size)
    # Across the sun a third of the length of a pixel, in octaves over its width, does not count;
    # of one that is more than eight times as long as wide less than that.
    across = (vx * SUN[1] - vy * SUN[0])**2 / (vx**2 + vy**2)
    octaves = np.log2(foot / size) * (
        1.0 - 0.34 * across * np.minimum(2.0 - foot / size / 8.0, 1.0))
    wanted = np.minimum(mip(np.log2(size) + octaves + FINE - 0.05), 8.0)
    np.testing.assert_allclose(detail, wanted, atol=2e-3)
    angle = expected[:, 2] / expected[:, 3]
    width = np.full(N, RADIUS)
    if smooth:
        most = np.where(expected[:, 3] > 4.0 * foot, foot / expected[:, 3], 0.0)
        angle = np.clip(angle, -RADIUS - most, RADIUS + most)
        block = angle.reshape(-1, 2, 32, 2)     # chunk, row, column of blocks, column
        change = np.hypot(np.diff(block, axis=3).repeat(2, 3), np.diff(block, axis=1).repeat(2, 1))
        width += 0.5 * np.minimum(change.ravel(), most)
    seen = disc_share(angle / width)
    last = bytes_of[:, 3]
    whole = np.where(layer > 0, seen * (1.0 - last),
                     seen + np.minimum(coarse, 1.0) * (last - seen))
    np.testing.assert_allclose(lit, whole, atol=5e-3)


def test_the_relief_of_both_tiles(pixels):
    depth, x, y = pixels[:3]
    rng = np.random.default_rng(2)
    codes = [[rng.integers(0, 256, (64 >> k, 64 >> k, 4)).astype(np.uint8) for k in range(7)]
             for _ in range(2)]
    detail = rng.choice([0.0, 1.0, 2.0, 2.4, 3.0, 4.7, 5.0], N).astype(F32)
    out, (coarse, fine) = arrays(6), map(packed_levels, codes)
    relief_rows.relief_of(
        depth, x, y, detail, np.append([1.0 / 6.4, 1.0 / 1.6, 1.0], np.zeros(10)).astype(F32),
        F32(0.5),
        np.array([0.2, 0.4], F32), *coarse, *fine, *out)
    p, own, following, lead = places(np.stack([x, y], axis=1).astype(float))
    lead *= 0.2             # over a wider zone

    def texels(levels, at, level):
        values = sum(np.maximum(1.0 - abs(level - k), 0.0)[:, None] * bilinear(codes, at)
                     for k, codes in enumerate(levels))
        return values / 255.0
    level = np.maximum(detail - 2.0, 0.0)
    a, after = (texels(codes[0], p / 6.4 + shift[:, :2], level) for shift in (own, following))
    other = np.where(lead < 1.0, np.clip(0.5 - 20.0 * (lead + a[:, 3] - after[:, 3]), 0, 1), 0.0)
    a += other[:, None] * (after - a)
    shift = np.where(other[:, None] > 0.5, following, own)[:, 2:]
    b = texels(codes[1], p / 1.6 + shift, detail)
    expected = [*(3.0 * (tile[:, k] - 0.501961) for tile in (a, b) for k in (0, 1)),
                *(0.2 + 0.4 * (2.0 * tile[:, 2] - 1.0) for tile in (a, b))]
    assert 0.05 < (other > 0.0).mean() < 0.5
    for found, wanted in zip(out, expected):
        # Beside the edge of a cell single precision may choose the other one.
        assert np.quantile(abs(found - wanted), 0.98) < 5e-3


def test_the_factor_between_nodes(pixels):
    depth, x, y, vx, vy, vz = pixels
    rng = np.random.default_rng(4)
    codes = rng.integers(60, 256, (9, 16, 8, 4)).astype(np.uint8)
    slope_x, slope_y = (rng.normal(0.0, 0.1, N).astype(F32) for _ in range(2))
    detail, out = rng.uniform(0.0, 8.0, N).astype(F32), arrays(1)[0]
    tangent = 0.2
    sun = np.array([1.0, 0.0, tangent]) / np.hypot(1.0, tangent)
    relief_brightness.relief_factor(depth, slope_x, slope_y, vx, vy, vz, detail,
                                    np.array([*sun, 1.0, 0.0, tangent, tangent], F32),
                                    np.ascontiguousarray(codes).view(np.uint32)[..., 0], out)
    up = np.stack([-slope_x, -slope_y, np.ones(N)])
    up /= np.linalg.norm(up, axis=0)
    cosine, of_sun = np.clip((up * [vx, vy, vz]).sum(axis=0), 0.0, 1.0), sun @ up
    across = np.maximum((1.0 - cosine**2) * (1.0 - of_sun**2), 1e-6)
    turn = np.clip((sun @ [vx, vy, vz] - cosine * of_sun) / np.sqrt(across), -1.0, 1.0)
    at = [detail, 15.0 * np.sqrt(cosine), 7.0 * np.sqrt(0.5 - 0.5 * turn)]
    roots = np.zeros((N, 4))
    low = [np.minimum(np.floor(place), n - 2).astype(int) for place, n in zip(at, (9, 16, 8))]
    for corner in np.ndindex(2, 2, 2):
        share = np.prod([abs(1 - step - (place - first)) for step, place, first
                         in zip(corner, at, low)], axis=0)
        roots += share[:, None] * codes[tuple(a + b for a, b in zip(low, corner))] / 255.0
    height = np.log2(np.maximum((tangent - slope_x) / tangent, 1e-6))
    height = np.clip(np.where(height < 0.0, height, 0.5 * height), -2.0, 1.0)
    weight = np.maximum(1.0 - abs(height[:, None] - [-2.0, -1.0, 0.0, 1.0]), 0.0)
    inverse = (255.0 / 128.0)**2 * (roots**2 * weight).sum(axis=1)
    np.testing.assert_allclose(out, 1.0 / np.maximum(inverse, 0.125), rtol=2e-3)


def test_tracks_near_and_far(pixels):
    depth, x, y = pixels[:3]
    rng = np.random.default_rng(5)
    sides = np.array([64, 32])
    near = rng.uniform(0.0, 0.3, (64 * 64 + 32 * 32, 6)).astype(F32)
    near[:, 4] *= 1e-3
    far = rng.uniform(0.0, 0.3, (40, 40, 3)).astype(F32)
    touched = rng.random((20, 20)) < 0.7
    windows = np.array([1.0 / 6.4, 2.5, 1.0 / 40.0, 18.0, 0.5, -0.5], F32)
    level = rng.choice([-5.0, -3.0, -2.6], N).astype(F32)
    out = arrays(7)
    track_map.prints_of(depth, x, y, level, windows, np.array([0.1, -np.log2(0.1), 0.0], F32),
                        touched, near, np.array([0, 64 * 64]), sides, far, True, *out)
    xy = np.stack([x, y], axis=1).astype(float)
    tile = np.floor(xy / 2.0).astype(int) % 20
    some = touched[tile[:, 1], tile[:, 0]]
    away = abs(xy - [0.5, -0.5]).max(axis=1)
    own = np.clip(level - np.log2(0.1), 0.0, 1.0)[:, None]
    parts = near[:64 * 64].reshape(64, 64, 6), near[64 * 64:].reshape(32, 32, 6)
    at = xy / 6.4 + 0.5 / 64
    value = (1.0 - own) * bilinear(parts[0], at) + own * bilinear(parts[1], at)
    distant = bilinear(far, xy / 40.0 + 0.5 * 0.1 / 40.0)
    close, beyond = some & (away < 2.5), some & (away >= 2.5) & (away <= 18.0)
    assert close.sum() > 50 and beyond.sum() > 50 and (~some).sum() > 50
    pressed = np.where(close, value[:, 5], np.where(beyond, distant[:, 1], 0.0))
    loose = np.clip(abs(value[:, 4]) * 1000.0, 0.0, 1.0) * (1.0 - value[:, 5])
    horizon = np.where(close, -0.1 + value[:, 2], np.where(some, 0.0, -0.1))
    seen = np.where(close, 1.0 - value[:, 3], np.where(beyond, 1.0 + distant[:, 0], 1.0))
    for found, wanted in zip(out, (
            np.where(close, value[:, 0], 0.0), np.where(close, value[:, 1], 0.0), horizon, seen,
            np.where(close, own[:, 0], some * 1.0), pressed,
            np.where(close, loose, np.where(beyond, distant[:, 2], 0.0)))):
        assert np.quantile(abs(found - wanted), 0.995) < 1e-3     # beside edges of tiles


def test_the_colour_of_soil(pixels):
    depth, x, y = pixels[:3]
    near = np.where(np.arange(N) < N // 2, F32(0.005), F32(1.0))   # within one cell of patches
    x, y = x * near, y * near
    rng = np.random.default_rng(6)
    albedo, cos_sun, of_sun = (rng.uniform(0.3, 1.0, N).astype(F32) for _ in range(3))
    whole = (of_sun * F32(1.2)).astype(F32)
    zero = np.zeros(N, F32)
    soil, spread, place = (0.3, -0.4, 0.2, -0.1), (0.05, -0.05, -0.1, 0.1), (12.3, -4.5)
    words = np.zeros(N, np.uint32)
    tint_rows.tint_of(depth, x, y, albedo, cos_sun, zero, of_sun, zero, whole,
                      np.array(soil, F32), np.array(spread, F32), np.array(place, F32),
                      np.zeros(2, F32), words)

    def patch(u, v):
        cell = np.floor([u, v]).astype(np.int64)
        f, g = np.array([u, v]) - cell
        f, g = f * f * (3.0 - 2.0 * f), g * g * (3.0 - 2.0 * g)

        def corner(i, j):
            a, b = (axis.astype(np.uint32) for axis in (cell[0] + i, cell[1] + j))
            h = a * np.uint32(0x9e3779b9) + b * np.uint32(0x85ebca6b)
            h = (h ^ (h >> 15)) * np.uint32(0x846ca68b)
            return ((h ^ (h >> 16)) & 0xffff) * (2.0 / 65535.0) - 1.0
        return ((corner(0, 0) * (1 - f) + corner(1, 0) * f) * (1 - g)
                + (corner(0, 1) * (1 - f) + corner(1, 1) * f) * g)
    u, v = x + 12.3, y - 4.5
    patches = 1.92 * patch(u / 23.0, v / 23.0) + 1.33 * patch(v / 5.0 + 7.5, u / 5.0 + 7.5)
    direct = of_sun / whole
    phase = np.sqrt(0.5 - 0.5 * cos_sun) - 0.258819
    for k in range(2):
        log = (soil[k] + spread[k] * patches + spread[2 + k] * np.log(np.maximum(albedo, 0.2))
               + soil[2 + k] * phase * direct + soil[k] * (1.0 - direct))
        codes = words >> 16 * k & 0xffff
        np.testing.assert_allclose(codes, 0.25 * 65535.0 * np.exp(log), rtol=1e-3)


def test_the_process_that_compiles_the_law_computes_what_later_ones_do(tmp_path):
    code = ('import numpy as np; '
            'from lunar_rover_sim.image.illumination.hapke import fill_reflectance; '
            'rng = np.random.default_rng(1); '
            'a = [rng.uniform(0.05, 1.0, 1280).astype(np.float32) for _ in range(7)]; '
            'fill_reflectance(*a[:6], np.array([0.3, 0.3, 0.4, 1.0, 0.06], np.float32), a[6]); '
            'print(a[6].tobytes().hex())')
    told = [subprocess.run([sys.executable, '-c', code], capture_output=True, check=True,
                           env={**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path)}).stdout
            for _ in range(2)]
    assert told[0] == told[1]


def test_far_ground_takes_a_seventh_of_each_neighbour():
    """From where a pixel is 75 mm longer than twice its width; the most where it is 125 mm.

    Nearer ground stays as it is. What shows no ground has no light, not even a number.
    """
    h, w, above = 200, 24, 0.3
    rng = np.random.default_rng(0)
    depth = np.repeat((above / PIXEL / (np.arange(h) + 0.5)).astype(F32)[:, None], w, 1)
    light = rng.random((h, w)).astype(F32)
    holes = rng.random((h, w)) < 0.1
    depth[holes], light[holes] = 0.0, np.nan
    far_m = np.array(far_ground(PIXEL, above))
    longer = PIXEL * far_m**2 / above - 2.0 * PIXEL * far_m
    np.testing.assert_allclose(longer, [0.075, 0.125])
    share = np.clip((depth - far_m[0]) / (far_m[1] - far_m[0]), 0.0, 1.0) / 7.0
    share[:, [0, -1]] = 0.0
    padded = np.pad(light, 1, constant_values=np.nan)
    beside = np.array([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
    mean = light + share * np.nansum(beside - light, axis=0)
    image, plain = (LitImage(np.zeros((h, w), F32), np.zeros((h, w), F32)) for _ in range(2))
    cover(image, GroundImage(depth, light), ONE_THREAD, far_ground(PIXEL, above))
    cover(plain, GroundImage(depth, light), ONE_THREAD)
    np.testing.assert_allclose(image.radiance, np.where(holes, 0.0, mean), rtol=1e-5)
    near = ~holes & (depth <= far_m[0])
    assert near.sum() > 2000 and np.array_equal(image.radiance[near], light[near])
    np.testing.assert_array_equal(plain.radiance, np.where(holes, 0.0, light))
    np.testing.assert_array_equal(image.depth_m, depth)
