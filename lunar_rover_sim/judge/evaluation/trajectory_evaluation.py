"""Evaluation of an estimated trajectory against the truth: associate, align, measure.

Whether an estimate is as good as it says, its covariances tell: the normalised estimation error
squared, e^T P^-1 e, of a consistent estimate has the mean of the degrees of freedom of e, and the
distribution chi^2 (Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, section 5.4). It is given per degree of freedom: 1 is right, 4 means errors twice
as large as told.

What the first pose tells as exact is no estimate but the choice of a frame: there the truth is
given the same frame, as open_vins does for position and yaw. All else is judged as it is told.
"""

from __future__ import annotations

import dataclasses
import html
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.results import plain
from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.base.seconds import EPOCH_NS
from lunar_rover_sim.judge.evaluation import metrics
from lunar_rover_sim.judge.evaluation.metrics import DistanceError, Statistics
from lunar_rover_sim.judge.evaluation.registration import align as align_trajectories
from lunar_rover_sim.judge.evaluation.registration import Alignment, associate, DEFAULT_TOLERANCE_S
from lunar_rover_sim.judge.evaluation.statistics import CONFIDENCE
from lunar_rover_sim.judge.evaluation.trajectory import Stamps, Trajectory
from lunar_rover_sim.judge.evaluation.trajectory_files import (bag_of, frame_on_rover,
                                                               image_stamps_ns, is_unstamped, load,
                                                               Source)

_JUMP_M, _JUMP_FACTOR = 0.1, 20.0       # a step whose error is beyond both; of the median step


@dataclasses.dataclass(frozen=True)
class EvaluationOptions:
    """How the trajectories were compared.

    Attributes:
        align: se3, sim3, yaw, origin or none.
        tolerance_s: Of the association [s].
        distance_m: Way between the poses of a pair in the relative errors [m].
        time_s: Time between the poses of a pair in the relative errors [s].
    """

    align: str = 'se3'
    tolerance_s: float = DEFAULT_TOLERANCE_S
    distance_m: float = 1.0
    time_s: float = 1.0


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Errors of an estimated trajectory.

    Attributes:
        truth: Associated true poses.
        estimate: Associated estimated poses, aligned.
        alignment: The transform that did it.
        ate_m: Absolute errors of the positions.
        ate_deg: Absolute errors of the orientations.
        rpe_distance_m: Relative errors of pairs a distance apart.
        rpe_distance_deg: Those of the orientations.
        rpe_time_m: Relative errors of pairs a time apart.
        rpe_time_deg: Those of the orientations.
        scale: Factor that a Sim(3) alignment finds (truth = scale x estimate), NaN where the path
            does not determine it.
        drift_percent: Mean translation error of the pairs by distance, in % of their distance.
        end_drift_percent: Error of the last pose if the first ones agree, in % of the tracked
            path.
        length_m: Distance driven along the whole truth, in the frame it is given in.
        tracked_share: Share of the frames (of the images, if they are known) with a pose.
        unmatched: Poses of the estimate without a true one.
        over_distance: Relative errors over 1, 2, 5, 10 m ..., as far as the path is long.
        consistency: Errors against the covariances of the estimate; None if it has none. No
            alignment touches it.
        fixes: Where an estimate finds its place that began without knowing it; None for others,
            and unless it is aligned by none.
    """

    truth: Trajectory
    estimate: Trajectory
    alignment: Alignment
    options: EvaluationOptions
    ate_m: Statistics
    ate_deg: Statistics
    rpe_distance_m: Statistics
    rpe_distance_deg: Statistics
    rpe_time_m: Statistics
    rpe_time_deg: Statistics
    scale: float
    drift_percent: float
    end_drift_percent: float
    length_m: float
    tracked_share: float
    unmatched: int
    over_distance: tuple[DistanceError, ...] = ()
    consistency: Consistency | None = None
    fixes: Fixes | None = None

    def __repr__(self) -> str:
        # A short drive has no drift: that is measured over stretches of it.
        drift = '' if math.isnan(self.drift_percent) else f'drift {self.drift_percent:.2f} %, '
        return (f'Evaluation(ATE {self.ate_m.rmse:.4f} m over {self.length_m:.2f} m, scale '
                f'{self.scale:.4f}, {drift}tracked {100 * self.tracked_share:.1f} %, aligned by '
                f'{self.options.align})')

    def _repr_html_(self) -> str:
        """Return the view from above of both paths, for a notebook."""
        # Here, because Matplotlib takes time to import.
        from lunar_rover_sim.judge.evaluation.trajectory_plots import top_view_svg
        return f'<div>{top_view_svg(self)}<pre>{html.escape(repr(self))}</pre></div>'

    @property
    def errors_m(self) -> Array:
        """(n,) absolute position errors [m]."""
        return metrics.absolute_errors_m(self.truth, self.estimate)

    @property
    def turned_deg(self) -> float | None:
        """Angle [deg] that all orientations are off by, as with a wrong moving frame.

        None where it is below 5 degrees, or the errors differ by more than a fifth of it.
        """
        angle = self.ate_deg
        return angle.mean if angle.mean > 5.0 and angle.std < 0.2 * angle.mean else None

    @property
    def jumps(self) -> list[tuple[float, float]]:
        """Stamps [s] and sizes [m] of the steps in which the estimate does not move as the rover.

        A SLAM program that moves its map, or starts another one, leaves such steps in what it
        published. A jump is more than 0.1 m, and more than 20 times the error of the median step.
        """
        sizes_m = np.linalg.norm(np.diff(self.estimate.positions_m - self.truth.positions_m,
                                         axis=0), axis=1)
        least_m = max(_JUMP_M, _JUMP_FACTOR * float(np.median(sizes_m)))
        return [(1e-9 * float(self.estimate.stamps_ns[k + 1]), float(sizes_m[k]))
                for k in np.flatnonzero(sizes_m > least_m)]

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values for JSON; NaN becomes None."""
        result: dict[str, Any] = {
            'truth': self.truth.name, 'estimate': self.estimate.name,
            **dataclasses.asdict(self.options), 'poses': len(self.estimate)}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, (Statistics, Consistency, Fixes)):
                result[field.name] = dataclasses.asdict(value)
            elif value is None or isinstance(value, (int, float)):
                result[field.name] = value
        result['over_distance'] = [dataclasses.asdict(error) for error in self.over_distance]
        result['alignment'] = {'rotation': self.alignment.rotation.tolist(),
                               'translation_m': self.alignment.translation_m.tolist(),
                               'scale': self.alignment.scale}
        return plain(result)


