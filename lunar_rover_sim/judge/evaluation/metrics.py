"""Errors of an estimated trajectory: absolute (ATE) and relative (RPE).

Absolute: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012, Eq. (2);
relative: the same, Eq. (1), over pairs that are a distance or a time apart; drift: Geiger et al.,
Are we ready for autonomous driving?, CVPR 2012.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory

PAIR_TOLERANCE = 0.1  # of the distance between the poses of a pair
DISTANCES_M = 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0


@dataclasses.dataclass(frozen=True)
class Statistics:
    """Statistics of a list of errors, in their unit; `count` is their number."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    count: int

    @classmethod
    def of(cls, errors: Array) -> Statistics:
        """Return the statistics of (n,) errors; NaN where there are none."""
        if not len(errors):
            nan = float('nan')
            return cls(nan, nan, nan, nan, nan, nan, 0)
        return cls(float(np.sqrt(np.mean(errors**2))), float(np.mean(errors)),
                   float(np.median(errors)), float(np.std(errors)), float(np.min(errors)),
                   float(np.max(errors)), len(errors))


def absolute_errors_m(truth: Trajectory, estimate: Trajectory) -> Array:
    """Return (n,) distances [m] between positions of equal stamps; the estimate is aligned."""
    return np.linalg.norm(truth.positions_m - estimate.positions_m, axis=1)


def absolute_angles_rad(truth: Trajectory, estimate: Trajectory) -> Array:
    """Return (n,) angles [rad] between orientations of equal stamps; the estimate is aligned."""
    return (truth.rotations.inv() * estimate.rotations).magnitude()


def pairs_by_distance(truth: Trajectory, distance_m: float) -> NDArray[np.int64]:
    """Return (k, 2) indices (i, j) of poses whose path along the truth is `distance_m` apart.

    For every i the j whose distance is nearest; pairs that are off by more than `PAIR_TOLERANCE`
    times the distance are left out.
    """
    return _pairs(truth.distances_m, distance_m, PAIR_TOLERANCE * distance_m)


def pairs_by_time(truth: Trajectory, time_s: float) -> NDArray[np.int64]:
    """Return (k, 2) indices of poses that are `time_s` apart, to half their median spacing."""
    since_start_s = (truth.stamps_ns - truth.stamps_ns[0]) * 1e-9
    return _pairs(since_start_s, time_s, 0.5 * float(np.median(np.diff(since_start_s))))


def relative_errors(truth: Trajectory, estimate: Trajectory,
                    pairs: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return (k,) translation errors [m] and rotation errors [rad] of the motion in each pair."""
    i, j = pairs[:, 0], pairs[:, 1]
    if not len(pairs):
        return np.zeros(0), np.zeros(0)
    motions = []
    for trajectory in (truth, estimate):
        back = trajectory.rotations[i].inv()
        motions.append((back * trajectory.rotations[j],
                        back.apply(trajectory.positions_m[j] - trajectory.positions_m[i])))
    (turn, shift), (turn_estimate, shift_estimate) = motions
    # E = (true motion)^-1 (estimated motion); the norm of its translation is free of rotation.
    return (np.linalg.norm(shift_estimate - shift, axis=1),
            (turn.inv() * turn_estimate).magnitude())


@dataclasses.dataclass(frozen=True)
class DistanceError:
    """Mean relative errors of the pairs of poses that are a distance apart.

    Attributes:
        distance_m: Along the truth.
        error_m, error_percent, error_deg: Of the translation, also in percent of the distance,
            and of the rotation.
        pairs: Number of pairs.
    """

    distance_m: float
    error_m: float
    error_percent: float
    error_deg: float
    pairs: int


def errors_over_distance(truth: Trajectory, estimate: Trajectory) -> tuple[DistanceError, ...]:
    """Return the errors over 1, 2, 5, 10 m ... as far as the path is long."""
    found = []
    for distance_m in DISTANCES_M:
        pairs = pairs_by_distance(truth, distance_m)
        if not len(pairs):
            continue
        errors_m, errors_rad = relative_errors(truth, estimate, pairs)
        apart_m = truth.distances_m[pairs[:, 1]] - truth.distances_m[pairs[:, 0]]
        found.append(DistanceError(
            distance_m, float(np.mean(errors_m)), 100.0 * float(np.mean(errors_m / apart_m)),
            float(np.degrees(np.mean(errors_rad))), len(pairs)))
    return tuple(found)


def _pairs(progress: Array, delta: float, slack: float) -> NDArray[np.int64]:
    n = len(progress)
    start = np.arange(n)
    goal = progress + delta
    after = np.searchsorted(progress, goal, side='left')
    low, high = np.clip(after - 1, 0, n - 1), np.clip(after, 0, n - 1)
    # The earlier of two equally near ones, never the pose itself.
    end = np.where(np.abs(progress[low] - goal) <= np.abs(progress[high] - goal), low, high)
    end = np.where(end == start, np.minimum(start + 1, n - 1), end)
    keep = (end > start) & (np.abs(progress[end] - goal) <= slack)
    return np.stack([start[keep], end[keep]], axis=1).astype(np.int64)
