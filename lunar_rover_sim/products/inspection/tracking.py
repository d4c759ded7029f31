"""Prediction of tracking on recorded images: a frame rate that fits the walk.

Feature-based trackers expect that the camera moves from frame to frame as it did before, and look
for each known point around the pixel that follows. ORB-SLAM3 (Campos et al., IEEE T-RO 2021)
searches within 7 px with two cameras and 15 px with one, at the finest level of its pyramid, and
once more within twice that. A wheeled rover glides and is predicted well. A walking one pitches
several times a second: the fewer frames, the farther off the prediction.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.messages import header_ns, odometry_row
from lunar_rover_sim.bag.reader import Bag, RawMessage
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario, RecordedScenario
from lunar_rover_sim.bag.series import Rows
from lunar_rover_sim.bag.totals import driven_distance_m
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.products.inspection.bag_scan import RoverData
from lunar_rover_sim.products.inspection.report import CheckReport, Status
from lunar_rover_sim.rover.description import RoverDescription

STEREO_SEARCH_PX = 7.0
LOST_PX = 2.0 * STEREO_SEARCH_PX
_COLUMNS, _ROWS = 12, 9         # of the points over the image
_FARTHEST_M = 30.0
_FRAMES = 1000                  # in memory at a time


@dataclasses.dataclass(frozen=True)
class PredictionMiss:
    """Predicted against true pixels over a drive, each frame by the median of its points.

    Attributes:
        rate_hz: Frames per second.
        median_px, p90_px: Median and 90th percentile over frames [px].
        lost: Share of frames that miss by more than LOST_PX, the second search of a stereo
            tracker.
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

    Args:
        T_world_base: (n, 4, 4) poses of the rover at successive frames.
        ground_below_base_m: Height of base_link over the ground, which is taken as a plane.
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


# On `baseline` 40 to 48 % of the frames are beyond at 10 Hz, where ORB-SLAM3 loses track, and at
# 20 Hz up to 2 % (6 to 7 % on rigid ground), where it tracked all of 400: after a single lost
# frame it relocalises by its bag of words.
MAX_LOST = 0.1
_RATES = 4      # the recorded one and its multiples by 2


def predictions(scenario: RecordedScenario, odom_ns: NDArray[np.int64], poses: Array,
                info: Any, frames_ns: NDArray[np.int64]) -> list[PredictionMiss]:
    """Return the miss at the recorded frame rate, then at 2, 4, 8 times that rate.

    Rates that are not on stamps of the odometry are left out. Empty if the recording does not
    describe its rover, or holds too little.

    Args:
        scenario: That of the recording.
        odom_ns: (n,) stamps of the odometry.
        poses: (n, 7) of it: position and quaternion wxyz.
        info, frames_ns: A CameraInfo of the left camera, and the stamps of its images.
    """
    steps = np.diff(np.unique(frames_ns))
    if 'rover' not in scenario.sections or not len(steps) or not info.p[0] > 0.0:
        return []
    fov_deg = np.degrees(2.0 * np.arctan(0.5 * info.width / info.p[0]))
    try:
        rover = RoverDescription.from_mapping(dict(scenario.sections['rover']), 'rover')
        camera = CameraConfig(info.width, info.height, float(fov_deg))
    except ConfigError:     # of another version
        return []
    rig = StereoRig(rover, camera)
    period_ns = int(np.median(steps))
    found = []
    for factor in (2**k for k in range(_RATES)):
        stamps = np.arange(frames_ns.min(), odom_ns.max(initial=0) + 1, period_ns / factor)
        _, at, _ = np.intersect1d(odom_ns, np.rint(stamps).astype(np.int64),
                                  return_indices=True)
        if len(at) < 0.9 * len(stamps):
            break
        if not np.isfinite(poses[at]).all():
            break
        T = np.array([frames.se3(frames.matrix_from_wxyz(pose[3:7]), pose[:3])
                      for pose in poses[at]]).reshape(-1, 4, 4)
        miss = prediction_miss(T, rig, rover.standing_height_m, factor * NS_PER_S / period_ns)
        if miss is None:
            break
        found.append(miss)
    return found


class Drive:
    """The true way of the one rover of a bag, and its frames, from the messages one by one."""

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._truth, self._camera = (bag.resolve(name) if bag.has(name) else ''
                                     for name in (bag.truth, topics.LEFT_INFO.name))
        self._poses, self._frames_ns = Rows(), array('q')
        self._info: Any = None

    @property
    def topics(self) -> tuple[str, ...]:
        """Those whose messages it takes."""
        return tuple(filter(None, (self._truth, self._camera)))

    def add(self, message: RawMessage, decoded: Any) -> None:
        """Take a message, and the same decoded; of other topics they are left out."""
        if message.topic == self._truth and message.msgtype == topics.ODOM.type:
            self._poses.add(header_ns(decoded), odometry_row(decoded)[:7])
        elif message.topic == self._camera and message.msgtype == topics.LEFT_INFO.type:
            self._frames_ns.append(header_ns(decoded))
            self._info = self._info or decoded

    def distance_m(self) -> float:
        """Return the distance driven [m]; 0 without odometry."""
        return driven_distance_m(*self._poses.arrays())

    def predictions(self) -> list[PredictionMiss]:
        """Return `predictions` of the drive; empty where odometry or images are missing."""
        if self._info is None or not len(self._poses):
            return []
        return predictions(recorded_scenario(self._bag), *self._poses.arrays(), self._info,
                           np.array(self._frames_ns, np.int64))


def sentence(found: Sequence[PredictionMiss]) -> str:
    """Return one line on the recorded rate and, if it is too low, on one that is not."""
    first = found[0]
    line = f'at {first.rate_hz:.3g} Hz a tracker that expects constant velocity misses by {first}'
    if first.lost > MAX_LOST:
        better = next((miss for miss in found[1:] if miss.lost <= MAX_LOST), found[-1])
        if better is not first:
            line += f'; at {better.rate_hz:.3g} Hz by {better}'
    return line


def tracking(rover: RoverData, report: CheckReport) -> None:
    """The frame rate fits the motion: trackers find points where they expect them."""
    info = rover.scan.topics.get(topics.LEFT_INFO.name)
    odom_ns, odom = rover.scan.signal(rover.scan.truth)
    found = []
    if info is not None and info.last is not None and not info.problems and len(odom_ns):
        found = predictions(rover.scenario, odom_ns, odom[:, :7], info.last,
                            np.array(info.stamps_ns, np.int64))
    if not found:
        report.add('tracking', Status.SKIP,
                   'odometry, CameraInfo and the rover are not all in the bag')
        return
    report.add('tracking', Status.WARN if found[0].lost > MAX_LOST else Status.PASS,
               sentence(found))
