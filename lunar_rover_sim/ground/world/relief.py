"""Self-affine relief, synthesised band by band so that nested levels share one spectrum.

The relief is Gaussian with an isotropic power spectrum S(k), k in rad/m, whose variance is the
integral of S d2k / (2 pi)2. S ~ k^(-2 - 2H) makes the RMS deviation over a baseline L grow as
L^H, H being the Hurst exponent (Shepard et al. 2001, "The roughness of natural terrain").
"""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
import scipy  # its parts when they are used

from lunar_rover_sim.ground.world.config import ReliefConfig
from lunar_rover_sim.ground.world.grid import height_step_m, round_to

Spectrum = Callable[[NDArray[np.float64]], NDArray[np.float64]]

# Wavelength, in cells of the coarser one, at which two neighbouring levels share the power.
SPLIT_CELLS = 5.0


def smoothstep(x: ArrayLike) -> NDArray[np.float64]:
    """Return 0 below 0, 1 above 1, and 3x^2 - 2x^3 between."""
    t = np.clip(x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def high_pass(k: NDArray[np.float64], wavelength_m: float) -> NDArray[np.float64]:
    """Return the power weight that passes wavelengths below one, with a flank of an octave."""
    return smoothstep(0.5 + np.log2(np.maximum(k, 1e-12) * wavelength_m / (2.0 * np.pi)))


def spectrum(config: ReliefConfig) -> Spectrum:
    """Return S(k) [m4] of the whole relief, k in rad/m."""
    def regolith(k: NDArray[np.float64]) -> NDArray[np.float64]:
        return k ** (-2.0 - 2.0 * config.hurst) * high_pass(k, config.longest_wavelength_m)

    def terrain(k: NDArray[np.float64]) -> NDArray[np.float64]:
        return (k ** (-2.0 - 2.0 * config.far_hurst)
                * high_pass(k, config.longest_wavelength_m)
                * (1.0 - high_pass(k, config.far_baseline_m)))

    regolith_gain = _gain(regolith, config.rms_slope_deg, config.baseline_m)
    terrain_gain = _gain(terrain, config.far_rms_slope_deg, config.far_baseline_m)
    return lambda k: regolith_gain * regolith(k) + terrain_gain * terrain(k)


def structure_function(S: Spectrum, baseline_m: float) -> float:
    """Return the mean squared height difference [m2] over a baseline [m].

    D(L) = 1 / pi * integral of S(k) (1 - J0(k L)) k dk, the isotropic two-dimensional form.
    """
    log_k = np.linspace(np.log(1e-5), np.log(1e4), 40001)
    k = np.exp(log_k)
    integrand = S(k) * (1.0 - scipy.special.j0(k * baseline_m)) * k * k
    return float(np.sum(integrand) * (log_k[1] - log_k[0]) / np.pi)


def _gain(S: Spectrum, rms_slope_deg: float, baseline_m: float) -> float:
    if rms_slope_deg == 0.0:
        return 0.0
    wanted = (np.tan(np.radians(rms_slope_deg)) * baseline_m) ** 2
    unit = structure_function(S, baseline_m)
    return wanted / unit if unit > 0.0 else 0.0


def synthesise(S: Spectrum, n: int, cell_m: float, parent_cell_m: float | None, finest: bool,
               rng: np.random.Generator) -> NDArray[np.float32]:
    """Return (n, n) heights [m] with the part of S(k) that belongs to a level.

    These are the wavelengths below the split with its parent (the next coarser level, whose cell
    is `parent_cell_m`; None if there is none, which sets no limit) and above the split with its
    child. The finest level has no child: its wavelengths fade out from 4 to 2 cells.
    """
    # The transform is periodic: a margin of the longest wavelength keeps opposite edges apart.
    margin = 8 if parent_cell_m is not None else n // 4
    size = scipy.fft.next_fast_len(n + margin, real=True)
    k_axis = 2.0 * np.pi * scipy.fft.fftfreq(size, cell_m)
    k_half = np.abs(k_axis[:size // 2 + 1])
    table_k = np.linspace(0.0, 1.5 * np.pi / cell_m, 16384)
    table_k[0] = table_k[1]
    too_short = (smoothstep(np.log2(table_k * cell_m / (0.5 * np.pi))) if finest
                 else high_pass(table_k, SPLIT_CELLS * cell_m))
    power = S(table_k) * (1.0 - too_short)
    if parent_cell_m is not None:
        power = power * high_pass(table_k, SPLIT_CELLS * parent_cell_m)
    power[0] = 0.0
    if not np.any(power):
        return np.zeros((n, n), np.float32)
    table = np.sqrt(power) / cell_m
    wave = _white_spectrum(size, rng)
    scale = (len(table) - 1) / table_k[-1]
    k2_half = k_half * k_half
    rise = np.diff(table)
    for j, ky in enumerate(k_half):
        index = np.sqrt(k2_half + ky * ky) * scale
        lower = index.astype(np.int32)
        index -= lower
        index *= rise[lower]
        index += table[lower]
        wave[j] *= index
        if 0 < j < (size + 1) // 2:
            wave[-j] *= index       # the row of -ky
    heights = scipy.fft.irfft2(wave, s=(size, size), overwrite_x=True)
    round_to(heights, height_step_m(cell_m))
    return heights[:n, :n].astype(np.float32)


def _white_spectrum(size: int, rng: np.random.Generator) -> NDArray[np.complex128]:
    """Return the (size, size // 2 + 1) real transform of white noise of unit variance.

    It is drawn where it is needed. Its components are uniform, not normal: heights are sums of so
    many of them that they are normal all the same, and uniform numbers are exact and quick.
    """
    wave = rng.random((size, size // 2 + 1, 2))
    wave -= 0.5
    wave *= size * math.sqrt(6.0)       # half of the variance, 1/12 before, for each component
    result = wave.view(np.complex128)[..., 0]
    # The columns that are their own mirror images are transforms of real lines.
    for column in (0, size // 2) if size % 2 == 0 else (0,):
        line = (rng.random(size) - 0.5) * math.sqrt(12.0 * size)
        result[:, column] = scipy.fft.fft(line)
    return result
