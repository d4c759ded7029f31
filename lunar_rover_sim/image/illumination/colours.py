"""Colours: spectra of ground, sun and lamp, and what a colour sensor sees of them.

A colour is told by two numbers, red over green and blue over green, of what a surface reflects
within the bands of a colour camera; a surface that reflects all wavelengths alike has 1 and 1.
Radiance is drawn once, and counts as that of the green band.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.frames import Array

WAVELENGTHS_NM = tuple(float(nm) for nm in range(400, 701, 20))
SUN_K = 5772.0
_PLANCK_JS, _LIGHT_MPS, _BOLTZMANN_JPK = 6.62607015e-34, 299792458.0, 1.380649e-23
_STEFAN = 5.670374419e-8        # [W m-2 K-4]
# Red, green and blue of a Sony IMX219 (Raspberry Pi camera 2) behind its infrared filter, relative
# to green at 520 nm: Sony's curves, digitised by K. Hufkens
# (github.com/bluegreen-labs/raspberry_pi_camera_responses). Pagnutti et al. (2017, J. Electron.
# Imaging 26, 013014) measured curves of that form. Sony's sensors for machine vision have filters
# of the same kind; green reaches a quantum efficiency of about 0.6 (EMVA 1288 of the IMX273).
_PEAK = 0.6
_RELATIVE = (
    (.099, .057, .036, .031, .049, .063, .121, .114, .113, .510, .961, .834, .764, .666, .558,
     .460),
    (.077, .046, .051, .086, .606, .934, .995, .929, .829, .658, .430, .226, .153, .137, .171,
     .230),
    (.488, .619, .741, .830, .720, .471, .238, .146, .092, .084, .071, .056, .059, .075, .091,
     .105))
RED, GREEN, BLUE = (tuple(round(_PEAK * share, 3) for share in curve) for curve in _RELATIVE)
# Equigonal albedo of highlands and maria (Velikodsky et al., 2011, Icarus 214, 30-45), at
# wavelengths in nm. They serve at 30 deg of phase, too.
_NM = (397.0, 420.0, 443.0, 467.0, 490.0, 513.0, 537.0, 560.0, 583.0, 607.0, 630.0, 653.0, 677.0,
       700.0)
_ALBEDO = {
    'highland': (.1043, .1114, .1185, .1260, .1329, .1397, .1465, .1531, .1586, .1638, .1692,
                 .1741, .1788, .1834),
    'mare': (.0648, .0688, .0728, .0770, .0811, .0852, .0894, .0936, .0971, .1005, .1038, .1070,
             .1100, .1130)}
_KIND = {'highland': 'highland', 'forward': 'highland', 'rock': 'highland', 'mare': 'mare',
         'basalt': 'mare'}
# Weathering by the solar wind reddens soil (Pieters et al., 2000, Meteorit. Planet. Sci. 35,
# 1101-1107); faces of rocks have less of it. How much less varies: this share of the soil's slope
# is a choice.
_FRESH = 0.6
# The Moon is the redder, the farther from opposition: change of the logarithms of red and blue
# over green with the sine of half the phase angle, from 20 to 90 deg in the reflectance of ROLO
# (Kieffer and Stone, 2005, Astron. J. 129, 2887-2901, table 4, bands from 442 to 704 nm).
PHASE_SLOPE = (0.052, -0.062)


@dataclasses.dataclass(frozen=True)
class Bands:
    """What a colour sensor sees.

    Attributes:
        response: (3, n) quantum efficiency of red, green and blue at `WAVELENGTHS_NM`.
    """

    response: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]] = (RED, GREEN, BLUE)

    def electrons_per_joule(self, temperature_k: float = SUN_K) -> Array:
        """Return the (3,) photo-electrons of red, green and blue pixels per joule of light.

        Args:
            temperature_k: Of the black body that the light comes from, all wavelengths counted.
        """
        metres = np.array(WAVELENGTHS_NM) * 1e-9
        photons = metres / (_PLANCK_JS * _LIGHT_MPS)        # of a joule
        step = metres[1] - metres[0]
        return np.asarray((np.array(self.response) * photons * planck(metres, temperature_k)).sum(
            axis=1) * step)

    def colour(self, reflectance: ArrayLike) -> Array:
        """Return (2,) red and blue over green of a surface under the sun.

        Args:
            reflectance: (n,) at `WAVELENGTHS_NM`, in any unit.
        """
        metres = np.array(WAVELENGTHS_NM) * 1e-9
        weight = np.array(self.response) * metres * planck(metres, SUN_K)
        seen = (weight * np.asarray(reflectance, float)).sum(axis=1) / weight.sum(axis=1)
        return seen[[0, 2]] / seen[1]

    def powers(self) -> Array:
        """Return (2,) powers that turn red and blue over green of the default bands into these.

        They are those of highland soil. Spectra of the Moon are smooth: mare soil under other
        bands is within 1.5 %, and so is light of 5000 K.
        """
        soil = albedo('highland')
        return np.asarray(np.log(self.colour(soil)) / np.log(Bands().colour(soil)))

    def colour_of_light(self, temperature_k: float) -> Array:
        """Return (2,) red and blue over green of a black body, over those of the sun."""
        ratio = self.electrons_per_joule(temperature_k) / self.electrons_per_joule()
        return np.asarray(ratio[[0, 2]] / ratio[1])


def planck(wavelength_m: ArrayLike, temperature_k: float) -> Array:
    """Return the share of a black body's radiation per metre of wavelength [1/m]."""
    metres = np.asarray(wavelength_m, float)
    exponent = _PLANCK_JS * _LIGHT_MPS / (metres * _BOLTZMANN_JPK * temperature_k)
    emitted = 2.0 * math.pi * _PLANCK_JS * _LIGHT_MPS**2 / metres**5 / np.expm1(exponent)
    return np.asarray(emitted / (_STEFAN * temperature_k**4))


def albedo(kind: str) -> Array:
    """Return the (n,) albedo of a parameter set of `hapke` at `WAVELENGTHS_NM`, of mature soil."""
    return np.interp(WAVELENGTHS_NM, _NM, _ALBEDO[_KIND[kind]])


@functools.cache
def ground_colour(kind: str) -> tuple[float, float]:
    """Return red and blue over green of soil of a parameter set, at 30 deg of phase."""
    red, blue = Bands().colour(albedo(kind))
    return float(red), float(blue)


def rock_colour(kind: str) -> tuple[float, float]:
    """Return red and blue over green of the rocks of a parameter set, at 30 deg of phase."""
    red, blue = ground_colour(kind)
    return red**_FRESH, blue**_FRESH