def evaluate(truth: Source, estimate: Source, *, align: str = 'se3', truth_frame: str = 'base',
             estimate_frame: str = 'base', tolerance_s: float = DEFAULT_TOLERANCE_S,
             distance_m: float = 1.0, time_s: float = 1.0, times: str | Path | None = None,
             frame_stamps_ns: Stamps | None = None) -> Evaluation:
    """Compare an estimated trajectory with the truth.

    Args:
        truth: A Trajectory, a file (TUM, EuRoC, KITTI), a bag (its odometry) or 'BAG:TOPIC'.
        estimate: Likewise.
        align: How the estimate is brought onto the truth: se3, sim3, yaw, origin or none.
        truth_frame: What of the rover the truth is of: base, imu, left or right (camera), lidar.
            Where it differs from `estimate_frame`, the mounts are those of the recorded rover if
            the truth is a bag, else of the packaged one.
        estimate_frame: What of the rover the estimate is of.
        tolerance_s: Largest distance in time between an estimated and a true pose [s].
        distance_m: Way between the poses of a pair in the relative errors [m].
        time_s: Time between the poses of a pair in the relative errors [s].
        times: File with the stamps of KITTI files, one a line. Without it, two KITTI files are
            compared pose by pose, at 10 Hz.
        frame_stamps_ns: Stamps of the images that the estimator was given, by default those of the
            images, or of their CameraInfo, in the bag of the truth; without any the share tracked
            is that of the truth's time, at the estimate's median rate.

    Raises:
        EvaluationError: If a source cannot be read.
        BagError: If a source cannot be read.
        EvaluationError: If the two cannot be associated or aligned, or an option is not valid.
        ConfigError: On an unknown frame.
    """
    options = EvaluationOptions(align, tolerance_s, distance_m, time_s)
    for name in ('distance_m', 'time_s'):
        if not 0.0 < getattr(options, name) < math.inf:
            raise EvaluationError(f'{name}: {getattr(options, name)} is not valid; valid is > 0 '
                                  'and finite')
    unstamped = [is_unstamped(source) for source in (truth, estimate)]
    if times is not None and not any(unstamped):
        raise EvaluationError(f'times: {times} is not used: neither {truth} nor {estimate} is a '
                              'KITTI file, and all others have stamps')
    if times is None and any(unstamped) and not all(unstamped):
        raise EvaluationError(f'{estimate if unstamped[1] else truth}: is a KITTI file, which has '
                              'no stamps; name a file with one stamp a line (--times)')
    true, estimated = load(truth, times), load(estimate, times)
    if times is None and all(unstamped) and len(true) != len(estimated):
        raise EvaluationError(f'{truth} has {len(true)} poses and {estimate} {len(estimated)}; '
                              'KITTI files have no stamps, so valid are as many in both, or a '
                              'file with one stamp a line (--times)')
    if bag_of(truth) is not None:
        estimated = _in_simulated_time(estimated, true)
    of_estimate = true
    if truth_frame != estimate_frame:
        of_estimate = true.of_frame(inverse(frame_on_rover(truth, truth_frame))
                                    @ frame_on_rover(truth, estimate_frame))
    if frame_stamps_ns is None:
        frame_stamps_ns = image_stamps_ns(truth)
    result = _compare(of_estimate, estimated, options, frame_stamps_ns)
    return dataclasses.replace(result, length_m=true.length_m)


