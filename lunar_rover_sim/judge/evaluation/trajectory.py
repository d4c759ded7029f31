"""A trajectory: stamped poses of one moving frame in one fixed frame."""

from __future__ import annotations

from collections.abc import Iterable
import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from lunar_rover_sim.bag.totals import driven_distance_m
from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.frames import Array, distance_along
from lunar_rover_sim.rover.physics.state import RoverState

Stamps = NDArray[np.int64]
_UNIT_TOLERANCE = 0.02      # of a quaternion's length: two decimals in a file leave 1 %
_ASYMMETRY = 1e-6           # of a covariance, relative to its largest number


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """Poses T_fixed_moving over time; arrays are read-only copies.

    Attributes:
        stamps_ns: (n,) int64, strictly increasing.
        positions_m: (n, 3).
        orientations_wxyz: (n, 4), normalised on construction.
        name: How errors and plots name it, for instance a file.
        covariances: (n, 6, 6) of x, y, z [m] and of the turn about the fixed axes X, Y, Z [rad],
            as geometry_msgs/PoseWithCovariance has them; None where nobody tells them.

    Raises:
        EvaluationError: If shapes differ, stamps are not whole numbers or do not increase, a
            number is not finite, or a covariance is none.
    """

    stamps_ns: Stamps
    positions_m: Array
    orientations_wxyz: Array
    name: str = 'trajectory'
    covariances: Array | None = None

    @classmethod
    def of_states(cls, states: Iterable[RoverState]) -> Trajectory:
        """Return the poses of base_link in the states of a `Simulation`: the truth."""
        known = list(states)
        return cls(np.array([state.stamp_ns for state in known], np.int64),
                   np.array([state.position_m for state in known]).reshape(-1, 3),
                   np.array([state.orientation_wxyz for state in known]).reshape(-1, 4), 'truth')

    def __repr__(self) -> str:
        span_s = 1e-9 * (self.stamps_ns[-1] - self.stamps_ns[0]) if len(self.stamps_ns) else 0.0
        return (f'Trajectory({self.name!r}, {len(self.stamps_ns)} poses, {span_s:.1f} s, '
                f'{self.length_m:.2f} m)')

    def __post_init__(self) -> None:
        stamps = np.array(self.stamps_ns).reshape(-1)
        if len(stamps) and stamps.dtype.kind not in 'iu':
            raise EvaluationError(f'{self.name}: stamps_ns: {stamps.dtype} is not valid; valid '
                                  'are whole nanoseconds')
        stamps = stamps.astype(np.int64)
        n = len(stamps)
        positions = np.array(self.positions_m, dtype=float)
        quats = np.array(self.orientations_wxyz, dtype=float)
        if positions.shape != (n, 3) or quats.shape != (n, 4):
            raise EvaluationError(f'{self.name}: {n} stamps, positions {positions.shape} and '
                                  f'orientations {quats.shape}; valid is (n,), (n, 3) and (n, 4)')
        bad = ~(np.isfinite(positions).all(axis=1) & np.isfinite(quats).all(axis=1))
        if bad.any():
            raise EvaluationError(f'{self.name}: pose {int(np.argmax(bad))} is not finite '
                                  f'({int(bad.sum())} such poses)')
        if n > 1 and (np.diff(stamps) <= 0).any():
            k = int(np.argmax(np.diff(stamps) <= 0)) + 1
            raise EvaluationError(f'{self.name}: stamps do not increase: pose {k} at '
                                  f'{stamps[k]} ns follows {stamps[k - 1]} ns')
        norms = np.linalg.norm(quats, axis=1)
        off = np.abs(norms - 1.0)
        if n and off.max() > _UNIT_TOLERANCE:
            raise EvaluationError(f'{self.name}: pose {int(np.argmax(off))} has a quaternion of '
                                  f'length {norms[np.argmax(off)]:.4g}; valid is 1 within '
                                  f'{100 * _UNIT_TOLERANCE:g} %')
        quats /= norms[:, None]
        arrays = {'stamps_ns': stamps, 'positions_m': positions, 'orientations_wxyz': quats}
        if self.covariances is not None:
            arrays['covariances'] = self._checked_covariances(n)
        for field, value in arrays.items():
            value.setflags(write=False)
            object.__setattr__(self, field, value)

    def _checked_covariances(self, n: int) -> Array:
        covariances = np.array(self.covariances, dtype=float)
        if covariances.shape != (n, 6, 6):
            raise EvaluationError(f'{self.name}: {n} stamps and covariances {covariances.shape}; '
                                  'valid is (n, 6, 6)')
        sizes = np.abs(covariances).max(axis=(1, 2), initial=0.0)
        good = np.isfinite(sizes)
        odd = np.abs(covariances - covariances.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
        good &= odd <= _ASYMMETRY * sizes
        safe = np.where(good[:, None, None], covariances, np.eye(6))
        good &= np.linalg.eigvalsh(0.5 * (safe + safe.transpose(0, 2, 1)))[:, 0] \
            >= -_ASYMMETRY * sizes
        if not good.all():
            raise EvaluationError(f'{self.name}: the matrix of pose {int(np.argmin(good))} is no '
                                  'covariance: valid are finite, symmetric ones without negative '
                                  'eigenvalues')
        return covariances

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def rotations(self) -> Rotation:
        """Orientations as a SciPy Rotation of length n."""
        return Rotation.from_quat(self.orientations_wxyz[:, [1, 2, 3, 0]])

    @property
    def seconds(self) -> Array:
        """(n,) stamps [s]."""
        return np.asarray(self.stamps_ns * 1e-9, dtype=np.float64)

    @property
    def distances_m(self) -> Array:
        """(n,) length of the path in space through all poses, up to each one [m]."""
        return distance_along(self.positions_m)

    @property
    def length_m(self) -> float:
        """Distance driven [m]: horizontal, in steps of 0.1 s; see `bag.totals`."""
        return driven_distance_m(self.stamps_ns, self.positions_m)

    def select(self, keep: ArrayLike) -> Trajectory:
        """Return the poses of an index or boolean array."""
        index = np.asarray(keep)
        covariances = None if self.covariances is None else self.covariances[index]
        return Trajectory(self.stamps_ns[index], self.positions_m[index],
                          self.orientations_wxyz[index], self.name, covariances)

    def moved(self, rotation: ArrayLike, translation_m: ArrayLike,
              scale: float = 1.0) -> Trajectory:
        """Return the trajectory in another fixed frame: p -> scale R p + t, q -> R q."""
        R = np.asarray(rotation, dtype=float)
        positions = scale * self.positions_m @ R.T + np.asarray(translation_m, dtype=float)
        J = np.zeros((6, 6))
        J[:3, :3], J[3:, 3:] = scale * R, R
        return Trajectory(self.stamps_ns, positions,
                          wxyz(Rotation.from_matrix(R) * self.rotations), self.name,
                          self._spread(J))

    def of_frame(self, T_moving_other: ArrayLike) -> Trajectory:
        """Return the trajectory of another frame that is rigidly fixed to the moving one."""
        T = np.asarray(T_moving_other, dtype=float)
        rotations = self.rotations
        positions = self.positions_m + rotations.apply(T[:3, 3])
        # The arm to the other frame turns with the moving one: dp' = dp + dtheta x arm.
        arm = positions - self.positions_m
        J = np.tile(np.eye(6), (len(arm), 1, 1))
        J[:, 0, 4], J[:, 1, 5], J[:, 2, 3] = arm[:, 2], arm[:, 0], arm[:, 1]
        J[:, 0, 5], J[:, 1, 3], J[:, 2, 4] = -arm[:, 1], -arm[:, 2], -arm[:, 0]
        return Trajectory(self.stamps_ns, positions,
                          wxyz(rotations * Rotation.from_matrix(T[:3, :3])), self.name,
                          self._spread(J))

    def _spread(self, J: Array) -> Array | None:
        """Return the covariances of what has these derivatives, (6, 6) or (n, 6, 6)."""
        if self.covariances is None:
            return None
        return np.asarray(J @ self.covariances @ np.swapaxes(J, -1, -2))


def wxyz(rotations: Rotation) -> Array:
    """Return the (n, 4) quaternions of SciPy rotations."""
    return np.atleast_2d(rotations.as_quat())[:, [3, 0, 1, 2]]
