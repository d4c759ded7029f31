"""A raster of heights as the source of a world: only the window that a level needs is read."""

from __future__ import annotations

import abc
import logging
import math
import pathlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.fill import harmonic_fill
from lunar_rover_sim.ground.world.grid import Box, box_around
from lunar_rover_sim.ground.world.missing_data import ADVICE, all_marked, marked, steepest, Suspect
from lunar_rover_sim.ground.world.tile import PAD_PIXELS, Tile

logger = logging.getLogger(__name__)

MAX_HEIGHT_M = 1e5  # beyond any height on the Moon: a marker for missing data
MAX_PIXEL_M = 1e6
_CHECKED_AROUND = 3     # pixels around the ground that are checked with it
_CHECKED_PIXELS = 1 << 22       # at once
_MOST_CHECKED = 1 << 26         # at full resolution; larger areas are checked as they are averaged
_MOST_READ = 1 << 33            # for one level: some minutes


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
        """Return values averaged over factor x factor pixels, and where there are data."""

    @abc.abstractmethod
    def read_raw(self, rows: slice, columns: slice) -> NDArray:
        """Return values as the file holds them; masked where it says that there are none."""

    def to_metres(self, values: NDArray) -> NDArray:
        """Return the heights that values of the file stand for."""
        return np.asarray(values, float) * self.config.dem.height_scale

    @abc.abstractmethod
    def close(self) -> None:
        """Release the file."""

    @property
    def pixel_m(self) -> float:
        """The larger side of a pixel."""
        return max(self.pixel_x_m, self.pixel_y_m)

    @property
    def area_m(self) -> Box:
        """The area of the file in the world frame."""
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
        """Set the reference height, that of the origin; check the ground around it.

        Raises:
            WorldError: As for `check_window`.
        """
        heights, known = self.check_window((0.0, 0.0))
        if heights[known].min() == heights[known].max():
            logger.warning('%s: all heights in the window are %g m', self.path,
                           heights[known].min())
        middle = harmonic_fill((heights - heights[known][0]).astype(np.float32), known)
        self.reference_m = float(heights[known][0]
                                 + middle[middle.shape[0] // 2, middle.shape[1] // 2])
        self.report['pixel_m'] = [self.pixel_x_m, self.pixel_y_m]

    def check_window(self, middle_m: tuple[float, float]) -> tuple[NDArray, NDArray]:
        """Return the heights of the fine ground around a place, and where there are data.

        Raises:
            WorldError: If the ground is not within the file or lacks data.
        """
        half, (x, y) = 0.5 * self.config.size_m, middle_m
        where = '' if middle_m == (0.0, 0.0) else f' around x {x:g}, y {y:g} m'
        area = self.area_m
        names = ('west', 'east', 'south', 'north')
        beyond = (area[0] + half - x, x + half - area[1], area[2] + half - y, y + half - area[3])
        worst = int(np.argmax(beyond))
        if beyond[worst] > 1e-6:
            wide, high = area[1] - area[0], area[3] - area[2]
            raise WorldError(
                f'{self.path}: the window of {self.config.size_m:g} m{where} reaches '
                f'{beyond[worst]:.4g} m beyond the {names[worst]} edge of the file '
                f'({wide:.5g} x {high:.5g} m); move world.dem.center or '
                'make world.size_m smaller')
        box = box_around(middle_m, half)
        heights, known, _, _ = self._window(box, self.config.cell_m, _CHECKED_AROUND)
        if not known.all():
            missing = int((~known).sum())
            if self.config.dem.nodata == 'refuse' or missing == known.size:
                raise WorldError(
                    f'{self.path}: {missing} of {known.size} pixels in the window{where} have no '
                    'data; move world.dem.center' + ('' if missing == known.size
                                                     else ' or set world.dem.nodata to fill'))
            logger.warning('%s: %d of %d pixels without data%s are filled', self.path, missing,
                           known.size, where)
        self._check_pixels_of(box, self.config.cell_m, 'the window' + where)
        self.report['filled_pixels'] = int((~known).sum())
        return heights, known

    def has_data(self, x_m: Array, y_m: Array) -> NDArray[np.bool_]:
        """Return where pixels at and around samples have data.

        Args:
            x_m, y_m: (n,) and (m,), ascending, evenly spaced.

        Returns:
            (m, n); beyond the file as at its edge.
        """
        axes, box = (y_m, x_m), (x_m[0], x_m[-1], y_m[0], y_m[-1])
        apart = [float(at[1] - at[0]) for at in axes]
        pixels = (x_m[-1] - x_m[0]) * (y_m[-1] - y_m[0]) / (self.pixel_x_m * self.pixel_y_m)
        cell = min(apart) if pixels > _MOST_CHECKED else 0.0
        _, known, corner, factor = self._window(box, cell, _CHECKED_AROUND)
        if not known.size:
            return np.zeros((len(y_m), len(x_m)), bool)
        phase, step = (pair[::-1] for pair in self._lattice(factor))
        first = corner[::-1]
        near = [np.clip(np.rint(at / step[k] - phase[k]).astype(int) - first[k], 0,
                        known.shape[k] - 1) for k, at in enumerate(axes)]
        found = known[np.ix_(*near)]
        # Pixels may be smaller than the samples are apart.
        gaps = [np.rint(((lost + first[k] + phase[k]) * step[k] - axes[k][0])
                        / apart[k]).astype(int) for k, lost in enumerate(np.nonzero(~known))]
        inside = np.logical_and.reduce([(at >= 0) & (at < size)
                                        for at, size in zip(gaps, found.shape)])
        found[gaps[0][inside], gaps[1][inside]] = False
        return found

    def tile(self, box_m: Box, cell_m: float) -> Tile | None:
        """Return the heights in a box, averaged to about a cell; None if there are none."""
        heights, known, first, factor = self._window(box_m, cell_m, PAD_PIXELS)
        if min(heights.shape) < 2 or not known.any():
            return None
        middle = (0.5 * (box_m[0] + box_m[1]), 0.5 * (box_m[2] + box_m[3]))
        around = 'the origin' if max(map(abs, middle)) < 1e-6 else 'x %g, y %g m' % middle
        wide = max(box_m[1] - box_m[0], box_m[3] - box_m[2])
        self._check_pixels_of(box_m, cell_m, f'the {wide:.4g} m around {around}')
        if not known.all() and wide > 2.0 * self.config.size_m and not self._has_told_gaps:
            self._has_told_gaps = True
            logger.warning('%s: %d of %d pixels around the window have no data and are filled',
                           self.path, int((~known).sum()), known.size)
        heights = harmonic_fill((heights - self.reference_m).astype(np.float32), known)
        return Tile(heights, first, *self._lattice(factor), not known.all())

    def _lattice(self, factor: int) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the phase of averaged pixels and their sides, x and y; see `Tile`."""
        phase_y = 0.5 - self.row0 / factor
        return ((0.5 - self.column0 / factor, phase_y if self.south_up else -phase_y),
                (factor * self.pixel_x_m, factor * self.pixel_y_m))

    def _check_pixels_of(self, box_m: Box, cell_m: float, where: str) -> None:
        """Raise WorldError if a part of the file holds marks of missing data that are undeclared.

        It is read pixel by pixel where it is not too large, else as it is averaged.
        """
        factor, rows, columns = self._extent(box_m, cell_m, _CHECKED_AROUND)
        wide, high = columns.stop - columns.start, rows.stop - rows.start
        if wide * high > _MOST_CHECKED:
            heights, known = self._known(*self.read(rows, columns, factor))
            self._refuse(steepest(heights, known, factor * self.pixel_m), rows.start,
                         columns.start, factor, where)
            return
        strip = max(_CHECKED_PIXELS // max(wide, 1), 2)
        marks: set[float | None] = set()
        for start in range(rows.start, max(rows.stop - 1, rows.start + 1), strip - 1):
            part = slice(start, min(start + strip, rows.stop))     # they share a row
            values = self.read_raw(part, columns)
            raw = np.ma.getdata(values)
            heights, known = self._known(raw, ~np.ma.getmaskarray(values))
            self._refuse(steepest(heights, known, self.pixel_m)
                         or marked(raw, heights, known, (self.pixel_y_m, self.pixel_x_m)),
                         start, columns.start, 1, where)
            marks.add(all_marked(raw, known) if known.any() else None)
        if len(marks) == 1 and None not in marks:
            raise WorldError(f'{self.path}: all pixels in {where} are {marks.pop():g}, a mark of '
                             f'missing data; {ADVICE}; or move world.dem.center')

    def _refuse(self, suspect: Suspect | None, row: int, column: int, factor: int,
                where: str) -> None:
        """Raise WorldError that says where a suspect is, in a part that begins at a pixel."""
        if suspect is None:
            return
        x = (column + (suspect.column + 0.5) * factor - self.column0) * self.pixel_x_m
        y = (row + (suspect.row + 0.5) * factor - self.row0) * self.pixel_y_m
        raise WorldError(f'{self.path}: x {x:.6g}, y {y if self.south_up else -y:.6g} m in '
                         f'{where}: {suspect.text}')

    def _known(self, values: NDArray, known: NDArray) -> tuple[NDArray, NDArray]:
        """Return heights, 0 where there are none, and where there are data."""
        with np.errstate(invalid='ignore'):     # signalling NaN, which is refused as NaN is
            heights = self.to_metres(values)
        known = known & np.isfinite(heights) & (np.abs(np.nan_to_num(heights)) < MAX_HEIGHT_M)
        return np.where(known, heights, 0.0), known

    def _extent(self, box_m: Box, cell_m: float, pad: int) -> tuple[int, slice, slice]:
        """Return the pixels that are averaged along a side, and the rows and columns of a box.

        Averages begin at the same pixels whatever the box.
        """
        factor = max(int(cell_m / self.pixel_m), 1)
        low, high = box_m[2:] if self.south_up else (-box_m[3], -box_m[2])
        c0, c1 = _clip(self.column0 + box_m[0] / self.pixel_x_m,
                       self.column0 + box_m[1] / self.pixel_x_m, self.width, factor, pad)
        r0, r1 = _clip(self.row0 + low / self.pixel_y_m, self.row0 + high / self.pixel_y_m,
                       self.height, factor, pad)
        if (c1 - c0) * (r1 - r0) > _MOST_READ:
            raise WorldError(f'{self.path}: {box_m[1] - box_m[0]:.4g} m are {c1 - c0} x {r1 - r0} '
                             f'pixels of {self.pixel_x_m:g} x {self.pixel_y_m:g} m; valid are at '
                             f'most {_MOST_READ}: resample it with `gdalwarp -tr`, or make '
                             'world.size_m or world.surroundings.extent_m smaller')
        return factor, slice(r0, r1), slice(c0, c1)

    def _window(self, box_m: Box, cell_m: float,
                pad: int) -> tuple[NDArray, NDArray, tuple[int, int], int]:
        """Return heights, data mask (row 0 south), the first averaged pixel, and the factor."""
        factor, rows, columns = self._extent(box_m, cell_m, pad)
        c0, r0 = columns.start, rows.start
        if columns.stop - c0 < factor or rows.stop - r0 < factor:
            empty = np.empty((0, 0))
            return empty, empty.astype(bool), (0, 0), factor
        heights, known = self._known(*self.read(rows, columns, factor))
        if self.south_up:
            return heights, known, (c0 // factor, r0 // factor), factor
        # Rows count from the north: the last one is the first, with the sign turned.
        return (heights[::-1], known[::-1],
                (c0 // factor, -(r0 // factor + heights.shape[0] - 1)), factor)


def _clip(low: float, high: float, size: int, factor: int, pad: int) -> tuple[int, int]:
    """Return the first and last pixel of a window with a margin, multiples of the factor."""
    first = max(math.floor(low / factor) - pad, 0) * factor
    last = min(math.ceil(high / factor) + pad, size // factor) * factor
    return first, first + max(last - first, 0)