def _in_simulated_time(estimate: Trajectory, truth: Trajectory) -> Trajectory:
    """Return the estimate of an exported sequence at the stamps of its bag.

    Exported sequences count time from a real date, a simulated bag from 0.
    """
    if (truth.stamps_ns >= EPOCH_NS).any() or (estimate.stamps_ns < EPOCH_NS).any():
        return estimate
    return dataclasses.replace(estimate, stamps_ns=estimate.stamps_ns - EPOCH_NS)


def _compare(truth: Trajectory, estimate: Trajectory, options: EvaluationOptions,
             frame_stamps_ns: Stamps | None) -> Evaluation:
    """Compare two trajectories of one moving frame."""
    pair = associate(truth, estimate, options.tolerance_s)
    alignment = align_trajectories(pair.estimate, pair.truth, options.align)
    aligned = alignment.apply(pair.estimate)
    by_distance = metrics.pairs_by_distance(pair.truth, options.distance_m)
    by_time = metrics.pairs_by_time(pair.truth, options.time_s)
    distance_m, distance_rad = metrics.relative_errors(pair.truth, aligned, by_distance)
    time_m, time_rad = metrics.relative_errors(pair.truth, aligned, by_time)
    along = pair.truth.distances_m
    drift = (100.0 * float(np.mean(distance_m / (along[by_distance[:, 1]]
                                                 - along[by_distance[:, 0]])))
             if len(by_distance) else float('nan'))
    return Evaluation(
        truth=pair.truth, estimate=aligned, alignment=alignment, options=options,
        ate_m=Statistics.of(metrics.absolute_errors_m(pair.truth, aligned)),
        ate_deg=Statistics.of(np.degrees(metrics.absolute_angles_rad(pair.truth, aligned))),
        rpe_distance_m=Statistics.of(distance_m),
        rpe_distance_deg=Statistics.of(np.degrees(distance_rad)),
        rpe_time_m=Statistics.of(time_m), rpe_time_deg=Statistics.of(np.degrees(time_rad)),
        scale=_scale(pair.estimate, pair.truth), drift_percent=drift,
        end_drift_percent=_end_drift(pair.truth, aligned), length_m=truth.length_m,
        tracked_share=_tracked(truth, pair.estimate, options.tolerance_s, frame_stamps_ns),
        unmatched=pair.unmatched,
        over_distance=metrics.errors_over_distance(pair.truth, aligned),
        consistency=consistency(pair.truth, pair.estimate),
        fixes=fixes(pair.truth, pair.estimate) if options.align == 'none' else None)


