"""Mounts of cameras, fixed or moving: on the rover's body, or beside the rover."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from lunar_rover_sim.base.frames import Array, se3
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.camera.motion import CameraTwist, ground_twist, leg_twists, twist_beside
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import moved, moved_pose, Posed


class Mount:
    """What carries a pair of cameras, and how it moves; one camera counts as two in one place.

    Attributes:
        on_body: Whether the rover's body stands still in the images.
    """

    on_body = False

    def follow(self, state: Posed, stamp_ns: int = 0) -> None:
        """Move with the rover, unless it stands; stamp_ns: simulated time [ns]."""

    def enter(self, world: World) -> None:
        """Be in another window of the site from now on."""

    def poses(self, state: Posed) -> list[Array]:
        """Return the (4, 4) poses T_world_camera of both optical frames."""
        raise NotImplementedError

    def ground_twist(self, state: Posed, side: int) -> CameraTwist:
        """Return the motion of a camera (0 left, 1 right) relative to the world."""
        raise NotImplementedError

    def link_twists(self, state: Posed, side: int, rover: RoverDescription) -> list[CameraTwist]:
        """Return its motion relative to the links of the rover, the body first."""
        raise NotImplementedError


class MountedPair(Protocol):
    """A pair of cameras on the rover, such as `StereoRig`."""

    @property
    def T_base_left(self) -> Array:
        """(4, 4) optical frame in base_link."""

    @property
    def T_base_right(self) -> Array:
        """(4, 4) optical frame in base_link."""


class BodyMount(Mount):
    """Cameras that are fixed to base_link."""

    on_body = True

    def __init__(self, rig: MountedPair) -> None:
        self._T_base_cameras = (rig.T_base_left, rig.T_base_right)

    def poses(self, state: Posed) -> list[Array]:
        """Return the (4, 4) poses T_world_camera of both optical frames."""
        return [state.T_world_base @ T for T in self._T_base_cameras]

    def ground_twist(self, state: Posed, side: int) -> CameraTwist:
        """Return the motion of a camera (0 left, 1 right) relative to the world."""
        return ground_twist(state, self._T_base_cameras[side])

    def link_twists(self, state: Posed, side: int, rover: RoverDescription) -> list[CameraTwist]:
        """Return its motion relative to the links of the rover, the body first."""
        still = CameraTwist(np.zeros(3), np.zeros(3))
        return [still, *leg_twists(state, self._T_base_cameras[side], rover)]


class MovingMount(Mount):
    """A camera beside the rover, as `place` says; at first at the origin of the world.

    Attributes:
        T_world_camera: (4, 4) pose of its optical frame.
    """

    def __init__(self) -> None:
        self.T_world_camera: Array = np.eye(4)
        self._velocity_mps, self._rate_radps = np.zeros(3), np.zeros(3)

    def place(self, T_world_camera: Array, velocity_mps: Array | None = None,
              rate_radps: Array | None = None) -> None:
        """Set pose and motion; velocity of the camera's centre, and rates, in world axes."""
        self.T_world_camera = T_world_camera
        self._velocity_mps = np.zeros(3) if velocity_mps is None else velocity_mps
        self._rate_radps = np.zeros(3) if rate_radps is None else rate_radps

    def poses(self, state: Posed) -> list[Array]:
        """Return the (4, 4) pose T_world_camera, twice."""
        return [self.T_world_camera, self.T_world_camera]

    def ground_twist(self, state: Posed, side: int) -> CameraTwist:
        """Return its motion relative to the world."""
        R = self.T_world_camera[:3, :3]
        return CameraTwist(self._velocity_mps @ R, self._rate_radps @ R)

    def link_twists(self, state: Posed, side: int, rover: RoverDescription) -> list[CameraTwist]:
        """Return its motion relative to the links of the rover, the body first."""
        return twist_beside(state, self.T_world_camera, self._velocity_mps, self._rate_radps,
                            rover)


class MountElsewhere(Mount):
    """A mount that moves in another frame than the one that is drawn in, which has its axes.

    States that it is given, and poses that it returns, are those of the frame that is drawn in.
    """

    def __init__(self, mount: Mount, offset_m: Callable[[], Array]) -> None:
        """offset_m: returns the (3,) place of the frame that is drawn in, at present."""
        self._mount, self._offset_m = mount, offset_m

    def _there(self, state: Posed) -> Posed:
        return moved(state, self._offset_m())

    def follow(self, state: Posed, stamp_ns: int = 0) -> None:
        """Move with the rover; stamp_ns: simulated time [ns]."""
        self._mount.follow(self._there(state), stamp_ns)

    def enter(self, world: World) -> None:
        """Be in another window of the site from now on."""
        self._mount.enter(world)

    def poses(self, state: Posed) -> list[Array]:
        """Return the (4, 4) poses of both optical frames."""
        return [moved_pose(T, -self._offset_m()) for T in self._mount.poses(self._there(state))]

    def ground_twist(self, state: Posed, side: int) -> CameraTwist:
        """Return the motion of a camera (0 left, 1 right) relative to the world."""
        return self._mount.ground_twist(self._there(state), side)

    def link_twists(self, state: Posed, side: int, rover: RoverDescription) -> list[CameraTwist]:
        """Return its motion relative to the links of the rover, the body first."""
        return self._mount.link_twists(self._there(state), side, rover)


class TurnedMount:
    """Cameras in the same places as those on another mount that look elsewhere."""

    def __init__(self, mount: Mount, R_camera_turned: Array) -> None:
        """R_camera_turned: (3, 3) axes of these cameras in those of the others."""
        self._mount, self._turn = mount, se3(R_camera_turned, np.zeros(3))

    def poses(self, state: Posed) -> list[Array]:
        """Return the (4, 4) poses T_world_camera of both optical frames."""
        return [T @ self._turn for T in self._mount.poses(state)]
