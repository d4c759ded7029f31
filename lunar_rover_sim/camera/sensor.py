"""The image sensor: what becomes of radiance, step by step.

radiance [W m-2 sr-1] -> irradiance on the sensor pi/4 L tau / N^2 -> photo-electrons in a pixel ->
point spread, vignetting -> shot noise, dark signal, full well, fixed pattern, read noise ->
converter. Stray light of the lens is added to the radiance before; see `lens`.
The arithmetic runs in rendering/shaders/sensor.frag; its constants are here.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera.config import CameraConfig, SensorConfig

_NUMBER_TYPES = {'mono8': np.uint8, 'rgb8': np.uint8, 'mono16': np.uint16}


@dataclasses.dataclass(frozen=True)
class SensorModel:
    """Constants that follow from the configuration."""

    camera: CameraConfig
    config: SensorConfig

    @property
    def electrons_per_radiance_second(self) -> float:
        """Photo-electrons per pixel, per W m-2 sr-1 and second, on the axis."""
        c = self.config
        optics = 0.25 * math.pi * c.transmission / c.f_number**2
        return optics * c.pixel_pitch_m**2 * c.electrons_per_joule

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
        return _NUMBER_TYPES[self.config.encoding]

    @property
    def output_scale(self) -> tuple[float, float]:
        """Numbers of the output per number of the converter, and 1 / its largest number."""
        bits = 16 if self.config.encoding == 'mono16' else 8
        return 2.0**(bits - self.config.bits), 1.0 / ((1 << bits) - 1)

    @property
    def companded(self) -> bool:
        """Whether the output is the root of the signal.

        As the Mars rovers' cameras reduced 12 bits to 8 (Maki et al., 2003, J. Geophys. Res. 108).
        """
        return self.config.companding == 'sqrt' and self.config.encoding != 'mono16'

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
