"""Relief below the grid: slopes, horizons ray by ray, its cover, its roughness, its levels."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares

from lunar_rover_sim.ground.world import fine_relief
from lunar_rover_sim.ground.world.config import CraterConfig
from lunar_rover_sim.ground.world.craters import profile_table, RADII
from lunar_rover_sim.ground.world.fine_relief import TileRecipe

BARE = TileRecipe(n=128, period_m=0.64, rms_slope=0.2, longest_m=0.1, hurst=0.8, pit_cover=0.0,
                  pit_m=(0.01, 0.05), pebble_cover=0.0, pebble_m=(0.01, 0.05))


def recipe(**values):
    return TileRecipe(**{**BARE.__dict__, **values})


def waves(n, texel, seed=0):
    """Return smooth periodic heights: waves of a fifth of the period or longer."""
    rng = np.random.default_rng(seed)
    phase = 2.0 * np.pi * np.arange(n) / n
    height = np.zeros((n, n))
    for _ in range(10):
        kx, ky = rng.integers(-4, 5, 2)
        height += np.sin(kx * phase + ky * phase[:, None] + rng.uniform(0.0, 6.3))
    return (0.01 * texel * n * height / 2.0).astype(np.float32)


@pytest.mark.parametrize('azimuth_deg', [0.0, 20.0, 45.0, 71.0, 90.0, 115.0, 160.0, 200.0, 250.0,
                                         300.0, 340.0])
def test_horizons_are_those_of_rays_over_the_periodic_ground(azimuth_deg):
    n, texel = 96, 0.002
    height = waves(n, texel)
    tangents = np.linspace(0.0, 0.5, 33)
    azimuth = np.radians(azimuth_deg)
    found = fine_relief.horizon(height, texel, azimuth, tangents)
    steps = np.arange(1.0, 1.2 * n, 0.5)
    rows, columns = np.mgrid[0:n:7, 0:n:7]
    expected = np.zeros(rows.shape)
    for step in steps:
        there = map_coordinates(height, [rows + step * np.sin(azimuth),
                                         columns + step * np.cos(azimuth)], order=1,
                                mode='grid-wrap')
        expected = np.maximum(expected, (there - height[rows, columns]) / (step * texel))
    assert expected.max() < 0.5 and np.mean(expected > 0.1) > 0.3
    # Waves of a quarter of the period: slopes change by 0.02 from a texel to the next. Rows
    # at the sunward end see a quarter of a period of neighbours only: a few low horizons there.
    error = np.abs(found[::7, ::7] - expected)
    assert error.max() < 0.06 and np.quantile(error, 0.97) < 0.025 and error.mean() < 0.006


@pytest.mark.parametrize('rms_slope', [0.1, 0.25])
def test_the_fractal_relief_has_its_slope_its_exponent_and_no_favourite_direction(rms_slope):
    height = fine_relief.relief(recipe(n=512, rms_slope=rms_slope), np.random.default_rng(0))
    assert height.mean() == pytest.approx(0.0, abs=1e-6)
    slope = fine_relief.slopes(height, BARE.period_m / 512)
    assert np.sqrt((slope.astype(float)**2).sum(axis=2).mean()) == pytest.approx(rms_slope,
                                                                                 rel=1e-3)
    assert np.std(slope[..., 0]) == pytest.approx(np.std(slope[..., 1]), rel=0.05)
    # The power of the height falls by k^(-2 - 2 hurst), far above the 10 / m of the longest wave.
    power = np.abs(np.fft.fft2(height))**2
    axis = np.fft.fftfreq(512, BARE.period_m / 512)
    frequency = np.hypot(axis, axis[:, None])
    bands = np.geomspace(40.0, 320.0, 8)
    mean = [power[(frequency >= low) & (frequency < high)].mean()
            for low, high in zip(bands, bands[1:])]
    exponent = np.polyfit(np.log(np.sqrt(bands[1:] * bands[:-1])), np.log(mean), 1)[0]
    assert exponent == pytest.approx(-2.0 - 2.0 * 0.8, abs=0.15)


def test_relief_ends_at_its_longest_wave_and_is_periodic():
    height = fine_relief.relief(recipe(n=512, longest_m=0.04), np.random.default_rng(0))
    power = np.abs(np.fft.fft2(height))**2
    frequency = np.hypot(*np.meshgrid(*[np.fft.fftfreq(512, BARE.period_m / 512)] * 2))
    # Below half of 1 / longest the power falls by (1/2)^4 squared over (1 + ...) squared.
    low = power[(frequency > 4.0) & (frequency < 12.0)].mean()
    middle = power[(frequency > 25.0) & (frequency < 35.0)].mean()
    assert low < 0.3 * middle
    inside = np.abs(np.diff(height, axis=1)).mean()
    assert np.abs(height[:, 0] - height[:, -1]).mean() < 1.3 * inside
    assert np.abs(height[0] - height[-1]).mean() < 1.3 * np.abs(np.diff(height, axis=0)).mean()


@pytest.mark.parametrize('cover', [0.02, 0.08])
def test_pebbles_cover_their_share_and_stand_on_the_ground(cover):
    """A stone's own outline is cut smaller than its diameter: half to nine tenths of its circle.

    It is at most 0.65 of its diameter high, and leans.
    """
    plain = recipe(n=512, rms_slope=1e-6, pebble_cover=cover, pebble_m=(0.01, 0.04))
    height = fine_relief.relief(plain, np.random.default_rng(0))
    above = height - np.median(height)
    share = np.mean(above > 1e-4)
    assert 0.4 * cover < share < 0.9 * cover
    assert above.min() > -1e-4
    assert 0.25 * 0.01 < above.max() < 0.04 * (0.65 + 3.0 * 0.2)


def a_pebble(seed, n=400, period=0.2, diameter=0.02):
    """Return the (n, n) heights of level ground with one pebble, and the side of a texel [m]."""
    alone = recipe(n=n, period_m=period, rms_slope=1e-9, pebble_cover=1.2 * 0.25 * np.pi
                   * (diameter / period)**2, pebble_m=(0.99 * diameter, diameter))
    height = fine_relief.relief(alone, np.random.default_rng(seed))
    height = height - np.median(height)
    # In the middle, so that nothing wraps around.
    row, column = np.unravel_index(np.argmax(height), height.shape)
    return np.roll(height, (n // 2 - row, n // 2 - column), (0, 1)), period / n


def test_shadows_of_pebbles_have_the_shape_of_pebbles():
    """Half way to its end a shadow is nearly as broad as the stone; that of a cone is half.

    Each row of it is as long as the stone is high there.
    """
    tangent = np.tan(np.radians(10.0))
    breadth, near_tip = [], []
    for seed in range(6):
        height, texel = a_pebble(seed)
        stone = height > 1e-4
        assert 0.3 * 0.02**2 < np.count_nonzero(stone) * texel**2 < 0.02**2
        horizon = fine_relief.horizon(height, texel, 0.0, np.linspace(0.0, 0.6, 25))
        dark = (horizon > tangent) & ~stone
        silhouette = height.max(axis=1)
        tall = silhouette > 0.5 * silhouette.max()
        reach = (np.argmax(height, axis=1) - np.argmax(dark, axis=1)) * texel
        assert np.median(reach[tall] / silhouette[tall]) * tangent == pytest.approx(1.0, abs=0.1)
        width = np.count_nonzero(stone.any(axis=1))
        last = np.nonzero(stone.any(axis=0))[0][0]      # the sun stands at +x
        length = last - np.nonzero(dark.any(axis=0))[0][0]
        for share, widths in ((0.5, breadth), (0.8, near_tip)):
            widths.append(np.count_nonzero(dark[:, last - round(share * length)]) / width)
    assert np.mean(breadth) > 0.78 and np.mean(near_tip) > 0.58, (breadth, near_tip)


@pytest.mark.parametrize('seed', range(2))
def test_a_pit_is_a_crater_of_some_age_anywhere_on_the_tile(seed):
    """Its place and age are those that fit best; then its profile holds at every texel."""
    n, period, diameter = 64, 0.128, 0.03
    texel = period / n
    one = recipe(n=n, period_m=period, rms_slope=1e-9, pit_cover=1.2 * 0.25 * np.pi
                 * (diameter / period)**2, pit_m=(0.9999 * diameter, diameter))
    height = fine_relief.relief(one, np.random.default_rng(seed)).astype(float)
    table = profile_table(CraterConfig(fresh_depth=0.15, fresh_rim=0.03))
    y, x = np.mgrid[0:n, 0:n]
    row, column = np.unravel_index(np.argmin(height), height.shape)

    def off(place):
        apart = [np.abs((axis - at + n / 2) % n - n / 2) for axis, at in zip((x, y), place)]
        profile = diameter * np.interp(2.0 * texel / diameter * np.hypot(*apart), RADII,
                                       table.at(np.clip(place[2], 0.0, 1.0)))
        return (height - profile + profile.mean()).ravel() / diameter

    fits = [least_squares(off, (column, row, age)) for age in (0.1, 0.4, 0.8)]
    assert min(np.abs(fit.fun).max() for fit in fits) < 1e-3


def test_pits_are_of_all_ages():
    """Depths over diameters of pits apart are those of diffusion at uniform ages, from 0.15 down.

    A tenth is deeper than 0.12, half are shallower than 0.08 (Fassett and Thomson 2014).
    """
    depths = []
    for seed in range(300):
        one = recipe(n=128, rms_slope=1e-9, pit_cover=0.008, pit_m=(0.0599, 0.0601))
        height = fine_relief.relief(one, np.random.default_rng(seed))
        depths.append(float(np.ptp(height)) / 0.06)
    table = profile_table(CraterConfig(fresh_depth=0.15, fresh_rim=0.03))
    expected = np.interp(np.linspace(0.0, 1.0, 300), table.ages, table.depth)
    for share in (10, 50, 90):
        found, theory = np.percentile(depths, share), np.percentile(expected, share)
        assert found == pytest.approx(theory, abs=0.012), (share, found, theory)
    assert np.percentile(expected, 90) > 0.11 and np.percentile(expected, 50) < 0.08


def test_stones_and_pits_cross_the_border_of_the_tile():
    """Rolled by half a period the tile is as rough along its seams as anywhere else."""
    full = recipe(n=256, pebble_cover=0.1, pit_cover=0.1)
    height = fine_relief.relief(full, np.random.default_rng(5))
    steps = np.abs(np.roll(height, -1, axis=1) - height).mean(axis=0)
    assert steps[-1] < 2.0 * np.median(steps)
    steps = np.abs(np.roll(height, -1, axis=0) - height).mean(axis=1)
    assert steps[-1] < 2.0 * np.median(steps)


def test_levels_hold_means_and_what_they_average_away():
    """A horizon of two values in a chequer, half of it below the sun.

    Codes of 8 bits: a slope in steps of scale / 255, a horizon in steps of range / 127.5.
    """
    n, centre, half_range = 16, 0.2, 0.4
    slope = np.zeros((n, n, 2), np.float32)
    chequer = (np.arange(n) + np.arange(n)[:, None]) % 2
    slope[..., 0], slope[..., 1] = 0.25, np.where(chequer, 0.5, -0.5)
    tangent = np.where(chequer, 0.5, 0.1).astype(np.float32)
    tile = fine_relief.mip_levels(slope, tangent, tangent, 2.0, centre, half_range)
    assert [len(level) for level in tile.codes] == [16, 8, 4, 2, 1]
    np.testing.assert_allclose(tile.slope_variance, [0.3125] + [0.0625] * 4, atol=1e-6)
    np.testing.assert_allclose(tile.spread, [0.0] + [0.2 * fine_relief.SPREAD] * 4, atol=1e-6)
    for k, level in enumerate(tile.codes):
        code = level.astype(float)
        assert level.dtype == np.uint8 and level.shape == (n >> k, n >> k, 4)
        np.testing.assert_allclose((code[..., 0] - 128.0) / 255.0 * 2.0, 0.25, atol=1 / 255)
        along = np.where(chequer, 0.5, -0.5) if k == 0 else 0.0
        np.testing.assert_allclose((code[..., 1] - 128.0) / 255.0 * 2.0, along, atol=1 / 255)
        horizon = (code[..., 2] / 127.5 - 1.0) * half_range + centre
        # Half of the ground is lit: the coarser horizon is the sun's own height.
        np.testing.assert_allclose(horizon, tangent if k == 0 else centre, atol=half_range / 200)


def test_the_lit_share_is_that_of_the_finest_level():
    """A tenth of the ground is lit: its mean horizon alone would leave less or none of it lit."""
    rng = np.random.default_rng(3)
    tangent = (0.05 + rng.exponential(0.1, (256, 256))).astype(np.float32)
    sun = float(np.quantile(tangent, 0.1))
    flat = np.zeros((256, 256, 2), np.float32)
    tile = fine_relief.mip_levels(flat, tangent, tangent, 2.0, sun, 0.4)
    for k in (1, 2, 4, 6):
        horizon = (tile.codes[k][..., 2] / 127.5 - 1.0) * 0.4 + sun
        assert np.mean(fine_relief.disc_share((sun - horizon) / tile.spread[k])) \
            == pytest.approx(0.1, abs=0.02)


def test_a_few_shadows_leave_slopes_that_turn_away_from_the_sun_lit():
    """A hundredth of level ground is dark: horizons of coarse levels stay where most of them are.

    A mean moved to where a hundredth is dark would lie just below the sun, at 0.25.
    """
    tangent = np.full((256, 256), 0.0, np.float32)
    tangent[np.random.default_rng(4).random(tangent.shape) < 0.01] = 0.35
    flat = np.zeros((256, 256, 2), np.float32)
    tile = fine_relief.mip_levels(flat, tangent, tangent, 2.0, 0.25, 0.4)
    for k in (2, 4, 6):
        horizon = (tile.codes[k][..., 2] / 127.5 - 1.0) * 0.4 + 0.25
        assert np.mean(horizon) < 0.05
        assert np.mean(fine_relief.disc_share((0.15 - horizon) / tile.spread[k])) > 0.97


def test_rises_bound_the_slopes_around():
    """Of random heights: no line from over a texel that is steeper meets them."""
    rng = np.random.default_rng(2)
    height = rng.normal(size=(512, 512)).astype(np.float32)**3
    rise = fine_relief.rises(height, 0.01, 0.002)
    for _ in range(3000):
        (y, x), (dy, dx) = rng.integers(0, 512, 2), rng.integers(-80, 81, 2)
        if dx or dy:
            up = height[(y + dy) % 512, (x + dx) % 512] - height[y, x] - 0.002
            assert up / (0.01 * np.hypot(dx, dy)) <= rise[y, x] * (1.0 + 1e-5) + 1e-5
    # None of the eight directions counts more than another.
    for turned in (lambda a: a.T, lambda a: a[::-1], lambda a: a[:, ::-1]):
        np.testing.assert_array_equal(fine_relief.rises(turned(height), 0.01, 0.002),
                                      turned(rise))
    one = np.zeros((512, 512), np.float32)
    one[100, 100] = 0.05
    rise = fine_relief.rises(one, 0.01)
    assert 0.05 / 0.3 <= rise[100, 130] <= 2.0 * 0.05 / 0.3 + 1e-6 and rise[400, 400] == 0.0


def test_a_pebble_is_salient_wherever_it_lies():
    """Also across the border of the tile, where its smoothing wraps around."""
    slope = np.zeros((128, 128, 2), np.float32)
    slope[60:68, 60:68], slope[:4, :4] = 1.0, 1.0
    salience = fine_relief.salience(slope, np.zeros((128, 128), np.float32))
    assert salience.min() >= 0.0 and salience.max() <= 1.0
    assert salience[64, 64] > 0.9 and salience[0, 0] > 0.9 and salience[-2, -2] > 0.5
    assert salience[30, 100] < 0.1


def test_codes_stay_within_a_byte():
    slope = np.full((4, 4, 2), 9.0, np.float32)
    tangent = np.full((4, 4), -9.0, np.float32)
    level = fine_relief.mip_levels(slope, tangent, tangent, 2.0, 0.2, 0.4).codes[0]
    assert np.all(level[..., :2] == 255) and np.all(level[..., 2] == 0)
