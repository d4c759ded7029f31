"""KITTI odometry sequences: image_0, image_1, calib.txt, times.txt, poses.txt.

Poses are those of the left camera in the frame of the first one, the upper three rows of each
matrix (Geiger et al., CVPR 2012); one line an image.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.sequence import numbers, pose_of, PngWriter, Sequence
from lunar_rover_sim.bag.stamps import in_seconds
from lunar_rover_sim.errors import BagError
from lunar_rover_sim.frames import Array, inverse


class KittiSequence(Sequence):
    """Writes a KITTI odometry sequence."""

    needs = (topics.LEFT_IMAGE.name, topics.RIGHT_IMAGE.name, topics.LEFT_INFO.name)
    uses = (topics.ODOM.name,)

    def __init__(self, bag: Bag, folder: Path, png: PngWriter) -> None:
        super().__init__(bag, folder, png)
        self._path = bag.path
        self._T_base_left = self.suite.T_base_imu @ self.suite.T_imu_left
        self._T_first_odom: Array | None = None
        self._has_truth = bag.has(topics.ODOM.name)
        self._poses: dict[int, Array] = {}
        self._waiting: list[int] = []
        self._count = 0
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
            self.png.write(self.folder / name / f'{self._count:06d}.png', pixels[topic.name])
        self.line('times.txt', in_seconds(stamp_ns))
        self._count += 1
        if self._has_truth:
            self._waiting.append(stamp_ns)
            self._settle()

    def data(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Keep the pose until its image comes."""
        self._poses[stamp_ns] = pose_of(message) @ self._T_base_left
        if len(self._poses) > 2000:
            del self._poses[min(self._poses)]
        self._settle()

    def notes(self) -> list[str]:
        """Tell whether there are poses; BagError where an image has none."""
        if self._waiting:
            raise BagError(f'{self._path}: no odometry at the stamp of the image at '
                           f'{in_seconds(self._waiting[0])} s, which poses.txt needs')
        return [] if self._has_truth else ['no odometry in the bag: poses.txt is missing']

    def _settle(self) -> None:
        while self._waiting and self._waiting[0] in self._poses:
            T = self._poses.pop(self._waiting.pop(0))
            if self._T_first_odom is None:
                self._T_first_odom = inverse(T)
            self.line('poses.txt', numbers((self._T_first_odom @ T)[:3]))
