"""The beams of one scan: directions, times, rows and columns."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.lidar.optics import FLASH, LidarOptics


@dataclasses.dataclass(frozen=True, eq=False)
class BeamPattern:
    """n beams in the order of firing.

    Attributes:
        direction: (n, 3) unit vectors, frame of the sensor.
        time_s: (n,) since the start of the scan.
        ring: (n,) row, 0 the lowest.
        column: (n,).
        column_s: (columns,) the mean time of each column, at which its pose is taken.
        azimuth_rad: (columns,) of the columns, ascending; that of the first beam of each.
        elevation_rad: (rings,) ascending; of a flash sensor those in its middle.
    """

    direction: Array
    time_s: Array
    ring: NDArray[np.uint16]
    column: NDArray[np.int32]
    column_s: Array
    azimuth_rad: Array
    elevation_rad: Array

    def __len__(self) -> int:
        return len(self.direction)

    @property
    def rings(self) -> int:
        """Number of rows."""
        return len(self.elevation_rad)

    @property
    def columns(self) -> int:
        """Number of columns."""
        return len(self.azimuth_rad)

    @functools.cached_property
    def direction_f32(self) -> NDArray[np.float32]:
        """(n, 3) directions as float32."""
        return self.direction.astype(np.float32)

    def ring_at(self, horizontal_beam: int) -> int:
        """Return a ring by its number; -1: the one nearest to the horizontal."""
        if horizontal_beam >= 0:
            return horizontal_beam
        return int(np.argmin(np.abs(self.elevation_rad)))


def beam_pattern(optics: LidarOptics, rate_hz: float) -> BeamPattern:
    """Return the beams of a scan at a rate [Hz]."""
    return _flash(optics) if optics.kind == FLASH else _scanning(optics, rate_hz)


def _scanning(optics: LidarOptics, rate_hz: float) -> BeamPattern:
    columns, beams = optics.columns_at(rate_hz), optics.beams
    start_s = np.arange(columns) / optics.columns_per_s
    time_s = (start_s[:, None] + optics.firing_s * np.arange(beams)).ravel()
    # The head keeps turning while a column is fired. In the middle of its field it looks ahead.
    begin = -np.radians(0.5 * optics.horizontal_deg)
    azimuth = begin + 2.0 * np.pi * rate_hz * time_s
    elevations = np.radians(optics.elevations())
    elevation = np.tile(elevations, columns)
    ring = np.empty(beams, np.uint16)
    ring[np.argsort(elevations, kind='stable')] = np.arange(beams)
    direction = np.stack([np.cos(elevation) * np.cos(azimuth),
                          np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1)
    return BeamPattern(direction, time_s, np.tile(ring, columns),
                       np.repeat(np.arange(columns, dtype=np.int32), beams),
                       time_s.reshape(columns, beams).mean(axis=1),
                       azimuth.reshape(columns, beams)[:, 0], np.sort(elevations))


def _flash(optics: LidarOptics) -> BeamPattern:
    columns, rows = optics.columns, optics.beams
    # The image plane is at x = 1; its middle row lies between the vertical bounds.
    side = np.tan(np.radians(0.5 * optics.horizontal_deg)) * np.linspace(-1.0, 1.0, columns)
    tilt = 0.5 * (optics.vertical_low_deg + optics.vertical_high_deg)
    up = np.tan(np.radians(0.5 * (optics.vertical_high_deg - optics.vertical_low_deg)))
    y, z = np.meshgrid(side, up * np.linspace(-1.0, 1.0, rows), indexing='ij')
    rays = np.stack([np.ones(y.shape), y, z], axis=-1).reshape(-1, 3)
    c, s = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
    rays = rays @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]).T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    middle = rays.reshape(columns, rows, 3)[columns // 2]
    return BeamPattern(rays, np.zeros(len(rays)),
                       np.tile(np.arange(rows, dtype=np.uint16), columns),
                       np.repeat(np.arange(columns, dtype=np.int32), rows), np.zeros(columns),
                       np.arctan(side), np.arcsin(middle[:, 2]))
