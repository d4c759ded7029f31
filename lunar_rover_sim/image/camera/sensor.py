"""The image sensor: what becomes of radiance, step by step.

radiance [W m-2 sr-1] -> irradiance on the sensor pi/4 L tau / N^2 -> photo-electrons in a pixel ->
point spread, vignetting -> colour filters -> shot noise, dark signal, full well, fixed pattern,
read noise -> converter, white balance. Stray light of the lens is added to the radiance before;
see `stray_light`.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import statistics
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.workers import ONE_THREAD, Workers
from lunar_rover_sim.image.camera.config import CameraConfig, LensConfig, SensorConfig
from lunar_rover_sim.image.camera.encoding import has_16_bits, has_colour
from lunar_rover_sim.image.camera.fisheye import FisheyeCamera
from lunar_rover_sim.image.camera.miscalibration import Miscalibration
from lunar_rover_sim.image.camera.mosaic import filtered
from lunar_rover_sim.image.camera.rig import PinholeCamera
from lunar_rover_sim.image.illumination.colours import Bands

F32 = NDArray[np.float32]

_NORMAL_BITS = 14       # of the number that picks a sample of the normal distribution
_TRANSMISSION = 0.9     # of the lens


@dataclasses.dataclass(frozen=True)
class SensorModel:
    """Constants that follow from the configuration."""

    camera: CameraConfig
    config: SensorConfig
    lens: LensConfig = LensConfig()

    @property
    def electrons_per_radiance_second(self) -> float:
        """Photo-electrons per pixel, per W m-2 sr-1 and second, on the axis."""
        c = self.config
        optics = 0.25 * math.pi * _TRANSMISSION / c.f_number**2
        per_joule = self.bands[1] if self.colour else c.electrons_per_joule
        return float(optics * c.pixel_pitch_m**2 * per_joule)

    @property
    def colour(self) -> bool:
        """Whether the pixels have colour filters; radiance is then that of the green band."""
        return has_colour(self.config.encoding)

    @property
    def _response(self) -> Bands:
        return Bands((self.config.red_response, self.config.green_response,
                      self.config.blue_response))

    @functools.cached_property
    def bands(self) -> Array:
        """(3,) photo-electrons per joule of sunlight of red, green and blue pixels [1/J]."""
        return self._response.electrons_per_joule()

    @functools.cached_property
    def powers(self) -> Array:
        """(2,) powers of a `Tint` that give the colours which these pixels see."""
        return self._response.powers()

    @property
    def balance(self) -> Array:
        """(2, 2) gains of the cells of the mosaic, in rows and columns."""
        gain = self.bands[1] / self.bands if self.config.white_balance == 'sun' else np.ones(3)
        return np.array([[gain[0], 1.0], [1.0, gain[2]]])

    @property
    def well_e(self) -> float:
        """Electrons that a pixel holds."""
        return self.config.pixel_well * self.config.full_well_e

    @property
    def largest_number(self) -> int:
        """The converter's largest number."""
        return (1 << self.config.bits) - 1

    @property
    def gain_dn_per_e(self) -> float:
        """Numbers of the converter per electron."""
        return (1.0 - self.config.black_level) * self.largest_number / self.config.full_well_e

    @property
    def output_type(self) -> type:
        """Type of the output pixels."""
        return np.uint16 if has_16_bits(self.config.encoding) else np.uint8

    @property
    def output_scale(self) -> tuple[float, float]:
        """Numbers of the output per number of the converter, and 1 / its largest number."""
        bits = 8 * np.dtype(self.output_type).itemsize
        return 2.0**(bits - self.config.bits), 1.0 / ((1 << bits) - 1)

    @property
    def companded(self) -> bool:
        """Whether the output is the root of the signal.

        As the Mars rovers' cameras reduced 12 bits to 8 (Maki et al., 2003, J. Geophys. Res. 108).
        """
        return self.config.companding == 'sqrt' and self.output_type is np.uint8

    def linear(self, image: NDArray[Any]) -> NDArray[np.float32]:
        """Return the signal above black that pixels represent, as a share of full scale."""
        level = image.astype(np.float32) / np.float32(np.iinfo(image.dtype).max)
        black = np.float32(self.config.black_level)
        return level * level if self.companded else (level - black) / (1 - black)

    @property
    def neighbour_weight(self) -> float:
        """Weight of each direct neighbour, over that of the pixel, in the point spread."""
        # Five taps 1, k, k, k, k have the variance 2 k / (1 + 4 k) along each axis.
        variance = self.config.psf_sigma_px**2
        return 0.5 * variance / (1.0 - 2.0 * variance)

    def exposure_for(self, radiance: float) -> float:
        """Return the exposure time [s] that puts a radiance at the target level."""
        c = self.config
        wanted = max(c.target_level - c.black_level, 0.005) * c.full_well_e
        return float(np.clip(wanted / max(radiance * self.electrons_per_radiance_second, 1e-9),
                             1e-6, 10.0))


