"""Validity of single messages: finite numbers, unit quaternions, images of their size."""

from __future__ import annotations

from collections.abc import Callable
import math
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from lunar_rover_sim.base.errors import brief
from lunar_rover_sim.image.camera.encoding import BAYER8, BAYER16, is_bayer

BYTES_PER_PIXEL = {BAYER8: 1, BAYER16: 2, 'mono8': 1, '8UC1': 1, 'mono16': 2, '16UC1': 2,
                   'rgb8': 3, 'bgr8': 3, 'rgba8': 4, 'bgra8': 4, '32FC1': 4, '32FC2': 8,
                   '32FC3': 12}
QUATERNION_TOLERANCE = 1e-6
_ROUNDING = 1e-9        # of a covariance, as a share of its largest element

_FLOATS = ('float32', 'float64')
# NaN, or infinity, is what their definitions ask for where something is not measured.
_MAY_BE_UNKNOWN = {
    'sensor_msgs/msg/BatteryState': ('temperature', 'charge', 'capacity', 'design_capacity',
                                     'percentage', 'cell_voltage', 'cell_temperature'),
    'sensor_msgs/msg/LaserScan': ('ranges',)}

# Dotted names of float fields, of float arrays, and of sequences of messages with their type.
_Leaves = tuple[list[str], list[str], list[tuple[str, str]]]


class FiniteCheck:
    """Finds numbers that are not finite in any message of a typestore."""

    def __init__(self, typestore: Typestore) -> None:
        self._typestore = typestore
        self._leaves: dict[str, _Leaves] = {}

    def problem(self, msgtype: str, message: Any) -> str | None:
        """Return the first field that holds NaN or infinity, or None."""
        if msgtype not in self._leaves:
            self._leaves[msgtype] = self._find(msgtype, '')
        scalars, arrays, sequences = self._leaves[msgtype]
        for name in scalars:
            if not math.isfinite(_get(message, name)):
                return f'{name} is {_get(message, name)}'
        for name in arrays:
            values = np.asarray(_get(message, name), dtype=float)
            if not np.all(np.isfinite(values)):
                return f'{name} holds {values[~np.isfinite(values)][0]}'
        for name, inner in sequences:
            for i, element in enumerate(_get(message, name)):
                found = self.problem(inner, element)
                if found:
                    return f'{name}[{i}].{found}'
        return None

    def _find(self, msgtype: str, prefix: str) -> _Leaves:
        scalars: list[str] = []
        arrays: list[str] = []
        sequences: list[tuple[str, str]] = []
        fields: Any = self._typestore.fielddefs[msgtype][1]
        for name, (kind, detail) in fields:
            path = prefix + name
            if name in _MAY_BE_UNKNOWN.get(msgtype, ()):
                continue
            if kind == Nodetype.BASE:
                if detail[0] in _FLOATS:
                    scalars.append(path)
            elif kind == Nodetype.NAME:
                inner = self._find(detail, path + '.')
                scalars += inner[0]
                arrays += inner[1]
                sequences += inner[2]
            else:
                element_kind, element = detail[0]
                if element_kind == Nodetype.NAME:
                    sequences.append((path, element))
                elif element[0] in _FLOATS:
                    arrays.append(path)
        return scalars, arrays, sequences


def _get(message: Any, path: str) -> Any:
    return attrgetter(path)(message)


def image_problem(image: Any) -> str | None:
    """Return what is wrong with the layout of a sensor_msgs/Image, or None."""
    bytes_per_pixel = BYTES_PER_PIXEL.get(image.encoding)
    if bytes_per_pixel is None:
        return f'encoding {image.encoding!r} is not known'
    if image.step < image.width * bytes_per_pixel:
        return f'step {image.step} is less than a row of {image.width} pixels'
    if len(image.data) != image.step * image.height:
        return f'data holds {len(image.data)} bytes, not {image.step * image.height}'
    if not image.width or not image.height:
        return 'it has no pixels'
    return None


