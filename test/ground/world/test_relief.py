"""Relief and craters read back from built worlds."""

import dataclasses

from ground.world.crater_scene import stamp
import numpy as np
import pytest
import worlds

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.ground.world import craters
from lunar_rover_sim.ground.world.config import CraterConfig, ReliefConfig, WorldConfig
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.relief import spectrum, structure_function
from lunar_rover_sim.ground.world.shade import rms_slope_deg
from lunar_rover_sim.ground.world.spline import Area

FREE = {'craters': {'density': 0.0}, 'rocks': {'abundance': 0.0}}


def deviogram(heights, lags):
    """Return the RMS deviation over lags [cells] along both axes."""
    return np.array([np.sqrt(0.5 * np.mean((heights[:, m:] - heights[:, :-m]) ** 2, dtype=float)
                             + 0.5 * np.mean((heights[m:] - heights[:-m]) ** 2, dtype=float))
                     for m in lags])


def test_structure_function_has_the_hurst_exponent():
    S = spectrum(ReliefConfig(far_rms_slope_deg=0.0, longest_wavelength_m=1e4, hurst=0.6))
    baselines = np.array([0.1, 0.3, 1.0, 3.0])
    deviation = np.sqrt([structure_function(S, b) for b in baselines])
    slope = np.polyfit(np.log(baselines), np.log(deviation), 1)[0]
    assert slope == pytest.approx(0.6, abs=0.01)
    assert deviation[1] / 0.3 == pytest.approx(np.tan(np.radians(2.0)), rel=1e-3)


@pytest.mark.parametrize('hurst', [0.5, 0.75])
def test_regolith_relief_read_back(hurst):
    world = worlds.world(relief={'hurst': hurst, 'far_rms_slope_deg': 0.0}, **FREE)
    inner = world.ground.heights_m[100:-100, 100:-100]
    lags = np.array([8, 12, 16, 24, 32, 48, 64])  # 0.2 to 1.6 m
    deviation = deviogram(inner, lags)
    measured = np.polyfit(np.log(lags), np.log(deviation), 1)[0]
    assert measured == pytest.approx(hurst, abs=0.05)
    at_baseline = np.degrees(np.arctan(deviation[1] / 0.3))
    assert at_baseline == pytest.approx(world.config.relief.rms_slope_deg, rel=0.08)
    # The next level continues the same law.
    coarse = world.levels[1].heights_m[100:-100, 100:-100]
    lags = np.array([16, 24, 32, 48])  # 3.2 to 9.6 m
    deviation = deviogram(coarse, lags)
    expected = np.tan(np.radians(2.0)) * 0.3 * (lags * 0.2 / 0.3) ** hurst
    assert np.allclose(deviation, expected, rtol=0.2)  # few independent patches


def test_terrain_relief_read_back():
    world = worlds.world(relief={'rms_slope_deg': 0.0, 'far_rms_slope_deg': 6.0}, **FREE)
    outer = world.levels[-1]
    assert rms_slope_deg(outer, 17.6) == pytest.approx(6.0, rel=0.08)
    # Hurst exponents near 1 show only at baselines far below the longest wavelength: compare
    # with the spectrum's own structure function.
    S = spectrum(world.config.relief)
    lags = np.array([11, 22, 44])
    expected = np.sqrt([structure_function(S, m * outer.cell_m) for m in lags])
    assert np.allclose(deviogram(outer.heights_m, lags), expected, rtol=0.1)
    # Nothing shorter than its baseline: the ground is a smooth slope.
    assert rms_slope_deg(world.ground, 0.05) == pytest.approx(rms_slope_deg(world.ground, 1.0),
                                                              rel=0.02)


@pytest.mark.parametrize('far_rms_slope_deg,published_deg,within_deg', [
    (2.5, 3.4, 0.3), (6.5, 7.5, 0.5)])
def test_slopes_of_a_landing_site_and_of_the_average_highland(far_rms_slope_deg, published_deg,
                                                              within_deg):
    # LOLA's median at 17 m is 7.5 deg in highlands and 2.0 deg in maria (Rosenburg et al., 2011).
    world = worlds.small(surroundings={'samples': 513},
                         relief={'far_rms_slope_deg': far_rms_slope_deg})
    z, lag = world.levels[2].heights_m, 11      # 819 m wide, 1.6 m cells
    rise = np.hypot((z[:, lag:] - z[:, :-lag])[:-lag], (z[lag:] - z[:-lag])[:, :-lag])
    slope = np.degrees(np.arctan(rise / (lag * world.levels[2].cell_m)))
    assert np.median(slope) == pytest.approx(published_deg, abs=within_deg)


