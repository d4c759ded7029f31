"""KITTI odometry sequences: image_0, image_1, velodyne, calib.txt, times.txt, poses.txt.

Each image has a line with the pose of the left camera in the frame of the first one: the upper
three rows of the matrix (Geiger et al., CVPR 2012). Where the bag has clouds of a LiDAR, each has
a scan in velodyne as well: see `velodyne.py`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag.messages import pose_matrix
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.frames import Array, inverse
from lunar_rover_sim.seconds import in_seconds
from lunar_rover_sim.sequences.posed import PosedSequence
from lunar_rover_sim.sequences.sensor_samples import CLOUDS
from lunar_rover_sim.sequences.sequence import numbers, PngWriter
from lunar_rover_sim.sequences.velodyne import recorded_cloud, VelodyneFiles


class KittiSequence(PosedSequence):
    """Writes a KITTI odometry sequence."""

    POSES = 'poses.txt'
    poses_of = ('poses.txt: true poses of the left camera (its optical frame) in its first frame, '
                'one for each image')
    needs = (topics.LEFT_IMAGE.name, topics.RIGHT_IMAGE.name, topics.LEFT_INFO.name)
    uses = (*PosedSequence.uses, *CLOUDS)

    def __init__(self, bag: Bag, folder: Path, png: PngWriter) -> None:
        cloud = recorded_cloud(bag)
        self.uses = (*PosedSequence.uses, *([cloud] if cloud else []))
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
        self._velodyne: VelodyneFiles | None = None
        if cloud is not None and self.T_base_lidar is not None:
            self._velodyne = VelodyneFiles(bag, cloud, folder, self.T_base_lidar)
            T_left_lidar = inverse(self._T_base_left) @ self.T_base_lidar
            self.line('calib.txt', f'Tr: {numbers(T_left_lidar[:3])}')
            self.first_ns = self._velodyne.first_ns
            self.lacks = {name: f'velodyne holds {cloud}' for name in CLOUDS}

    def images(self, stamp_ns: int, pixels: dict[str, NDArray[Any]]) -> None:
        """Write the pair, its stamp, and its pose and scan as soon as they are known."""
        for name, topic in (('image_0', topics.LEFT_IMAGE), ('image_1', topics.RIGHT_IMAGE)):
            self.png.write(self.folder / name / f'{self.count:06d}.png', pixels[topic.name])
        if self._velodyne is not None:
            self._velodyne.image(stamp_ns)
        self.taken(stamp_ns)

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
