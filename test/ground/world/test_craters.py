"""Craters: how old and how large they are, how they degrade, and how they are drawn."""

import dataclasses
import functools

from ground.world.crater_scene import stamp
import numpy as np
import pytest
from scipy import integrate, special, stats
from scipy.ndimage import map_coordinates

from lunar_rover_sim.ground.world import rays, streams
from lunar_rover_sim.ground.world.config import CraterConfig
from lunar_rover_sim.ground.world.craters import (Craters, fresh_profile, keep_clear, populate,
                                                  profile_table, RADII, REACH, survivors)
from lunar_rover_sim.ground.world.spline import Area

ROUND = CraterConfig(irregularity=0.0)


def craters(position, diameter, age):
    """Return a catalogue from lists."""
    count = len(diameter)
    return Craters(np.reshape(np.asarray(position, float), (count, 2)),
                   np.asarray(diameter, float), np.asarray(age, float), np.zeros(count, np.int32))


def many(seed=0, **values):
    """Return thousands of craters of 1 m to 4 m."""
    config = CraterConfig(**{'density': 0.3, **values})
    return config, populate(config, 100.0, 1.0, 4.0, 2, np.random.default_rng(seed))


@pytest.mark.parametrize('exponent', [0.5, 1.0, 3.0])
def test_ages_have_the_exponent(exponent):
    """The share of craters younger than a of their lifetime is a to the exponent."""
    _, found = many(age_exponent=exponent)
    statistic = stats.kstest(found.age, lambda a: np.clip(a, 0.0, 1.0)**exponent).statistic
    assert statistic < 2.0 / np.sqrt(len(found))


@pytest.mark.parametrize('slope', [1.5, 2.0, 3.0])
def test_number_and_sizes_follow_the_cut_power_law(slope):
    config, found = many(slope=slope)
    area = 200.0**2
    # N(>D) = density 1.54 D0^-2 (D / D0)^-slope per m2 with D0 = 10 m (Gault 1970).
    cumulative = config.density * 1.54 / 100.0 * (np.array([1.0, 4.0]) / 10.0)**-slope * area
    expected = cumulative[0] - cumulative[1]
    assert len(found) == pytest.approx(expected, abs=4.0 * np.sqrt(expected))

    def law(d):
        return (1.0 - d**-slope) / (1.0 - 4.0**-slope)
    assert stats.kstest(found.diameter_m, law).statistic < 2.0 / np.sqrt(len(found))
    assert found.diameter_m.min() >= 1.0 and found.diameter_m.max() <= 4.0
    assert np.all(found.level == 2)


def test_places_sizes_and_ages_are_independent():
    _, found = many()
    for axis in (0, 1):
        uniform = stats.uniform(-100.0, 200.0)
        statistic = stats.kstest(found.position_m[:, axis], uniform.cdf).statistic
        assert statistic < 2.0 / np.sqrt(len(found))
    table = np.column_stack([found.position_m, found.diameter_m, found.age])
    correlation = np.corrcoef(table.T) - np.eye(4)
    assert np.abs(correlation).max() < 4.0 / np.sqrt(len(found))


def test_a_band_outside_the_configured_sizes_is_empty():
    config = CraterConfig(min_diameter_m=2.0, max_diameter_m=3.0)
    rng = np.random.default_rng(0)
    assert len(populate(config, 100.0, 0.1, 2.0, 0, rng)) == 0
    assert len(populate(config, 100.0, 3.0, 9.0, 0, rng)) == 0
    both = populate(config, 300.0, 0.1, 9.0, 0, rng)
    assert len(both) > 100 and both.diameter_m.min() >= 2.0 and both.diameter_m.max() <= 3.0


def test_time_since_formation_grows_with_the_area():
    """A 2 m crater takes four times as long to erase as one of 1 m (Fassett & Thomson 2014)."""
    found = craters(np.zeros((3, 2)), [1.0, 2.0, 4.0], [1.0, 0.25, 0.0625])
    np.testing.assert_allclose(found.time, 1.0)