class Tint(NamedTuple):
    """The colour of what a camera sees.

    Attributes:
        codes: (h, w) uint32 red and blue over green of the default responses, in the lower and
            the upper 16 bits, as `mosaic.TINT_ONE` stores them; 0 where nothing is drawn.
        own: (h, w) radiance that comes from what is seen, and not from the veil [W m-2 sr-1].
    """

    codes: NDArray[np.uint32]
    own: F32


class ImageSensor:
    """Turns radiance images into the pixels that the sensors of a pair put out."""

    def __init__(self, camera: PinholeCamera | FisheyeCamera, model: SensorModel, seed: int,
                 padding: tuple[int, int] = (0, 0),
                 wrong: Miscalibration = Miscalibration(), workers: Workers = ONE_THREAD) -> None:
        """Draw the fixed patterns.

        Args:
            camera: Geometry of both cameras.
            model: Constants.
            seed: Of all noise.
            padding: Columns and rows of radiance beyond each edge of the image.
            wrong: With the right camera.
            workers: Share the rows.
        """
        self._model, self._seed, self._workers = model, seed, workers
        self._gain, self._offset = _patterns(camera, model.config, seed)
        self._gain[1] *= np.float32(wrong.gain)
        moved = model.camera.distorted or any(padding)
        self._source = [each.source(model.camera) + padding if moved else None
                        for each in (Miscalibration(), wrong)]

    def pixels(self, radiance: F32, side: int, exposure_s: float, frame_index: int,
               tint: Tint | None = None) -> NDArray[Any]:
        """Return (h, w) pixels of one image, of colour sensors those of its mosaic.

        Args:
            radiance: (h, w) that the lens passes on, plus the padding [W m-2 sr-1].
            side: 0 for the left camera, 1 for the right one: each has its own pattern and noise.
            exposure_s: Exposure time.
            frame_index: Gives each frame its own noise.
            tint: Of what is seen, for colour sensors; None: all is grey.
        """
        model, c = self._model, self._model.config
        dark, source = np.float32(c.dark_current_e_s * exposure_s), self._source[side]
        if not model.colour:
            electrons = self._collected(radiance, side, exposure_s, source, dark)
        else:
            light = self._collected(radiance, side, exposure_s, source, np.float32(0.0))
            tint = tint or Tint(np.zeros(radiance.shape, np.uint32), radiance)
            electrons = np.empty(light.shape, np.float32)
            self._workers.rows(
                filtered, len(electrons), light, *tint, radiance,
                np.zeros((0, 0, 2), np.float32) if source is None else source,
                (model.bands[[0, 2]] / model.bands[1]).astype(np.float32),
                model.powers.astype(np.float32), dark, electrons)
        # A different number for each seed, frame and side.
        key = np.random.SeedSequence([self._seed, frame_index % (1 << 63), side])
        result: NDArray[Any] = np.empty(electrons.shape, model.output_type)
        self._workers.rows(
            _convert, len(result), electrons, self._offset[side], _normal_samples(),
            np.uint32(key.generate_state(1)[0]),
            np.float32(c.shot_noise), np.float32((c.read_noise_e * c.read_noise)**2),
            np.float32(model.well_e),
            (np.float32(model.gain_dn_per_e), np.float32(c.black_level * model.largest_number),
             np.float32(model.largest_number)),
            model.colour, model.balance.astype(np.float32),
            model.companded, np.float32(np.iinfo(model.output_type).max),
            np.float32(model.output_scale[0]), result)
        return result

    def _collected(self, radiance: F32, side: int, exposure_s: float, source: Array | None,
                   dark: np.float32) -> F32:
        """Return the electrons of each pixel without a filter; source: places between pixels."""
        model, c = self._model, self._model.config
        size = self._gain[side].shape
        if source is not None:
            image, radiance = radiance, np.empty(size, np.float32)
            self._workers.rows(_resampled, len(radiance), image, source, radiance)
        result = np.empty(size, np.float32)
        self._workers.rows(
            _collected, len(result), radiance, self._gain[side],
            np.float32(model.neighbour_weight if c.psf_sigma_px > 0.0 else 0.0),
            np.float32(model.electrons_per_radiance_second * exposure_s), dark, result)
        return result


def _patterns(camera: PinholeCamera | FisheyeCamera, c: SensorConfig,
              seed: int) -> tuple[F32, F32]:
    """Return vignetting times gain of each pixel, and its offset [e-]; both (2, h, w)."""
    v, u = np.indices((camera.height, camera.width))
    falloff = camera.falloff(np.stack([u, v], axis=-1))
    gain = np.stack(2 * [falloff**c.vignetting])
    offset = np.zeros_like(gain)
    if c.fixed_pattern:
        rng = np.random.default_rng([seed, 4141])
        gain *= np.maximum(1.0 + c.prnu * rng.standard_normal(gain.shape), 0.0)
        offset = c.dsnu_e * rng.standard_normal(gain.shape)
    return gain.astype(np.float32), offset.astype(np.float32)


