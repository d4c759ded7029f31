"""Optical flow from each image to the next one, with a mask of what the next one shows.

It is computed from depth, labels, poses and leg angles: the flow in a bag leads to the past.
"""

from __future__ import annotations

from collections import deque
import dataclasses
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera.flow import FlowModel, Moved
from lunar_rover_sim.errors import SequenceError
from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.labels import link_label
from lunar_rover_sim.rover.description import Legs, RoverDescription
from lunar_rover_sim.rover.visual import link_poses
from lunar_rover_sim.seconds import in_seconds

SEEN, HIDDEN, OUTSIDE = 0, 1, 100       # values of the mask
_CLOSE = 1.02           # depths that differ by less are of one surface
_MOST_WAITING = 2000    # angles kept in memory


@dataclasses.dataclass
class _FlowFrame:
    number: int
    stamp_ns: int
    depth_m: NDArray[np.float32]
    label: NDArray[np.uint16]
    T_odom_base: Array | None = None


class FlowFiles:
    """Writes NUMBER_NUMBER_flow.npy and _mask.npy once two images and their poses are known.

    K: (3, 3) intrinsics [px]; T_base_camera: (4, 4)
    """

    def __init__(self, folder: Path, K: Array, T_base_camera: Array,
                 rover: RoverDescription) -> None:
        self._folder, self._K, self._T_base_camera = folder, K, T_base_camera
        self._rover = rover
        self._frames: deque[_FlowFrame] = deque()
        self._angles: dict[int, Array] = {}

    @property
    def legs(self) -> Legs:
        """The legs of the recorded rover."""
        return self._rover.legs

    def image(self, number: int, stamp_ns: int, depth_m: NDArray[np.float32],
              label: NDArray[np.uint16]) -> None:
        """Take the (h, w) truth of the next image."""
        self._frames.append(_FlowFrame(number, stamp_ns, depth_m, label))

    def pose(self, T_odom_base: Array) -> None:
        """Take the pose of the first image that has none."""
        next(f for f in self._frames if f.T_odom_base is None).T_odom_base = T_odom_base
        self._settle()

    def angles(self, stamp_ns: int, angle_rad: Array) -> None:
        """Take the leg angles [rad] of a state, in the order of `legs`."""
        self._angles[stamp_ns] = angle_rad
        if len(self._angles) > _MOST_WAITING:
            del self._angles[min(self._angles)]
        self._settle()

    def check(self, what: str) -> None:
        """Raise SequenceError if an image waits for its leg angles; what: the bag, for messages.
        """
        if len(self._frames) > 1:
            raise SequenceError(f'{what}: no joint_states at the stamp of the image at '
                                f'{in_seconds(self._frames[0].stamp_ns)} s or of the next one, '
                                'which flow needs')

    def _settle(self) -> None:
        while len(self._frames) > 1:
            for frame in (self._frames[0], self._frames[1]):
                if frame.T_odom_base is None or frame.stamp_ns not in self._angles:
                    return
            self._write(self._frames.popleft(), self._frames[0])

    def _write(self, frame: _FlowFrame, following: _FlowFrame) -> None:
        assert frame.T_odom_base is not None and following.T_odom_base is not None
        links = self._links(frame.T_odom_base, frame.stamp_ns)
        links_then = self._links(following.T_odom_base, following.stamp_ns)
        bodies = [Moved(mask, links[k], links_then[k]) for k in range(len(links))
                  if (mask := frame.label == link_label(k)).any()]
        model = FlowModel(self._K, frame.depth_m, frame.T_odom_base @ self._T_base_camera,
                          following.T_odom_base @ self._T_base_camera, bodies)
        flow = model.optical_flow()
        depth_then = frame.depth_m + model.scene_flow()[..., 2]
        mask = seen_mask(flow, np.where(np.isnan(depth_then), np.inf, depth_then),
                         following.depth_m)
        name = self._folder / f'{frame.number:06d}_{following.number:06d}'
        np.save(f'{name}_flow.npy', np.nan_to_num(flow, nan=0.0), allow_pickle=False)
        np.save(f'{name}_mask.npy', mask, allow_pickle=False)

    def _links(self, T_odom_base: Array, stamp_ns: int) -> list[Array]:
        """Return the poses of base_link and the legs."""
        local = link_poses(self._rover, self._angles[stamp_ns])
        return [T_odom_base @ T for T in local.values()]


def seen_mask(flow: NDArray[np.float32], depth_then_m: NDArray[np.floating],
              depth_there_m: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return (h, w) what another image shows of each pixel's point: SEEN, HIDDEN or OUTSIDE.

    flow: (h, w, 2) to the other image [px]
    depth_then_m: (h, w) depth of the points in the other camera; depth_there_m: (h, w) what that
    camera sees. A point is hidden where all four pixels around it show something nearer.
    """
    height, width = depth_then_m.shape
    u = np.arange(width) + flow[..., 0]
    v = np.arange(height)[:, None] + flow[..., 1]
    with np.errstate(invalid='ignore'):
        inside = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    # The deepest of the four pixels around a place between them.
    deepest = cv2.dilate(depth_there_m, np.ones((2, 2), np.uint8), anchor=(0, 0),
                         borderType=cv2.BORDER_REPLICATE)
    rows = np.floor(np.where(inside, v, 0.0)).astype(int).clip(0, height - 1)
    columns = np.floor(np.where(inside, u, 0.0)).astype(int).clip(0, width - 1)
    hidden = depth_then_m > _CLOSE * deepest[rows, columns]
    return np.where(inside, np.where(hidden, HIDDEN, SEEN), OUTSIDE).astype(np.uint8)
