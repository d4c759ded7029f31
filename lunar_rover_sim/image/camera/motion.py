"""Motion of a camera relative to the ground, to the rover's body and to its legs."""

from __future__ import annotations

import dataclasses

import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import Posed


@dataclasses.dataclass(frozen=True)
class CameraTwist:
    """The motion of a camera relative to a rigid body, in the optical axes of the camera.

    Attributes:
        linear_velocity_mps: (3,) of the camera's centre.
        angular_velocity_radps: (3,).
    """

    linear_velocity_mps: Array
    angular_velocity_radps: Array

    def image_speed(self, rays: Array, nearness: Array) -> Array:
        """Return the (n,) speeds in the image of points, over the focal length [1/s].

        Args:
            rays: (n, 3), of depth 1.
            nearness: (n,) inverse depths [1/m].
        """
        swing = np.cross(self.angular_velocity_radps, rays)
        speed = swing + self.linear_velocity_mps * nearness[:, None]
        return np.linalg.norm(speed[:, :2] - rays[:, :2] * speed[:, 2:], axis=1)


def ground_twist(state: Posed, T_base_camera: Array) -> CameraTwist:
    """Return the motion of a camera, at (4, 4) T_base_camera, relative to the world."""
    R = T_base_camera[:3, :3]
    rate = np.asarray(state.angular_velocity_radps, float)
    velocity = state.linear_velocity_mps + np.cross(rate, T_base_camera[:3, 3])
    return CameraTwist(velocity @ R, rate @ R)


def leg_twists(state: Posed, T_base_camera: Array, rover: RoverDescription) -> list[CameraTwist]:
    """Return the motion of a camera relative to the legs of the rover, in their order.

    Legs turn about their axles, along y of base_link.
    """
    R, centre = T_base_camera[:3, :3], T_base_camera[:3, 3]
    twists = []
    for axle, speed in zip(rover.legs.axle_positions_m(), state.joint_velocity_radps):
        rate = np.array([0.0, -float(speed), 0.0])
        twists.append(CameraTwist(np.cross(rate, centre - axle) @ R, rate @ R))
    return twists


def twist_beside(state: Posed, T_world_camera: Array, velocity_mps: Array, rate_radps: Array,
                 rover: RoverDescription) -> list[CameraTwist]:
    """Return the motion of a camera beside the rover relative to its body and its legs.

    Args:
        T_world_camera: (4, 4) of the optical frame.
        velocity_mps, rate_radps: (3,) of the camera, world axes.
    """
    R, centre = T_world_camera[:3, :3], T_world_camera[:3, 3]
    base = state.T_world_base
    turn = base[:3, :3]
    body_rate = turn @ state.angular_velocity_radps
    body_velocity = turn @ state.linear_velocity_mps

    def relative(origin: Array, velocity: Array, rate: Array) -> CameraTwist:
        point = velocity + np.cross(rate, centre - origin)  # of the link, where the camera is
        return CameraTwist((velocity_mps - point) @ R, (rate_radps - rate) @ R)

    twists = [relative(base[:3, 3], body_velocity, body_rate)]
    for axle, speed in zip(rover.legs.axle_positions_m(), state.joint_velocity_radps):
        arm = turn @ np.asarray(axle, float)
        twists.append(relative(base[:3, 3] + arm, body_velocity + np.cross(body_rate, arm),
                               body_rate + turn @ [0.0, float(speed), 0.0]))
    return twists
