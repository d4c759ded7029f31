"""What the graph is given with a pair of images: inertial samples, wheels, sun and stars."""

from __future__ import annotations

from collections import deque
import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.frames import Array

_MEMORY_NS = 30_000_000_000     # of inertial samples


class Wheels(NamedTuple):
    """Wheel odometry at the stamp of an image: x, y, yaw (3,) and their covariance (3, 3)."""

    pose: Array
    covariance: Array


class Sun(NamedTuple):
    """A direction to the sun: stamp [ns], (3,) in base axes, and the true one, (3,) in the map."""

    stamp_ns: int
    in_base: Array
    in_map: Array


class Stars(NamedTuple):
    """An attitude: stamp [ns], R_map_base (3, 3), covariance (3, 3) about map axes [rad^2]."""

    stamp_ns: int
    R_map_base: Array
    covariance_rad2: Array


class Inertial(NamedTuple):
    """Samples in base axes: stamps (n,) [ns], rates (n, 3) [rad/s], forces (n, 3) [m/s^2]."""

    stamps_ns: NDArray[np.int64]
    rates_radps: Array
    forces_mps2: Array


@dataclasses.dataclass(frozen=True)
class Aids:
    """What comes beside a pair of images; None where nobody measured it.

    Attributes:
        inertial: Samples since the pair before.
        wheels: At the stamp of the pair.
        sun, stars: The newest since the pair before.
    """

    inertial: Inertial | None = None
    wheels: Wheels | None = None
    sun: Sun | None = None
    stars: Stars | None = None


class Turns:
    """Rotations between stamps, and which way is up, from the last inertial samples."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, Array, Array]] = deque()

    def add(self, inertial: Inertial) -> None:
        """Take samples; those that are old are forgotten."""
        for ns, rate, force in zip(inertial.stamps_ns.tolist(), inertial.rates_radps,
                                   inertial.forces_mps2):
            self._samples.append((ns, rate, force))
        while self._samples and self._samples[-1][0] - self._samples[0][0] > _MEMORY_NS:
            self._samples.popleft()

    def between(self, start_ns: int, end_ns: int) -> Array | None:
        """Return R_start_end (3, 3); None where the samples do not cover the time."""
        if end_ns < start_ns:
            back = self.between(end_ns, start_ns)
            return None if back is None else back.T
        if start_ns == end_ns:
            return np.eye(3)
        within = self._within(start_ns, end_ns)
        if within is None:
            return None
        stamps, rates, _ = within
        steps = np.diff(np.append(start_ns, stamps)) * 1e-9
        turn = Rotation.identity()
        for step in Rotation.from_rotvec(rates * steps[:, None]):
            turn = turn * step
        return np.asarray(turn.as_matrix())

    def up(self, start_ns: int, end_ns: int) -> tuple[Array, float] | None:
        """Return the mean specific force (3,) [m/s^2] in the axes at the end, and its time [s].

        None where the samples do not cover the time.
        """
        within = self._within(start_ns, end_ns)
        if within is None or end_ns <= start_ns:
            return None
        stamps, rates, forces = within
        total, turn, later = np.zeros(3), Rotation.identity(), end_ns
        for ns, rate, force in zip(stamps[::-1], rates[::-1], forces[::-1]):
            # turn: R_end_sample
            turn = turn * Rotation.from_rotvec(-rate * (later - ns) * 1e-9)
            total, later = total + turn.apply(force), ns
        return total / len(stamps), (end_ns - start_ns) * 1e-9

    def _within(self, start_ns: int, end_ns: int) -> tuple[NDArray[np.int64], Array, Array] | None:
        chosen = [sample for sample in self._samples if start_ns < sample[0] <= end_ns]
        most_ns = 1.5 * (end_ns - start_ns) / max(1, len(chosen))
        if not chosen or chosen[0][0] - start_ns > most_ns or end_ns - chosen[-1][0] > most_ns:
            return None
        stamps, rates, forces = zip(*chosen)
        return np.array(stamps, np.int64), np.array(rates), np.array(forces)
