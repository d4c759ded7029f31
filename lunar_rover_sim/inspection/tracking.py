"""Whether a tracker can follow the recorded images: a frame rate that fits the walk."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim import frames, topics
from lunar_rover_sim.bag.messages import odometry_row
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario, RecordedScenario
from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.camera.prediction import prediction_miss, PredictionMiss
from lunar_rover_sim.camera.rig import StereoRig
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.frames import Array
from lunar_rover_sim.inspection.report import CheckReport, Status
from lunar_rover_sim.inspection.rover_data import RoverData
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.seconds import NS_PER_S

# On `baseline` 40 to 48 % of the frames are beyond at 10 Hz, where ORB-SLAM3 loses track, and at
# 20 Hz up to 2 % (6 to 7 % on rigid ground), where it tracked all of 400: after a single lost
# frame it relocalises by its bag of words.
MAX_LOST = 0.1
_RATES = 4      # the recorded one and its multiples by 2


def predictions(scenario: RecordedScenario, odom_ns: NDArray[np.int64], poses: Array,
                info: Any, frames_ns: NDArray[np.int64]) -> list[PredictionMiss]:
    """Return the miss at the recorded frame rate, then at 2, 4, 8 times that rate.

    odom_ns (n,) stamps and poses (n, 7) of the odometry: position and quaternion wxyz
    info, frames_ns: a CameraInfo of the left camera, and the stamps of its images

    Rates that are not on stamps of the odometry are left out. Empty if the recording does not
    describe its rover, or holds too little.
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


def of_bag(bag: Bag) -> list[PredictionMiss]:
    """Return `predictions` of a bag with one rover; empty where it lacks odometry or images."""
    if not (bag.has(bag.truth) and bag.has(topics.LEFT_INFO.name)):
        return []
    frames_ns = np.array([bag.stamp_ns(message) for message in bag.raw([topics.LEFT_INFO.name])],
                         np.int64)
    steps = np.diff(np.unique(frames_ns))
    if not len(steps):
        return []
    # Of the odometry only what the highest rate uses is decoded and held in memory.
    first_ns, finest_ns = int(frames_ns.min()), int(np.median(steps)) / 2**(_RATES - 1)
    odom_ns, poses = [], []
    for message in bag.raw([bag.truth]):
        stamp_ns = bag.stamp_ns(message)
        assert stamp_ns is not None     # nav_msgs/Odometry has a header
        if round(first_ns + round((stamp_ns - first_ns) / finest_ns) * finest_ns) == stamp_ns:
            odom_ns.append(stamp_ns)
            poses.append(odometry_row(bag.decode(message.data, message.msgtype))[:7])
    return predictions(recorded_scenario(bag), np.array(odom_ns, np.int64),
                       np.array(poses).reshape(-1, 7), bag.first(topics.LEFT_INFO.name), frames_ns)


def sentence(found: Sequence[PredictionMiss]) -> str:
    """Return one line on the recorded rate and, if it is too low, on one that is not."""
    first = found[0]
    line = f'at {first.rate_hz:.3g} Hz, constant velocity misses by {first}'
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
