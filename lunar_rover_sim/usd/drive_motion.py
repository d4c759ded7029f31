"""What a bag says about the motion of its rover, as arrays by stamp."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag.messages import header_ns, imu_row, joint_order, odometry_row, xyz
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.series import Odometry
from lunar_rover_sim.errors import UsdError
from lunar_rover_sim.frames import Array, matrix_from_wxyz, product_wxyz
from lunar_rover_sim.rover.description import JOINT_NAMES, LEG_NAMES, RoverDescription
from lunar_rover_sim.seconds import NS_PER_S


class Series(NamedTuple):
    """stamps_ns (n,) and values (n, k)."""

    stamps_ns: NDArray[np.int64]
    values: Array


class DriveMotion(NamedTuple):
    """The motion of a rover; those of `others` that were recorded, by name.

    odometry: poses and twists of base_link
    joints: (n, 4) leg angles [rad, unwrapped] at the stamps of the odometry
    others: `joint_velocity` [rad/s], `joint_torque` [N m] and `joint_command` [rad/s] (n, 4);
        `imu` (n, 6) rates [rad/s] and specific forces [m/s2]; `contact/<leg>` (n, 3) force [N],
        world axes; `frames` (n, 0), the stamps of the images
    """

    odometry: Odometry
    joints: Array
    others: dict[str, Series]

    @property
    def rate_hz(self) -> int:
        """State rate [Hz], from the median interval."""
        steps = np.diff(self.odometry.stamps_ns)
        return round(NS_PER_S / float(np.median(steps))) if len(steps) else 1


def read_motion(bag: Bag) -> DriveMotion:
    """Return the motion in a bag, which is read once; raise UsdError where it holds no drive."""
    for name in (bag.truth, topics.JOINT_STATES.name):
        if not bag.count(name):
            raise UsdError(f'{bag.path}: holds no drive: {name} is missing')
    rows: dict[str, Callable[[Any], Any]] = {
        bag.truth: odometry_row,
        topics.JOINT_STATES.name: lambda m: _joint_row(bag, m),
        topics.JOINT_COMMANDS.name:
            lambda m: _values(m.velocity, joint_order(m, bag.path, UsdError)),
        topics.IMU_RAW.name: imu_row,
        **{topic.name: lambda m: xyz(m.wrench.force) for topic in topics.CONTACTS},
        topics.LEFT_INFO.name: lambda m: ()}
    names = {bag.resolve(name): name for name in rows if bag.has(name)}
    stamps: dict[str, list[int]] = {name: [] for name in names.values()}
    values: dict[str, list[Any]] = {name: [] for name in names.values()}
    for full_name, _, message in bag.messages(names):
        name = names[full_name]
        stamps[name].append(header_ns(message))
        values[name].append(rows[name](message))
    found = {name: Series(np.array(stamps[name], np.int64), np.array(values[name], float))
             for name in stamps if stamps[name]}
    odometry, states = found[bag.truth], found[topics.JOINT_STATES.name]
    pose = odometry.values
    count = len(JOINT_NAMES)
    angles, velocity, torque = np.split(states.values, [count, 2 * count], axis=1)
    joints = np.stack([np.interp(odometry.stamps_ns, states.stamps_ns, angle)
                       for angle in angles.T], axis=-1)
    others = {'joint_velocity': Series(states.stamps_ns, velocity),
              'joint_torque': Series(states.stamps_ns, torque)}
    keys = {topics.JOINT_COMMANDS.name: 'joint_command', topics.IMU_RAW.name: 'imu',
            topics.LEFT_INFO.name: 'frames',
            **{topic.name: f'contact/{leg}' for leg, topic in zip(LEG_NAMES, topics.CONTACTS)}}
    others |= {key: found[name] for name, key in keys.items() if name in found}
    path = Odometry(odometry.stamps_ns, pose[:, 0:3], pose[:, 3:7], pose[:, 7:13])
    return DriveMotion(path, joints, others)


def link_motion(rover: RoverDescription, motion: DriveMotion) -> dict[str, tuple[Array, Array]]:
    """Return leg → positions (n, 3) and orientations_wxyz (n, 4) in the world."""
    odometry = motion.odometry
    rotation = matrix_from_wxyz(odometry.orientations_wxyz)
    result = {}
    for k, (leg, axle) in enumerate(zip(LEG_NAMES, rover.legs.axle_positions_m())):
        half = 0.5 * motion.joints[:, k]
        zero = np.zeros_like(half)
        turn = np.stack([np.cos(half), zero, np.sin(half), zero], axis=-1)
        result[leg] = (odometry.positions_m + rotation @ np.asarray(axle, float),
                       product_wxyz(odometry.orientations_wxyz, turn))
    return result


def continuous(orientations_wxyz: Array) -> Array:
    """Return the same (n, 4) rotations with signs that do not jump, for interpolation."""
    flips = np.sum(orientations_wxyz[1:] * orientations_wxyz[:-1], axis=1) < 0.0
    sign = np.where(np.cumsum(np.concatenate([[False], flips])) % 2, -1.0, 1.0)
    return orientations_wxyz * sign[:, None]


def _joint_row(bag: Bag, message: Any) -> Array:
    """Return angles, velocities and torques, in our order."""
    order = joint_order(message, bag.path, UsdError)
    return np.concatenate([_values(v, order) for v in (message.position, message.velocity,
                                                       message.effort)])


def _values(values: Any, order: list[int]) -> Array:
    """Return values in our order; NaN where a message has none."""
    return np.asarray(values, float)[order] if len(values) else np.full(len(order), np.nan)
