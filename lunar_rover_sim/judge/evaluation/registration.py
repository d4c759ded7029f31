"""Bringing an estimate onto the truth: association in time, alignment in space.

Poses are associated by their stamps; the truth is interpolated. Alignment is by least squares
over positions, `min sum |y_i - (s R x_i + t)|^2`, after Umeyama, Least-squares estimation of
transformation parameters between two point patterns, IEEE PAMI 13 (4), 1991, Eqs. (39)-(43).
`yaw` turns about z only: roll and pitch, which gravity makes observable, are kept.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Slerp

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.paths import counted
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import nearest
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory, wxyz

DEFAULT_TOLERANCE_S = 0.02
MOST_TOLERANCE_S = 1e3
MIN_POSES = 3
MODES = ('se3', 'sim3', 'yaw', 'origin', 'none')

# Spread of the points across their main direction, relative to that along it. Below it, double
# precision does not determine a rotation about the main direction.
_STRAIGHT = 1e-6


@dataclasses.dataclass(frozen=True)
class Association:
    """Truth and estimate with equal stamps, pose by pose.

    Attributes:
        unmatched: Poses of the estimate for which there was no truth.
    """

    truth: Trajectory
    estimate: Trajectory
    unmatched: int


def associate(truth: Trajectory, estimate: Trajectory,
              tolerance_s: float = DEFAULT_TOLERANCE_S) -> Association:
    """Return the truth at the stamps of the estimate.

    Truth is taken as it is where a stamp agrees, else interpolated between its neighbours
    (position linearly, orientation on the shortest arc) if both are nearer than `tolerance_s` [s],
    else taken from a single neighbour nearer than that; otherwise the pose is left out.

    Raises:
        EvaluationError: If fewer than three poses are left.
    """
    if not 0.0 <= tolerance_s <= MOST_TOLERANCE_S:
        raise EvaluationError(f'tolerance: {tolerance_s} is not valid; valid is 0 to '
                              f'{MOST_TOLERANCE_S:g} [s]')
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
        raise EvaluationError(f'{trajectory.name}: holds {counted(len(trajectory), "pose")}; at '
                              f'least {MIN_POSES} are needed')


def _span(trajectory: Trajectory) -> str:
    return (f'{trajectory.stamps_ns[0] * 1e-9:.3f} to '
            f'{trajectory.stamps_ns[-1] * 1e-9:.3f} s')


@dataclasses.dataclass(frozen=True)
class Alignment:
    """y = scale R x + t; rotation R (3, 3), translation t (3,) [m]."""

    rotation: Array
    translation_m: Array
    scale: float = 1.0

    def apply(self, trajectory: Trajectory) -> Trajectory:
        """Return the trajectory in the frame of the truth."""
        return trajectory.moved(self.rotation, self.translation_m, self.scale)


def align(estimate: Trajectory, truth: Trajectory, mode: str = 'se3') -> Alignment:
    """Return the transform that brings the estimate onto the truth; both have equal stamps.

    Args:
        mode: `se3` (rotation, translation), `sim3` (and scale), `yaw` (turn about z, translation),
            `origin` (first pose onto first pose), `none`.

    Raises:
        EvaluationError: If the positions do not determine the alignment: all on one straight line
            (se3, sim3), or without horizontal motion (yaw).
    """
    if mode not in MODES:
        raise EvaluationError(f'align: {mode!r} is not valid; {nearest(mode, MODES)}')
    if mode == 'none':
        return Alignment(np.eye(3), np.zeros(3))
    if mode == 'origin':
        rotation = (truth.rotations[0] * estimate.rotations[0].inv()).as_matrix()
        return Alignment(rotation, truth.positions_m[0] - rotation @ estimate.positions_m[0])
    x, y = estimate.positions_m, truth.positions_m
    try:
        return _yaw(x, y) if mode == 'yaw' else umeyama(x, y, with_scale=mode == 'sim3')
    except EvaluationError as error:
        raise EvaluationError(f'{estimate.name}: {error}') from None


def umeyama(x: Array, y: Array, with_scale: bool) -> Alignment:
    """Return the least-squares similarity (or rigid) transform of (n, 3) points x onto y.

    Raises:
        EvaluationError: If the points lie on a straight line, or on one spot.
    """
    mean_x, mean_y = x.mean(axis=0), y.mean(axis=0)
    dx, dy = x - mean_x, y - mean_y
    for points, whose in ((dx, 'the estimate'), (dy, 'the truth')):
        spread = np.linalg.svd(points, compute_uv=False)
        if not spread[0] > 0.0:
            raise EvaluationError(f'{whose} does not move; an alignment is not determined')
        if spread[1] <= _STRAIGHT * spread[0]:
            raise EvaluationError(f'{whose} moves on a straight line, about which a rotation is '
                                  'not determined; align by yaw or origin')
    u, d, vt = np.linalg.svd(dy.T @ dx / len(x))
    sign = np.ones(3)
    if np.linalg.det(u) * np.linalg.det(vt) < 0.0:
        sign[2] = -1.0
    rotation = u @ np.diag(sign) @ vt
    scale = float(d @ sign / np.mean(np.sum(dx * dx, axis=1))) if with_scale else 1.0
    return Alignment(rotation, mean_y - scale * rotation @ mean_x, scale)


def _yaw(x: Array, y: Array) -> Alignment:
    mean_x, mean_y = x.mean(axis=0), y.mean(axis=0)
    dx, dy = x - mean_x, y - mean_y
    along = float(np.sum(dx[:, 0] * dy[:, 0] + dx[:, 1] * dy[:, 1]))
    across = float(np.sum(dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0]))
    if not np.hypot(along, across) > 1e-12 * float(np.sum(dx * dx) + np.sum(dy * dy)):
        raise EvaluationError('it has no horizontal motion in common with the truth; a yaw is '
                              'not determined')
    angle = np.arctan2(across, along)
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Alignment(rotation, mean_y - rotation @ mean_x)
