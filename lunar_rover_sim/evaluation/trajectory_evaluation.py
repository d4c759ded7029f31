"""An estimate judged against the truth: associate, align, measure."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from lunar_rover_sim.errors import EvaluationError
from lunar_rover_sim.evaluation import metrics
from lunar_rover_sim.evaluation.alignment import align, Alignment
from lunar_rover_sim.evaluation.association import associate, DEFAULT_TOLERANCE_S
from lunar_rover_sim.evaluation.metrics import Statistics
from lunar_rover_sim.evaluation.trajectory import Stamps, Trajectory
from lunar_rover_sim.frames import Array


@dataclasses.dataclass(frozen=True)
class EvaluationOptions:
    """How to judge.

    align: se3, sim3, yaw, origin or none; tolerance_s of the association [s];
    distance_m, time_s: how far the poses of a pair are apart in the relative errors.
    """

    align: str = 'se3'
    tolerance_s: float = DEFAULT_TOLERANCE_S
    distance_m: float = 1.0
    time_s: float = 1.0


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """What came out.

    truth, estimate: associated poses, the estimate aligned; alignment: what aligned it
    ate_m, ate_deg: absolute errors; rpe_distance_*, rpe_time_*: relative ones
    scale: factor that a Sim(3) alignment finds (truth = scale x estimate), NaN where the path
        does not determine it
    drift_percent: mean translation error of the pairs by distance, in % of their distance
    end_drift_percent: error of the last pose if the first ones agree, in % of the path
    length_m: of the true path where it was tracked
    tracked_share: share of the frames (of the images, if they are known) with a pose
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

    @property
    def errors_m(self) -> Array:
        """(n,) absolute position errors [m]."""
        return metrics.absolute_errors_m(self.truth, self.estimate)

    @property
    def turned_deg(self) -> float | None:
        """Angle [deg] by which all orientations are off alike, as of a wrong moving frame.

        None where it is below 5 degrees, or the errors differ by more than a fifth of it.
        """
        angle = self.ate_deg
        return angle.mean if angle.mean > 5.0 and angle.std < 0.2 * angle.mean else None

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values for JSON; NaN becomes None."""
        result: dict[str, Any] = {
            'truth': self.truth.name, 'estimate': self.estimate.name,
            **dataclasses.asdict(self.options), 'poses': len(self.estimate)}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Statistics):
                result[field.name] = {k: _plain(v) for k, v in dataclasses.asdict(value).items()}
            elif isinstance(value, (int, float)):
                result[field.name] = _plain(value)
        result['alignment'] = {'rotation': self.alignment.rotation.tolist(),
                               'translation_m': self.alignment.translation_m.tolist(),
                               'scale': self.alignment.scale}
        return result


def evaluate(truth: Trajectory, estimate: Trajectory,
             options: EvaluationOptions = EvaluationOptions(),
             frame_stamps_ns: Stamps | None = None) -> Evaluation:
    """Judge an estimate; both trajectories are of the same moving frame.

    frame_stamps_ns: stamps of the images the estimator was given; without them the share tracked
        is that of the truth's time, at the estimate's median rate.

    Raises EvaluationError where the two cannot be associated or aligned.
    """
    for name in ('distance_m', 'time_s'):
        if not getattr(options, name) > 0.0:
            raise EvaluationError(f'{name}: {getattr(options, name)} is not valid; valid is > 0')
    pair = associate(truth, estimate, options.tolerance_s)
    alignment = align(pair.estimate, pair.truth, options.align)
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
        end_drift_percent=_end_drift(pair.truth, aligned), length_m=pair.truth.length_m,
        tracked_share=_tracked(truth, pair.estimate, options.tolerance_s, frame_stamps_ns),
        unmatched=pair.unmatched)


def _scale(estimate: Trajectory, truth: Trajectory) -> float:
    try:
        return align(estimate, truth, 'sim3').scale
    except EvaluationError:
        return float('nan')


def _end_drift(truth: Trajectory, estimate: Trajectory) -> float:
    """Return how far the last pose is off in % of the path, once the first ones agree."""
    if not truth.length_m > 0.0:
        return float('nan')
    moved = align(estimate, truth, 'origin').apply(estimate)
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


def _plain(value: float) -> float | int | None:
    return value if np.isfinite(value) else None
