"""Keyframes, and the places that the rover has seen: those that a loop may close to.

A keyframe is the corners of a stereo pair, with their points and descriptors.

One is kept for each spot and heading, so memory grows with the ground covered and not with the
way. Of those near enough, the ones whose words are most like are candidates. A word is a
descriptor's signs along some fixed random directions (Charikar, STOC 2002), so there is no
vocabulary to be trained.
"""

from __future__ import annotations

from collections import defaultdict
import dataclasses
import math

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.slam.euroc_reader import Camera, Image
from lunar_rover_sim.judge.slam.reference.geometry import detect, disparities, from_disparity

_CORNERS = 350
_MIN_DISPARITY_PX = 1.5
_COARSE_PX = 320            # width of the image for the first disparities
# A descriptor covers this width on the ground, so that a place looks the same from near and far.
_PATCH_M = 0.12
_PATCH_PX = 6.0             # width of the patch of SIFT over the size of its keypoint
_SIZES_PX = 2.0, 24.0       # of a keypoint
_SIZE_OF_OCTAVE_PX = 4.0    # of a keypoint of the first octave
_EVEN = 16              # the width of an image over the one within which light is made even
_GREY, _CONTRAST = 128.0, 40.0  # mean and standard deviation there [levels]
_NOISE = 4.0            # contrast below which there is more noise than ground [levels]


@dataclasses.dataclass(frozen=True)
class Keyframe:
    """Corners of one pair.

    Attributes:
        left: The left image.
        px: (n, 3) u, v and right u.
        points_m: (n, 3) in the left camera.
        descriptors: (n, 128) SIFT.
    """

    left: Image
    px: Array
    points_m: Array
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.px)


def evenly_lit(image: Image) -> Image:
    """Return an image with the same mean and contrast everywhere (Wallis, 1976).

    A lamp goes along with the camera, so the ground that it lights changes its brightness; and
    what is far from it has hardly any contrast.
    """
    side = image.shape[1] // _EVEN | 1
    values = image.astype(np.float32)
    mean, square = (cv2.boxFilter(v, -1, (side, side)) for v in (values, values * values))
    contrast = np.sqrt(np.maximum(square - mean * mean, 0.0))
    return np.asarray(cv2.convertScaleAbs(
        _GREY + _CONTRAST * (values - mean) / (contrast + _NOISE)), np.uint8)