@functools.cache
def _normal_samples() -> F32:
    """Return samples of the normal distribution, all equally probable.

    They are the means of intervals of equal probability, scaled to the variance 1. The mean is 0
    by symmetry; the kurtosis is 2.999.
    """
    count = 1 << _NORMAL_BITS
    quantile = statistics.NormalDist().inv_cdf
    bounds = np.array([-np.inf, *(quantile(k / count) for k in range(1, count)), np.inf])
    density = np.exp(-0.5 * bounds**2) / math.sqrt(2.0 * math.pi)
    means = count * (density[:-1] - density[1:])
    return (means / math.sqrt(np.mean(means**2))).astype(np.float32)


@compiled
def _resampled(first, last, image, source, result):  # type: ignore[no-untyped-def]
    """Fill in rows of an image at (h, w, 2) places between its pixels, column and row, within it.
    """
    for r in range(first, last):
        for c in range(source.shape[1]):
            x, y = source[r, c, 0], source[r, c, 1]
            column, row = int(x), int(y)
            x, y = x - column, y - row
            upper = image[row, column] * (1.0 - x) + image[row, column + 1] * x
            lower = image[row + 1, column] * (1.0 - x) + image[row + 1, column + 1] * x
            result[r, c] = upper * (1.0 - y) + lower * y


@compiled
def _collected(first, last, radiance, gain, spread, sensitivity,  # type: ignore[no-untyped-def]
               dark, result):
    """Fill in rows of the electrons of each pixel, after the point spread.

    Args:
        spread: Weight of each direct neighbour, over that of the pixel.
        sensitivity: Electrons per radiance on the axis.
        dark: Dark signal [e-].
    """
    h, w = radiance.shape
    one, four = np.float32(1.0), np.float32(4.0)
    share = spread / (one + four * spread)
    rest = one - four * share
    for r in range(first, last):
        own, up, down = radiance[r], radiance[max(r - 1, 0)], radiance[min(r + 1, h - 1)]
        out, pattern = result[r], gain[r]
        west, middle, east = own[:w - 2], own[1:w - 1], own[2:]
        north, south, inner = up[1:w - 1], down[1:w - 1], out[1:w - 1]
        for c in range(w - 2):
            inner[c] = rest * middle[c] + share * ((west[c] + east[c]) + (north[c] + south[c]))
        for c in (0, w - 1):
            out[c] = rest * own[c] + share * ((own[max(c - 1, 0)] + own[min(c + 1, w - 1)])
                                              + (up[c] + down[c]))
        for c in range(w):
            out[c] = out[c] * sensitivity * pattern[c] + dark


@compiled
def _convert(first, last, electrons, offset, normal, key, shot,  # type: ignore[no-untyped-def]
             read2, well, converter, balanced, balance, root, most, scale, result):
    """Add noise, and convert rows of electrons to the numbers of the output.

    Args:
        normal: Equally probable samples.
        key: Of the noise of this image.
        shot: 0 or 1.
        read2: Square of the read noise [e-^2].
        well: Electrons that a pixel holds.
        converter: Numbers per electron, black level, largest number.
        balanced: Whether the signal is multiplied by the (2, 2) gains `balance` of rows and
            columns, as digital numbers.
        root: Whether the output is the root of the signal.
        most: Largest number of the output.
        scale: Numbers of the output per number of the converter.
    """
    w = electrons.shape[1]
    zero, half, one = np.float32(0.0), np.float32(0.5), np.float32(1.0)
    per_electron, black, largest = converter
    signal = one / (largest - black)
    shift = np.uint32(32)
    count = len(normal)
    while count > 1:
        count //= 2
        shift -= np.uint32(1)
    noisy = shot > zero or read2 > zero
    index, noise = np.empty(w, np.uint32), np.zeros(w, np.float32)
    numbers = np.empty(w, np.float32)
    for r in range(first, last):
        if noisy:
            for c in range(w):
                # A hash of the pixel (murmur3's finalizer; Appleby, 2008).
                x = np.uint32(np.uint32(r * w + c) * np.uint32(2654435761)) ^ key
                x = np.uint32((x ^ (x >> np.uint32(16))) * np.uint32(0x85ebca6b))
                x = np.uint32((x ^ (x >> np.uint32(13))) * np.uint32(0xc2b2ae35))
                index[c] = (x ^ (x >> np.uint32(16))) >> shift
            for c in range(w):
                noise[c] = normal[index[c]]
        row, pattern, out = electrons[r], offset[r], result[r]
        for c in range(w):
            # Shot and read noise are independent: one Gaussian of their joint variance.
            e = row[c] + np.sqrt(shot * max(row[c], zero) + read2) * noise[c]
            number = (min(e, well) + pattern[c]) * per_electron + black
            numbers[c] = min(max(np.floor(number + half), zero), largest)
        if balanced:
            even, odd = balance[r & 1, 0], balance[r & 1, 1]
            for c in range(w):
                gain = odd if c & 1 else even
                number = np.floor(black + (numbers[c] - black) * gain + half)
                numbers[c] = min(number, largest)
        if root:
            for c in range(w):
                numbers[c] = np.floor(np.sqrt(max(numbers[c] - black, zero) * signal) * most
                                      + half)
        else:
            for c in range(w):
                numbers[c] = np.floor(numbers[c] * scale)
        for c in range(w):
            out[c] = numbers[c]