def test_relief_does_not_repeat():
    # A periodic synthesis would correlate opposite edges of the coarsest level.
    world = worlds.world(relief={'rms_slope_deg': 0.0, 'far_rms_slope_deg': 6.0}, **FREE)
    heights = world.levels[-1].heights_m
    edge, opposite = heights[0] - heights[0].mean(), heights[-1] - heights[-1].mean()
    assert abs(np.corrcoef(edge, opposite)[0, 1]) < 0.5


def test_relief_favours_no_direction():
    hurst = 0.5     # that world is there
    world = worlds.world(relief={'hurst': hurst, 'far_rms_slope_deg': 0.0}, **FREE)
    heights = world.ground.heights_m
    m = 12
    along_x = np.std(heights[:, m:] - heights[:, :-m])
    along_y = np.std(heights[m:] - heights[:-m])
    k = round(m / np.sqrt(2.0))
    diagonal = np.std(heights[k:, k:] - heights[:-k, :-k]) * (m / (k * np.sqrt(2.0))) ** hurst
    # One sample; over 24 seeds of 0.65 the ratio is 1.003 with a standard error of 0.002.
    assert along_x == pytest.approx(along_y, rel=0.06)
    assert diagonal == pytest.approx(along_x, rel=0.06)


def test_baseline_can_be_driven():
    world = worlds.world()
    # The rover is 0.3 m long.
    assert 2.0 < rms_slope_deg(world.ground, 0.3) < 7.0


def test_crater_sizes_read_back():
    world = worlds.world()
    config = world.config.craters
    for level, low in zip(world.levels, (0.15, 2.0, 15.0)):
        half = level.half_extent_m
        inside = np.abs(world.craters.position_m).max(axis=1) <= half
        diameter = world.craters.diameter_m[inside & (world.craters.diameter_m >= low)]
        expected = ((craters.density_per_m2(config, low)
                     - craters.density_per_m2(config, config.max_diameter_m))
                    * (2 * half) ** 2)
        # Poisson; the start keeps a few away, and younger craters erase a few older ones.
        assert abs(len(diameter) - expected) < 4.0 * np.sqrt(expected) + 0.03 * expected
        # Maximum likelihood of the exponent (Crawford et al. 1970), untruncated: the largest
        # crater is 13 times the smallest or more, which biases it by less than 0.02.
        slope = len(diameter) / np.sum(np.log(diameter / low))
        assert slope == pytest.approx(config.slope, abs=4.0 * config.slope / np.sqrt(len(diameter))
                                      + 0.03)


def test_craters_are_as_deep_as_their_age_says():
    # Sparse craters on a plane: each is measured by its mean profile over all azimuths.
    world = worlds.world(relief={'rms_slope_deg': 0.0, 'far_rms_slope_deg': 0.0},
                         rocks={'abundance': 0.0},
                         craters={'density': 0.008, 'min_diameter_m': 0.6, 'max_diameter_m': 1.2,
                                  'age_exponent': 0.6})
    ground, config, all_ = world.ground, world.config.craters, world.craters
    measured = []
    for i in np.flatnonzero(np.abs(all_.position_m).max(axis=1) < 20.0):
        distance = np.linalg.norm(all_.position_m - all_.position_m[i], axis=1)
        distance[i] = np.inf
        if np.any(distance < 1.3 * (all_.diameter_m + all_.diameter_m[i])):
            continue
        angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
        r = 0.5 * all_.diameter_m[i] * np.linspace(0.0, 2.4, 97)
        ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        h = ground.height_at(all_.position_m[i] + r[:, None, None] * ring)
        # The crest of each azimuth, as the outline is irregular.
        crest = h.max(axis=0).mean()
        plain = h[-1].mean()
        d = all_.diameter_m[i]
        measured.append((all_.age[i], (crest - h[0].mean()) / d, (crest - plain) / d))
    age, depth, rim = np.array(measured).T
    assert len(age) > 30
    table = craters.profile_table(config)
    assert np.allclose(depth, np.interp(age, table.ages, table.depth), atol=0.012)
    assert depth[age < 0.1].mean() > 0.14
    assert depth[age > 0.9].mean() < 0.04
    assert rim.max() < 0.05 and rim[age > 0.5].max() < 0.012


