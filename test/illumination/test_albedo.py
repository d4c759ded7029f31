"""Albedos as integrals: what goes out over what comes in."""

import numpy as np
import pytest
from scipy import integrate

from lunar_rover_sim.illumination import hapke


@pytest.mark.parametrize('name', sorted(hapke.SETS))
@pytest.mark.parametrize('cos_i', [0.3, 0.5, 0.9])
def test_the_hemispherical_albedo_is_the_flux_out_over_the_flux_in(name, cos_i):
    """Radiance times cosine over all directions, over cos i for a beam of unit normal flux."""
    kind = hapke.SETS[name]
    mu, weight = np.polynomial.legendre.leggauss(60)
    mu, weight = 0.5 * (mu + 1.0), 0.5 * weight
    azimuth = np.radians(np.arange(0.5, 360.0))
    cos_g = cos_i * mu[:, None] + np.sqrt((1.0 - cos_i**2) * (1.0 - mu[:, None]**2)) \
        * np.cos(azimuth)
    r = hapke.reflectance(cos_i, np.broadcast_to(mu[:, None], cos_g.shape), cos_g, kind)
    out = 2.0 * np.pi * np.sum(weight * mu * r.mean(axis=1))
    assert hapke.hemispherical_albedo(kind, cos_i) == pytest.approx(out / cos_i, rel=0.03)


@pytest.mark.parametrize('b,c', [(0.2, 0.4), (0.3, -0.2)])
def test_the_phase_function_throws_to_the_side_that_c_says(b, c):
    """Henyey and Greenstein's two lobes: the mean cosine of the phase angle is b c."""
    def moment(angle):
        return np.cos(angle) * hapke.phase_function(angle, b, c) * np.sin(angle) / 2.0

    mean, _ = integrate.quad(moment, 0.0, np.pi)
    assert mean == pytest.approx(b * c, abs=1e-9)
    whole, _ = integrate.quad(lambda a: hapke.phase_function(a, b, c) * np.sin(a) / 2.0, 0.0,
                              np.pi)
    assert whole == pytest.approx(1.0)


def test_multiple_scattering_brightens_bright_ground_more():
    """Doubling the single-scattering albedo of a dark ground more than doubles its brightness."""
    kind = hapke.SETS['mare']
    half, whole = (hapke.reflectance(1.0, 1.0, 0.8, kind, albedo=a) for a in (0.5, 1.0))
    assert 2.0 < whole / half < 3.0
