"""The ground falls away as the sphere does, on procedural and on measured terrain."""

import numpy as np
import pytest
import worlds

from lunar_rover_sim.illumination.config import ReflectanceConfig, SunConfig
from lunar_rover_sim.illumination.sunlight import Sunlight
from lunar_rover_sim.world import levels as nest
from lunar_rover_sim.world.build import build_world, drop_m, MOON_RADIUS_M
from lunar_rover_sim.world.config import WorldConfig

WIDE = {'size_m': 12.8, 'surroundings': {'extent_m': 6000.0, 'samples': 513}}
CORNER_M = 6.4 * 2.0**0.5


@pytest.fixture(scope='module')
def plain():
    """Return a bare world without relief, to 6.5 km and more."""
    return build_world(WorldConfig.from_mapping({**worlds.BARE, **WIDE}), 0)


def fallen(level):
    """Return the (n, n) drop of a level by the formula [m]."""
    x = nest.axis_m(level.n, level.cell_m)
    return np.maximum(x**2 + x[:, None]**2 - CORNER_M**2, 0.0) / (2.0 * 1737.4e3)


def test_the_drop_is_that_of_the_sphere(plain):
    assert not plain.ground.heights_m.any()
    for level in plain.levels[1:]:
        # At the border, a chord of the next level's cells: c^2 / 8R.
        chord = (8.0 * level.cell_m)**2 / (8.0 * MOON_RADIUS_M)
        assert np.abs(level.heights_m + fallen(level)).max() < 2e-6 + chord
    far = plain.levels[-1]
    assert far.half_extent_m > 6000.0
    assert far.heights_m[far.n // 2, -1] == pytest.approx(-far.half_extent_m**2 / 3474.8e3,
                                                          abs=1e-4)


def test_the_parabola_is_the_sphere():
    r = np.array([1600.0, 5000.0, 20000.0])
    assert drop_m(r**2, 0.0) == pytest.approx(
        MOON_RADIUS_M - np.sqrt(MOON_RADIUS_M**2 - r**2), abs=0.005)
    assert drop_m(1600.0**2, 0.0) == pytest.approx(0.737, abs=0.001)


def test_measured_terrain_is_bent_too(tmp_path):
    (tmp_path / 'dem.yaml').write_text('size: [300, 300]\npixel_size: [50.0, -50.0]\n')
    np.save(tmp_path / 'dem.npy', np.full((300, 300), 250.0, np.float32))
    config = {**worlds.BARE, **WIDE, 'source': 'dem', 'path': str(tmp_path)}
    world = build_world(WorldConfig.from_mapping(config), 0)
    for level in world.levels[1:]:
        chord = (8.0 * level.cell_m)**2 / (8.0 * MOON_RADIUS_M)
        assert np.abs(level.heights_m + fallen(level)).max() < 1e-4 + chord


@pytest.mark.parametrize('height_m', [0.5, 3.0])
@pytest.mark.parametrize('above_rad', [1e-4, -1e-4])
def test_the_sun_sets_behind_the_horizon_of_the_sphere(plain, height_m, above_rad):
    """The horizon lies sqrt(2 h / R) below the horizontal, 0.8 and 1.9 mrad.

    The last ground of a plane, 6.5 km away, would be 0.1 and 0.5 mrad below it.
    """
    elevation = above_rad - np.sqrt(2.0 * height_m / MOON_RADIUS_M)
    light = Sunlight(plain, SunConfig(azimuth_deg=90.0, elevation_deg=np.degrees(elevation)),
                     ReflectanceConfig(), np.array([0.0, np.cos(elevation), np.sin(elevation)]),
                     indirect=False)
    seen = light.angle_above_horizon(np.array([[0.0, 0.0, height_m]]))
    assert np.sign(seen) == np.sign(above_rad)
