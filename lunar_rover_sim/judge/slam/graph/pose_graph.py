"""The graph of poses, solved by GTSAM: iSAM2 (Kaess et al., IJRR 31 (2), 2012) with QR.

QR and not Cholesky: the latter fails where a part of the graph is nearly free. Covariances are of
(turn [rad], shift [m]) in the axes of the pose, T Exp(turn, shift), as in GTSAM.
"""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.frames import Array, inverse, se3
from lunar_rover_sim.judge.slam.graph.measured import Wheels

MISSING = ('the graph needs GTSAM, which is not installed: pip install "lunar_rover_sim[graph]" '
           '(wheels for Python 3.11 to 3.14)')
_QUANTILE = 0.999       # of chi^2, beyond which a measurement is refused


def gate(dof: int) -> float:
    """Return the largest chi^2 of a measurement that is believed; 22.46 for 6 of freedom."""
    return float(chi2.ppf(_QUANTILE, dof))


def has_gtsam() -> bool:
    """Return whether GTSAM is installed and can be imported."""
    try:
        importlib.import_module('gtsam')
    except ImportError:
        return False
    return True


class PoseGraph:
    """Poses T_map_base by their keys 0, 1, 2 ...; factors are collected until `solve`.

    Raises:
        SlamError: Without GTSAM.
    """

    def __init__(self) -> None:
        if not has_gtsam():
            raise SlamError(MISSING)
        self._gtsam: Any = importlib.import_module('gtsam')
        parameters = self._gtsam.ISAM2Params()
        parameters.setFactorization('QR')
        parameters.relinearizeSkip = 1
        parameters.setRelinearizeThreshold(0.01)
        self._solver = self._gtsam.ISAM2(parameters)
        self._begin()

    def _begin(self) -> None:
        self._factors = self._gtsam.NonlinearFactorGraph()
        self._values = self._gtsam.Values()

    def add(self, key: int, T_map_base: Array) -> None:
        """Add a pose; it needs factors that hold it before `solve`."""
        self._values.insert(key, self._gtsam.Pose3(T_map_base))

    def prior(self, key: int, T_map_base: Array, covariance: Array) -> None:
        """Hold a pose."""
        self._factors.add(self._gtsam.PriorFactorPose3(
            key, self._gtsam.Pose3(T_map_base), self._noise(covariance)))

    def between(self, first: int, second: int, T_first_second: Array, covariance: Array) -> None:
        """Hold two poses together."""
        self._factors.add(self._gtsam.BetweenFactorPose3(
            first, second, self._gtsam.Pose3(T_first_second), self._noise(covariance)))

    def direction(self, key: int, in_map: Array, in_base: Array, sigma_rad: float) -> None:
        """Hold the attitude by a direction (3,) that is known in the map and seen in the base."""
        gtsam = self._gtsam
        self._factors.add(gtsam.AttitudeFactorPose3(
            key, gtsam.Unit3(in_map / np.linalg.norm(in_map)),
            gtsam.noiseModel.Isotropic.Sigma(2, sigma_rad),
            gtsam.Unit3(in_base / np.linalg.norm(in_base))))

    def attitude(self, key: int, R_map_base: Array, covariance_rad2: Array) -> None:
        """Hold the attitude; the covariance (3, 3) is about the axes of the base."""
        self._factors.add(self._gtsam.PoseRotationPrior3D(
            key, self._gtsam.Rot3(R_map_base), self._noise(covariance_rad2)))

    @property
    def has_new(self) -> bool:
        """Whether factors were added since it was solved."""
        return bool(self._factors.size())

    def solve(self) -> None:
        """Take in what was added.

        Raises:
            SlamError: If the graph is singular; it is of no more use then.
        """
        try:
            self._solver.update(self._factors, self._values)
            self._solver.update()
        except (RuntimeError, IndexError) as error:
            raise SlamError(f'the graph is singular: {str(error).strip().splitlines()[0]}') \
                from None
        self._begin()

    def pose(self, key: int) -> Array:
        """Return T_map_base (4, 4) of a key."""
        return np.asarray(self._solver.calculateEstimatePose3(key).matrix())

    def poses(self) -> dict[int, Array]:
        """Return T_map_base of all keys."""
        values = self._solver.calculateEstimate()
        return {key: np.asarray(values.atPose3(key).matrix()) for key in values.keys()}

    def covariance(self, key: int) -> Array:
        """Return the covariance (6, 6) of a pose."""
        return np.asarray(self._solver.marginalCovariance(key))

    def relative_covariance(self, first: int, second: int) -> Array:
        """Return the covariance (6, 6) of the pose `second` in `first`."""
        gtsam = self._gtsam
        joint = self._solver.jointMarginalCovariance(gtsam.KeyVector([first, second]))
        blocks = np.block([[joint.at(a, b) for b in (first, second)] for a in (first, second)])
        T = gtsam.Pose3(self.pose(second)).between(gtsam.Pose3(self.pose(first)))
        J = np.hstack([-np.asarray(T.AdjointMap()), np.eye(6)])
        return np.asarray(J @ blocks @ J.T)

    def _noise(self, covariance: Array) -> Any:
        return self._gtsam.noiseModel.Gaussian.Covariance(covariance)


