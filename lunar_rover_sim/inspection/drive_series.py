"""The true motion of a recorded drive: states by stamp, its pitch and its slip."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim import frames, topics
from lunar_rover_sim.bag.messages import header_ns, joint_order, odometry_row, xyz
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.errors import BagError
from lunar_rover_sim.frames import Array, matrix_from_wxyz, se3
from lunar_rover_sim.physics.foot_motion import FootObserver
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.world.grid import HeightGrid

WINDOW_S = 1.0             # window of a slip ratio
_SLIP_RATE_HZ = 50.0        # sampling rate of the feet
_LEAST_SWEEP_M = 0.02       # sum over the feet in a window; below it there is no slip ratio


class DriveSeries(NamedTuple):
    """States that the bag holds, (n, …) arrays.

    stamps_ns (n,); poses (n, 13) as `odometry_row`; angles, velocities (n, 4) of the legs;
    forces_n (n, 4, 3) on the legs, NaN where contacts were not recorded
    """

    stamps_ns: NDArray[np.int64]
    poses: Array
    angles: Array
    velocities: Array
    forces_n: Array

    def nearest(self, time_ns: int) -> int:
        """Return the index of the last state up to a time, or the first one."""
        return max(int(np.searchsorted(self.stamps_ns, time_ns, side='right')) - 1, 0)

    def pose(self, k: int) -> RoverPose:
        """Return pose, velocities and leg angles of state `k`."""
        row = self.poses[k]
        return RoverPose(se3(matrix_from_wxyz(row[3:7]), row[:3]), self.angles[k], row[7:10],
                         row[10:13], self.velocities[k])

    def pitch_deg(self) -> Array:
        """Return the (n,) pitch [deg], positive with the nose down."""
        return np.degrees(frames.rpy_from_wxyz(self.poses[:, 3:7])[:, 1])

    def slip(self, rover: RoverDescription, ground: HeightGrid, gravity_mps2: float,
             window_s: float = WINDOW_S) -> tuple[Array, Array]:
        """Return times [s] and slip ratios of the rover over the window before each.

        The ratio is slipped over swept distance of all feet, see `physics/foot_motion.py`; NaN
        where they hardly move or contacts were not recorded.
        """
        n = len(self.stamps_ns)
        steps = np.diff(self.stamps_ns)
        stride = max(1, round(1e9 / _SLIP_RATE_HZ / float(np.median(steps)))) if n > 1 else 1
        chosen = np.arange(0, n, stride)
        observer = FootObserver(rover, ground, gravity_mps2)
        motions = [observer.observe(self._state(int(k))) for k in chosen]
        sweep = np.array([motion.sweep_mps.sum() for motion in motions])
        slipped = np.array([motion.slip_mps.sum() for motion in motions])
        times_s = np.asarray(self.stamps_ns[chosen] * 1e-9, float)
        step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
        count = max(1, round(window_s / step_s)) if step_s else 1
        kernel = np.ones(count)
        swept_m: Array = np.convolve(sweep, kernel)[:len(sweep)] * step_s
        slipped_m = np.convolve(slipped, kernel)[:len(sweep)] * step_s
        ratio: Array = np.divide(slipped_m, swept_m, out=np.full(len(sweep), np.nan),
                                 where=np.abs(swept_m) > _LEAST_SWEEP_M)
        if not np.all(np.isfinite(self.forces_n)):
            ratio[:] = np.nan
        return times_s, ratio

    def _state(self, k: int) -> RoverState:
        row, zeros = self.poses[k], np.zeros(4)
        return RoverState(int(self.stamps_ns[k]), row[:3], row[3:7], row[7:10], row[10:13],
                          self.angles[k], self.velocities[k], zeros, zeros, self.forces_n[k],
                          np.zeros((4, 3)), np.zeros(3), np.zeros(3))


def read_drive(bag: Bag, start_ns: int | None = None, end_ns: int | None = None) -> DriveSeries:
    """Return the motion in a bag between two times; raise BagError where it holds none."""
    for name in (bag.truth, topics.JOINT_STATES.name):
        if not bag.count(name):
            raise BagError(f'{bag.path}: holds no drive: {name} is missing')
    contacts = [topic.name for topic in topics.CONTACTS if bag.has(topic.name)]
    names = {bag.resolve(name): name
             for name in (bag.truth, topics.JOINT_STATES.name, *contacts)}
    rows: dict[str, dict[int, Any]] = {name: {} for name in names.values()}
    for topic, _, message in bag.messages(names, start_ns, end_ns):
        name = names[topic]
        value = (odometry_row(message) if name == bag.truth
                 else _legs(bag, message) if name == topics.JOINT_STATES.name
                 else xyz(message.wrench.force))
        rows[name][header_ns(message)] = value
    common = sorted(set(rows[bag.truth]) & set(rows[topics.JOINT_STATES.name]))
    if not common:
        raise BagError(f'{bag.path}: holds no drive: no {topics.JOINT_STATES.name} has the stamp '
                       f'of a message of {bag.truth}')
    legs = np.array([rows[topics.JOINT_STATES.name][stamp] for stamp in common])
    forces = np.full((len(common), 4, 3), np.nan)
    for leg, contact in enumerate(topics.CONTACTS):
        found = rows.get(contact.name, {})
        for k, stamp in enumerate(common):
            forces[k, leg] = found.get(stamp, np.nan)
    return DriveSeries(np.array(common, np.int64), np.array([rows[bag.truth][s] for s in common]),
                       legs[:, 0], legs[:, 1], forces)


def _legs(bag: Bag, message: Any) -> Array:
    """Return (2, 4) angles and velocities in our order; legs without velocities are at rest."""
    order = joint_order(message, bag.path, BagError)
    angles = np.asarray(message.position, float)[order]
    speeds = (np.asarray(message.velocity, float)[order] if len(message.velocity)
              else np.zeros(len(order)))
    return np.stack([angles, speeds])
