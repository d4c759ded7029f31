"""Hapke's bidirectional reflectance of a particulate surface.

r(i, e, g) = w / (4 pi) mu0e / (mu0e + mue) [(1 + B(g)) p(g) + H(mu0e) H(mue) - 1] S(i, e, psi)

after Hapke, "Theory of Reflectance and Emittance Spectroscopy", 2nd ed., 2012: eq. 9.47 (shadow
hiding opposition effect B, isotropic multiple scattering), 6.7 (two-lobe Henyey-Greenstein p),
8.56 (H) and 12.63 (macroscopic roughness, with mu0e, mue and S of eqs. 12.45-12.54). Radiance is
L = J r with J the normal irradiance. All that is drawn is lit by these loops, in single precision:
errors are below 1e-3 of r, mostly below 1e-5.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.compiled import inlined, vectorised
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.fast_math import arc_cosine, exp2, log2
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import nearest

_PART = 128             # of the numbers: where none of it is lit, nothing is computed
_ZERO, _HALF, _ONE, _TWO = (np.float32(x) for x in (0.0, 0.5, 1.0, 2.0))
_LEAST, _TINY, _SMOOTHEST = np.float32(1e-6), np.float32(1e-9), np.float32(1e-4)
_MOST_W = np.float32(0.999)
_PI, _ONE_OVER_PI, _TWO_OVER_PI = (np.float32(x) for x in (np.pi, 1.0 / np.pi, 2.0 / np.pi))
_FOUR_PI = np.float32(0.25 / np.pi)
_LOG2_E, _HALF_LOG_2, _LOWEST = (np.float32(x) for x in (1.44269504, 0.34657359, -126.0))


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

    def law(self, scale: float = 1.0) -> NDArray[np.float32]:
        """Return w times `scale`, b, c, b_s0, h_s, as loops take them."""
        return np.array([self.w * scale, self.b, self.c, self.b_s0, self.h_s], np.float32)


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


def reflectance(cos_i: ArrayLike, cos_e: ArrayLike, cos_g: ArrayLike, parameters: HapkeParameters,
                *, albedo: ArrayLike = 1.0, theta_deg: float | None = None) -> Array:
    """Return r [1/sr] for cosines of incidence, emission and phase; 0 where either is <= 0.

    Args:
        albedo: Factor on w.
        theta_deg: Replaces the set's roughness (0: smooth).
    """
    tangent = math.tan(math.radians(parameters.theta_deg if theta_deg is None else theta_deg))
    every = np.broadcast_arrays(cos_i, cos_e, cos_g, tangent, albedo, 0.0)
    result = np.empty(every[0].size, np.float32)
    fill_reflectance(*(np.array(each, np.float32).ravel() for each in every), parameters.law(),
                     result)
    return result.reshape(every[0].shape).astype(float)


@inlined
def _exp(x):  # type: ignore[no-untyped-def]
    """Return e to a power of 0 and less."""
    return exp2(max(x * _LOG2_E, _LOWEST))


@inlined        # called, it gave other last bits in the process that compiled it
def _filled(cos_i, cos_e, cos_g, tan_theta,  # type: ignore[no-untyped-def]
            albedo, more_c, law, result):
    """As `fill_reflectance`, whether anything is lit or not."""
    w_all, b, c_all, b_s0, h_s = law[0], law[1], law[2], law[3], law[4]
    bb = _ONE + b * b
    outer = _HALF * (_ONE - b * b)
    # Divisions take most of the time: those that can be are done together.
    for j in range(len(result)):
        mu0, mu = min(max(cos_i[j], _LEAST), _ONE), min(max(cos_e[j], _LEAST), _ONE)
        cosine = min(max(cos_g[j], -_ONE), _ONE)
        w = min(max(w_all * albedo[j], _ZERO), _MOST_W)
        theta = max(tan_theta[j], _SMOOTHEST)
        chi = _ONE / np.sqrt(_ONE + _PI * theta * theta)
        sin_i, sin_e = np.sqrt(_ONE - mu0 * mu0), np.sqrt(_ONE - mu * mu)
        cos_psi = (cosine - mu0 * mu) / max(sin_i * sin_e, _LEAST)
        cos_psi = min(max(cos_psi, -_ONE), _ONE)
        psi = arc_cosine(cos_psi) * _ONE_OVER_PI
        half2 = _HALF * (_ONE - cos_psi)
        f = _exp(-_TWO * np.sqrt(half2 / max(_ONE - half2, _TINY)))
        ti, te = sin_i * theta, sin_e * theta
        over_i, over_e = max(ti, _LEAST), max(te, _LEAST)
        both = _ONE / (over_i * over_e)
        ci, ce = mu0 * over_e * both, mu * over_i * both
        e1_i, e1_e = _exp(-_TWO_OVER_PI * ci), _exp(-_TWO_OVER_PI * ce)
        e2_i, e2_e = _exp(-_ONE_OVER_PI * ci * ci), _exp(-_ONE_OVER_PI * ce * ce)
        both = _ONE / ((_TWO - e1_i) * (_TWO - e1_e))
        eta_i = mu0 + ti * e2_i * (_TWO - e1_e) * both      # over chi
        eta_e = mu + te * e2_e * (_TWO - e1_i) * both
        low = mu0 >= mu
        e1_max, e1_min = e1_e if low else e1_i, e1_i if low else e1_e
        e2_max, e2_min = e2_e if low else e2_i, e2_i if low else e2_e
        below = _ONE / (_TWO - e1_max - psi * e1_min)
        facing = (cos_psi * e2_max + half2 * e2_min) * below
        away = (e2_max - half2 * e2_min) * below
        mu0e = max(chi * (mu0 + ti * (facing if low else away)), _LEAST)
        mue = max(chi * (mu + te * (away if low else facing)), _LEAST)
        own_eta, other_eta = eta_i if low else eta_e, eta_e if low else eta_i
        shadowed = chi * other_eta * (own_eta * (_ONE - f) + f * (mu0 if low else mu))
        seen = mue * mu0 * mu0e / (shadowed * (mu0e + mue))
        gamma = np.sqrt(_ONE - w)
        r0 = (_ONE - gamma) / (_ONE + gamma)
        both = _ONE / (mu0e * mue)
        log_i = log2((_ONE + mu0e) * mue * both)
        log_e = log2((_ONE + mue) * mu0e * both)
        h_i = _ONE - w * mu0e * (r0 + _HALF_LOG_2 * (_ONE - _TWO * r0 * mu0e) * log_i)
        h_e = _ONE - w * mue * (r0 + _HALF_LOG_2 * (_ONE - _TWO * r0 * mue) * log_e)
        multiple = _ONE / (h_i * h_e) - _ONE
        back, forth = bb - _TWO * b * cosine, bb + _TWO * b * cosine
        back, forth = back * np.sqrt(back), forth * np.sqrt(forth)
        c = c_all + more_c[j]
        lobes = outer * ((_ONE + c) * forth + (_ONE - c) * back) / (back * forth)
        wide = h_s * (_ONE + cosine)
        sine = np.sqrt(max(_ONE - cosine * cosine, _ZERO))
        single = (_ONE + b_s0 * wide / max(wide + sine, _TINY)) * lobes
        value = w * _FOUR_PI * seen * (single + multiple)
        result[j] = value if min(cos_i[j], cos_e[j]) > _ZERO else _ZERO


@vectorised
def fill_reflectance(cos_i, cos_e, cos_g, tan_theta,  # type: ignore[no-untyped-def]
                     albedo, more_c, law, result):
    """Fill in Hapke's reflectance [1/sr]; 0 where either cosine is <= 0.

    Args:
        cos_i, cos_e, cos_g: (n,) cosines of incidence, emission and phase.
        tan_theta: (n,) tangent of the mean slope of what is not drawn.
        albedo: (n,) factor on w.
        more_c: (n,) what is added to c.
        law: w, b, c, b_s0, h_s.
        result: (n,).
    """
    for start in range(0, len(result), _PART):
        end, lit = min(start + _PART, len(result)), 0
        for j in range(start, end):
            lit += cos_i[j] > _ZERO
        if lit == 0:
            result[start:end] = _ZERO
        else:
            _filled(cos_i[start:end], cos_e[start:end], cos_g[start:end], tan_theta[start:end],
                    albedo[start:end], more_c[start:end], law, result[start:end])


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