def pixels(image: Any) -> np.ndarray:
    """Return the (h, w) or (h, w, c) pixels of a sensor_msgs/Image, a view where possible.

    Mosaics are interpolated: they become (h, w, 3) red, green, blue.
    The image must pass `image_problem`.
    """
    kinds: dict[str, type] = {BAYER16: np.uint16, 'mono16': np.uint16, '16UC1': np.uint16,
                              '32FC1': np.float32, '32FC2': np.float32, '32FC3': np.float32}
    kind = kinds.get(image.encoding, np.uint8)
    channels = BYTES_PER_PIXEL[image.encoding] // np.dtype(kind).itemsize
    rows = np.asarray(image.data, np.uint8).reshape(image.height, image.step)
    rows = rows[:, :image.width * BYTES_PER_PIXEL[image.encoding]]
    result: np.ndarray = np.ascontiguousarray(rows).view(kind)
    if image.is_bigendian and result.dtype.itemsize > 1:
        result = result.byteswap()
    if is_bayer(image.encoding):
        from lunar_rover_sim.image.camera.mosaic import interpolated  # OpenCV and Numba take long
        return interpolated(result)
    return result.reshape(image.height, image.width, channels) if channels > 1 else result


def true_depth_problem(image: Any) -> str | None:
    """Depth of the scene: positive everywhere, +Inf for the sky, never NaN."""
    depth = pixels(image)
    if np.isnan(depth).any():
        return f'{int(np.isnan(depth).sum())} pixels are NaN'
    if (depth <= 0.0).any():
        return f'{int((depth <= 0.0).sum())} pixels are not in front of the camera'
    return None


def depth_problem(image: Any) -> str | None:
    """Depth from matching: positive, +Inf where too far, NaN where unknown (REP-118)."""
    wrong = pixels(image) <= 0.0
    if wrong.any():
        return f'{int(wrong.sum())} pixels are not in front of the camera'
    return None


def disparity_problem(message: Any) -> str | None:
    """Disparity: its image, a positive focal length and baseline."""
    if not (message.f > 0.0 and message.t > 0.0):
        return f'f = {message.f:g} px and t = {message.t:g} m; both must be positive'
    if message.image.encoding != '32FC1':
        return f'encoding {message.image.encoding!r}; valid is 32FC1'
    return image_problem(message.image) or (
        None if np.all(np.isfinite(pixels(message.image))) else 'pixels are NaN or infinite')


def covariance_problem(path: str) -> Callable[[Any], str | None]:
    """Return a check that a 6 x 6 covariance is symmetric and has no negative variance."""
    def problem(message: Any) -> str | None:
        P = np.reshape(np.asarray(_get(message, path), float), (6, 6))
        size = np.abs(P).max()
        if np.abs(P - P.T).max() > _ROUNDING * size:
            return f'{path} is not symmetric'
        low = float(np.linalg.eigvalsh(P)[0])
        return f'{path} has a variance of {low:.2g} < 0' if low < -_ROUNDING * size else None
    return problem


def quaternion_problem(name: str) -> Callable[[Any], str | None]:
    """Return a check that the quaternion at the dotted field `name` has length 1."""
    def problem(message: Any) -> str | None:
        q = _get(message, name)
        norm = math.sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w)
        if abs(norm - 1.0) > QUATERNION_TOLERANCE:
            return f'{name} has length {norm:.6f}, not 1'
        return None
    return problem


def joints_problem(message: Any) -> str | None:
    """Every joint has a position and a velocity; effort is complete or empty."""
    return _joints_problem(message, ('position', 'velocity'))


def commands_problem(message: Any) -> str | None:
    """Every joint has a velocity; position and effort are complete or empty."""
    return _joints_problem(message, ('velocity',))


def _joints_problem(message: Any, needed: tuple[str, ...]) -> str | None:
    for name in ('position', 'velocity', 'effort'):
        length = len(getattr(message, name))
        if length != len(message.name) and (length or name in needed):
            return f'{name} holds {length} values for {len(message.name)} joints'
    return None


def exposure_problem(message: Any) -> str | None:
    """Left and right image have a time, which is positive."""
    if list(message.name) != ['left', 'right'] or len(message.position) != 2:
        return f'exposure times of {brief(list(message.name))}, not of left and right'
    shortest = float(min(message.position))
    return None if shortest > 0.0 else f'exposure time {shortest:g} s is not positive'


