"""Reading an exported EuRoC sequence: frames and calibration."""

from __future__ import annotations

from collections.abc import Iterator
import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
import yaml

from lunar_rover_sim.errors import SlamError
from lunar_rover_sim.frames import Array, inverse

Image = NDArray[np.uint8]


@dataclasses.dataclass(frozen=True)
class Camera:
    """Pinhole camera, or a pair of equal, rectified ones.

    focal_px, centre_px: (fx, fy), (cx, cy) [px]; baseline_m: 0 for a single camera;
    distortion: k1, k2, p1, p2 of the raw images
    """

    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    baseline_m: float = 0.0
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

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
        T_left_right = inverse(_mount(left)) @ _mount(_sensor(sequence, 'cam1'))
        baseline_m = float(T_left_right[0, 3])
        off = np.abs(T_left_right - np.eye(4))
        off[0, 3] = 0.0
        if not baseline_m > 0.0 or off.max() > 1e-3:
            raise SlamError(f'{sequence}: cam1 is not cam0 shifted along x; only '
                            'rectified pairs can be tracked')
    fx, fy, cx, cy = left['intrinsics']
    return Camera((fx, fy), (cx, cy), baseline_m, tuple(left['distortion_coefficients']))


def stamps_ns(sequence: Path) -> list[int]:
    """Return the stamps of the frames [ns]."""
    try:
        return [int(line) for line in (sequence / 'times.txt').read_text().split()]
    except (OSError, ValueError) as error:
        raise SlamError(f'{sequence}: times.txt cannot be read: {error}') from None


def read_frames(sequence: Path, camera: Camera) -> Iterator[Frame]:
    """Yield the undistorted frames in order, with right images if there is a baseline."""
    for stamp_ns in stamps_ns(sequence):
        images = [camera.rectified(_image(sequence / 'mav0' / name / 'data' / f'{stamp_ns}.png'))
                  for name in (('cam0', 'cam1') if camera.baseline_m else ('cam0',))]
        yield Frame(stamp_ns, *images)


def _image(path: Path) -> Image:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise SlamError(f'{path}: is missing or no image')
    return np.asarray(image, np.uint8)


def _sensor(sequence: Path, name: str) -> Any:
    path = sequence / 'mav0' / name / 'sensor.yaml'
    try:
        return yaml.safe_load(path.read_text(encoding='utf-8'))
    except (OSError, yaml.YAMLError) as error:
        raise SlamError(f'{path}: cannot be read: {error}') from None


def _mount(sensor: Any) -> Array:
    return np.array(sensor['T_BS']['data'], dtype=float).reshape(4, 4)
