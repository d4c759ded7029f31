"""KITTI odometry sequences: image_0, image_1, velodyne, calib.txt, times.txt, poses.txt.

Images of colour sensors are in image_2 and image_3, and grey ones of them in image_0 and image_1.
Each image has a line with the pose of the left camera in the frame of the first one: the upper
three rows of the matrix (Geiger et al., CVPR 2012). Where the bag has clouds of a LiDAR, each has
a scan in velodyne as well: see `VelodyneFiles`.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.messages import header_ns, pose_matrix
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import SequenceError
from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.base.seconds import in_seconds
from lunar_rover_sim.image.stereo.depth import grey
from lunar_rover_sim.products.sequences.sensor_samples import (cloud_rows, CLOUDS, KEPT_NS,
                                                               LATE_NS, RecentMessages)
from lunar_rover_sim.products.sequences.sequence import numbers, PngWriter, PosedSequence

_FULL_PERCENT = 100.0       # a reflectance of 1
_POSES = ''                 # the only topic of its kind
_POSES_NS = 3 * KEPT_NS     # a scan lasts 1 s at most


def recorded_cloud(bag: Bag) -> str | None:
    """Return the topic of the clouds that a sequence holds; None where the bag has none."""
    return next((name for name in reversed(CLOUDS) if bag.count(name)), None)


class VelodyneFiles:
    """Writes the scan of each image once it is known.

    Attributes:
        first_ns: Stamp of the first scan; images before it have none.
        stamps_ns: Of the scans that were written, one for each image.
    """

    def __init__(self, bag: Bag, cloud: str, folder: Path, T_base_lidar: Array) -> None:
        self._path, self._cloud, self._folder = bag.path, cloud, folder / 'velodyne'
        self._folder.mkdir()
        self._T_base_lidar = T_base_lidar
        self._moves = cloud == topics.LIDAR_DESKEWED.name and bag.has(bag.truth)
        self._scans: RecentMessages[NDArray[np.float32]] = RecentMessages()
        self._poses: RecentMessages[Array] = RecentMessages(_POSES_NS)
        self._waiting: deque[int] = deque()     # stamps of images
        self.first_ns = header_ns(bag.first(cloud))
        self.stamps_ns: list[int] = []

    @property
    def note(self) -> str:
        """What the folder holds."""
        return (f'velodyne: {self._cloud}, of each image the last scan that began at or before '
                'it' + (', in the frame of the LiDAR at the image' if self._moves else ''))

    def image(self, stamp_ns: int) -> None:
        """Take the stamp of the next image."""
        self._write(stamp_ns - LATE_NS)
        self._waiting.append(stamp_ns)

    def scan(self, stamp_ns: int, message: Any) -> None:
        """Take a cloud."""
        self._write(stamp_ns - KEPT_NS)
        rows = cloud_rows(f'{self._path}: {self._cloud}', message)[:, :4]
        rows[:, 3] /= _FULL_PERCENT
        self._scans.add(self._cloud, stamp_ns, rows)

    def pose(self, stamp_ns: int, T_odom_base: Array) -> None:
        """Take a true pose."""
        if self._moves:
            self._poses.add(_POSES, stamp_ns, T_odom_base)

    def finish(self) -> None:
        """Write what is left."""
        self._write(None)

    def _write(self, before_ns: int | None) -> None:
        """Write the scans of images of earlier stamps; None: of all."""
        while self._waiting and (before_ns is None or self._waiting[0] < before_ns):
            image_ns = self._waiting.popleft()
            found = self._scans.at(self._cloud, image_ns)
            if found is None:
                raise SequenceError(f'{self._path}: {self._cloud}: no scan at or before the image '
                                    f'at {in_seconds(image_ns)} s, though there are earlier ones; '
                                    'messages are not in the order of their stamps')
            scan_ns, rows = found
            if self._moves:
                T = inverse(self._T_odom_lidar(image_ns)) @ self._T_odom_lidar(scan_ns)
                rows = np.concatenate([rows[:, :3] @ T[:3, :3].T + T[:3, 3], rows[:, 3:]], axis=1)
            (self._folder / f'{len(self.stamps_ns):06d}.bin').write_bytes(
                rows.astype('<f4').tobytes())
            self.stamps_ns.append(scan_ns)

    def _T_odom_lidar(self, stamp_ns: int) -> Array:
        found = self._poses.at(_POSES, stamp_ns)
        if found is None or found[0] != stamp_ns:
            raise SequenceError(f'{self._path}: no odometry at {in_seconds(stamp_ns)} s, which '
                                f'velodyne needs; valid is one of each image and {self._cloud}')
        return found[1] @ self._T_base_lidar


class KittiSequence(PosedSequence):
    """Writes a KITTI odometry sequence."""

    POSES = 'poses.txt'
    poses_of = ('poses.txt: true poses of the left camera (its optical frame) in its first frame, '
                'one for each image')
    layout = ('KITTI odometry: image_0, image_1, in colour image_2, image_3, calib.txt, '
              'times.txt, poses.txt; with LiDAR clouds, velodyne')
    needs = (topics.LEFT_IMAGE.name, topics.RIGHT_IMAGE.name, topics.LEFT_INFO.name)
    uses = (*PosedSequence.uses, *CLOUDS)

    def __init__(self, bag: Bag, folder: Path, png: PngWriter) -> None:
        cloud = recorded_cloud(bag)
        self.uses = (*PosedSequence.uses, *([cloud] if cloud else []))
        super().__init__(bag, folder, png)
        self._T_base_left = self.suite.mounts['left']
        self._T_first_odom: Array | None = None
        for k, baseline_m in enumerate(2 * (0.0, self.suite.baseline_m)):
            self.line('calib.txt', f'P{k}: {numbers(self.suite.P(baseline_m))}')
        self._velodyne: VelodyneFiles | None = None
        if cloud is not None and self.T_base_lidar is not None:
            self._velodyne = VelodyneFiles(bag, cloud, folder, self.T_base_lidar)
            T_left_lidar = inverse(self._T_base_left) @ self.T_base_lidar
            self.line('calib.txt', f'Tr: {numbers(T_left_lidar[:3])}')
            self.first_ns = self._velodyne.first_ns
            self.lacks = {name: f'velodyne holds {cloud}' for name in CLOUDS}

    def images(self, stamp_ns: int, pixels: dict[str, NDArray[Any]]) -> None:
        """Write the pair, its stamp, and its pose and scan as soon as they are known."""
        for side, topic in enumerate((topics.LEFT_IMAGE, topics.RIGHT_IMAGE)):
            image = pixels[topic.name]
            if image.ndim == 3:
                self._write_image(2 + side, image)
            self._write_image(side, grey(image))
        if self._velodyne is not None:
            self._velodyne.image(stamp_ns)
        self.taken(stamp_ns)

    def _write_image(self, camera: int, image: NDArray[Any]) -> None:
        folder = self.folder / f'image_{camera}'
        if not self.count:
            folder.mkdir()
        self.png.write(folder / f'{self.count:06d}.png', image)

    def data(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Keep poses and scans until their images come."""
        if topic == topics.ODOM.name:
            super().data(topic, stamp_ns, message)
            if self._velodyne is not None:
                self._velodyne.pose(stamp_ns, pose_matrix(message))
        elif self._velodyne is not None:
            self._velodyne.scan(stamp_ns, message)

    def write_pose(self, T_odom_base: Array) -> None:
        """Write the pose in the frame of the first one."""
        T = T_odom_base @ self._T_base_left
        if self._T_first_odom is None:
            self._T_first_odom = inverse(T)
        self.line('poses.txt', numbers((self._T_first_odom @ T)[:3]))

    def notes(self) -> list[str]:
        """Write the last scans; return what is missing, and what velodyne holds."""
        notes = super().notes()
        if self._velodyne is not None:
            self._velodyne.finish()
            for scan_ns in self._velodyne.stamps_ns:
                self.line('velodyne_times.txt', in_seconds(scan_ns))
            notes.append(self._velodyne.note)
        return notes
