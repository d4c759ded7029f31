"""TUM RGB-D sequences: rgb, depth, associations.txt, groundtruth.txt.

Depth is that of the scene, 16 bits, 5000 counts a metre; 0 where there is none or it lies beyond
13.1 m. Ground truth is the pose of the left camera, whose images they are (Sturm et al., IROS
2012).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lunar_rover_sim.bag.messages import pose_matrix
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import wxyz_from_matrix
from lunar_rover_sim.base.seconds import sortable_seconds
from lunar_rover_sim.products.sequences.orbslam3_settings import DEPTH_FACTOR
from lunar_rover_sim.products.sequences.sequence import (depth_counts, MOST_COUNTS, numbers,
                                                         PngWriter, Sequence)


class TumSequence(Sequence):
    """Writes a TUM RGB-D sequence."""

    needs = (topics.LEFT_IMAGE.name, topics.LEFT_INFO.name, topics.TRUE_DEPTH.name)
    uses = (topics.ODOM.name,)
    poses_of = 'groundtruth.txt: true poses of the left camera (its optical frame) in odom'
    layout = ('TUM RGB-D: rgb, depth (16-bit PNG, 5000 counts a metre), groundtruth.txt of the '
              'left camera, calibration.yaml')
    is_dated = True
    depth = {'depth': {'png_counts_per_m': DEPTH_FACTOR, 'along': 'optical axis', 'missing': 0}}

    def __init__(self, bag: Bag, folder: Path, png: PngWriter) -> None:
        super().__init__(bag, folder, png)
        self._T_base_left = self.suite.mounts['left']
        (folder / 'rgb').mkdir()
        (folder / 'depth').mkdir()
        self.line('rgb.txt', '# timestamp filename')
        self.line('depth.txt', '# timestamp filename')
        self.line('groundtruth.txt', f'# {self.poses_of.partition(": ")[2]}')
        self.line('groundtruth.txt', '# timestamp tx ty tz qx qy qz qw')

    def images(self, stamp_ns: int, pixels: dict[str, NDArray[Any]]) -> None:
        """Write image, depth and their lines."""
        stamp = self._stamp(stamp_ns)
        depth = depth_counts(pixels[topics.TRUE_DEPTH.name], DEPTH_FACTOR)
        for name, image in (('rgb', pixels[topics.LEFT_IMAGE.name]), ('depth', depth)):
            self.png.write(self.folder / name / f'{stamp}.png', image)
            self.line(f'{name}.txt', f'{stamp} {name}/{stamp}.png')
        self.line('associations.txt', f'{stamp} rgb/{stamp}.png {stamp} depth/{stamp}.png')

    def data(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Write the pose of the left camera."""
        T = pose_matrix(message) @ self._T_base_left
        w, x, y, z = wxyz_from_matrix(T[:3, :3])
        self.line('groundtruth.txt',
                  f'{self._stamp(stamp_ns)} {numbers(T[:3, 3], [x, y, z, w])}')

    def _stamp(self, stamp_ns: int) -> str:
        return sortable_seconds(stamp_ns + self.epoch_ns)

    def notes(self) -> list[str]:
        """Return the depth factor."""
        return [f'depth: {DEPTH_FACTOR:g} counts a metre, 0 beyond '
                f'{MOST_COUNTS / DEPTH_FACTOR:.1f} m']