def _scale(estimate: Trajectory, truth: Trajectory) -> float:
    try:
        return align_trajectories(estimate, truth, 'sim3').scale
    except EvaluationError:
        return float('nan')


def _end_drift(truth: Trajectory, estimate: Trajectory) -> float:
    """Return the error of the last pose in % of the path, once the first poses agree."""
    if not truth.length_m > 0.0:
        return float('nan')
    moved = align_trajectories(estimate, truth, 'origin').apply(estimate)
    error = np.linalg.norm(moved.positions_m[-1] - truth.positions_m[-1])
    return 100.0 * float(error) / truth.length_m


def _tracked(truth: Trajectory, estimate: Trajectory, tolerance_s: float,
             frames_ns: Stamps | None) -> float:
    if frames_ns is not None and len(frames_ns):
        after = np.searchsorted(estimate.stamps_ns, frames_ns)
        low = np.clip(after - 1, 0, len(estimate) - 1)
        high = np.clip(after, 0, len(estimate) - 1)
        gap = np.minimum(np.abs(estimate.stamps_ns[low] - frames_ns),
                         np.abs(estimate.stamps_ns[high] - frames_ns))
        spacing = np.median(np.diff(frames_ns)) if len(frames_ns) > 1 else np.inf
        return float(np.mean(gap <= min(tolerance_s * 1e9, 0.5 * spacing)))
    period = np.median(np.diff(estimate.stamps_ns))
    frames = round((truth.stamps_ns[-1] - truth.stamps_ns[0]) / period) + 1
    return min(1.0, len(estimate) / frames)


NOTHING = 'nothing'             # of the frame is chosen by the first pose
FIX_M = 3.0                     # a position is known where its standard deviation is below this
_FALSE = 0.999                  # a fix is false beyond this quantile of chi^2
# Standard deviations of what is a choice of the frame. Where that is the frame of the base, the
# tilt moves a camera beside it by some millimetres.
_EXACT_M, _EXACT_RAD = 1e-2, 1e-4
_LEAST_VARIANCE = 1e-14         # of a covariance that can be inverted; rounding is below it


class Interval(NamedTuple):
    """Where a mean NEES per degree of freedom lies with the probability CONFIDENCE."""

    low: float
    high: float


def nees_interval(dof: int, drives: int = 1) -> Interval:
    """Return the interval of the mean NEES per degree of freedom of a consistent estimate.

    The errors within one drive hang together, so a whole drive counts as one draw.

    Args:
        dof: Degrees of freedom of an error, 3 for a position.
        drives: Independent drives over which the mean is taken.
    """
    n = dof * drives
    tail = 0.5 * (1.0 - CONFIDENCE)
    return Interval(float(chi2.ppf(tail, n) / n), float(chi2.ppf(1.0 - tail, n) / n))


@dataclasses.dataclass(frozen=True)
class Nees:
    """NEES of an error of three degrees of freedom over one drive.

    Attributes:
        per_dof: Mean over the poses, per degree of freedom; NaN where no covariance is regular.
        low: Lower end of its interval for a consistent estimate, see `nees_interval`.
        high: Upper end of it.
        share_inside: Share of the poses within the interval of a single one.
        poses: Number of poses.
    """

    per_dof: float
    low: float
    high: float
    share_inside: float
    poses: int

    @classmethod
    def of(cls, errors: Array, covariances: Array) -> Nees:
        """Return it of (n, 3) errors and their (n, 3, 3) covariances."""
        interval = nees_interval(3)
        regular = np.linalg.eigvalsh(covariances)[:, 0] > _LEAST_VARIANCE
        if not regular.any():
            return cls(float('nan'), *interval, float('nan'), 0)
        nees = _nees(errors[regular], covariances[regular]) / 3.0
        inside = (nees >= interval.low) & (nees <= interval.high)
        return cls(float(np.mean(nees)), *interval, float(np.mean(inside)), len(nees))