def test_near_the_start_only_gentle_craters_stay():
    """Fresh ones have walls of 39 deg, the oldest of 3 deg or so."""
    found = craters([[0.0, 5.9], [0.0, 6.1], [0.0, 0.0], [3.0, 3.0]], [5.0, 5.0, 5.0, 5.0],
                    [0.0, 0.0, 1.0, 0.0])
    kept = keep_clear(found, ROUND, radius_m=2.0, steepest_deg=8.0)
    # 0.8 diameters and the radius: 6 m.
    np.testing.assert_array_equal(kept.position_m, [[0.0, 6.1], [0.0, 0.0]])
    strict = keep_clear(found, ROUND, radius_m=2.0, steepest_deg=1.0)
    np.testing.assert_array_equal(strict.position_m, [[0.0, 6.1]])


def test_a_crater_is_erased_by_a_younger_one_within_its_rim():
    """The rim of a 10 m crater, and a tenth beyond; older and equally old ones erase nothing."""
    fine = craters([[5.4, 0.0], [5.6, 0.0], [0.0, 0.0], [0.0, 5.0]], [2.0, 2.0, 2.0, 2.0],
                   [1.0, 1.0, 0.1, 0.5])
    young = craters([[0.0, 0.0]], [10.0], [0.015])       # time 1.5; fine: 4, 4, 0.4, 2
    kept = survivors(fine, young)
    np.testing.assert_array_equal(kept.position_m, [[5.6, 0.0], [0.0, 0.0]])
    old = craters([[0.0, 0.0]], [10.0], [0.5])
    assert len(survivors(fine, old)) == 4
    assert len(survivors(fine, Craters.join([]))) == 4


def test_the_fresh_profile_is_a_parabola_with_ejecta_of_the_third_power():
    h = fresh_profile(ROUND)
    at = {r: h[np.argmin(np.abs(RADII - r))] for r in (0.0, 0.5, 1.0, 2.0)}
    assert at[0.0] == pytest.approx(0.04 - 0.2)
    assert at[0.5] == pytest.approx(0.04 - 0.2 * 0.75)
    assert at[1.0] == pytest.approx(0.04)
    assert at[2.0] == pytest.approx(0.04 / 8.0)


# Waves on a disc of five radii through whose border nothing flows: J1(5 k) = 0.
WAVES = np.r_[0.0, special.jn_zeros(1, 150)] / 5.0


@functools.lru_cache(maxsize=1)
def amplitudes():
    """Return the amplitude of every wave in the fresh profile."""
    r = np.linspace(0.0, 5.0, 2001)
    h = np.where(r < 1.0, 0.04 - 0.2 * (1.0 - r**2), 0.04 * np.maximum(r, 1.0)**-3.0)
    overlap = integrate.trapezoid(r * h * special.j0(WAVES[:, None] * r), r, axis=1)
    return 2.0 * overlap / (5.0 * special.j0(5.0 * WAVES))**2


def diffused(r, time):
    """Return the fresh profile after a time of diffusion, exactly: each wave decays by itself."""
    decayed = amplitudes() * np.exp(-WAVES**2 * time)
    return decayed @ special.j0(WAVES[:, None] * np.asarray(r))


def test_profiles_degrade_as_diffusion_says_at_a_steady_rate():
    """The whole profile at every age is the exact solution at a time proportional to the age."""
    table = profile_table(ROUND)
    inside = RADII <= 0.7 * REACH          # beyond it fades out
    radii = RADII[inside][::8]
    rates = []
    for i in (8, 16, 24, 32):
        profile = table.heights[i][inside][::8]
        times = np.geomspace(0.01, 1.0, 25)
        floor = [diffused([0.0], t)[0] for t in times]
        time = np.interp(profile[0], floor, times)
        np.testing.assert_allclose(profile, diffused(radii, time), atol=0.002)
        rates.append(time / table.ages[i])
    # Times are read from 25 steps of a fifth.
    np.testing.assert_allclose(rates, np.mean(rates), rtol=0.06)


