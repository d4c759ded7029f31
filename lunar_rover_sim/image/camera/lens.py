"""Light that a lens does not put where it belongs: scattered light, veil, hood.

Roughness and dust of the lens scatter a share of the light around its image. In direction cosines
the pattern is the same for all directions, b(d) = b0 (1 + (d / l)^2)^(-s/2), d being the distance
between two directions (Harvey's form; Ritt et al., 2020, Sensors 20, 6308, used it for commercial
camera lenses). Light that reflects between lens surfaces and sensor several times is out of focus
and veils the whole image evenly. What is scattered or veils is missing in the image proper.

Irradiance on the sensor is radiance times cos^4 of the angle from the axis, and a pixel covers
cos^4 over the square of the focal length in direction cosines. So sums of that irradiance over
pixels are conserved.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.camera.config import CameraConfig, LensConfig

_OFFSETS = 8        # places per axis of a cell that the scatter of its light is averaged over


@dataclasses.dataclass(frozen=True)
class Lens:
    """The lens of a camera."""

    config: LensConfig
    camera: CameraConfig

    @property
    def reach(self) -> float:
        """Distance from the axis of the farthest direction in front of the lens."""
        return 1.0

    @property
    def perfect(self) -> bool:
        """Whether all light goes where it belongs."""
        return self.config.scatter_share == 0.0 and self.config.veil_share == 0.0

    @property
    def direct_share(self) -> float:
        """Share of the light that goes where it belongs."""
        return 1.0 - self.config.scatter_share - self.config.veil_share

    @functools.cached_property
    def scatter_peak(self) -> float:
        """Scattered share per steradian at its source, b0 [1/sr].

        The scattered share of light on the axis goes to all directions in front of the lens.
        Off-axis light is scattered about as much.
        """
        square = math.radians(self.config.scatter_core_deg)**2
        power = 1.0 - 0.5 * self.config.scatter_exponent
        if abs(power) < 1e-6:
            integral = math.log1p(self.reach**2 / square)
        else:
            integral = ((1.0 + self.reach**2 / square)**power - 1.0) / power
        return self.config.scatter_share / (math.pi * square * integral)

    def scatter(self, distance: ArrayLike) -> Array:
        """Return the scattered share per steradian b(d) at distances in direction cosines."""
        core = math.radians(self.config.scatter_core_deg)
        d = np.asarray(distance, dtype=float)
        # It has no end: of light from far aside, directions are up to 2 apart.
        value: Array = self.scatter_peak * (1.0 + (d / core)**2)**(
            -0.5 * self.config.scatter_exponent)
        return value

    def beyond_rad(self, direction: Array) -> float:
        """Return how far outside the frame a (3,) unit vector, camera axes, points [rad].

        It is 0 within; the farther of both is that across and that along the columns.
        """
        camera, (x, y, z) = self.camera, direction
        if z <= 0.0:
            return math.inf
        return max(math.atan2(abs(side), z) - math.atan2(0.5 * pixels, camera.focal_px)
                   for side, pixels in ((x, camera.width), (y, camera.height)))

    def hood(self, direction: Array) -> float:
        """Return the share of the lens that light from a (3,) unit vector falls on, camera axes.

        The hood is rectangular as the frame: the share is 1 up to the edge of the image, and falls
        smoothly to 0 where the hood hides the whole lens.
        """
        width, beyond = math.radians(self.config.hood_deg), self.beyond_rad(direction)
        if beyond <= 0.0:
            return 1.0
        if beyond >= width:
            return 0.0
        x = 1.0 - beyond / width
        return x * x * (3.0 - 2.0 * x)

    def strays(self, direction: Array) -> bool:
        """Return whether light from a (3,) unit vector, camera axes, strays in the lens."""
        return not self.perfect and self.hood(direction) > 0.0


class Glare:
    """The glare of extended light, from the means of cells of several pixels to their corners.

    Light from beyond the edges of the image is not known and left out.
    """

    def __init__(self, lens: Lens, shape: tuple[int, int], cell_px: int, pixels: int) -> None:
        """Prepare the kernel; shape: rows and columns of cells; pixels: of the whole image."""
        self._corners = shape[0] + 1, shape[1] + 1
        self._veil = lens.config.veil_share * cell_px**2 / pixels
        self._padded = tuple(cv2.getOptimalDFTSize(2 * n) for n in shape)
        # Light comes from anywhere within a cell.
        offsets = (np.arange(_OFFSETS) + 0.5) / _OFFSETS
        rows, columns = (np.where(np.arange(n) <= n // 2, np.arange(n), np.arange(n) - n)
                         for n in self._padded)
        scale = cell_px / lens.camera.focal_px
        kernel = np.zeros(self._padded)
        for dy in offsets:
            for dx in offsets:
                kernel += lens.scatter(
                    scale * np.hypot((rows - dy)[:, None], (columns - dx)[None]))
        self._kernel = np.fft.rfft2(kernel * (scale / _OFFSETS)**2)

    def of(self, irradiance: NDArray[np.floating]) -> Array:
        """Return the irradiance (k, rows + 1, columns + 1) that arrives astray at corners.

        Args:
            irradiance: (k, rows, columns) mean radiance of the cells of k images, times cos^4.
        """
        spectrum = np.fft.rfft2(irradiance, s=self._padded) * self._kernel
        scattered = np.fft.irfft2(spectrum, s=self._padded)
        veil = self._veil * irradiance.sum(axis=(1, 2), keepdims=True)
        return scattered[:, :self._corners[0], :self._corners[1]] + veil
