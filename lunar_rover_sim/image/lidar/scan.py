"""One scan: what all its beams have measured."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.lidar.beam_pattern import BeamPattern
from lunar_rover_sim.image.lidar.returns import Returns

# As the drivers of Velodyne lay out their points.
POINT = np.dtype([('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('intensity', '<f4'),
                  ('ring', '<u2'), ('time', '<f4')])


@dataclasses.dataclass(frozen=True)
class PlanarScan:
    """One ring as distances in the plane of the sensor, evenly spaced in azimuth.

    Attributes:
        range_m: (columns,) float32, inf where nothing returns.
        intensity: (columns,) float32, 0 there.
    """

    angle_min_rad: float
    angle_step_rad: float
    time_step_s: float
    range_m: NDArray[np.float32]
    intensity: NDArray[np.float32]


@dataclasses.dataclass(frozen=True)
class Scan:
    """A scan of n beams.

    Attributes:
        returns: What they measure.
        R: (columns + 1, 3, 3) orientation of the sensor in the world at the start of the scan and
            at each column.
        p: (columns + 1, 3) its position then [m].
    """

    pattern: BeamPattern
    returns: Returns
    R: Array
    p: Array

    @property
    def points_m(self) -> NDArray[np.float32]:
        """(n, 3) as sensors give them, each in the frame of the sensor at its own time [m].

        NaN where nothing returns.
        """
        return self.pattern.direction_f32 * self.returns.range_m[:, None]

    @property
    def deskewed_m(self) -> NDArray[np.float32]:
        """(n, 3) the same in the frame of the sensor at the start of the scan."""
        pattern, R, p = self.pattern, self.R, self.p
        local = self.points_m.astype(float).reshape(pattern.columns, pattern.rings, 3)
        moved = local @ (R[0].T @ R[1:]).transpose(0, 2, 1) + ((p[1:] - p[0]) @ R[0])[:, None]
        return moved.reshape(-1, 3).astype(np.float32)

    def cloud(self, organized: bool = False, deskewed: bool = False) -> NDArray[np.void]:
        """Return points as records of POINT.

        Args:
            organized: (rings, columns), NaN where nothing returns; otherwise (m,), what returns,
                in the order of firing.
            deskewed: `deskewed_m` instead of `points_m`.
        """
        pattern, place = self.pattern, self.deskewed_m if deskewed else self.points_m
        if organized:
            kept = np.lexsort((pattern.column, pattern.ring))
        else:
            kept = np.flatnonzero(np.isfinite(self.returns.range_m))
        cloud = np.empty(len(kept), POINT)
        for k, name in enumerate('xyz'):
            cloud[name] = place[kept, k]
        cloud['intensity'] = self.returns.intensity[kept]
        cloud['ring'], cloud['time'] = pattern.ring[kept], pattern.time_s[kept]
        return cloud.reshape(pattern.rings, -1) if organized else cloud

    def planar(self, ring: int) -> PlanarScan:
        """Return a ring as a scan in the plane, as Nav2 reads it.

        Distances are those along the plane. Where the columns are not evenly spaced, as behind a
        lens, each angle takes the column nearest to it.
        """
        plane = _plane(self.pattern, ring)
        found = self.returns.range_m[plane.beam]
        seen = np.isfinite(found)
        return PlanarScan(
            plane.angle_min_rad, plane.angle_step_rad, plane.time_step_s,
            np.where(seen, found * plane.shortening, np.inf).astype(np.float32),
            np.where(seen, self.returns.intensity[plane.beam], 0.0).astype(np.float32))


@dataclasses.dataclass(frozen=True)
class _Plane:
    """Where a ring is evenly spaced in azimuth: (columns,) beams, and cosines of their elevation.

    The same in every scan.
    """

    angle_min_rad: float
    angle_step_rad: float
    time_step_s: float
    beam: NDArray[np.int64]
    shortening: Array


@functools.lru_cache(maxsize=8)
def _plane(pattern: BeamPattern, ring: int) -> _Plane:
    beam = np.flatnonzero(pattern.ring == ring)
    beam = beam[np.argsort(pattern.column[beam])]
    direction = pattern.direction[beam]
    azimuth = np.unwrap(np.arctan2(direction[:, 1], direction[:, 0]))
    if azimuth[0] > np.pi / 2.0:        # a ring begins behind the sensor
        azimuth = azimuth - 2.0 * np.pi
    even = np.linspace(azimuth[0], azimuth[-1], len(beam))
    beam = beam[np.clip(np.searchsorted(0.5 * (azimuth[1:] + azimuth[:-1]), even), 0,
                        len(beam) - 1)]
    time = pattern.time_s[beam]
    return _Plane(float(even[0]), float(even[1] - even[0]),
                  float((time[-1] - time[0]) / (len(time) - 1)), beam,
                  np.hypot(pattern.direction[beam, 0], pattern.direction[beam, 1]))
