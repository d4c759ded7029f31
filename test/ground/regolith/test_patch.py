"""The changed part of the ground as one grid."""

import numpy as np
import pytest

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.ground.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.ground.regolith.patch import changed_patch, save_patch
from lunar_rover_sim.ground.world.grid import HeightGrid

MARGIN = 40     # samples of untouched ground


def ground(n=81):
    """Return a plane that rises by 0.1 to the east; 81 samples of 25 mm reach to 1 m."""
    x = (np.arange(n) - (n - 1) / 2) * 0.025
    return HeightGrid(np.tile(0.1 * x, (n, 1)).astype(np.float32), 0.025)


def changed(*places):
    overlay = Overlay()
    for k, (ix, iy) in enumerate(places):
        overlay.put(ix, iy, np.full((1, 1), -0.001 * (k + 1)), np.full((1, 1), 0.0005))
    return overlay


def test_it_holds_all_that_changed_and_a_margin(tmp_path):
    patch = changed_patch(ground(), changed((10, -20), (30, 5)))
    assert patch.x_m == pytest.approx(CELL_M * np.arange(10 - MARGIN, 31 + MARGIN))
    assert patch.y_m == pytest.approx(CELL_M * np.arange(-20 - MARGIN, 6 + MARGIN))
    assert patch.change_m.shape == patch.height_m.shape == (26 + 2 * MARGIN, 21 + 2 * MARGIN)
    assert np.count_nonzero(patch.change_m) == np.count_nonzero(patch.compaction_m) == 2
    assert patch.change_m[MARGIN, MARGIN] == pytest.approx(-0.001)
    assert patch.change_m[MARGIN + 25, MARGIN + 20] == pytest.approx(-0.002)
    np.testing.assert_allclose(patch.height_m, 0.1 * patch.x_m + patch.change_m, atol=1e-6)
    save_patch(patch, tmp_path / 'patch.npz')
    with np.load(tmp_path / 'patch.npz') as saved:
        assert set(saved) == {'x_m', 'y_m', 'height_m', 'change_m', 'compaction_m'}
        assert np.array_equal(saved['height_m'], patch.height_m)


@pytest.mark.parametrize('place, x_ends, y_ends', [
    ((190, -195), (150, 200), (-200, -155)), ((-170, 180), (-200, -130), (140, 200))])
def test_it_ends_where_the_ground_ends(place, x_ends, y_ends):
    """At 1 m, or 200 samples; heights are known everywhere."""
    patch = changed_patch(ground(), changed(place))
    assert (patch.x_m[[0, -1]] / CELL_M).tolist() == pytest.approx(x_ends)
    assert (patch.y_m[[0, -1]] / CELL_M).tolist() == pytest.approx(y_ends)
    assert np.isfinite(patch.height_m).all()


def test_untouched_ground_has_no_changed_part():
    with pytest.raises(WorldError, match='there is no changed part'):
        changed_patch(ground(), Overlay())
