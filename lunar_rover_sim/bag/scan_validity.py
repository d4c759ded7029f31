"""Validity of scans of a LiDAR: layouts, ranges, times."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_TYPES = {2: '<u1', 4: '<u2', 6: '<u4', 7: '<f4', 8: '<f8'}     # of PointField
_NEEDED = ('x', 'y', 'z', 'intensity', 'ring', 'time')
_TOLERANCE = 1e-4       # of ranges, which are float32


def laser_scan_problem(message: Any) -> str:
    """Ranges: as many as there are angles, within their bounds, inf where nothing returns."""
    ranges = np.asarray(message.ranges, float)
    steps = (message.angle_max - message.angle_min) / message.angle_increment \
        if message.angle_increment else np.nan
    if not abs(steps - (len(ranges) - 1)) < 0.01:
        return f'{len(ranges)} ranges for {steps + 1:.2f} angles'
    if np.isnan(ranges).any():
        return f'{int(np.isnan(ranges).sum())} ranges are NaN; valid is inf where nothing returns'
    far = np.isfinite(ranges) & (ranges > message.range_max * (1.0 + _TOLERANCE))
    return f'{int(far.sum())} ranges beyond range_max' if far.any() else ''


def lidar_points(message: Any) -> NDArray[np.void]:
    """Return (m,) records of the fields of a LiDAR; the cloud must have them and be whole."""
    fields = _fields(message)
    dtype = np.dtype({'names': list(_NEEDED), 'formats': [fields[n][1] for n in _NEEDED],
                      'offsets': [fields[n][0] for n in _NEEDED],
                      'itemsize': message.point_step})
    return np.frombuffer(np.asarray(message.data, np.uint8).tobytes(), dtype)


def _fields(message: Any) -> dict[str, tuple[int, str | None]]:
    """Return where each field of a point is, and its type."""
    return {f.name: (f.offset, _TYPES.get(f.datatype)) for f in message.fields}


def lidar_cloud_problem(message: Any) -> str:
    """Points with the fields of a LiDAR; finite where the cloud is dense; times from 0 on."""
    fields = _fields(message)
    missing = [name for name in _NEEDED if fields.get(name, (0, None))[1] is None]
    if missing:
        return f'fields {", ".join(missing)} are missing'
    if message.is_bigendian:
        return 'data are big-endian; valid is little-endian'
    end = max(fields[name][0] + np.dtype(fields[name][1]).itemsize for name in _NEEDED)
    if end > message.point_step:
        return f'fields end at {end} of {message.point_step} bytes'
    size = message.point_step * message.width * message.height
    if len(message.data) != size or message.row_step != message.point_step * message.width:
        return f'data holds {len(message.data)} bytes, not {size}'
    points = lidar_points(message)
    place = np.stack([points[name] for name in ('x', 'y', 'z')])
    unknown = ~np.isfinite(place).all(axis=0)
    if message.is_dense and unknown.any():
        return f'{int(unknown.sum())} points are not finite in a dense cloud'
    if len(points) and not points['time'].min() >= 0.0:
        return f'time is {points["time"].min()} s'
    return ''
