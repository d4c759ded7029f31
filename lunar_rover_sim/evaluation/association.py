"""Association of estimated with true poses by their stamps; the truth is interpolated."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Slerp

from lunar_rover_sim.errors import EvaluationError
from lunar_rover_sim.evaluation.trajectory import Trajectory, wxyz

DEFAULT_TOLERANCE_S = 0.02
MIN_POSES = 3


@dataclasses.dataclass(frozen=True)
class Association:
    """Truth and estimate with equal stamps, pose by pose.

    unmatched: poses of the estimate for which there was no truth.
    """

    truth: Trajectory
    estimate: Trajectory
    unmatched: int


def associate(truth: Trajectory, estimate: Trajectory,
              tolerance_s: float = DEFAULT_TOLERANCE_S) -> Association:
    """Return the truth at the stamps of the estimate.

    Truth is taken as it is where a stamp agrees, else interpolated between its neighbours
    (position linearly, orientation on the shortest arc) if both are nearer than `tolerance_s`
    [s], else taken from a single neighbour nearer than that; otherwise the pose is left out.

    Raises EvaluationError where fewer than three poses are left.
    """
    if not tolerance_s >= 0.0:
        raise EvaluationError(f'tolerance: {tolerance_s} is not valid; valid is >= 0 [s]')
    tolerance_ns = round(tolerance_s * 1e9)
    _check_length(truth)
    _check_length(estimate)
    stamps = estimate.stamps_ns
    after = np.searchsorted(truth.stamps_ns, stamps, side='left')
    before = np.clip(after - 1, 0, len(truth) - 1)
    after = np.clip(after, 0, len(truth) - 1)
    gap_after = np.abs(truth.stamps_ns[after] - stamps)
    gap_before = np.abs(stamps - truth.stamps_ns[before])
    exact = gap_after == 0
    between = (~exact & (gap_after <= tolerance_ns) & (gap_before <= tolerance_ns)
               & (truth.stamps_ns[before] < stamps) & (stamps < truth.stamps_ns[after]))
    nearest = np.where(gap_before < gap_after, before, after)
    single = ~exact & ~between & (np.minimum(gap_before, gap_after) <= tolerance_ns)
    keep = exact | between | single
    if keep.sum() < MIN_POSES:
        raise EvaluationError(
            f'{estimate.name}: {int(keep.sum())} of {len(estimate)} poses lie within '
            f'{tolerance_s:g} s of {truth.name}; at least {MIN_POSES} are needed (estimate '
            f'{_span(estimate)}, truth {_span(truth)})')
    index = np.where(exact, after, nearest)
    positions = truth.positions_m[index]
    quats = truth.orientations_wxyz[index]
    if between.any():
        low, high = before[between], after[between]
        share = ((stamps[between] - truth.stamps_ns[low])
                 / (truth.stamps_ns[high] - truth.stamps_ns[low]))[:, None]
        positions[between] = ((1.0 - share) * truth.positions_m[low]
                              + share * truth.positions_m[high])
        start_ns = truth.stamps_ns[0]
        slerp = Slerp((truth.stamps_ns - start_ns).astype(float), truth.rotations)
        quats[between] = wxyz(slerp((stamps[between] - start_ns).astype(float)))
    matched = estimate.select(keep)
    return Association(Trajectory(matched.stamps_ns, positions[keep], quats[keep], truth.name),
                       matched, int((~keep).sum()))


def _check_length(trajectory: Trajectory) -> None:
    if len(trajectory) < MIN_POSES:
        raise EvaluationError(f'{trajectory.name}: holds {len(trajectory)} poses; at least '
                              f'{MIN_POSES} are needed')


def _span(trajectory: Trajectory) -> str:
    return (f'{trajectory.stamps_ns[0] * 1e-9:.3f} to '
            f'{trajectory.stamps_ns[-1] * 1e-9:.3f} s')
