"""TartanAir sequences: images, depth, segmentation and flow in folders, poses of both cameras.

The layout of the data set of Wang et al. (TartanAir: A Dataset to Push the Limits of Visual
SLAM, IROS 2020): images and depth are numbered from 000000; one line `tx ty tz qx qy qz qw` an
image gives the pose of that camera, its axes forward, right, down, in a north-east-down world
(x north, y east, z down; our odom frame is x east, y north, z up). Depth is float32 in metres
along the optical axis, the sky 10,000; besides, as 16-bit PNG in mm, 0 where there is none or it
lies beyond 65.5 m. times.txt holds the stamps [s], which the original lacks.

Where the bag has depth or labels of the right camera, they lie in depth_right, depth_right_mm and
seg_right. Where it has labels, seg_left holds classes (seg_label_map.json names them), and flow
leads to the next image: NUMBER_NUMBER_flow.npy, (h, w, 2) float32, right and down [px], with a
mask of what the next image shows: 0 seen, 1 hidden, 100 outside.
"""

from __future__ import annotations

from collections import deque
import dataclasses
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.messages import joint_order
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import SequenceError
from lunar_rover_sim.base.files.arrays import npy_bytes
from lunar_rover_sim.base.frames import Array, wxyz_from_matrix
from lunar_rover_sim.base.seconds import in_seconds
from lunar_rover_sim.image.camera.flow import FlowModel, Moved
from lunar_rover_sim.image.rendering.labels import class_names, LABEL_FIRST_ROCK, link_label
from lunar_rover_sim.products.sequences.labelled import check_pinhole
from lunar_rover_sim.products.sequences.sequence import (depth_counts, numbers, PngWriter,
                                                         PosedSequence)
from lunar_rover_sim.rover.description import Legs, RoverDescription
from lunar_rover_sim.rover.visual import link_poses
from lunar_rover_sim.run.recorded_run import RecordedRun

SKY_M = 10_000.0
# Rocks are one class: the format has 8 bits. The labels below it stay.
ROCK = LABEL_FIRST_ROCK
_MM_PER_M = 1000.0
# Rows: north, east, down in x east, y north, z up.
_R_NED_ODOM: Array = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# Columns: forward, right, down in the optical frame (x right, y down, z forward).
_R_OPTICAL_FRD: Array = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