def adjoint(T: Array) -> Array:
    """Return the (6, 6) adjoint of T: T Exp(x) = Exp(Ad x) T, x = (turn, shift)."""
    R, t = T[:3, :3], T[:3, 3]
    cross = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
    return np.block([[R, np.zeros((3, 3))], [cross @ R, R]])


_WHEELS_UP_M, _WHEELS_TILT_RAD = 0.03, 0.3


def composed(T: Array, P: Array, relative: Array, covariance: Array) -> tuple[Array, Array]:
    """Return the pose T relative, and its covariance, in its own axes."""
    A = adjoint(inverse(relative))
    return T @ relative, A @ P @ A.T + covariance


def difference(first: Array, second: Array) -> Array:
    """Return (turn, shift) (6,) of second^-1 first, in the axes of the end."""
    D = inverse(second) @ first
    return np.concatenate([Rotation.from_matrix(D[:3, :3]).as_rotvec(), D[:3, 3]])


def fused(T: Array, P: Array, other: Array, other_covariance: Array) -> tuple[Array, Array]:
    """Return the mean of two measurements of one motion, weighted by their covariances."""
    gain = P @ np.linalg.inv(P + other_covariance)
    move = gain @ difference(other, T)
    step = se3(Rotation.from_rotvec(move[:3]).as_matrix(), move[3:])
    covariance = P - gain @ P
    return T @ step, 0.5 * (covariance + covariance.T)


def rolled(before: Wheels, now: Wheels) -> tuple[Array, Array]:
    """Return the motion of the base by the wheels, and its covariance (turn, shift)."""
    x, y, yaw = now.pose - before.pose
    c, s = math.cos(before.pose[2]), math.sin(before.pose[2])
    T = se3(Rotation.from_euler('Z', yaw).as_matrix(), [c * x + s * y, c * y - s * x, 0.0])
    F = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
    added = now.covariance - F @ before.covariance @ F.T
    c, s = math.cos(now.pose[2]), math.sin(now.pose[2])
    turned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    added = turned @ added @ turned.T
    # A difference of large covariances: rounding, or odometry of another model, may leave
    # variances below 0.
    variances, axes = np.linalg.eigh(0.5 * (added + added.T))
    added = axes @ np.diag(np.abs(variances)) @ axes.T
    way = math.hypot(x, y)
    covariance = np.diag([_WHEELS_TILT_RAD**2] * 2 + [0.0] * 3
                         + [_WHEELS_UP_M**2 + (0.2 * way)**2])
    order = [3, 4, 2]
    covariance[np.ix_(order, order)] += added + np.diag([1e-6, 1e-6, 1e-6])
    return T, covariance
