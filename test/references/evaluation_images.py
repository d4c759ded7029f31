"""Evaluation: statistics of images, their layouts, comparisons of two sets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from references.cases import reference
from references.figures import drawn, instead_of_files
from references.scenes import waves
from references.stereo import scene
from references.summary import Within

from lunar_rover_sim.evaluation import bootstrap
from lunar_rover_sim.evaluation.grey_images import chosen, GreyPair, levels_of
from lunar_rover_sim.evaluation.image_comparison import compare_images, ImageComparison
from lunar_rover_sim.evaluation.image_layouts import open_images
from lunar_rover_sim.evaluation.image_plots import save_comparison
from lunar_rover_sim.evaluation.image_statistics import (ground_mask, image_statistics, MEASURES,
                                                         spectrum_slope)
from lunar_rover_sim.files.images import write_png

# Keypoints and matches are counted after floating-point arithmetic: a few may come or go.
COUNTED = 0.02
# OpenCV interpolates between 32 places in a pixel; versions round to them differently.
REMAPPED = 0.01


def _picture(seed: int, height: int = 77, width: int = 121) -> np.ndarray:
    """Return ground with shadows below a dark sky, 0 to 1."""
    image = waves((height, width), seed)
    image += 0.25 * np.random.default_rng(seed).uniform(-1.0, 1.0, image.shape)
    image[40:55, 30:60] *= 0.1
    image[:15] = 0.01
    return np.clip(image, 0.0, 1.0).astype(np.float32)


@reference
def statistics() -> dict[str, Any]:
    """Measures of single images and pairs, with and without truth and sky."""
    left, right, truth, _ = scene()
    scale = np.float32(1.0 / 255.0)
    sky = truth.copy()
    sky[20:25, 30:40] = np.nan
    found: dict[str, Any] = {}
    for name, pair, shown in (
            ('pair', GreyPair('a', left * scale, right * scale), False),
            ('truth', GreyPair('b', left * scale, right * scale, sky), True),
            ('unused', GreyPair('c', left * scale, right * scale, sky), False),
            ('single', GreyPair('d', _picture(1)), False),
            ('even', GreyPair('e', np.full((40, 50), 0.5, np.float32)), False),
            ('narrow', GreyPair('f', left[:, :16] * scale, right[:, :16] * scale), False)):
        made = image_statistics(pair, shown)
        values = zip(MEASURES, made.values.tolist())
        found[name] = {'values': Within(dict(values), COUNTED), 'histogram': made.log_gradients,
                       'gradient': float(made.values[0]), 'slope': float(made.values[1]),
                       'shadow': float(made.values[2])}
    for seed, shape in ((2, (77, 121)), (3, (90, 40)), (4, (33, 64))):
        image = _picture(seed, *shape)
        ground = ground_mask(image)
        found[f'ground {seed}'] = ground
        found[f'slope {seed}'] = [spectrum_slope(image, ground), spectrum_slope(image, ~ground),
                                  spectrum_slope(image[:31], ground[:31])]
    wide = GreyPair('w', left * scale, right * scale, sky)
    found['narrowed'] = [wide.narrowed(64), wide.narrowed(500)]
    return found


@reference
def greys() -> dict[str, Any]:
    """Levels of pixels of each kind, and choices of items."""
    eight = (255.0 * waves((9, 14))).astype(np.uint8)
    colour = np.stack([eight, eight // 2, eight // 3, eight * 0 + 255], axis=-1)
    deep = eight.astype(np.uint16) * 16 + 5
    return {'levels': [levels_of(pixels, linear, black, full) for pixels in (eight, colour, deep)
                       for linear, black, full in ((False, 0.0, 0.0), (True, 9.0, 2000.0))],
            'chosen': [str(chosen(list(range(n)), most)) for n, most in ((10, 3), (7, 7), (5, 9),
                                                                         (1, 4), (101, 5))]}


@reference
def resamples() -> dict[str, Any]:
    """Intervals and p values of series."""
    rng = np.random.default_rng(6)
    series = np.cumsum(rng.normal(size=50)) * 0.1 + 3.0
    lengths = [bootstrap.block_length(n) for n in (1, 2, 5, 27, 40, 900)]
    found: dict[str, Any] = {'lengths': lengths,
                             'places': bootstrap.resampled(11, np.random.default_rng(1))}
    values = {'series': series, 'gaps': np.where(np.arange(50) % 4, series, np.nan),
              'three': series[:3], 'two': series[:2], 'none': series[:0]}
    for name, one in values.items():
        mean, resamples_ = bootstrap.estimate(one, np.random.default_rng(2))
        found[name] = {'mean': mean, 'resamples': resamples_,
                       'difference': bootstrap.difference(0.1, resamples_ - 2.95)}
    first = rng.random((12, 20))
    for name, second in (('same', rng.random((9, 20))), ('other', rng.random((9, 20)) ** 2)):
        found[name] = list(bootstrap.permutation_p(first, second, np.random.default_rng(3), 150))
    return found


def _write(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, image)


def _set(folder: Path, seed: int, count: int, truth: bool) -> Path:
    left, right, disparity, _ = scene()
    for k in range(count):
        noise = np.random.default_rng(seed + k).integers(0, 9 + seed, left.shape)
        for side, image in (('left', left), ('right', right)):
            _write(folder / f'image_{side}' / f'{k:03d}_{side}.png',
                   np.clip(image * (1.0 + 0.03 * k) + noise, 0, 255).astype(np.uint8))
        if truth:
            (folder / 'depth_left').mkdir(exist_ok=True)
            with np.errstate(divide='ignore'):
                np.save(folder / 'depth_left' / f'{k:03d}_left_depth.npy',
                        np.minimum(34.0 / disparity, np.float32(2e4)))
    if truth:
        (folder / 'calibration.yaml').write_text(
            'left:\n  fx_fy_cx_cy_px: [340.0, 340.0, 66.0, 35.0]\nbaseline_m: 0.1\n')
    return folder


def _compared(folder: Path) -> ImageComparison:
    return compare_images(_set(folder / 'sets' / 'a', 1, 5, True),
                          _set(folder / 'sets' / 'b', 4, 4, False),
                          width_px=96, seed=3)


@reference
def comparisons(folder: Path) -> dict[str, Any]:
    """Two sets against each other, as numbers and as a picture."""
    result = _compared(folder)
    made = result.to_mapping()
    found: dict[str, Any] = {'a': made['a']['images'], 'keys': sorted(made)}
    for k, row in enumerate(result.rows):
        numbers = np.array([*row.first[:3], *row.second[:3], *row.difference])
        found[row.name] = {'count': [row.first.n, row.second.n],
                           'meaning': made['measures'][row.name]['meaning'],
                           'numbers': numbers if k < 3 else Within(numbers, COUNTED)}
    with instead_of_files() as figures:
        save_comparison(result, folder / 'c.png')
    for k in range(3):
        _write(folder / 'sets' / 'sky' / f'{k}.png', np.full((71, 133), 7, np.uint8))
    sky = compare_images(folder / 'sets' / 'a', folder / 'sets' / 'sky', frames=3)
    few = compare_images(folder / 'sets' / 'a', folder / 'sets' / 'b', frames=2)
    picture = drawn(figures[0])
    for axes in picture.values():
        if isinstance(axes, dict):      # without p, which has three digits of a count
            axes['title'] = axes['title'].partition('\np')[0]
    return {**found, 'distance': [result.distance.value, result.chance], 'width': few.width_px,
            'sky': [sky.distance.value, sky.chance, float(sky.rows[0].second.n)],
            'few': [few.distance.value, few.distance.low],
            'picture': Within(picture, COUNTED)}


@reference
def layouts(folder: Path) -> dict[str, Any]:
    """Sets as data sets lay them out: names, order, sides, truth, exposures."""
    found: dict[str, Any] = {}
    kinds = {'EuRoC': ('mav0/cam0/data/{}.png', 'mav0/cam1/data/{}.png'),
             'KITTI': ('image_0/{}.png', 'image_1/{}.png'), 'TUM': ('rgb/{}.png', ''),
             'LuSNAR': ('image1/RGB/{}.png', 'image2/RGB/{}.png'),
             'many': ('M1/image1/RGB/{}.png', 'M1/image2/RGB/{}.png'),
             'sides': ('left/{}.png', 'right/{}.png'), 'named': ('{}_left.png', '{}_right.png'),
             'single': ('{}.png', ''), 'bare': ('left.png', 'right.png'),
             'odd': ('zleft_x{}.png', '')}
    for kind, (left, right) in kinds.items():
        for k in range(3):
            image = (255.0 * waves((8, 11), k)).astype(np.uint8)
            _write(folder / kind / left.format(9 - k), image)
            if right:
                _write(folder / kind / right.format(9 - k), image[::-1].copy())
        images = open_images(folder / kind)
        found[kind] = {'layout': f'{images.layout} {images.total}', 'pairs': list(images.read(2))}
    depth = open_images(_set(folder / 'depth', 2, 2, True))
    found['depth'] = {'layout': depth.layout, 'pairs': list(depth.read(1))}
    for light in ('Sun_30', 'NoSun'):
        place = folder / 'polar' / 'Terrain1' / 'PosA' / light
        for exposure, level in ((32, 300.0), (64, 1500.0), (128, 5200.0)):
            for side in 'LR':
                image = 16.0 + level * waves((24, 32), ord(side))
                _write(place / f'Cam{side}_PosA_{exposure:04d}.png',
                       np.minimum(image, 4095.0).astype(np.uint16))
    found['raw'] = [pair.left for pair in open_images(folder / 'polar').read(5)]
    (folder / 'polar' / 'Terrain1' / 'stereo.calibration').write_text(
        'CAMERA_MATRIX_LEFT: 40 0 15 0 41 12 0 0 1\n'
        'DISTORTION_COEFFICIENTS_LEFT: -0.1 0.01 0 0 0\n'
        'CAMERA_MATRIX_RIGHT: 39 0 16 0 40 11 0 0 1\n'
        'DISTORTION_COEFFICIENTS_RIGHT: -0.05 0 0 0 0\n'
        'ROTATION_MATRIX: 1 0 0 0 1 0 0 0 1\nTRANSLATION_VECTOR: -0.3 0.01 0\n')
    rectified = list(open_images(folder / 'polar').read(1))[0]
    found['rectified'] = Within([rectified.left, rectified.right], REMAPPED)
    return found
