"""Ground in bands: means of texels, far ground, and one law from any process."""

import os
import subprocess
import sys

import numpy as np

from lunar_rover_sim.base.workers import ONE_THREAD
from lunar_rover_sim.image.camera.development import LitImage
from lunar_rover_sim.image.rendering.ground_band import GroundImage
from lunar_rover_sim.image.rendering.ground_picture import cover, far_ground
from lunar_rover_sim.image.rendering.surface import mip_texels

PIXEL = 1.0 / 500.0
F32 = np.float32


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
