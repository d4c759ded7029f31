"""The folder velodyne of a KITTI sequence: a scan for each image.

NNNNNN.bin holds float32 x, y, z [m] and reflectance of each point; the transform `Tr` maps points
to the left camera, `P0 Tr x` to its image (Geiger et al., CVPR 2012, and the readme of its
devkit). The scan of an image is the last that began at or before it.

Scans of KITTI's odometry are free of the motion during the scan, and in the frame of the LiDAR at
the time of the image. So deskewed clouds are taken where the bag has them, and the true motion
from the start of the scan to the image is applied. Without those, points are as the sensor saw
them, each at its own time.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.errors import SequenceError
from lunar_rover_sim.frames import Array, inverse
from lunar_rover_sim.seconds import in_seconds
from lunar_rover_sim.sequences.sensor_samples import (cloud_rows, CLOUDS, KEPT_NS, LATE_NS,
                                                      RecentMessages)

_FULL_PERCENT = 100.0       # a reflectance of 1
_POSES = ''                 # the only topic of its kind
_POSES_NS = 3 * KEPT_NS     # a scan lasts 1 s at most


def recorded_cloud(bag: Bag) -> str | None:
    """Return the topic of the clouds that a sequence holds; None where the bag has none."""
    return next((name for name in reversed(CLOUDS) if bag.count(name)), None)


class VelodyneFiles:
    """Writes the scan of each image once it is known.

    first_ns: stamp of the first scan; images before it have none
    stamps_ns: of the scans that were written, one for each image
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
            rows.astype('<f4').tofile(self._folder / f'{len(self.stamps_ns):06d}.bin')
            self.stamps_ns.append(scan_ns)

    def _T_odom_lidar(self, stamp_ns: int) -> Array:
        found = self._poses.at(_POSES, stamp_ns)
        if found is None or found[0] != stamp_ns:
            raise SequenceError(f'{self._path}: no odometry at {in_seconds(stamp_ns)} s, which '
                                f'velodyne needs; valid is one of each image and {self._cloud}')
        return found[1] @ self._T_base_lidar
