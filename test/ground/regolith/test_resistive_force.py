"""Resistive force theory against the identities of its formula and published plates."""

import dataclasses

import numpy as np
import pytest

from lunar_rover_sim.ground.regolith.resistive_force import (GENERIC, plate_force_n, POPPY_CLOSE,
                                                             POPPY_LOOSE)
from lunar_rover_sim.ground.regolith.soil import PRESETS

HALF = 0.5 * np.pi


def test_a_flat_plate_pressed_down_has_the_stiffness_zeta():
    """The generic coefficients are scaled so: alpha_z(0, pi/2) = 1."""
    alpha_x, alpha_z = GENERIC.alpha(0.0, HALF)
    assert alpha_z == pytest.approx(1.0, abs=1e-12)
    assert alpha_x == pytest.approx(0.0, abs=1e-12)
    assert GENERIC.bearing == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize('soil, down_n, aside_n', [
    ('poppy_loose', 12.7, 4.15), ('poppy_close', 23.2, 5.35)])
def test_plates_in_poppy_seeds(soil, down_n, aside_n):
    """10 cm^2 at 5 cm, pressed down, and upright pushed sideways (Li et al. 2013)."""
    soil = PRESETS[soil]
    down = plate_force_n(soil.shape, soil.zeta_npm3, 1e-3, 0.05, 0.0, HALF)
    aside = plate_force_n(soil.shape, soil.zeta_npm3, 1e-3, 0.05, HALF, 0.0)
    assert down[1] == pytest.approx(down_n, abs=0.05)
    assert aside[0] == pytest.approx(aside_n, abs=0.05)


@pytest.mark.parametrize('shape', [GENERIC, POPPY_LOOSE, POPPY_CLOSE])
def test_the_force_is_the_fourier_series_of_the_paper(shape):
    """Li et al. (2013), supplement: terms cos and sin of 2 pi (m beta / pi + n gamma / 2 pi)."""
    rng = np.random.default_rng(2)
    up = {(0, 0): (shape.a00, 0.0), (1, 0): (shape.a10, 0.0), (1, 1): (0.0, shape.b11),
          (0, 1): (0.0, shape.b01), (-1, 1): (0.0, shape.b_11)}
    back = {(1, 1): (shape.c11, 0.0), (0, 1): (shape.c01, 0.0), (-1, 1): (shape.c_11, 0.0),
            (1, 0): (0.0, shape.d10)}
    for beta, gamma in [*rng.uniform(-HALF, HALF, (40, 2)), (0.7, HALF), (0.7, -HALF)]:
        expected = [sum(a * np.cos(2.0 * m * beta + n * gamma)
                        + b * np.sin(2.0 * m * beta + n * gamma)
                        for (m, n), (a, b) in terms.items()) for terms in (back, up)]
        assert shape.alpha(beta, gamma) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize('shape', [GENERIC, POPPY_LOOSE, POPPY_CLOSE])
def test_a_motion_backward_is_the_mirror_of_one_forward(shape):
    rng = np.random.default_rng(1)
    beta, gamma = rng.uniform(-HALF, HALF, 50), rng.uniform(-HALF, HALF, 50)
    x, z = shape.alpha(beta, gamma)
    back_x, back_z = shape.alpha(-beta, np.copysign(np.pi, gamma) - gamma)
    np.testing.assert_allclose(back_x, -x, atol=1e-12)
    np.testing.assert_allclose(back_z, z, atol=1e-12)


def test_a_plate_has_no_front_and_back_of_its_own():
    """Turned by half a circle it is the same plate."""
    gamma = np.linspace(-HALF, HALF, 21)
    np.testing.assert_allclose(GENERIC.alpha(0.3, gamma), GENERIC.alpha(0.3 + np.pi, gamma))


def test_upright_plates_resist_sideways_by_the_side_ratio():
    for shape in (GENERIC, POPPY_LOOSE, POPPY_CLOSE):
        alpha_x, _ = shape.alpha(HALF, 0.0)
        assert alpha_x / shape.bearing == pytest.approx(shape.side_ratio)
        # Soil is weaker sideways than downwards.
        assert 0.15 < shape.side_ratio < 0.6


def test_a_face_that_leads_downwards_is_lifted_more_than_one_that_leads_upwards():
    lift = [GENERIC.alpha(beta, 0.0)[1] for beta in (np.pi / 4, -np.pi / 4)]
    assert lift[0] > 3.0 * lift[1] > 0.0


@pytest.mark.parametrize('depth_m, low, high', [(0.02, 20e3, 60e3), (0.05, 20e3, 60e3)])
def test_surveyor_footpads_stand_on_highland(depth_m, low, high):
    """Surveyor 3: 20 to 60 kPa at 2 to 5 cm; Surveyor 5: 27 kPa."""
    soil = PRESETS['highland']
    _, force = plate_force_n(soil.shape, soil.zeta_npm3, 1.0, depth_m, 0.0, HALF)
    assert low <= force <= high


def test_the_apollo_15_penetrometer_stands_on_dense_highland():
    """348 kPa at 16 cm (Mitchell et al. 1974)."""
    soil = PRESETS['highland_dense']
    _, force = plate_force_n(soil.shape, soil.zeta_npm3, 1.0, 0.16, 0.0, HALF)
    assert force == pytest.approx(348e3, rel=0.02)


@pytest.mark.parametrize('packing', [POPPY_LOOSE, POPPY_CLOSE])
def test_all_grains_have_about_the_generic_shape(packing):
    """Li et al. (2013): over the bearing of a flat plate the coefficients hardly differ."""
    for field in dataclasses.fields(GENERIC):
        own = getattr(packing, field.name) / packing.bearing
        assert own == pytest.approx(getattr(GENERIC, field.name), abs=0.07)
