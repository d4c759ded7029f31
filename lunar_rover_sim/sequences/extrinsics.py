"""Poses of the sensors on a recorded rover: from the bag's tf_static, else from its scenario."""

from __future__ import annotations

from typing import Any

import numpy as np

from lunar_rover_sim import topics
from lunar_rover_sim.bag.messages import transform_matrix
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario
from lunar_rover_sim.errors import BagError, ConfigError
from lunar_rover_sim.frames import (Array, BASE_FRAME, IMU_FRAME, LEFT_OPTICAL_FRAME, LIDAR_FRAME,
                                    RIGHT_OPTICAL_FRAME)
from lunar_rover_sim.parameters import nearest
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import imu_pose, lidar_pose, optical_poses

FRAMES = {'base': BASE_FRAME, 'imu': IMU_FRAME, 'left': LEFT_OPTICAL_FRAME,
          'right': RIGHT_OPTICAL_FRAME, 'lidar': LIDAR_FRAME}


def rover_frame(rover: RoverDescription, frame: str) -> Array:
    """Return T_base_frame (4, 4) of one of `FRAMES` on a rover; ConfigError on another name."""
    _check(frame)
    left, right = optical_poses(rover)
    return {'base': np.eye(4), 'imu': imu_pose(rover), 'left': left, 'right': right,
            'lidar': lidar_pose(rover)}[frame]


def recorded_frame(bag: Bag, frame: str) -> Array:
    """Return T_base_frame (4, 4) of one of `FRAMES` on the recorded rover.

    Raises ConfigError on another name, BagError where the bag does not say where the frame is.
    """
    _check(frame)
    if frame == 'base':
        return np.eye(4)
    found = frame_from_tf(bag, FRAMES[frame])
    if found is not None:
        return found
    rover = recorded_rover(bag)
    if rover is None:
        raise BagError(f'{bag.path}: holds neither tf_static nor a scenario; where '
                       f'{FRAMES[frame]} is on the rover is not known')
    return rover_frame(rover, frame)


def recorded_rover(bag: Bag) -> RoverDescription | None:
    """Return the recorded rover; None where the bag has no scenario that describes it.

    Raises BagError where the scenario is not of this version.
    """
    values: Any = recorded_scenario(bag).sections.get('rover')
    if not values:
        return None
    try:
        return RoverDescription.from_mapping(values, 'rover')
    except ConfigError as error:
        raise BagError(f'{bag.path}: its scenario is not of this version: {error}') from None


def _check(frame: str) -> None:
    if frame not in FRAMES:
        raise ConfigError(f'frame: {frame!r} is not valid; {nearest(frame, FRAMES)}')


def frame_from_tf(bag: Bag, child: str) -> Array | None:
    """Return T_base_child (4, 4) from the bag's tf_static; None where it lacks the frame."""
    if not bag.has(topics.TF_STATIC.name):
        return None
    parents: dict[str, tuple[str, Array]] = {}
    for _, _, message in bag.messages([topics.TF_STATIC.name]):
        for transform in message.transforms:
            parents[transform.child_frame_id] = (transform.header.frame_id,
                                                 transform_matrix(transform))
    T = np.eye(4)
    for _ in range(len(parents)):
        if child not in parents:
            return None
        parent, T_parent_child = parents[child]
        T = T_parent_child @ T
        if parent == BASE_FRAME:
            return T
        child = parent
    return None
