"""POLAR stereo data set (Wong et al., NASA Ames, 2017): exposures of one scene, rectified pairs.

Of the exposures of a scene the longest is taken whose left image is hardly saturated, as an
automatic exposure would. The layout is described in `image_layouts`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import re
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.series import spread
from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.images import read_pixels
from lunar_rover_sim.base.files.yaml_text import read_text
from lunar_rover_sim.judge.evaluation.image_statistics import check_sizes, F32, GreyPair, levels_of

_BLACK, _FULL = 16.0, 4095.0
_SATURATED_SHARE = 0.01
_CALIBRATION = 'stereo.calibration'
_MOST_BYTES = 1 << 20
_MATRICES = {'CAMERA_MATRIX_LEFT': 9, 'DISTORTION_COEFFICIENTS_LEFT': 0, 'CAMERA_MATRIX_RIGHT': 9,
             'DISTORTION_COEFFICIENTS_RIGHT': 0, 'ROTATION_MATRIX': 9, 'TRANSLATION_VECTOR': 3}

Maps = tuple[Any, ...]     # of cv2.remap: columns and rows, left and right


class PolarScene(NamedTuple):
    """One position under one light: exposures [ms] → left image."""

    folder: Path
    exposures: dict[int, Path]


def scenes(path: Path) -> list[PolarScene]:
    """Return the scenes below a folder: the set, a terrain, a position or a light."""
    found: dict[Path, dict[int, Path]] = {}
    depths = ('', '*/', '*/*/', '*/*/*/')      # a light, a position, a terrain, the set
    for left in sorted(left for depth in depths for left in path.glob(f'{depth}CamL_*.png')):
        exposure = re.search(r'_(\d+)\.png$', left.name)
        if exposure is None:
            raise EvaluationError(f'{left}: names no exposure; valid is CamL_*_EXPOSURE.png')
        found.setdefault(left.parent, {})[int(exposure[1])] = left
    return [PolarScene(folder, exposures) for folder, exposures in found.items()]


def pairs(all_scenes: list[PolarScene], most: int) -> Iterator[GreyPair]:
    """Yield one pair for each of at most so many scenes."""
    for scene in spread(all_scenes, most):
        left_path, left = _exposed(scene)
        rights = sorted(left_path.parent.glob(
            f'CamR_*_{left_path.stem.rpartition("_")[2]}.png'))
        right = _linear(rights[0]) if rights else None
        check_sizes(GreyPair('', left, right), left_path)
        maps = _rectification(scene.folder, left.shape) if right is not None else None
        if maps is None:
            # Raw pairs have no common rows: the left image alone is compared.
            right = None
        else:
            left = _remapped(left, maps[:2])
            right = _remapped(right, maps[2:])
        yield GreyPair(str(left_path), np.sqrt(left),
                       None if right is None else np.sqrt(right))


def _linear(path: Path) -> F32:
    """Return the signal as a share of full scale."""
    return levels_of(read_pixels(path, EvaluationError), False, _BLACK, _FULL)


def _exposed(scene: PolarScene) -> tuple[Path, F32]:
    for exposure in sorted(scene.exposures, reverse=True):
        path = scene.exposures[exposure]
        image = _linear(path)
        if (image >= 1.0).mean() <= _SATURATED_SHARE:
            break
    return path, image


def _remapped(image: F32 | None, maps: Maps) -> F32:
    assert image is not None
    return np.asarray(cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR), np.float32)


def _rectification(folder: Path, shape: tuple[int, ...]) -> Maps | None:
    """Return the maps of left and right image; None where no calibration lies above."""
    path = next((f / _CALIBRATION for f in (folder, *folder.parents)
                 if (f / _CALIBRATION).is_file()), None)
    if path is None:
        return None
    values: dict[str, NDArray[np.float64]] = {}
    for line in read_text(path, _MOST_BYTES, EvaluationError).splitlines():
        key, _, rest = line.partition(':')
        if key.strip() in _MATRICES:
            try:
                values[key.strip()] = np.array(rest.split(), float)
            except ValueError:
                raise EvaluationError(f'{path}: {key.strip()}: {rest.strip()[:60]!r} is not a '
                                      'list of numbers') from None
    for key, count in _MATRICES.items():
        if key not in values or not np.isfinite(values[key]).all() or (
                count and values[key].size != count):
            raise EvaluationError(f'{path}: {key} is missing or not {count or "some"} numbers')
    K1, d1, K2, d2, R, T = (values[key] for key in _MATRICES)
    K1, K2, R = (m.reshape(3, 3) for m in (K1, K2, R))
    if min(K1[0, 0], K1[1, 1], K2[0, 0], K2[1, 1]) <= 0.0 or not T.any():
        raise EvaluationError(f'{path}: a focal length is not above 0, or the translation is 0')
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-3) or np.linalg.det(R) < 0.0:
        raise EvaluationError(f'{path}: ROTATION_MATRIX is not a rotation')
    size = shape[1], shape[0]
    maps: list[Any] = []
    try:
        R1, R2, P1, P2, *_ = cv2.stereoRectify(K1, d1, K2, d2, size, R, T.reshape(3, 1), alpha=0)
        for K, d, turn, P in ((K1, d1, R1, P1), (K2, d2, R2, P2)):
            maps += cv2.initUndistortRectifyMap(K, d, turn, P, size, cv2.CV_32FC1)
    except cv2.error as error:
        raise EvaluationError(f'{path}: is not the calibration of a pair: '
                              f'{error.err}') from None
    if not all(np.isfinite(part).all() for part in maps):
        raise EvaluationError(f'{path}: is not the calibration of a pair')
    return tuple(maps)
