"""Sequences with one pose per stereo pair: images and odometry wait for each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lunar_rover_sim import topics
from lunar_rover_sim.bag.messages import pose_matrix
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.errors import SequenceError
from lunar_rover_sim.frames import Array
from lunar_rover_sim.seconds import in_seconds
from lunar_rover_sim.sequences.sequence import PngWriter, Sequence

_MOST_WAITING = 2000    # poses kept in memory


class PosedSequence(Sequence):
    """Numbers the images; passes the pose of each to `write_pose`, in order, when it is known.

    POSES: name of the file with the poses, for messages
    has_truth: whether the bag has true odometry; there are no poses otherwise
    count: of the images so far; path: of the bag
    """

    POSES = ''
    uses: tuple[str, ...] = (topics.ODOM.name,)

    def __init__(self, bag: Bag, folder: Path, png: PngWriter) -> None:
        super().__init__(bag, folder, png)
        self.path = bag.path
        self.has_truth = bag.has(bag.truth)
        self._poses: dict[int, Array] = {}
        self._waiting: list[int] = []
        self.count = 0

    def write_pose(self, T_odom_base: Array) -> None:
        """Take the (4, 4) pose of the next image."""
        raise NotImplementedError

    def taken(self, stamp_ns: int) -> None:
        """Note that an image with this stamp was written."""
        self.line('times.txt', in_seconds(stamp_ns))
        self.count += 1
        if self.has_truth:
            self._waiting.append(stamp_ns)
            self._settle()

    def data(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Keep the pose until its image comes."""
        self._poses[stamp_ns] = pose_matrix(message)
        if len(self._poses) > _MOST_WAITING:
            del self._poses[min(self._poses)]
        self._settle()

    def notes(self) -> list[str]:
        """Return a note if there are no poses; raise SequenceError if an image lacks its pose."""
        if self._waiting:
            raise SequenceError(f'{self.path}: no odometry at the stamp of the image at '
                                f'{in_seconds(self._waiting[0])} s, which {self.POSES} needs')
        return [] if self.has_truth else [f'no odometry in the bag: {self.POSES} is missing']

    def _settle(self) -> None:
        while self._waiting and self._waiting[0] in self._poses:
            self.write_pose(self._poses.pop(self._waiting.pop(0)))
