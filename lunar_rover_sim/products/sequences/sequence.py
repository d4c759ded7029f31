"""The part that sequence formats share: PNG files from threads, text files, sensors."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar, TextIO

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.messages import pose_matrix
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.closing import Closing
from lunar_rover_sim.base.errors import SequenceError
from lunar_rover_sim.base.files.images import write_png
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.seconds import in_seconds
from lunar_rover_sim.products.sequences.sensors import (further_cameras, recorded_sensors,
                                                        RecordedCamera, SensorSuite)
from lunar_rover_sim.run.recorded_run import RecordedRun

_THREADS = 2
_QUEUE = 8        # images in memory
_COMPRESSION = 1  # of 9; the next levels cost twice the time for 3 % of the size


class PngWriter:
    """Writes PNG files from a few threads; at most a few images wait at any time."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(_THREADS)
        self._waiting: deque[Future[None]] = deque()

    def write(self, path: Path, pixels: NDArray[Any]) -> None:
        """Write (h, w) or RGB (h, w, 3) pixels, 8 or 16 bits; errors appear at a later call."""
        self._waiting.append(self._pool.submit(write_png, path, pixels, _COMPRESSION))
        while len(self._waiting) > _QUEUE:
            self._waiting.popleft().result()

    def finish(self) -> None:
        """Wait until everything is written; raise OSError where something was not."""
        while self._waiting:
            self._waiting.popleft().result()

    def __enter__(self) -> PngWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        try:
            if error is None:
                self.finish()
        finally:
            self._pool.shutdown(cancel_futures=True)


class Sequence(Closing):
    """A sequence that is written into a folder. A format sets the attributes and overrides
    `images`, `data` and, where it has something to say, `notes`.

    Attributes:
        needs, uses: Topics of the contract that must, or may, be in the bag.
        depth: Units of the depth images, as they are written to calibration.yaml.
        of_further: Which topics of hazard cameras the format has a place for, images first.
        further_needs: What such a camera needs to be written, for messages.
        further: The hazard cameras of the bag that it writes; `of_further` of each make a set.
        lacks: Topic of a sensor → what it lacks to be written, where the format has a place for
            it.
        poses_of: What the poses are of and where they stand, a sentence for README.txt.
        layout: The files of the format, a sentence for the card of a data set.
        is_dated: Whether files are named by time, which then counts from `epoch_ns`.
        epoch_ns: Unix time [ns] at which simulated time is 0.
        first_ns: Images before are left out.
        T_base_lidar: (4, 4) where the LiDAR is, if its scans are written.
    """

    needs: ClassVar[tuple[str, ...]] = ()
    uses: tuple[str, ...] = ()
    depth: Mapping[str, Mapping[str, Any]] = {}
    of_further: ClassVar[tuple[topics.Topic, ...]] = ()
    further_needs: ClassVar[str] = ''
    lacks: Mapping[str, str] = {}
    poses_of: ClassVar[str] = ''
    layout: ClassVar[str] = ''
    is_dated: ClassVar[bool] = False
    epoch_ns = 0
    first_ns = 0

    def __init__(self, bag: Bag, folder: Path, png: PngWriter) -> None:
        for name in self.needs:
            if not bag.has(name):
                raise SequenceError(f'{bag.path}: lacks {name}, which this format needs')
        self.folder = folder
        self.png = png
        self.suite: SensorSuite = recorded_sensors(bag, self.needs)
        self.further = [c for c in further_cameras(bag) if self.has_place_for(c)] \
            if self.of_further else []
        scans = {topic.name for topic in topics.OF_LIDAR}.intersection(self.needs + self.uses)
        self.T_base_lidar = (RecordedRun(bag).frame('lidar')
                             if any(bag.has(name) for name in scans) else None)
        self._files: dict[str, TextIO] = {}

    def has_place_for(self, camera: RecordedCamera) -> bool:
        """Return whether the images of a hazard camera are written."""
        return True

    def images(self, stamp_ns: int, pixels: dict[str, NDArray[Any]]) -> None:
        """Take one complete set of images, by topic."""
        raise NotImplementedError

    def further_images(self, camera: RecordedCamera, stamp_ns: int,
                       pixels: dict[str, NDArray[Any]]) -> None:
        """Take one complete set of a hazard camera, by its topics in the bag."""
        raise NotImplementedError

    def data(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Take a message that is not an image."""
        raise NotImplementedError

    def notes(self) -> list[str]:
        """Return sentences for the user about the sequence."""
        return []

    def line(self, name: str, text: str) -> None:
        """Append a line to the text file `name` below the folder."""
        if name not in self._files:
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            self._files[name] = path.open('w', encoding='ascii')
        self._files[name].write(text + '\n')

    def close(self) -> None:
        """Close the text files."""
        while self._files:
            self._files.popitem()[1].close()


def numbers(*values: Any, separator: str = ' ') -> str:
    """Return numbers that read back exactly."""
    flat = np.concatenate([np.ravel(v) for v in values])
    return separator.join(repr(float(v) + 0.0) for v in flat)  # no -0.0


MOST_COUNTS = 65535     # of 16 bits


def depth_counts(depth_m: NDArray[np.float32], per_m: float) -> NDArray[np.uint16]:
    """Return depth in counts; 0 where there is none or it does not fit 16 bits."""
    with np.errstate(invalid='ignore', over='ignore'):
        counts = np.rint(depth_m.astype(float) * per_m)
        known = np.isfinite(counts) & (counts >= 0.0) & (counts <= MOST_COUNTS)
    return np.where(known, counts, 0).astype(np.uint16)


_MOST_WAITING = 2000    # poses kept in memory


class PosedSequence(Sequence):
    """Numbers the images; passes the pose of each to `write_pose`, in order, when it is known.

    Attributes:
        POSES: Name of the file with the poses, for messages.
        has_truth: Whether the bag has true odometry; there are no poses otherwise.
        count: Of the images so far.
        path: Of the bag.
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
