"""Sets of images in the layouts of bags and data sets.

| layout | recognised by | pairs | true disparity |
|---|---|---|---|
| bag of this package | bag | yes | from `ground_truth/depth/image` |
| EuRoC (Burri et al., 2016) | mav0/cam0/data | cam1 | |
| KITTI (Geiger et al., 2012) | image_0 | image_1 | |
| TartanAir (Wang et al.) | image_left | image_right | depth_left, with our calibration.yaml |
| TUM RGB-D (Sturm et al., 2012) | rgb | | |
| LuSNAR (Liu et al., 2024) | image1/RGB | image2/RGB | (its unit is not known) |
| POLAR (Wong et al., 2017) | CamL_*.png | CamR_* | its range maps are not read |
| any folder | pictures | NAME_left, NAME_right, or left/, right/ | |

LuSNAR's layout is that of its README. POLAR's (TerrainNN_NAME/PosX_DISTANCE_LIGHTS/SUN/
CamL_*_EXPOSURE.png, 12 bits above a black level of 16, and `stereo.calibration` of the terrain
with lines like `CAMERA_MATRIX_LEFT: ...`) is from public programs that read it; neither set was at
hand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
import re
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.series import messages_at, picture, read_calibration, spread
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.arrays import map_array
from lunar_rover_sim.base.files.images import read_pixels
from lunar_rover_sim.base.files.paths import recorded_bag
from lunar_rover_sim.base.files.yaml_text import read_text, read_yaml
from lunar_rover_sim.image.stereo.depth import disparity_from_depth
from lunar_rover_sim.judge.evaluation.image_statistics import check_sizes, F32, GreyPair, levels_of
from lunar_rover_sim.products.sequences.sensors import CALIBRATION_FILE
from lunar_rover_sim.run.recorded_run import RecordedRun

_PICTURES = ('.png', '.jpg', '.jpeg', '.tif', '.tiff', '.pgm', '.bmp')
_MOST_BYTES = 1 << 20
_MOST_SCALE = 1e6     # px m
_LEAST_DEPTH_M = 1e-3


class ImageSet(NamedTuple):
    """A set of images: where, in which layout, how many; `read` yields at most so many pairs."""

    path: Path
    layout: str
    total: int
    read: Callable[[int], Iterator[GreyPair]]


def open_images(path: Path | str) -> ImageSet:
    """Return the set of images at a path: a bag, the folder of a run or of a data set.

    Raises:
        EvaluationError: If there are no images.
        BagError: If a bag cannot be read.
    """
    path = recorded_bag(path)
    if not path.exists():
        raise EvaluationError(f'{path}: there is no such folder or bag')
    if path.is_file() or any((path / 'metadata.yaml').is_file() or any(path.glob(pattern))
                             for pattern in ('*.mcap', '*.db3')):
        with open_bag(path) as bag:
            name = topics.LEFT_IMAGE.name
            count = bag.count(name)
        if not count:
            raise EvaluationError(f'{path}: holds no images on {name}')
        return ImageSet(path, 'bag', count, lambda most: _bag_pairs(path, most))
    for layout, lefts, right_of in (
            ('EuRoC', path.glob('mav0/cam0/data/*'), _replacing(path, 'cam0', 'cam1')),
            ('KITTI', path.glob('image_0/*'), _replacing(path, 'image_0', 'image_1')),
            ('TartanAir', path.glob('image_left/*'), _replacing(path, 'left', 'right')),
            ('TUM', path.glob('rgb/*'), None),
            # One scene, or the folder of all.
            ('LuSNAR', path.glob('image1/RGB/*'), _replacing(path, 'image1', 'image2')),
            ('LuSNAR', path.glob('*/image1/RGB/*'), _replacing(path, 'image1', 'image2'))):
        found = _pictures(lefts)
        if found:
            return _files(path, layout, found, right_of)
    scenes = polar_scenes(path)
    if scenes:
        return ImageSet(path, 'POLAR', len(scenes),
                        lambda most: _polar_pairs(scenes, most))
    return _folder(path)


def _pictures(paths: Iterator[Path]) -> list[Path]:
    return sorted(p for p in paths if p.suffix.lower() in _PICTURES and p.is_file())


def _replacing(path: Path, old: str, new: str) -> Callable[[Path], Path]:
    """Return what names the right image: only names below the folder of the set change."""
    return lambda left: path / str(left.relative_to(path)).replace(old, new)


def _folder(path: Path) -> ImageSet:
    """Return the pictures of any folder: those of two folders, pairs by name, or single ones."""
    lefts = _pictures(path.glob('left/*'))
    if lefts:
        return _files(path, 'folder', lefts, lambda left: path / 'right' / left.name)
    found = _pictures(path.glob('*')) if path.is_dir() else []
    lefts = [p for p in found if p.stem == 'left' or p.stem.endswith('_left')]
    if lefts:
        return _files(path, 'folder', lefts,
                      lambda left: left.with_stem(left.stem[:-len('left')] + 'right'))
    if not found:
        raise EvaluationError(f'{path}: holds no images; valid are a bag, and folders of EuRoC, '
                              'KITTI, TartanAir, TUM, LuSNAR, POLAR, or of pictures')
    return _files(path, 'folder', found, None)


def _files(path: Path, layout: str, lefts: list[Path],
           right_of: Callable[[Path], Path] | None) -> ImageSet:
    scale = _disparity_scale(path) if layout == 'TartanAir' else 0.0

    def read(most: int) -> Iterator[GreyPair]:
        for left in spread(lefts, most):
            right = right_of(left) if right_of is not None else None
            pair = GreyPair(left.name, _grey(left),
                            _grey(right) if right is not None and right.is_file() else None,
                            _tartanair_truth(left, scale) if scale else None)
            check_sizes(pair, left)
            yield pair

    return ImageSet(path, layout, len(lefts), read)


def _grey(path: Path) -> F32:
    levels = read_pixels(path, EvaluationError)
    return levels_of(levels, linear=levels.dtype == np.uint16)


def _disparity_scale(path: Path) -> float:
    """Return focal length times baseline [px m] of an exported sequence; 0 where not known."""
    file = path / CALIBRATION_FILE
    if not file.is_file():
        return 0.0
    values = read_yaml(file, _MOST_BYTES, EvaluationError)
    try:
        scale = float(values['left']['fx_fy_cx_cy_px'][0]) * float(values['baseline_m'])
    except (KeyError, TypeError, ValueError, IndexError, OverflowError):
        raise EvaluationError(f'{file}: lacks left.fx_fy_cx_cy_px or baseline_m') from None
    if not 0.0 < scale < _MOST_SCALE:
        raise EvaluationError(f'{file}: focal length times baseline: {scale:g} px m is not valid; '
                              f'valid is > 0 and < {_MOST_SCALE:g}')
    return scale


def _tartanair_truth(left: Path, scale: float) -> F32 | None:
    file = left.parent.parent / 'depth_left' / f'{left.stem}_depth.npy'
    if not file.is_file():
        return None
    depth = map_array(file, EvaluationError)
    if depth.dtype.kind != 'f' or depth.ndim != 2:
        raise EvaluationError(f'{file}: {depth.dtype} {depth.shape} is not depth; valid are '
                              'floats in rows and columns')
    with np.errstate(over='ignore'):    # beyond float32 is the sky
        depth = depth.astype(np.float32)
    if (depth < _LEAST_DEPTH_M).any():
        raise EvaluationError(f'{file}: holds a depth of {np.nanmin(depth):g} m; valid is '
                              f'{_LEAST_DEPTH_M:g} m and more')
    return disparity_from_depth(np.where(depth >= 1e4, np.inf, depth), scale, 1.0)


def _bag_pairs(path: Path, most: int) -> Iterator[GreyPair]:
    with open_bag(path) as bag:
        linear = RecordedRun(bag).scenario.get('render_node', 'sensor.companding') == 'linear'
        wanted = topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.TRUE_DEPTH
        scale = _bag_scale(bag) if bag.has(topics.TRUE_DEPTH.name) else 0.0
        stamps = [m.time_ns for m in bag.raw([topics.LEFT_IMAGE.name])]
        for stamp in spread(stamps, most):
            found = {topic: picture(bag, message).pixels
                     for topic, message in messages_at(bag, wanted, stamp).items()}

            def side(pixels: NDArray[np.generic] | None) -> F32 | None:
                # mono16 is linear in any case, mono8 and rgb8 as the scenario says.
                return None if pixels is None else levels_of(
                    pixels, linear or pixels.dtype == np.uint16)

            left = side(found[topics.LEFT_IMAGE])
            assert left is not None
            depth = found.get(topics.TRUE_DEPTH)
            pair = GreyPair(str(stamp), left, side(found.get(topics.RIGHT_IMAGE)),
                            disparity_from_depth(depth, scale, 1.0)
                            if depth is not None and scale else None)
            check_sizes(pair, path)
            yield pair


def _bag_scale(bag: Bag) -> float:
    """Return focal length times baseline [px m]; 0 where the bag does not say."""
    if not bag.has(topics.LEFT_INFO.name) or not bag.has(topics.RIGHT_INFO.name):
        return 0.0
    right = read_calibration(bag, topics.RIGHT_INFO.name)
    return float(right.P[0, 0]) * right.baseline_m


_BLACK, _FULL = 16.0, 4095.0
_SATURATED_SHARE = 0.01
_CALIBRATION = 'stereo.calibration'
_MATRICES = {'CAMERA_MATRIX_LEFT': 9, 'DISTORTION_COEFFICIENTS_LEFT': 0, 'CAMERA_MATRIX_RIGHT': 9,
             'DISTORTION_COEFFICIENTS_RIGHT': 0, 'ROTATION_MATRIX': 9, 'TRANSLATION_VECTOR': 3}

Maps = tuple[Any, ...]     # of cv2.remap: columns and rows, left and right


class PolarScene(NamedTuple):
    """One position under one light: exposures [ms] → left image."""

    folder: Path
    exposures: dict[int, Path]


def polar_scenes(path: Path) -> list[PolarScene]:
    """Return the scenes below a folder: the set, a terrain, a position or a light."""
    found: dict[Path, dict[int, Path]] = {}
    depths = ('', '*/', '*/*/', '*/*/*/')      # a light, a position, a terrain, the set
    for left in sorted(left for depth in depths for left in path.glob(f'{depth}CamL_*.png')):
        exposure = re.search(r'_(\d+)\.png$', left.name)
        if exposure is None:
            raise EvaluationError(f'{left}: names no exposure; valid is CamL_*_EXPOSURE.png')
        found.setdefault(left.parent, {})[int(exposure[1])] = left
    return [PolarScene(folder, exposures) for folder, exposures in found.items()]


def _polar_pairs(scenes: list[PolarScene], most: int) -> Iterator[GreyPair]:
    """Yield one rectified pair for each of at most so many scenes.

    Of its exposures the longest is taken whose left image is hardly saturated, as an automatic
    exposure would.
    """
    for scene in spread(scenes, most):
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
