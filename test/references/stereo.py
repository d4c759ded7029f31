"""Stereo: matching, refinement, depth, errors against truth."""

from __future__ import annotations

from typing import Any

import numpy as np
from references.cases import reference
from references.scenes import waves
from references.summary import Within

from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.camera.rig import StereoRig
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.stereo.config import SgmConfig
from lunar_rover_sim.stereo.depth import depth_from_disparity, disparity_from_depth, DisparityMap
from lunar_rover_sim.stereo.error import disparity_errors_px, stereo_errors, StereoErrors
from lunar_rover_sim.stereo.points import grey, points_from_depth
from lunar_rover_sim.stereo.refinement import refined
from lunar_rover_sim.stereo.sgm import SgmMatcher

_H, _W = 71, 133
# OpenCV interpolates between 32 places in a pixel; versions round to them differently.
REMAPPED = 1e-3


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return left and right image, uint8, and the true disparity of both: a slope and a block."""
    rows, columns = np.indices((_H, _W + 60))
    texture = np.random.default_rng(2).uniform(0.0, 1.0, (_H, _W + 60))
    texture = 0.35 * texture + 0.65 * waves((_H, _W + 60))
    left_truth = (3.3 + 0.16 * np.arange(_H))[:, None] + np.zeros((_H, _W))
    left_truth[30:52, 60:91] = 18.0
    left_truth[:9] = 0.0
    right_truth = (3.3 + 0.16 * np.arange(_H))[:, None] + np.zeros((_H, _W))
    right_truth[30:52, 42:73] = 18.0
    right_truth[:9] = 0.0

    def picture(shift: np.ndarray) -> np.ndarray:
        place = np.arange(_W)[None] + shift + 5.0
        low = np.floor(place).astype(int)
        part = place - low
        row = rows[:, :_W]
        return (1.0 - part) * texture[row, low] + part * texture[row, low + 1]

    left = picture(np.zeros((_H, _W)))
    right = picture(right_truth)
    for image in (left, right):
        image *= 220.0
        image[:9] = 4.0
    left[60:68, 100:120], right[60:68, 88:110] = 3.0, 3.0        # shadow
    left[12:22, 100:118], right[12:22, 95:113] = 255.0, 255.0    # saturated
    left[40:56, 10:26], right[40:56, 0:16] = 90.0, 90.0          # flat
    return (left.astype(np.uint8), right.astype(np.uint8), left_truth.astype(np.float32),
            right_truth.astype(np.float32))


_CONFIGS = {
    '3way': SgmConfig(num_disparities=32),
    'plain': SgmConfig(num_disparities=32, refinement=False),
    'sgbm': SgmConfig(mode='sgbm', num_disparities=16, min_disparity=3, block_size=5, p1=90,
                      p2=700, uniqueness_percent=15, dark_level=0, min_contrast=0.0),
    'hh': SgmConfig(mode='hh', num_disparities=32, block_size=3, min_disparity=-5,
                    speckle_window_px=0, left_right_max_px=-1, pre_filter_cap=10),
    'hh4': SgmConfig(mode='hh4', num_disparities=48, block_size=9, speckle_range_px=1,
                     min_contrast=9.0, dark_level=60)}


@reference
def matches() -> dict[str, Any]:
    """Disparities by each mode, of 8 bits, 16 bits and colour, and their errors."""
    left, right, truth, right_truth = scene()
    rig = StereoRig(RoverDescription(), CameraConfig(width=_W, height=_H))
    found: dict[str, Any] = {}
    for name, config in _CONFIGS.items():
        made = SgmMatcher(config, rig).match(left, right)
        errors = stereo_errors(made, truth, right_truth, left)
        found[name] = {
            'map': Within(made, REMAPPED), 'valid': made.valid, 'finite': made.has_finite_depth,
            'depth': Within(np.minimum(made.depth_m, 5.0), 10 * REMAPPED),
            'summary': Within(np.array(list(errors.summary().values())), REMAPPED)}
    wide = SgmMatcher(_CONFIGS['3way']).match(left.astype(np.uint16) * 257,
                                              right.astype(np.uint16) * 257)
    colours = np.stack([left, left // 2, 255 - left], axis=-1)
    found['deep'] = Within(wide.disparity_px, REMAPPED)
    found['colour'] = Within(SgmMatcher(_CONFIGS['3way']).match(
        colours, np.stack([right, right // 2, 255 - right], axis=-1)).disparity_px, REMAPPED)
    black = SgmMatcher(_CONFIGS['3way']).match(left // 40, right // 40)
    found['black'] = black.valid
    found['grey'] = [grey(colours), grey(left)]
    return found


@reference
def refinements() -> dict[str, Any]:
    """A rough disparity map that is refined, with gaps and an edge."""
    left, right, truth, _ = scene()
    rough = np.round(truth) + 0.4 * (np.indices((_H, _W)).sum(axis=0) % 3 - 1.0)
    valid = np.random.default_rng(1).random((_H, _W)) > 0.2
    made = refined(rough.astype(np.float32), valid, left, right)
    return {'refined': Within(made, REMAPPED), 'odd': Within(refined(
        rough[1:60, 4:90].astype(np.float32), valid[1:60, 4:90], left[1:60, 4:90],
        right[1:60, 4:90]), REMAPPED)}


@reference
def depths() -> dict[str, Any]:
    """Depth and disparity, points of clouds."""
    d = np.linspace(-2.0, 20.0, 12 * 13).reshape(12, 13).astype(np.float32)
    made = DisparityMap(d, 0.0, 15.0, 0.0625, (1, 2, 8, 7))
    depth = depth_from_disparity(made, 310.0, 0.11)
    K = np.array([[300.0, 0.0, 5.7], [0.0, 280.0, 6.1], [0.0, 0.0, 1.0]])
    return {'depth': depth, 'back': disparity_from_depth(depth, 310.0, 0.11),
            'sky': disparity_from_depth([0.1, 3.0, np.inf], 310.0, 0.11),
            'points': points_from_depth(depth, K), 'valid': made.valid,
            'finite': made.has_finite_depth}


@reference
def errors() -> dict[str, Any]:
    """Counts of pixels by what is wrong with them, one frame and two."""
    left, _, truth, right_truth = scene()
    rng = np.random.default_rng(3)
    disparity = truth + rng.normal(0.0, 0.9, truth.shape).astype(np.float32)
    disparity[rng.random(truth.shape) < 0.4] = -1.0
    found: dict[str, Any] = {}
    total = StereoErrors()
    for name, image, least, most, levels in (
            ('eight', left, 0.0, 31.0, {}),
            ('sixteen', left.astype(np.uint16) * 257, 4.0, 16.0, {}),
            ('colour', np.stack([left] * 3, axis=-1), 0.0, 20.0,
             {'shadow_level': 0.4, 'texture_level': 0.2, 'block_px': 5})):
        made = DisparityMap(disparity, least, most, 0.0625, (12, 4, 110, 60))
        other = right_truth if name != 'colour' else None
        one = stereo_errors(made, truth, other, image, **levels)
        total = total + one
        found[name] = {'counts': one, 'summary': one.summary(), 'signed': disparity_errors_px(
            made, truth, made.valid)}
    found['all'] = {'summary': total.summary(), 'counts': np.array(total.signed_counts)}
    found['none'] = StereoErrors().summary()
    return found
