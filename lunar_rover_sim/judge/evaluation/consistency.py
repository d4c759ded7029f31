"""Whether an estimate is as good as it says: its errors against its covariances.

The normalised estimation error squared, e^T P^-1 e, of a consistent estimate has the mean of the
degrees of freedom of e, and the distribution chi^2 (Bar-Shalom, Li, Kirubarajan, Estimation with
Applications to Tracking and Navigation, 2001, section 5.4). It is given per degree of freedom: 1
is right, 4 means errors twice as large as told.

What the first pose tells as exact is no estimate but the choice of a frame: there the truth is
given the same frame, as open_vins does for position and yaw. All else is judged as it is told.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory

CONFIDENCE = 0.95
NOTHING = 'nothing'             # of the frame is chosen by the first pose
FIX_M = 3.0                     # a position is known where its standard deviation is below this
_FALSE = 0.999                  # a fix is false beyond this quantile of chi^2
_EXACT_M, _EXACT_RAD = 1e-3, 1e-4       # standard deviations of what is a choice of the frame
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
        low, high: Interval of it for a consistent estimate, see `nees_interval`.
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