class TartanAirSequence(PosedSequence):
    """Writes a TartanAir sequence; segmentation and flow where the bag has labels."""

    POSES = 'pose_left.txt'
    poses_of = ('pose_left.txt, pose_right.txt: true poses of each camera (its axes forward, '
                'right, down) in a north-east-down world, one for each image')
    layout = ('TartanAir: image_left, image_right, depth_left (npy, metres; and 16-bit PNG, '
              'millimetres), pose_left.txt, pose_right.txt (NED), calibration.yaml; with labels, '
              'seg_left and flow')
    needs = (topics.LEFT_IMAGE.name, topics.RIGHT_IMAGE.name, topics.LEFT_INFO.name,
             topics.TRUE_DEPTH.name)
    uses = (topics.ODOM.name, topics.LABELS.name, topics.JOINT_STATES.name,
            topics.RIGHT_TRUE_DEPTH.name, topics.RIGHT_LABELS.name)

    def __init__(self, bag: Bag, folder: Path, png: PngWriter) -> None:
        super().__init__(bag, folder, png)
        suite = self.suite
        self._mounts = suite.mounts
        sides = ('left', 'right') if bag.has(topics.RIGHT_TRUE_DEPTH.name) else ('left',)
        for side in sides:
            self.depth = {**self.depth, f'depth_{side}': {
                'npy_unit': 'm', 'along': 'optical axis', 'sky_m': SKY_M}, f'depth_{side}_mm': {
                'png_counts_per_m': _MM_PER_M, 'along': 'optical axis', 'missing': 0}}
        for name in ('image_left', 'image_right', *self.depth):
            (folder / name).mkdir()
        self._missing: list[str] = []
        self._segments = bag.has(topics.LABELS.name)
        self._flow = self._flow_files(bag)
        segmented = [side for side, topic in (('left', topics.LABELS),
                                              ('right', topics.RIGHT_LABELS))
                     if bag.has(topic.name)]
        for side in segmented:
            check_pinhole(suite, str(bag.path))
            (folder / f'seg_{side}').mkdir()
        if segmented:
            names = {**class_names(0, recorded_scenario(bag).legs), ROCK: 'rock'}
            (folder / 'seg_label_map.json').write_text(json.dumps(
                {'name_map': {name: k for k, name in names.items()}}, indent=1) + '\n',
                encoding='ascii')

    def images(self, stamp_ns: int, pixels: dict[str, NDArray[Any]]) -> None:
        """Write the pair, its depth and its stamp, and its poses as soon as they are known."""
        number = f'{self.count:06d}'
        for side, topic in (('left', topics.LEFT_IMAGE), ('right', topics.RIGHT_IMAGE)):
            self.png.write(self.folder / f'image_{side}' / f'{number}_{side}.png',
                           pixels[topic.name])
        for side, depth, labels in (
                ('left', topics.TRUE_DEPTH, topics.LABELS),
                ('right', topics.RIGHT_TRUE_DEPTH, topics.RIGHT_LABELS)):
            if depth.name in pixels:
                self._write_depth(f'{number}_{side}', side, pixels[depth.name])
            if labels.name in pixels:
                (self.folder / f'seg_{side}' / f'{number}_{side}_seg.npy').write_bytes(
                    npy_bytes(classes(pixels[labels.name])))
        if self._flow is not None:
            self._flow.image(self.count, stamp_ns,
                             pixels[topics.TRUE_DEPTH.name].astype(np.float32),
                             pixels[topics.LABELS.name])
        self.taken(stamp_ns)

    def _write_depth(self, name: str, side: str, depth: NDArray[Any]) -> None:
        depth_m = depth.astype(np.float32)
        (self.folder / f'depth_{side}' / f'{name}_depth.npy').write_bytes(
            npy_bytes(np.where(np.isfinite(depth_m), depth_m, np.float32(SKY_M))))
        self.png.write(self.folder / f'depth_{side}_mm' / f'{name}_depth.png',
                       depth_counts(depth_m, _MM_PER_M))

    def data(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Keep poses and leg angles until their image comes."""
        if topic == topics.ODOM.name:
            super().data(topic, stamp_ns, message)
        elif self._flow is not None:
            order = joint_order(message, self._flow.legs, self.path)
            self._flow.angles(stamp_ns, np.asarray(message.position, float)[order])

    def notes(self) -> list[str]:
        """Return what is missing; SequenceError where an image has no pose."""
        notes = super().notes()
        if self._flow is not None:
            self._flow.check(str(self.path))
        return [*self._missing, *notes]

    def write_pose(self, T_odom_base: Array) -> None:
        """Write the poses of both cameras."""
        for side, T_base_camera in self._mounts.items():
            position, wxyz = ned_pose(T_odom_base @ T_base_camera)
            w, x, y, z = wxyz
            self.line(f'pose_{side}.txt', numbers(position, [x, y, z, w]))
        if self._flow is not None:
            self._flow.pose(T_odom_base)

    def _flow_files(self, bag: Bag) -> FlowFiles | None:
        """Return what writes flow; None, with a note, where something for it is missing."""
        if not self._segments:
            self._missing.append(f'no {topics.LABELS.name} in the bag: segmentation and flow are '
                                 'not written')
            return None
        rover = RecordedRun(bag).rover
        for what, is_there in (('odometry', self.has_truth),
                               (topics.JOINT_STATES.name, bag.has(topics.JOINT_STATES.name)),
                               ('description of the rover', rover is not None)):
            if not is_there:
                self._missing.append(f'no {what} in the bag: flow is not written')
                return None
        assert rover is not None
        (self.folder / 'flow').mkdir()
        return FlowFiles(self.folder / 'flow', self.suite.K, self._mounts['left'], rover)


def ned_pose(T_odom_camera: Array) -> tuple[Array, Array]:
    """Return position (3,) [m] and quaternion wxyz (4,) of a camera, north-east-down.

    Args:
        T_odom_camera: (4, 4), of the optical frame. The camera's axes are forward, right, down.
    """
    rotation = _R_NED_ODOM @ T_odom_camera[:3, :3] @ _R_OPTICAL_FRD
    return _R_NED_ODOM @ T_odom_camera[:3, 3], wxyz_from_matrix(rotation)


def classes(label: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Return labels as classes; all rocks are one."""
    return np.minimum(label, ROCK).astype(np.uint8)


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

    Args:
        K: (3, 3) intrinsics [px].
        T_base_camera: (4, 4).
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
        name = f'{frame.number:06d}_{following.number:06d}'
        (self._folder / f'{name}_flow.npy').write_bytes(npy_bytes(np.nan_to_num(flow, nan=0.0)))
        (self._folder / f'{name}_mask.npy').write_bytes(npy_bytes(mask))

    def _links(self, T_odom_base: Array, stamp_ns: int) -> list[Array]:
        """Return the poses of base_link and the legs."""
        local = link_poses(self._rover, self._angles[stamp_ns])
        return [T_odom_base @ T for T in local.values()]


def seen_mask(flow: NDArray[np.float32], depth_then_m: NDArray[np.floating],
              depth_there_m: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return (h, w) what another image shows of each pixel's point: SEEN, HIDDEN or OUTSIDE.

    Args:
        flow: (h, w, 2) to the other image [px].
        depth_then_m: (h, w) depth of the points in the other camera.
        depth_there_m: (h, w) what that camera sees. A point is hidden where all four pixels around
            it show something nearer.
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
