"""A raster of heights as the source of a world: only the window that a level needs is read."""

from __future__ import annotations

import abc
import logging
import pathlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.fill import harmonic_fill
from lunar_rover_sim.ground.world.tile import Tile

logger = logging.getLogger(__name__)

MAX_HEIGHT_M = 1e5  # beyond any height on the Moon: a marker for missing data
_PAD_PIXELS = 3
# Neighbouring pixels of any ground differ by less: 84 deg up to 30 m of distance and 45 deg
# beyond, or a step of 30 m in a fine model.
_MAX_SLOPE, _MAX_FAR_SLOPE, _NEAR_M, _MAX_STEP_M = 10.0, 1.0, 30.0, 30.0
_CHECKED_PIXELS = 1 << 22       # at once
_MOST_CHECKED = 1 << 26         # at full resolution; larger areas are checked as they are averaged


class Raster(abc.ABC):
    """A grid of heights; a `tile.Source`. Rows count from the north, unless `south_up`."""

    def __init__(self, path: pathlib.Path, config: WorldConfig) -> None:
        self.path = path
        self.config = config
        self.reference_m = 0.0
        self.report: dict[str, Any] = {'file': str(path)}
        self.south_up = False
        self.width = self.height = 0
        self.pixel_x_m = self.pixel_y_m = 1.0
        self.column0 = self.row0 = 0.0
        self._has_told_gaps = False

    @abc.abstractmethod
    def read(self, rows: slice, columns: slice, factor: int) -> tuple[NDArray, NDArray]:
        """Return heights [m] averaged over factor x factor pixels, and where there are data."""

    @abc.abstractmethod
    def close(self) -> None:
        """Release the file."""

    @property
    def pixel_m(self) -> float:
        """The larger side of a pixel."""
        return max(self.pixel_x_m, self.pixel_y_m)

    @property
    def area_m(self) -> tuple[float, float, float, float]:
        """The area of the file in the world frame: x low, x high, y low, y high [m]."""
        south, north = self.row0 - self.height, self.row0
        if self.south_up:
            south, north = -self.row0, self.height - self.row0
        return (-self.column0 * self.pixel_x_m, (self.width - self.column0) * self.pixel_x_m,
                south * self.pixel_y_m, north * self.pixel_y_m)

    def middle_in_pixels(self) -> tuple[float, float]:
        """Return column and row of the world's origin, given as `pixel` or as `offset` [m]."""
        a, b = self.config.dem.center
        if self.config.dem.center_mode == 'pixel':
            return a, b
        sign = 1.0 if self.south_up else -1.0
        return (self.width / 2.0 + a / self.pixel_x_m,
                self.height / 2.0 + sign * b / self.pixel_y_m)

    def check_ground(self) -> None:
        """Set the reference height.

        Raises:
            WorldError: If the ground is not within the file or lacks data.
        """
        half = 0.5 * self.config.size_m
        area = self.area_m
        names = ('west', 'east', 'south', 'north')
        beyond = (area[0] + half, half - area[1], area[2] + half, half - area[3])
        worst = int(np.argmax(beyond))
        if beyond[worst] > 1e-6:
            wide, high = area[1] - area[0], area[3] - area[2]
            raise WorldError(
                f'{self.path}: the window of {self.config.size_m:g} m reaches '
                f'{beyond[worst]:.4g} m beyond the {names[worst]} edge of the file '
                f'({wide:.5g} x {high:.5g} m); move world.dem.center or '
                'make world.size_m smaller')
        heights, known, _, _ = self._window(half, self.config.cell_m)
        if not known.all():
            missing = int((~known).sum())
            if self.config.dem.nodata == 'refuse' or missing == known.size:
                raise WorldError(
                    f'{self.path}: {missing} of {known.size} pixels in the window have no data; '
                    'move world.dem.center' + ('' if missing == known.size
                                               else ' or set world.dem.nodata to fill'))
            logger.warning('%s: %d of %d pixels without data are filled', self.path, missing,
                           known.size)
        self._check_relief(heights, known, 1, 'the window')
        if heights[known].min() == heights[known].max():
            logger.warning('%s: all heights in the window are %g m', self.path,
                           heights[known].min())
        self.report['filled_pixels'] = int((~known).sum())
        middle = harmonic_fill((heights - heights[known][0]).astype(np.float32), known)
        self.reference_m = float(heights[known][0]
                                 + middle[middle.shape[0] // 2, middle.shape[1] // 2])
        self.report['pixel_m'] = [self.pixel_x_m, self.pixel_y_m]

    def _check_relief(self, heights: NDArray, known: NDArray, factor: int, where: str) -> None:
        """Raise WorldError if neighbours differ as no ground does: an undeclared no-data value.

        Args:
            heights: As `_window` returns them, row 0 south.
            known: Where there are data.
            factor: Pixels of the file that a height is the mean of, along each side.
            where: For the message.

        Raises:
            WorldError: Neighbours differ by more than a slope of any ground.
        """
        apart_m = factor * self.pixel_m
        most_m = max(_MAX_SLOPE * min(apart_m, _NEAR_M)
                     + _MAX_FAR_SLOPE * max(apart_m - _NEAR_M, 0.0), _MAX_STEP_M)
        for axis in (0, 1):
            step = np.abs(np.diff(heights, axis=axis))
            both = known[1:] & known[:-1] if axis == 0 else known[:, 1:] & known[:, :-1]
            step[~both] = 0.0
            if step.size and step.max() > most_m:
                j, i = np.unravel_index(int(np.argmax(step)), step.shape)
                pair = heights[j, i], heights[j + (axis == 0), i + (axis == 1)]
                raise WorldError(
                    f'{self.path}: {max(pair, key=abs):g} m beside {min(pair, key=abs):g} m in '
                    f'{where}; valid are steps of at most {most_m:g} m between pixels; if one '
                    'of them marks missing data, declare it (`gdal_edit.py -a_nodata`, or NaN in '
                    'dem.npy)')

    def tile(self, half_extent_m: float, cell_m: float) -> Tile | None:
        """Return the heights in [-h, h]^2, averaged to about a cell; None if there are none."""
        heights, known, x, y = self._window(half_extent_m, cell_m)
        if min(heights.shape) < 2 or not known.any():
            return None
        self._check_tile(half_extent_m, cell_m, heights, known)
        if not known.all() and half_extent_m > self.config.size_m and not self._has_told_gaps:
            self._has_told_gaps = True
            logger.warning('%s: %d of %d pixels around the window have no data and are filled',
                           self.path, int((~known).sum()), known.size)
        heights = harmonic_fill((heights - self.reference_m).astype(np.float32), known)
        return Tile(heights, x, y, float(max(x[1] - x[0], y[1] - y[0])))

    def _check_tile(self, half_m: float, cell_m: float, heights: NDArray, known: NDArray) -> None:
        """Check the relief of what a level shows, pixel by pixel where it is not too large."""
        factor, rows, columns = self._extent(half_m, cell_m)
        where = f'the {2.0 * half_m:.4g} m around the origin'
        wide, high = columns.stop - columns.start, rows.stop - rows.start
        if factor == 1 or wide * high > _MOST_CHECKED:
            self._check_relief(heights, known, factor, where)
            return
        strip = max(_CHECKED_PIXELS // wide, 2)
        for start in range(rows.start, rows.stop - 1, strip - 1):      # they share a row
            part = slice(start, min(start + strip, rows.stop))
            self._check_relief(*self._known(*self.read(part, columns, 1)), 1, where)

    def _known(self, heights: NDArray, known: NDArray) -> tuple[NDArray, NDArray]:
        """Return scaled heights, 0 where there are none, and where there are data."""
        heights = np.asarray(heights, float) * self.config.dem.height_scale
        known = known & np.isfinite(heights) & (np.abs(np.nan_to_num(heights)) < MAX_HEIGHT_M)
        return np.where(known, heights, 0.0), known

    def _extent(self, half_m: float, cell_m: float) -> tuple[int, slice, slice]:
        """Return the pixels that are averaged along a side, and the rows and columns of a window.
        """
        factor = max(int(cell_m / self.pixel_m), 1)
        c0, c1 = _clip(self.column0, half_m / self.pixel_x_m, self.width, factor)
        r0, r1 = _clip(self.row0, half_m / self.pixel_y_m, self.height, factor)
        return factor, slice(r0, r1), slice(c0, c1)

    def _window(self, half_m: float,
                cell_m: float) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Return heights, data mask (row 0 south), and pixel centres in x and y."""
        factor, rows, columns = self._extent(half_m, cell_m)
        c0, r0 = columns.start, rows.start
        if columns.stop - c0 < factor or rows.stop - r0 < factor:
            empty = np.empty((0, 0))
            return empty, empty.astype(bool), empty[0:0], empty[0:0]
        heights, known = self._known(*self.read(rows, columns, factor))
        x = (c0 + (np.arange(heights.shape[1]) + 0.5) * factor - self.column0) * self.pixel_x_m
        y = (r0 + (np.arange(heights.shape[0]) + 0.5) * factor - self.row0) * self.pixel_y_m
        if not self.south_up:
            heights, known, y = heights[::-1], known[::-1], -y[::-1]
        return heights, known, x, y


def _clip(middle: float, half: float, size: int, factor: int) -> tuple[int, int]:
    """Return the first and last pixel of a window with a margin, a multiple of the factor."""
    pad = _PAD_PIXELS * factor
    low = max(int(np.floor(middle - half)) - pad, 0)
    high = min(int(np.ceil(middle + half)) + pad, size)
    return low, low + max(high - low, 0) // factor * factor
