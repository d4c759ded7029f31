"""Relief that is added below the pixels of an elevation model."""

import numpy as np
import pytest
from world.elevation_models import config, hills, write_tiff

from lunar_rover_sim.world.build import build_world


def test_relief_below_a_model_reaches_down_to_the_cells_with_and_without_surroundings(tmp_path):
    """Curvature over one cell is to that over four as it is where coarser levels exist."""
    path = write_tiff(tmp_path / 'hills.tif', hills())
    shares = []
    for surroundings in ({'extent_m': 0.0}, {'samples': 129}):
        world = build_world(config(path, size_m=6.4, craters={'density': 0.0},
                                   rocks={'abundance': 0.0}, surroundings=surroundings), 3)
        short, long = (np.std(np.diff(world.ground.heights_m[::k], 2, axis=0)) for k in (1, 4))
        shares.append(short / long)
    assert len(world.levels) > 1
    assert shares[0] == pytest.approx(shares[1], rel=0.15)


def test_relief_below_a_model_is_handed_on_from_level_to_level(tmp_path):
    """Pixels of 20 m, cells of 1.6 m around ones of 0.2 m: both have relief of 8 m, as strong."""
    path = write_tiff(tmp_path / 'flat.tif', np.full((32, 32), 5.0, np.float32), pixel=20.0)
    rms = []
    for seed in (1, 2):
        world = build_world(config(path, craters={'density': 0.0}, rocks={'abundance': 0.0}), seed)
        for inner, grid in enumerate(world.levels[1:3]):
            lag, heights = round(8.0 / grid.cell_m), grid.heights_m.astype(float)
            bends = heights[:, 2 * lag:] - 2.0 * heights[:, lag:-lag] + heights[:, :-2 * lag]
            axis = (np.arange(grid.n) - 0.5 * (grid.n - 1)) * grid.cell_m
            away = np.maximum(np.abs(axis)[:, None], np.abs(axis[lag:-lag]))
            beyond = world.levels[1].half_extent_m + 10.0 if inner else -1.0
            rms.append(np.sqrt(np.mean(bends[away > beyond]**2)))
    # Finer cells have more of it: 1.4 and 1.6 times; 0.6 and 0.9 without that of the level around.
    assert 1.1 < np.mean([rms[0] / rms[1], rms[2] / rms[3]]) < 2.0
