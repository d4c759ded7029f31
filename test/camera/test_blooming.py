"""Charge that runs along the columns of a CCD."""

import numpy as np
import pytest

from lunar_rover_sim.camera.blooming import bloom


def test_charge_is_conserved_and_fills_the_column_to_both_sides():
    electrons = np.full((100, 5), 10.0)
    electrons[50, 2] = 1900.0
    result = bloom(electrons, 100.0, 1.0)
    assert result.sum() == pytest.approx(electrons.sum())
    np.testing.assert_array_equal(result[:, [0, 1, 3, 4]], electrons[:, [0, 1, 3, 4]])
    # 1800 beyond the well fill 10 pixels by 90 each way.
    assert np.all(result[40:61, 2] == 100.0)
    assert np.all(result[:40, 2] == 10.0) and np.all(result[61:, 2] == 10.0)


def test_neighbouring_sources_share_the_room_between_them():
    electrons = np.zeros((60, 1))
    electrons[20], electrons[30] = 1500.0, 1100.0
    result = bloom(electrons, 100.0, 1.0)
    assert result.sum() == pytest.approx(electrons.sum())
    assert result.max() == 100.0 and np.all(result[20:31] == 100.0)


def test_charge_leaves_at_the_ends_and_through_drains():
    electrons = np.zeros((10, 2))
    electrons[5, 0] = 1e9
    assert np.all(bloom(electrons, 100.0, 1.0)[:, 0] == 100.0)
    electrons[5, 0] = 500.0
    assert bloom(electrons, 100.0, 0.5).sum() == pytest.approx(300.0)
    assert bloom(electrons, 100.0, 0.0).sum() == pytest.approx(100.0)
    assert electrons[5, 0] == 500.0     # the input is kept


def test_nothing_moves_below_the_well():
    electrons = np.random.default_rng(0).uniform(0.0, 99.0, (20, 30))
    np.testing.assert_array_equal(bloom(electrons, 100.0, 1.0), electrons)
