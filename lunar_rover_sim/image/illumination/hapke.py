"""Hapke's bidirectional reflectance of a particulate surface: the reference implementation.

r(i, e, g) = w / (4 pi) mu0e / (mu0e + mue) [(1 + B(g)) p(g) + H(mu0e) H(mue) - 1] S(i, e, psi)

after Hapke, "Theory of Reflectance and Emittance Spectroscopy", 2nd ed., 2012: eq. 9.47 (shadow
hiding opposition effect B, isotropic multiple scattering), 6.7 (two-lobe Henyey-Greenstein p),
8.56 (H) and 12.63 (macroscopic roughness, with mu0e, mue and S of eqs. 12.45-12.54). Radiance is
L = J r with J the normal irradiance. The shader `hapke.glsl` computes the same; a test compares
them.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import nearest


@dataclasses.dataclass(frozen=True)
class HapkeParameters:
    """Parameters of one kind of ground.

    Attributes:
        w: Single-scattering albedo.
        b: Width of the Henyey-Greenstein lobes.
        c: Balance of the Henyey-Greenstein lobes; c > 0 scatters back.
        b_s0: Amplitude of the opposition effect.
        h_s: Angular half-width of the opposition effect.
        theta_deg: Mean slope of all relief too small to be drawn.
    """

    w: float
    b: float
    c: float
    b_s0: float
    h_s: float
    theta_deg: float


def hockey_stick(b: float) -> float:
    """Return c as a function of b (Hapke, 2012, eq. 6.9; used by Sato et al., 2014)."""
    return 3.29 * float(np.exp(-17.4 * b * b)) - 0.908


# The Moon at 643 nm, on the scale of LROC's Wide Angle Camera. Sato et al. (2014, J. Geophys. Res.
# Planets 119, 1775-1805) mapped w, b, c, B_S0 and h_S in tiles of 1 deg with theta fixed.
# - mare: the five values of the tile of Tranquility Base (23.5 E, 0.5 N) in their published map
#   WAC_HAPKEPARAMMAP.
# - highland: b and B_S0 as they give them for highlands (section 3.4, eq. 4). The phase curves of
#   the map begin beyond the peak of the opposition effect: their h_S = 0.074 makes a surge of 24 %
#   from 4 to 0 deg of phase, where Clementine saw more than 40 % (Buratti et al., 1996, Icarus
#   124, 490-499). h_S is the width that makes 41 %. w then gives the reflectance of the median of
#   their map between 30 S and 30 N (w = 0.385, b = 0.2375, c = 0.325, B_S0 = 1.69, h_S = 0.067),
#   which is mostly highland, at i = g = 30 deg, e = 0: 0.098.
# - forward: highland with the lobes turned round, and the w that gives the same reflectance there.
#   Yutu-2 saw strong forward scattering of undisturbed soil at centimetres (Lin et al., 2020,
#   Astron. Astrophys. 638, A35); how strong it is here is a choice.
# Rocks are a choice: less backscattering than mature soil, smooth at the scale of facets, brighter
# than the soil around them by a tenth (highland) and a fifth (basalt, the rock of the maria).
SETS: dict[str, HapkeParameters] = {
    'highland': HapkeParameters(w=0.412, b=0.23, c=hockey_stick(0.23), b_s0=1.65, h_s=0.034,
                                theta_deg=23.4),
    'forward': HapkeParameters(w=0.522, b=0.23, c=-0.40, b_s0=1.65, h_s=0.034, theta_deg=23.4),
    'mare': HapkeParameters(w=0.222, b=0.254, c=0.160, b_s0=1.993, h_s=0.0597, theta_deg=23.4),
    'rock': HapkeParameters(w=0.455, b=0.26, c=hockey_stick(0.26), b_s0=1.2, h_s=0.06,
                            theta_deg=16.0),
    'basalt': HapkeParameters(w=0.290, b=0.26, c=hockey_stick(0.26), b_s0=1.2, h_s=0.06,
                              theta_deg=16.0),
}


def parameter_set(name: str) -> HapkeParameters:
    """Return a named set; raise ConfigError for an unknown name."""
    if name not in SETS:
        raise ConfigError(f'reflectance: {name!r} is not valid; {nearest(name, SETS)}')
    return SETS[name]


def phase_function(g_rad: ArrayLike, b: float, c: float) -> Array:
    """Return the two-lobe Henyey-Greenstein phase function; its mean over the sphere is 1."""
    cos_g = np.cos(g_rad)
    back = (1.0 - b * b) / (1.0 - 2.0 * b * cos_g + b * b)**1.5
    forward = (1.0 - b * b) / (1.0 + 2.0 * b * cos_g + b * b)**1.5
    return 0.5 * (1.0 + c) * back + 0.5 * (1.0 - c) * forward


def opposition(g_rad: ArrayLike, b_s0: float, h_s: float) -> Array:
    """Return the shadow hiding opposition effect B(g)."""
    return b_s0 / (1.0 + np.tan(0.5 * np.asarray(g_rad)) / h_s)


def chandrasekhar(x: ArrayLike, w: ArrayLike) -> Array:
    """Return H(x), Hapke's second approximation (2012, eq. 8.56)."""
    x = np.asarray(x, dtype=float)
    gamma = np.sqrt(1.0 - np.asarray(w, dtype=float))
    r0 = (1.0 - gamma) / (1.0 + gamma)
    return 1.0 / (1.0 - w * x * (r0 + 0.5 * (1.0 - 2.0 * r0 * x) * np.log((1.0 + x) / x)))


def reflectance(cos_i: ArrayLike, cos_e: ArrayLike, cos_g: ArrayLike, parameters: HapkeParameters,
                *, albedo: ArrayLike = 1.0, theta_deg: float | None = None) -> Array:
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


def roughness(mu0: ArrayLike, mu: ArrayLike, cos_g: ArrayLike,
              theta_rad: float) -> tuple[Array, Array, Array]:
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

    def e1(cosine: Array, sine: Array) -> Array:
        return np.exp(-2.0 / np.pi * cosine / np.maximum(tan_theta * sine, 1e-6))

    def e2(cosine: Array, sine: Array) -> Array:
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


def normal_albedo(parameters: HapkeParameters) -> float:
    """Return the radiance factor pi r at i = e = g = 0."""
    return float(np.pi * reflectance(1.0, 1.0, 1.0, parameters))


def hemispherical_albedo(parameters: HapkeParameters, cos_i: float = 0.5) -> float:
    """Return the share of a sunbeam that the ground scatters back into the half space."""
    mu, azimuth = np.meshgrid(np.linspace(0.02, 0.98, 25), np.radians(np.arange(3.75, 360.0, 7.5)),
                              indexing='ij')
    cos_g = cos_i * mu + np.sqrt((1.0 - cos_i**2) * (1.0 - mu**2)) * np.cos(azimuth)
    r = reflectance(cos_i, mu, cos_g, parameters)
    return float(2.0 * np.pi * np.mean(r * mu) / cos_i)
