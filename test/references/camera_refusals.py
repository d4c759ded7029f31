"""Cameras and stereo: what is refused at which bound."""

from __future__ import annotations

from typing import Any

import numpy as np
from references.cases import reference
from references.words import said

from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.camera.hazard_config import HazardCameraConfig
from lunar_rover_sim.stereo.config import SgmConfig
from lunar_rover_sim.stereo.sgm import SgmMatcher


@reference
def refused_cameras() -> dict[str, Any]:
    """Lenses that cannot be inverted, models and fields of view that do not go together."""
    lenses = [(k1, 0.0, p1, 0.0, 0.0) for k1 in (-0.4, -0.3, -0.25, -0.2, 0.0)
              for p1 in (0.0, 0.3)]
    hazards: list[dict[str, Any]] = [
        {}, {'near_m': 10.0, 'far_m': 10.0}, {'near_m': 9.9, 'far_m': 10.0},
        {'distortion': (0.1, 0.0, 0.0, 0.0, 0.0)},
        {'model': 'pinhole', 'horizontal_fov_deg': 150.0},
        {'model': 'pinhole', 'horizontal_fov_deg': 150.1}, {'model': 'pinhole'},
        {'model': 'pinhole', 'horizontal_fov_deg': 90.0,
         'fisheye_distortion': (0.1, 0.0, 0.0, 0.0)},
        {'model': 'pinhole', 'horizontal_fov_deg': 90.0, 'distortion': (-0.5, 0.0, 0.0, 0.0, 0.0)},
        {'fisheye_distortion': (-0.12, 0.0, 0.0, 0.0)}, {'fisheye_distortion': (-0.13, 0, 0, 0)},
        {'fisheye_distortion': (-0.13, 0, 0, 0), 'image_circle_deg': 170.0,
         'horizontal_fov_deg': 150.0}]
    return {'lenses': [said(CameraConfig, distortion=lens) for lens in lenses],
            'hazards': [said(HazardCameraConfig, **values) for values in hazards]}


@reference
def refused_matches() -> dict[str, Any]:
    """Parameters that OpenCV refuses, and images that are too narrow."""
    tried: list[dict[str, Any]] = [
        {'num_disparities': 24}, {'num_disparities': 48}, {'block_size': 4}, {'p1': 9, 'p2': 9},
        {'p1': 9, 'p2': 10}, {'p1': 9}]
    image = np.zeros((20, 64), np.uint8)
    return {'said': [said(SgmConfig, **values) for values in tried],
            'images': [said(SgmMatcher(SgmConfig(
                num_disparities=count, min_disparity=least)).match, image, other)
                for count, least, other in (
                    (48, 0, image), (64, 0, image), (48, 15, image), (48, 16, image),
                    (48, 0, image[:-1]))]}