def test_measures_of_the_profiles():
    """The wall of a fresh parabola falls by 2 depth / radius at its rim: 0.8, or 39 deg."""
    table = profile_table(ROUND)
    assert table.steepest[0] == pytest.approx(0.8, rel=0.03)
    assert table.depth[0] == pytest.approx(0.2, abs=2e-7)
    slope = np.abs(np.diff(table.heights, axis=1)).max(axis=1) / (RADII[1] / 2.0)
    np.testing.assert_allclose(table.steepest[4:], slope[4:], rtol=0.03)
    np.testing.assert_allclose(table.depth, table.heights.max(axis=1) - table.heights[:, 0])
    # Beyond its reach a crater is not there, and it fades to that without a step.
    assert np.all(table.heights[:, RADII >= REACH] == 0.0)
    assert np.abs(np.diff(table.heights[:, RADII > 0.6 * REACH], axis=1)).max() < 1e-3


def test_a_crater_as_deep_as_the_oldest_does_not_change():
    table = profile_table(CraterConfig(fresh_depth=0.1, oldest_depth=0.2))
    np.testing.assert_allclose(table.heights, np.tile(table.heights[0], (len(table.ages), 1)))


CELL, SIDE = 0.05, 241
FIRST = (-(SIDE // 2), -(SIDE // 2))


def drawn(catalogue, config=ROUND, ground=None, seed=0):
    """Return a ground with craters drawn into it."""
    heights = np.zeros((SIDE, SIDE), np.float32) if ground is None else ground.astype(np.float32)
    keyed = dataclasses.replace(catalogue, key=streams.keys(0, seed, 0, len(catalogue)))
    stamp(Area(heights, FIRST, CELL), keyed, config)
    return heights


def polar(heights, centre, radii, angles):
    """Return heights at polar places around a centre [m]: (angles, radii)."""
    x = centre[0] + radii * np.cos(angles)[:, None]
    y = centre[1] + radii * np.sin(angles)[:, None]
    return map_coordinates(heights, [y / CELL + (SIDE - 1) / 2, x / CELL + (SIDE - 1) / 2],
                           order=1)


@pytest.mark.parametrize('age', [0.0, 0.3, 1.0])
@pytest.mark.parametrize('centre', [(0.0, 0.0), (1.33, -0.71)])
def test_a_crater_on_level_ground_is_its_profile_all_around(age, centre):
    heights = drawn(craters([centre], [3.0], [age]))
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    radii = np.linspace(0.0, 4.2, 43)
    expected = 3.0 * np.interp(radii / 1.5, RADII, profile_table(ROUND).at(age))
    # Cells of 5 cm on walls of 0.8 whose slope changes by 0.8 per 1.5 m.
    found = polar(heights, centre, radii, angles)
    assert np.abs(found - expected).max() < 0.02
    assert np.abs((found - expected).mean(axis=0)).max() < 0.01


def outline(seed, irregularity):
    """Return by how much the outline of one crater bulges at 360 azimuths, as a share."""
    heights = drawn(craters([[0.0, 0.0]], [4.0], [0.0]),
                    CraterConfig(irregularity=irregularity), seed=seed)
    angles = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
    radii = np.linspace(0.6, 3.4, 281)
    inside = polar(heights, (0.0, 0.0), radii, angles) < 0.0
    # The bowl meets the plain where 0.04 = 0.2 (1 - r^2).
    return np.sqrt(0.8) * 2.0 / radii[np.argmin(inside, axis=1)] - 1.0


def test_outlines_bulge_in_two_to_four_lobes_with_the_configured_rms():
    share = 0.06
    bulges = np.array([outline(seed, share) for seed in range(60)])
    assert np.sqrt(np.mean(bulges**2)) == pytest.approx(share, rel=0.12)
    spectrum = np.fft.rfft(bulges, axis=1) / 180.0
    power = np.mean(np.abs(spectrum)**2, axis=0) / 2.0
    # Shares of the power of two, three and four lobes: 0.56, 0.25 and 0.19; hardly others.
    assert power[2:5].sum() > 0.95 * power[1:].sum()
    np.testing.assert_allclose(power[2:5] / power[2:5].sum(), [0.56, 0.25, 0.19], atol=0.1)
    # Phases are random: cosine and sine parts are as large, and of either sign.
    for order in (2, 3, 4):
        real, imaginary = spectrum[:, order].real, spectrum[:, order].imag
        assert 0.5 < np.std(real) / np.std(imaginary) < 2.0
        assert abs(np.mean(spectrum[:, order])) < 4.0 * np.std(real) / np.sqrt(60.0)


@pytest.mark.parametrize('east,north', [(0.1, 0.0), (0.0, -0.1), (0.05, 0.08)])
@pytest.mark.parametrize('centre', [(0.0, 0.0), (2.0, 1.0)])
def test_a_crater_on_a_slope_keeps_the_slope(east, north, centre):
    """The plane that fits a plane is that plane: what is drawn is the profile on top of it."""
    axis = (np.arange(SIDE) - (SIDE - 1) / 2) * CELL
    plane = east * axis + north * axis[:, None]
    one = craters([centre], [3.0], [0.2])
    np.testing.assert_allclose(drawn(one, ground=plane) - plane, drawn(one), atol=1e-5)


@pytest.mark.parametrize('age,left', [(0.0, 0.0), (0.5, 0.35), (1.0, 0.7)])
def test_relief_within_the_rim_is_erased_the_less_the_older_the_crater(age, left):
    """Ripples along either axis: 0.7 of the age is back within the rim, all of it outside."""
    axis = (np.arange(SIDE) - (SIDE - 1) / 2) * CELL
    ripples = 0.02 * (np.sin(2.0 * np.pi * axis / 0.5) + np.cos(2.0 * np.pi * axis[:, None] / 0.5))
    one = craters([[0.0, 0.0]], [4.0], [age])
    kept = drawn(one, ground=ripples) - drawn(one)
    rho = np.hypot(axis, axis[:, None]) / 2.0
    for region, share in ((rho < 0.8, left), (rho > 1.5, 1.0)):
        assert np.std(kept[region]) == pytest.approx(share * np.std(ripples[region]), abs=4e-4)


def test_a_small_crater_leaves_the_ground_under_it_as_it_is():
    """Below five cells of radius nothing is flattened: the profile is added."""
    axis = (np.arange(SIDE) - (SIDE - 1) / 2) * CELL
    ripples = 0.01 * np.sin(2.0 * np.pi * axis / 0.5) + 0.0 * axis[:, None]
    one = craters([[0.0, 0.0]], [0.45], [0.0])
    np.testing.assert_allclose(drawn(one, ground=ripples) - ripples, drawn(one), atol=1e-6)


@pytest.mark.parametrize('age,strength', [(0.0, 1.0), (0.1, 0.25), (0.19, 0.0025), (0.2, 0.0)])
def test_fresh_craters_are_bright_and_fade_with_the_square_of_age(age, strength):
    albedo = np.ones((SIDE, SIDE), np.float32)
    rays.brighten(Area(albedo, FIRST, CELL), craters([[1.0, -0.5]], [2.0], [age]), 0.1)
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    rings = polar(albedo - 1.0, (1.0, -0.5), np.array([0.0, 0.5, 1.7, 3.6]), angles)
    assert np.ptp(rings, axis=0).max() < 0.004 * max(strength, 0.1)
    # Whole up to 0.8 radii; at 1.7 it has fallen by exp(-1/2); nothing beyond 3.5 radii.
    expected = 0.1 * strength * np.array([1.0, 1.0, np.exp(-0.5), 0.0])
    np.testing.assert_allclose(rings.mean(axis=0), expected, atol=1e-3 * strength)


def test_craters_too_small_for_the_map_do_not_brighten_it():
    albedo = np.ones((SIDE, SIDE), np.float32)
    rays.brighten(Area(albedo, FIRST, CELL), craters([[0.0, 0.0]], [0.29], [0.0]), 0.1)
    assert np.all(albedo == 1.0)
    rays.brighten(Area(albedo, FIRST, CELL), craters([[0.0, 0.0]], [0.31], [0.0]), 0.1)
    assert albedo.max() > 1.09
