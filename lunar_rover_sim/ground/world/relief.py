"""Self-affine relief of a place, band by band, so that nested levels share one spectrum.

The relief is Gaussian with an isotropic power spectrum S(k), k in rad/m, whose variance is the
integral of S d2k / (2 pi)2. S ~ k^(-2 - 2H) makes the RMS deviation over a baseline L grow as
L^H, H being the Hurst exponent (Shepard et al. 2001, "The roughness of natural terrain").
"""

from __future__ import annotations

import collections
from collections.abc import Callable
import functools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
import scipy  # its parts when they are used

from lunar_rover_sim.ground.world import streams
from lunar_rover_sim.ground.world.config import ReliefConfig
from lunar_rover_sim.ground.world.grid import height_step_m, round_to

Spectrum = Callable[[NDArray[np.float64]], NDArray[np.float64]]

# Wavelength, in cells of the coarser one, at which two neighbouring levels share the power.
SPLIT_CELLS = 5.0
_MOST_BLOCKS = 160         # that are kept, 1 MB each


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


BLOCK, REACH = 512, 128     # cells of a block of relief, and of its kernel to either side
_PERIOD = 1024              # cells, of the transform that gives the kernel


@functools.lru_cache(maxsize=32)
def _kernel(config: ReliefConfig, cell_m: float, parent_cell_m: float | None,
            finest: bool) -> NDArray[np.complex128] | None:
    """Return the transform of the kernel that makes a level's relief of white noise.

    The level has the wavelengths below the split with its parent (the next coarser level; None if
    there is none, which sets no limit) and above the split with its child. The finest level has no
    child: its wavelengths fade out from 4 to 2 cells.

    Returns:
        Of (BLOCK + 2 REACH) samples along a side; None if the level is smooth.
    """
    k = np.linspace(0.0, 1.5 * np.pi / cell_m, 16384)
    k[0] = k[1]
    too_short = (smoothstep(np.log2(k * cell_m / (0.5 * np.pi))) if finest
                 else high_pass(k, SPLIT_CELLS * cell_m))
    power = spectrum(config)(k) * (1.0 - too_short)
    if parent_cell_m is not None:
        power *= high_pass(k, SPLIT_CELLS * parent_cell_m)
    if not np.any(power):
        return None
    axis = np.abs(2.0 * np.pi * scipy.fft.fftfreq(_PERIOD, cell_m))
    amplitude = np.interp(np.sqrt(axis[:, None] ** 2 + axis[:_PERIOD // 2 + 1] ** 2), k,
                          np.sqrt(power) / cell_m)
    amplitude[0, 0] = 0.0
    kernel = scipy.fft.irfft2(amplitude, s=(_PERIOD, _PERIOD))
    index = np.minimum(np.arange(_PERIOD), _PERIOD - np.arange(_PERIOD))
    kernel *= 1.0 - smoothstep((np.hypot(index[:, None], index) / REACH - 0.7) / 0.3)
    size = BLOCK + 2 * REACH
    near = np.r_[0:REACH + 1, -REACH:0]
    cut = np.zeros((size, size))
    cut[np.ix_(near, near)] = kernel[np.ix_(near, near)]
    return np.asarray(scipy.fft.rfft2(cut))


class Relief:
    """The relief of one seed on the lattices of all levels, block by block.

    White noise of a block and `REACH` cells around it is filtered by the kernel of the spectrum,
    so that a block is the same whatever is made beside it.
    """

    def __init__(self, config: ReliefConfig, seed: int) -> None:
        self.config, self.seed = config, seed
        self._blocks: collections.OrderedDict[
            tuple[int, int, int], NDArray[np.float32]] = collections.OrderedDict()

    def detail(self, level: int, cell_m: float, parent_cell_m: float | None,
               first: tuple[int, int], shape: tuple[int, int]) -> NDArray[np.float32]:
        """Return heights [m] with the part of the spectrum that belongs to a level.

        Args:
            level: 0 is the finest.
            parent_cell_m: Of the next coarser one.
            first: Column and row of the level's lattice at which they begin.
            shape: Rows and columns.
        """
        kernel = _kernel(self.config, cell_m, parent_cell_m, level == 0)
        if kernel is None:
            return np.zeros(shape, np.float32)
        return streams.of_blocks(first, shape, BLOCK, functools.partial(
            self._block, level, cell_m, kernel))

    def _block(self, level: int, cell_m: float, kernel: NDArray[np.complex128], x: int,
               y: int) -> NDArray[np.float32]:
        if (level, x, y) in self._blocks:
            self._blocks.move_to_end((level, x, y))
            return self._blocks[level, x, y]
        size = BLOCK + 2 * REACH
        noise = streams.blocks(self.seed, f'relief {level}',
                               (x * BLOCK - REACH, y * BLOCK - REACH), (size, size))
        # Uniform, not normal: heights are sums of so many that they are normal all the same, and
        # uniform numbers are exact and quick.
        wave = scipy.fft.rfft2((noise.astype(np.float64) - 0.5) * math.sqrt(12.0))
        wave *= kernel
        heights = scipy.fft.irfft2(wave, s=(size, size), overwrite_x=True)
        heights = np.ascontiguousarray(heights[REACH:-REACH, REACH:-REACH])
        round_to(heights, height_step_m(cell_m))
        self._blocks[level, x, y] = heights.astype(np.float32)
        if len(self._blocks) > _MOST_BLOCKS:
            self._blocks.popitem(last=False)
        return self._blocks[level, x, y]
