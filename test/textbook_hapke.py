"""Hapke's formulae as the textbook has them, in double precision, to compare the law with.

"Theory of Reflectance and Emittance Spectroscopy", 2nd ed., 2012: eqs. 9.47, 6.7, 8.56, 12.45 to
12.63.
"""

import numpy as np


def phase_function(g_rad, b, c):
    """Return the two-lobe Henyey-Greenstein phase function; its mean over the sphere is 1."""
    cos_g = np.cos(g_rad)
    back = (1.0 - b * b) / (1.0 - 2.0 * b * cos_g + b * b)**1.5
    forward = (1.0 - b * b) / (1.0 + 2.0 * b * cos_g + b * b)**1.5
    return 0.5 * (1.0 + c) * back + 0.5 * (1.0 - c) * forward


def opposition(g_rad, b_s0, h_s):
    """Return the shadow hiding opposition effect B(g)."""
    return b_s0 / (1.0 + np.tan(0.5 * np.asarray(g_rad)) / h_s)


def chandrasekhar(x, w):
    """Return H(x), Hapke's second approximation (2012, eq. 8.56)."""
    x = np.asarray(x, dtype=float)
    gamma = np.sqrt(1.0 - np.asarray(w, dtype=float))
    r0 = (1.0 - gamma) / (1.0 + gamma)
    return 1.0 / (1.0 - w * x * (r0 + 0.5 * (1.0 - 2.0 * r0 * x) * np.log((1.0 + x) / x)))


def reflectance(cos_i, cos_e, cos_g, parameters, *, albedo=1.0, theta_deg=None):
    """Return r [1/sr] for cosines of incidence, emission and phase; 0 where either is <= 0.

    Args:
        albedo: Factor on w.
        theta_deg: Replaces the set's roughness (0: smooth).
    """
    mu0 = np.asarray(cos_i, dtype=float)
    mu = np.asarray(cos_e, dtype=float)
    seen = (mu0 > 0.0) & (mu > 0.0)
    mu0 = np.clip(mu0, 1e-6, 1.0)
    mu = np.clip(mu, 1e-6, 1.0)
    cos_g = np.clip(np.asarray(cos_g, dtype=float), -1.0, 1.0)
    w = np.clip(parameters.w * np.asarray(albedo, dtype=float), 0.0, 0.999)
    g = np.arccos(cos_g)
    theta = np.radians(parameters.theta_deg if theta_deg is None else theta_deg)
    mu0e, mue, shadowing = roughness(mu0, mu, cos_g, theta)
    single = (1.0 + opposition(g, parameters.b_s0, parameters.h_s)) \
        * phase_function(g, parameters.b, parameters.c)
    multiple = chandrasekhar(mu0e, w) * chandrasekhar(mue, w) - 1.0
    value = w / (4.0 * np.pi) * mu0e / (mu0e + mue) * (single + multiple) * shadowing
    return np.where(seen, value, 0.0)


def roughness(mu0, mu, cos_g, theta_rad):
    """Return effective cosines (mu0e, mue) and S of a surface with mean slope theta."""
    mu0, mu = np.asarray(mu0, dtype=float), np.asarray(mu, dtype=float)
    if theta_rad <= 0.0:
        return mu0, mu, np.ones(np.broadcast(mu0, mu, cos_g).shape)
    tan_theta = np.tan(theta_rad)
    chi = 1.0 / np.sqrt(1.0 + np.pi * tan_theta**2)
    sin_i, sin_e = np.sqrt(1.0 - mu0**2), np.sqrt(1.0 - mu**2)
    cos_psi = np.clip((np.asarray(cos_g) - mu0 * mu) / np.maximum(sin_i * sin_e, 1e-6), -1.0, 1.0)
    psi = np.arccos(cos_psi)
    sin2_half = 0.5 * (1.0 - cos_psi)
    f = np.exp(-2.0 * np.sqrt(sin2_half / np.maximum(1.0 - sin2_half, 1e-9)))

    def e1(cosine, sine):
        return np.exp(-2.0 / np.pi * cosine / np.maximum(tan_theta * sine, 1e-6))

    def e2(cosine, sine):
        return np.exp(-(cosine / np.maximum(tan_theta * sine, 1e-6))**2 / np.pi)

    e1_i, e1_e, e2_i, e2_e = e1(mu0, sin_i), e1(mu, sin_e), e2(mu0, sin_i), e2(mu, sin_e)
    eta_i = chi * (mu0 + sin_i * tan_theta * e2_i / (2.0 - e1_i))
    eta_e = chi * (mu + sin_e * tan_theta * e2_e / (2.0 - e1_e))
    low = mu0 >= mu  # i <= e
    e1_max, e1_min = np.where(low, e1_e, e1_i), np.where(low, e1_i, e1_e)
    e2_max, e2_min = np.where(low, e2_e, e2_i), np.where(low, e2_i, e2_e)
    below = 2.0 - e1_max - psi / np.pi * e1_min
    facing = (cos_psi * e2_max + sin2_half * e2_min) / below
    away = (e2_max - sin2_half * e2_min) / below
    mu0e = chi * (mu0 + sin_i * tan_theta * np.where(low, facing, away))
    mue = chi * (mu + sin_e * tan_theta * np.where(low, away, facing))
    ratio = np.where(low, mu0 / eta_i, mu / eta_e)
    shadowing = mue / eta_e * mu0 / eta_i * chi / (1.0 - f + f * chi * ratio)
    return np.maximum(mu0e, 1e-6), np.maximum(mue, 1e-6), shadowing