def test_many_degraded_craters_and_few_fresh_ones():
    catalogue, config = worlds.world().craters, CraterConfig()
    table = craters.profile_table(config)
    depth = np.interp(catalogue.age, table.ages, table.depth)
    assert np.median(depth) < 0.5 * config.fresh_depth
    assert 0.01 < np.mean(depth > 0.85 * config.fresh_depth) < 0.1


def test_profile_from_fresh_to_old():
    config = CraterConfig()
    table = craters.profile_table(config)
    assert table.depth[0] == pytest.approx(0.2, abs=1e-6)    # Pike (1977)
    assert table.rim[0] == pytest.approx(0.04, abs=1e-6)
    assert table.depth[-1] == pytest.approx(config.oldest_depth, abs=0.003)
    assert np.all(np.diff(table.depth) < 0.0) and np.all(np.diff(table.steepest) < 1e-9)
    # Diffusion moves soil and makes none: ring volumes stay, up to what tapers off at the reach.
    volume = (table.heights * craters.RADII).sum(axis=1) * craters.RADII[1]
    assert np.ptp(volume) < 0.012


def test_the_younger_crater_lies_on_top():
    config = dataclasses.replace(CraterConfig(), irregularity=0.0)
    position = np.array([[-1.5, 0.0], [1.5, 0.0]])
    diameter = np.array([4.0, 4.0])
    age = np.array([0.3, 0.01])
    n, cell = 481, 0.025
    both = np.zeros((n, n), np.float32)
    swapped, alone = both.copy(), both.copy()
    level = np.zeros(2, np.int32)
    first = (-(n // 2), -(n // 2))
    stamp(Area(both, first, cell), Craters(position, diameter, age, level), config)
    stamp(Area(swapped, first, cell),
          Craters(position[::-1], diameter[::-1], age[::-1], level), config)
    # Time decides, not the order of the list.
    assert np.array_equal(both, swapped)
    stamp(Area(alone, first, cell),
          Craters(position[1:], diameter[1:], age[1:], level[1:]), config)
    axis = (np.arange(n) - 0.5 * (n - 1)) * cell
    in_young = np.hypot(axis - 1.5, axis[:, None]) < 1.6
    in_old = (np.hypot(axis + 1.5, axis[:, None]) < 2.0) & in_young
    # Where they overlap, the old one is gone but for a plane's tilt and offset: what is left of
    # the difference bends far less than the bowl that was there (0.45 m deep).
    left = (both - alone)[in_young]
    assert np.ptp(left) < 0.2 and in_old.any()
    x, y = np.meshgrid(axis, axis)
    design = np.column_stack([x[in_young], y[in_young], np.ones(in_young.sum())])
    rest = left - design @ np.linalg.lstsq(design, left, rcond=None)[0]
    assert np.abs(rest).max() < 0.06


def test_small_old_craters_do_not_survive_within_young_large_ones():
    coarser = Craters(np.zeros((1, 2)), np.array([10.0]), np.array([0.001]), np.zeros(1, np.int32))
    fine = Craters(np.array([[1.0, 0.0], [1.0, 1.0], [30.0, 0.0]]), np.full(3, 2.0),
                   np.array([0.9, 0.01, 0.9]), np.zeros(3, np.int32))
    kept = craters.survivors(fine, coarser)
    assert kept.age.tolist() == [0.01, 0.9] and kept.position_m[1, 0] == 30.0


def test_too_many_craters_are_refused():
    config = CraterConfig(slope=4.0)
    with pytest.raises(WorldError, match=r'raise world.craters.min_'):
        craters.populate(config, 25.6, 0.15, 1.6, 0, np.random.default_rng(0))


def test_crater_density_zero_means_none():
    config = WorldConfig.from_mapping(FREE).craters
    rng = np.random.default_rng(0)
    assert len(craters.populate(config, 100.0, 0.1, 10.0, 0, rng)) == 0