def keyframe(camera: Camera, left: Image, right: Image) -> Keyframe:
    """Return the corners of a rectified pair that have a disparity."""
    px = detect(left, np.zeros((0, 2)), _CORNERS)
    shrink = max(1, left.shape[1] // _COARSE_PX)
    found = disparities(left, right, px, shrink) if len(px) else np.zeros(0)
    good = found > _MIN_DISPARITY_PX
    px, disparity = px[good], found[good]
    points = from_disparity(camera, px, disparity)
    return Keyframe(left, np.column_stack([px, px[:, 0] - disparity]), points,
                    _descriptors(camera, left, px, points[:, 2]))


def _descriptors(camera: Camera, image: Image, px: Array, depth_m: Array) -> NDArray[np.uint8]:
    """Return SIFT descriptors (Lowe, 2004), upright, of patches of one size on the ground."""
    if not len(px):
        return np.zeros((0, 128), np.uint8)
    size = np.clip(camera.focal_px[0] * _PATCH_M / (_PATCH_PX * depth_m), *_SIZES_PX)
    octave = np.maximum(np.rint(np.log2(size / _SIZE_OF_OCTAVE_PX)), 0).astype(int)
    # The index of the keypoint, since OpenCV may drop some and change their order.
    points = [cv2.KeyPoint(float(u), float(v), float(s), 0.0, 0.0, int(o) | (1 << 8), k)
              for k, ((u, v), s, o) in enumerate(zip(px, size, octave))]
    kept, found = cv2.SIFT.create().compute(image, points)
    descriptors = np.zeros((len(px), 128), np.uint8)
    if found is not None:
        descriptors[[point.class_id for point in kept]] = np.asarray(found).astype(np.uint8)
    return descriptors


_SPOT_M, _SPOT_RAD = 0.3, math.radians(30.0)    # nearer than both, a place is known
_REACH_M, _REACH_RAD = 1.5, math.radians(45.0)  # of a view that shows the same ground
_CELL_M = 4.0
_MOST = 64              # places whose words are compared
_WORD_BITS = 12
_QUALITY = 90           # of the images that are kept


@dataclasses.dataclass
class Place:
    """A keyframe of the graph that is remembered."""

    key: int
    packed: tuple[NDArray[np.uint8], Array, Array, NDArray[np.uint8]]
    words: NDArray[np.int64]
    position_m: Array
    yaw_rad: float

    @property
    def keyframe(self) -> Keyframe:
        """As it was, but for the losses of JPEG."""
        image, px, points, descriptors = self.packed
        left = np.asarray(cv2.imdecode(image, cv2.IMREAD_GRAYSCALE), np.uint8)
        return Keyframe(left, px, points, descriptors)


class Places:
    """All of them, by cells of the ground."""

    def __init__(self) -> None:
        self._cells: defaultdict[tuple[int, int], list[Place]] = defaultdict(list)
        self._directions = np.random.default_rng(0).standard_normal((128, _WORD_BITS))

    def __len__(self) -> int:
        return sum(map(len, self._cells.values()))

    def add(self, key: int, keyframe: Keyframe, T_map_base: Array) -> None:
        """Remember a keyframe, unless its place is known already."""
        position, yaw = T_map_base[:3, 3], _yaw(T_map_base)
        for place in self._near(position, _SPOT_M):
            if (math.dist(place.position_m[:2], position[:2]) < _SPOT_M
                    and abs(_wrapped(place.yaw_rad - yaw)) < _SPOT_RAD):
                return
        self._cells[self._cell(position)].append(
            Place(key, _packed(keyframe), self._words(keyframe), position.copy(), yaw))

    def candidates(self, keyframe: Keyframe, T_map_base: Array, slack_m: float, slack_rad: float,
                   newest_key: int, most: int) -> list[Place]:
        """Return at most `most` places that may show the same, the likeliest first.

        Args:
            slack_m, slack_rad: By how much the pose may be off.
            newest_key: Places of later keys are left out.
        """
        position, yaw = T_map_base[:3, 3], _yaw(T_map_base)
        reach_m, reach_rad = _REACH_M + slack_m, _REACH_RAD + slack_rad
        near = [place for place in self._near(position, reach_m) if place.key <= newest_key
                and math.dist(place.position_m[:2], position[:2]) < reach_m
                and abs(_wrapped(place.yaw_rad - yaw)) < reach_rad]
        near.sort(key=lambda place: math.dist(place.position_m[:2], position[:2]))
        words = self._words(keyframe)
        alike = [(-len(np.intersect1d(words, place.words, True)), k)
                 for k, place in enumerate(near[:_MOST])]
        return [near[k] for _, k in sorted(alike)[:most]]

    def move(self, poses: dict[int, Array]) -> None:
        """Take the present T_map_base of the keys."""
        places = [place for cell in self._cells.values() for place in cell]
        self._cells.clear()
        for place in places:
            T = poses[place.key]
            place.position_m, place.yaw_rad = T[:3, 3].copy(), _yaw(T)
            self._cells[self._cell(place.position_m)].append(place)

    def _words(self, keyframe: Keyframe) -> NDArray[np.int64]:
        # Descriptors are never negative: their mean is taken off, or all signs would be alike.
        d = keyframe.descriptors.astype(float)
        signs = (d - d.mean(axis=1, keepdims=True)) @ self._directions > 0.0
        return np.unique(signs @ (1 << np.arange(_WORD_BITS)))

    def _near(self, position: Array, reach_m: float) -> list[Place]:
        (i, j), n = self._cell(position), math.ceil(reach_m / _CELL_M)
        if (2 * n + 1)**2 > len(self._cells):
            return [place for cell in self._cells.values() for place in cell]
        return [place for di in range(-n, n + 1) for dj in range(-n, n + 1)
                for place in self._cells.get((i + di, j + dj), ())]

    @staticmethod
    def _cell(position: Array) -> tuple[int, int]:
        return math.floor(position[0] / _CELL_M), math.floor(position[1] / _CELL_M)


def _packed(keyframe: Keyframe) -> tuple[NDArray[np.uint8], Array, Array, NDArray[np.uint8]]:
    _, image = cv2.imencode('.jpg', keyframe.left, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return np.asarray(image, np.uint8), keyframe.px, keyframe.points_m, keyframe.descriptors


def _yaw(T: Array) -> float:
    return math.atan2(T[1, 0], T[0, 0])


def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
