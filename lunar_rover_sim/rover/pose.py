"""Where the rover is and how its legs stand: all that a picture of it depends on."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from lunar_rover_sim.frames import Array


class Posed(Protocol):
    """Something with a pose and leg angles, such as `physics.state.RoverState` or `RoverPose`."""

    @property
    def T_world_base(self) -> Array:
        """(4, 4) pose of base_link in the world."""

    @property
    def joint_angle_rad(self) -> Array:
        """(4,) leg angles [rad] in the order of LEG_NAMES."""


@dataclasses.dataclass(frozen=True)
class RoverPose:
    """A pose that no simulation has to produce.

    T_world_base: (4, 4) pose of base_link in the world, translation in metres
    joint_angle_rad: (4,) leg angles [rad] in the order of LEG_NAMES
    """

    T_world_base: Array
    joint_angle_rad: Array = dataclasses.field(default_factory=lambda: np.zeros(4))
