"""How far a tracker of constant velocity mispredicts where it will see a point.

Feature-based trackers expect that the camera moves from frame to frame as it did before, and look
for each known point around the pixel that follows. ORB-SLAM3 (Campos et al., IEEE T-RO 2021)
searches within 7 px with two cameras and 15 px with one, at the finest level of its pyramid, and
once more within twice that. A wheeled rover glides and is predicted well. A walking one pitches
several times a second: the fewer frames, the farther off the prediction.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera.rig import StereoRig
from lunar_rover_sim.frames import Array, inverse

STEREO_SEARCH_PX = 7.0
LOST_PX = 2.0 * STEREO_SEARCH_PX
_COLUMNS, _ROWS = 12, 9         # of the points over the image
_FARTHEST_M = 30.0
_FRAMES = 1000                  # in memory at a time


@dataclasses.dataclass(frozen=True)
class PredictionMiss:
    """Predicted against true pixels over a drive, each frame by the median of its points.

    rate_hz: frames per second
    median_px, p90_px: median and 90th percentile over frames [px]
    lost: share of frames that miss by more than LOST_PX, the second search of a stereo tracker
    """

    rate_hz: float
    median_px: float
    p90_px: float
    lost: float

    def __str__(self) -> str:
        return (f'{self.median_px:.1f} px in the median, {self.p90_px:.1f} px at p90, '
                f'{100 * self.lost:.0f} % of the frames beyond {LOST_PX:g} px')


def prediction_miss(T_world_base: Array, rig: StereoRig, ground_below_base_m: float,
                    rate_hz: float) -> PredictionMiss | None:
    """Return how far a prediction by constant velocity misses; None with fewer than 3 frames.

    T_world_base: (n, 4, 4) poses of the rover at successive frames
    ground_below_base_m: height of base_link over the ground, which is taken as a plane
    """
    misses_px = _misses_px(np.asarray(T_world_base, float), rig, ground_below_base_m)
    if not len(misses_px):
        return None
    return PredictionMiss(rate_hz, float(np.median(misses_px)),
                          float(np.percentile(misses_px, 90)),
                          float(np.mean(misses_px > LOST_PX)))


def _misses_px(T_world_base: Array, rig: StereoRig, ground_below_base_m: float) -> Array:
    """Return the (n - 2,) medians over the points of a grid [px]."""
    pixels, points = _grid(rig, ground_below_base_m)
    # In pieces: the points of an hour at once would take gigabytes.
    return np.concatenate([np.empty(0), *(
        _medians_px(T_world_base[k:k + _FRAMES + 2], rig, pixels, points)
        for k in range(0, len(T_world_base) - 2, _FRAMES))])


def _medians_px(T_world_base: Array, rig: StereoRig, pixels: Array, points: Array) -> Array:
    """Return the (n - 2,) medians over (m, 2) pixels of (m, 3) points in the left camera [px]."""
    T_world_camera = T_world_base @ rig.T_base_left
    T_camera_world = np.array([inverse(T) for T in T_world_camera])
    # The motion before, applied once more: T_k' = (T_k-1 T_k-2^-1) T_k-1, world to camera.
    before = T_camera_world[1:-1]
    predicted = before @ T_world_camera[:-2] @ before
    # From the true camera to the predicted one.
    miss = predicted @ T_world_camera[2:]
    seen = np.einsum('kij,mj->kmi', miss[:, :3, :3], points) + miss[:, None, :3, 3]
    ahead = np.where(seen[..., 2:] > 0.0, seen[..., 2:], np.nan)
    offset = rig.focal_px * seen[..., :2] / ahead + rig.K[:2, 2] - pixels
    # A point that is predicted behind the camera is not found.
    distance = np.nan_to_num(np.linalg.norm(offset, axis=-1), nan=np.inf)
    return np.median(distance, axis=1)


def _grid(rig: StereoRig, ground_below_base_m: float) -> tuple[Array, Array]:
    """Return (m, 2) pixels over the ground and their (m, 3) points in the left camera."""
    u, v = (axis.ravel() for axis in np.meshgrid(
        (np.arange(_COLUMNS) + 0.5) * rig.width / _COLUMNS,
        (np.arange(_ROWS) + 0.5) * rig.height / _ROWS))
    rays = np.stack([(u - rig.K[0, 2]) / rig.focal_px, (v - rig.K[1, 2]) / rig.focal_px,
                     np.ones(u.shape)], axis=1)
    height_m = rig.T_base_left[2, 3] + ground_below_base_m
    falls: NDArray[np.float64] = -(rays @ rig.T_base_left[2, :3])      # per metre of depth
    ground = falls > height_m / _FARTHEST_M
    if not ground.any():        # the cameras look at the sky: what they see is far
        return np.stack([u, v], axis=1), rays * _FARTHEST_M
    return (np.stack([u, v], axis=1)[ground],
            rays[ground] * (height_m / falls[ground])[:, None])
