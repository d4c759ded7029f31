"""KITTI odometry sequences: image_0, image_1, calib.txt, times.txt, poses.txt.

Each image has a line with the pose of the left camera in the frame of the first one: the upper
three rows of the matrix (Geiger et al., CVPR 2012).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.frames import Array, inverse
from lunar_rover_sim.sequences.posed import PosedSequence
from lunar_rover_sim.sequences.sequence import numbers, PngWriter


class KittiSequence(PosedSequence):
    """Writes a KITTI odometry sequence."""

    POSES = 'poses.txt'
    needs = (topics.LEFT_IMAGE.name, topics.RIGHT_IMAGE.name, topics.LEFT_INFO.name)

    def __init__(self, bag: Bag, folder: Path, png: PngWriter) -> None:
        super().__init__(bag, folder, png)
        self._T_base_left = self.suite.T_base_imu @ self.suite.T_imu_left
        self._T_first_odom: Array | None = None
        for name in ('image_0', 'image_1'):
            (folder / name).mkdir()
        suite = self.suite
        for k, baseline_m in enumerate((0.0, suite.baseline_m, 0.0, suite.baseline_m)):
            P = [[suite.focal_px[0], 0.0, suite.centre_px[0], -suite.focal_px[0] * baseline_m],
                 [0.0, suite.focal_px[1], suite.centre_px[1], 0.0], [0.0, 0.0, 1.0, 0.0]]
            self.line('calib.txt', f'P{k}: {numbers(P)}')

    def images(self, stamp_ns: int, pixels: dict[str, NDArray[Any]]) -> None:
        """Write the pair, its stamp, and its pose as soon as it is known."""
        for name, topic in (('image_0', topics.LEFT_IMAGE), ('image_1', topics.RIGHT_IMAGE)):
            self.png.write(self.folder / name / f'{self.count:06d}.png', pixels[topic.name])
        self.taken(stamp_ns)

    def write_pose(self, T_odom_base: Array) -> None:
        """Write the pose in the frame of the first one."""
        T = T_odom_base @ self._T_base_left
        if self._T_first_odom is None:
            self._T_first_odom = inverse(T)
        self.line('poses.txt', numbers((self._T_first_odom @ T)[:3]))