@dataclasses.dataclass(frozen=True)
class Consistency:
    """Errors of an estimate against the covariances that it tells.

    Attributes:
        frame: What the first pose tells as exact and the truth takes from it: `pose`, `position
            and yaw`, `position` or `nothing`.
        position, orientation: NEES of both.
    """

    frame: str
    position: Nees
    orientation: Nees


@dataclasses.dataclass(frozen=True)
class Fixes:
    """Where an estimate that begins without knowing its place finds it.

    A fix is a pose at which the largest horizontal standard deviation falls below FIX_M. It is
    false where the error is beyond the quantile 0.999 of chi^2.

    Attributes:
        first_s, first_m: Time and way to the first fix; NaN without one.
        count, false: Number of all fixes, and of the false ones.
        error_median_m, error_p95_m: Horizontal errors of all poses from the first fix on.
    """

    first_s: float
    first_m: float
    count: int
    false: int
    error_median_m: float = float('nan')
    error_p95_m: float = float('nan')


def consistency(truth: Trajectory, estimate: Trajectory) -> Consistency | None:
    """Return the consistency of an estimate; None if it has no covariances.

    Args:
        truth: At the stamps of the estimate.
        estimate: As it was told, not aligned.
    """
    if estimate.covariances is None:
        return None
    frame, true = _in_frame(truth, estimate)
    turns = (estimate.rotations * true.rotations.inv()).as_rotvec()
    # A pose that chooses the frame is no estimate, however small the deviations it tells.
    judged = slice(0 if frame == NOTHING else 1, None)
    errors, P = (estimate.positions_m - true.positions_m)[judged], estimate.covariances[judged]
    return Consistency(frame, Nees.of(errors, P[:, :3, :3]), Nees.of(turns[judged], P[:, 3:, 3:]))


def fixes(truth: Trajectory, estimate: Trajectory) -> Fixes | None:
    """Return the fixes of an estimate; None if it is not one that begins without its place.

    Args:
        truth: At the stamps of the estimate, in the frame of the map of the estimate.
        estimate: As it was told, not aligned.
    """
    if estimate.covariances is None:
        return None
    P = estimate.covariances[:, :2, :2]
    known = np.sqrt(np.linalg.eigvalsh(P)[:, -1]) < FIX_M
    if known[0]:
        return None
    found = np.flatnonzero(known[1:] & ~known[:-1]) + 1
    if not len(found):
        return Fixes(float('nan'), float('nan'), 0, 0)
    first = found[0]
    errors = (estimate.positions_m - truth.positions_m)[:, :2]
    false = _nees(errors[found], P[found] + _LEAST_VARIANCE * np.eye(2)) > chi2.ppf(_FALSE, 2)
    return Fixes(1e-9 * float(truth.stamps_ns[first] - truth.stamps_ns[0]),
                 float(truth.distances_m[first]), len(found), int(false.sum()),
                 *np.percentile(np.linalg.norm(errors[first:], axis=1), [50.0, 95.0]).tolist())


def _nees(errors: Array, covariances: Array) -> Array:
    solved = np.linalg.solve(covariances, errors[..., None])[..., 0]
    return np.asarray(np.sum(errors * solved, axis=1))


def _in_frame(truth: Trajectory, estimate: Trajectory) -> tuple[str, Trajectory]:
    """Return what the first pose of the estimate chooses, and the truth in that frame."""
    assert estimate.covariances is not None
    deviation = np.sqrt(np.maximum(np.diagonal(estimate.covariances[0]), 0.0))
    if not (deviation[:3] < _EXACT_M).all():
        return NOTHING, truth
    turn = estimate.rotations[0] * truth.rotations[0].inv()
    if (deviation[3:] < _EXACT_RAD).all():
        frame = 'pose'
    elif deviation[5] < _EXACT_RAD:
        # Of all turns about z, the one that leaves the least angle.
        x, y, z, w = turn.as_quat()
        turn = Rotation.from_rotvec([0.0, 0.0, 2.0 * np.arctan2(z, w)])
        frame = 'position and yaw'
    else:
        turn, frame = Rotation.identity(), 'position'
    R = turn.as_matrix()
    return frame, truth.moved(R, estimate.positions_m[0] - R @ truth.positions_m[0])