def camera_info_problem(message: Any) -> str | None:
    """Focal lengths positive, K and P of one kind, a size."""
    k, p = message.k.reshape(3, 3), message.p.reshape(3, 4)
    if not (k[0, 0] > 0.0 and k[1, 1] > 0.0 and p[0, 0] > 0.0):
        return f'focal lengths K {k[0, 0]:g}, {k[1, 1]:g}, P {p[0, 0]:g} are not positive'
    if not message.width or not message.height:
        return 'it has no size'
    return None


_TYPES = {2: '<u1', 4: '<u2', 6: '<u4', 7: '<f4', 8: '<f8'}     # of PointField
_NEEDED = ('x', 'y', 'z', 'intensity', 'ring', 'time')
_TOLERANCE = 1e-4       # of ranges, which are float32


def laser_scan_problem(message: Any) -> str | None:
    """Ranges: as many as there are angles, within their bounds, inf where nothing returns."""
    ranges = np.asarray(message.ranges, float)
    steps = (message.angle_max - message.angle_min) / message.angle_increment \
        if message.angle_increment else np.nan
    if not abs(steps - (len(ranges) - 1)) < 0.01:
        return f'{len(ranges)} ranges for {steps + 1:.2f} angles'
    if np.isnan(ranges).any():
        return f'{int(np.isnan(ranges).sum())} ranges are NaN; valid is inf where nothing returns'
    far = np.isfinite(ranges) & (ranges > message.range_max * (1.0 + _TOLERANCE))
    return f'{int(far.sum())} ranges beyond range_max' if far.any() else None


def lidar_points(message: Any) -> NDArray[np.void]:
    """Return (m,) records of the fields of a LiDAR; the cloud must have them and be whole."""
    fields = _point_fields(message)
    dtype = np.dtype({'names': list(_NEEDED), 'formats': [fields[n][1] for n in _NEEDED],
                      'offsets': [fields[n][0] for n in _NEEDED],
                      'itemsize': message.point_step})
    return np.frombuffer(np.asarray(message.data, np.uint8).tobytes(), dtype)


def _point_fields(message: Any) -> dict[str, tuple[int, str | None]]:
    """Return where each field of a point is, and its type."""
    return {f.name: (f.offset, _TYPES.get(f.datatype)) for f in message.fields}


def lidar_cloud_problem(message: Any) -> str | None:
    """Points with the fields of a LiDAR; finite where the cloud is dense; times from 0 on."""
    fields = _point_fields(message)
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
    return None


_ELEVATION = ('x', 'y', 'z', 'stddev')
_MOST_CELLS = 4096      # along a side of a map


def grid_problem(message: Any) -> str | None:
    """Return what is wrong with the layout of a nav_msgs/OccupancyGrid, or None."""
    info, place = message.info, message.info.origin.position
    if not 0 < len(message.data) == info.width * info.height:
        return f'data holds {len(message.data)} cells, not {info.width} x {info.height}'
    if max(info.width, info.height) > _MOST_CELLS:
        return f'{info.width} x {info.height} cells; valid is up to {_MOST_CELLS} along a side'
    if not all(map(math.isfinite, (place.x, place.y))) or not 0.0 < info.resolution < math.inf:
        return (f'cells of {info.resolution:g} m from x {place.x:g}, y {place.y:g} m; valid are '
                'finite places, and cells > 0')
    return None


def elevation_points(message: Any) -> NDArray[np.float64]:
    """Return the cells (n, 4) of a map of heights: x, y, z and the standard deviation of z [m].

    The message must pass `elevation_problem`.
    """
    return np.frombuffer(bytes(message.data), '<f4').reshape(-1, len(_ELEVATION)).astype(float)


def elevation_problem(message: Any) -> str | None:
    """Four numbers a cell, one after the other; places finite, and those of a map."""
    names = tuple(field.name for field in message.fields)
    if names != _ELEVATION or message.is_bigendian or message.point_step != 4 * len(names):
        return (f'points of {message.point_step} bytes with {brief(names)}; valid are x, y, z and '
                'stddev, float32, little-endian')
    size = message.point_step * message.width * message.height
    if len(message.data) != size:
        return f'data holds {len(message.data)} bytes, not {size}'
    points = elevation_points(message)
    if not np.isfinite(points).all():
        return 'a cell is not finite'
    if len(points) and np.ptp(points[:, :2], axis=0).max() > _MOST_CELLS:
        return f'cells are {np.ptp(points[:, :2], axis=0).max():g} m apart'
    return None
