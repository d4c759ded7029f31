"""Reading an exported EuRoC sequence: frames and calibration."""

from __future__ import annotations

from collections.abc import Iterator
import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import brief, SlamError
from lunar_rover_sim.base.files.images import read_picture
from lunar_rover_sim.base.files.yaml_text import read_text, read_yaml
from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.products.sequences.euroc import TIMES_FILE
from lunar_rover_sim.products.sequences.sensors import SensorSuite

Image = NDArray[np.uint8]

_MAX_BYTES = 1 << 24
_LARGEST = 1e6          # of a number of a calibration: beyond any camera
_SKEW = 1e-3            # of a rotation matrix with few digits
_MOST_DIGITS = 19       # of a stamp of 64 bits


@dataclasses.dataclass(frozen=True)
class Camera:
    """Pinhole camera, or a pair of equal, rectified ones.

    Attributes:
        focal_px, centre_px: (fx, fy), (cx, cy) [px].
        baseline_m: 0 for a single camera.
        distortion: k1, k2, p1, p2 of the raw images.
    """

    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    baseline_m: float = 0.0
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    @classmethod
    def of(cls, suite: SensorSuite) -> Camera:
        """Return the pair that took the images of a bag."""
        return cls(suite.focal_px, suite.centre_px, suite.baseline_m, tuple(suite.distortion[:4]))

    @property
    def matrix(self) -> Array:
        """(3, 3) K."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def rectified(self, image: Image) -> Image:
        """Return the image without its distortion."""
        if not any(self.distortion):
            return image
        return np.asarray(cv2.undistort(image, self.matrix, np.array(self.distortion)), np.uint8)


class Frame(NamedTuple):
    """Stamp [ns], left and, of a stereo sequence, right image (h, w)."""

    stamp_ns: int
    left: Image
    right: Image | None = None


def read_camera(sequence: Path, stereo: bool) -> Camera:
    """Return the calibration of a sequence; raise SlamError if it cannot be read."""
    left = _sensor(sequence, 'cam0')
    baseline_m = 0.0
    if stereo:
        T_left_right = inverse(_mount(sequence, left)) @ _mount(sequence,
                                                                _sensor(sequence, 'cam1'))
        baseline_m = float(T_left_right[0, 3])
        off = np.abs(T_left_right - np.eye(4))
        off[0, 3] = 0.0
        if not baseline_m > 0.0 or off.max() > 1e-3:
            raise SlamError(f'{sequence}: cam1 is not cam0 shifted along x; only '
                            'rectified pairs can be tracked')
    fx, fy, cx, cy = _numbers(sequence, left, 'intrinsics', 4)
    distortion = _numbers(sequence, left, 'distortion_coefficients', 4)
    if not (fx > 0.0 and fy > 0.0):
        raise SlamError(f'{sequence}: intrinsics: focal lengths {fx:g}, {fy:g} are not positive')
    return Camera((fx, fy), (cx, cy), baseline_m, distortion)


def stamps_ns(sequence: Path, file: str = TIMES_FILE) -> list[int]:
    """Return the stamps of the frames [ns]; file: times.txt or times_imu.txt."""
    return [int(word) for word in _stamps(sequence, file)]


def _stamps(sequence: Path, file: str = TIMES_FILE) -> list[str]:
    """Return the stamps of the frames [ns] as they name the files."""
    path = sequence / file
    words = read_text(path, _MAX_BYTES, SlamError).split()
    for word in words:
        if (not word.isascii() or not word.isdigit() or len(word) > _MOST_DIGITS
                or int(word) >= 1 << 63):
            raise SlamError(f'{path}: {brief(word)} is not a stamp [ns]')
    return words


def read_frames(sequence: Path, camera: Camera) -> Iterator[Frame]:
    """Yield the undistorted frames in order, with right images if there is a baseline."""
    for stamp in _stamps(sequence):
        images = [camera.rectified(read_picture(
            sequence / 'mav0' / name / 'data' / f'{stamp}.png', SlamError))
                  for name in (('cam0', 'cam1') if camera.baseline_m else ('cam0',))]
        yield Frame(int(stamp), *images)


def _sensor(sequence: Path, name: str) -> dict[str, Any]:
    path = sequence / 'mav0' / name / 'sensor.yaml'
    sensor = read_yaml(path, _MAX_BYTES, SlamError)
    if not isinstance(sensor, dict):
        raise SlamError(f'{path}: is not a mapping of a sensor')
    return sensor


def _mount(sequence: Path, sensor: dict[str, Any]) -> Array:
    mount = sensor.get('T_BS')
    matrix = np.reshape(_numbers(sequence, mount if isinstance(mount, dict) else {}, 'data', 16),
                        (4, 4))
    skew = matrix[:3, :3] @ matrix[:3, :3].T - np.eye(3)
    if (np.linalg.det(matrix[:3, :3]) < 0.0 or np.abs(skew).max() > _SKEW
            or np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > _SKEW):
        raise SlamError(f'{sequence}: T_BS is not a pose')
    return matrix


def _numbers(sequence: Path, values: dict[str, Any], name: str, count: int) -> tuple[float, ...]:
    """Return the finite numbers of an entry; raise SlamError if there are not as many."""
    found = values.get(name)
    if (not isinstance(found, list) or len(found) != count
            or not all(isinstance(x, (int, float)) and abs(x) <= _LARGEST for x in found)):
        raise SlamError(f'{sequence}: sensor.yaml: {name}: {brief(found)} is not {count} numbers '
                        f'of at most {_LARGEST:g}')
    return tuple(map(float, found))
