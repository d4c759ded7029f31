"""Go through the stereo frames of a bag as NumPy arrays: images, depth, and the true pose."""

from collections.abc import Iterator
from pathlib import Path
import sys
from typing import NamedTuple

import numpy as np

from lunar_rover_sim import open_bag, topics
from lunar_rover_sim.bag.series import common_stamps, picture, read_odometry

STEREO = (topics.LEFT_IMAGE.name, topics.RIGHT_IMAGE.name, topics.TRUE_DEPTH.name)


class Frame(NamedTuple):
    """One moment: grey images (h, w), depth (h, w) [m], position [m], orientation wxyz."""

    stamp_ns: int
    left: np.ndarray
    right: np.ndarray
    depth_m: np.ndarray
    position_m: np.ndarray
    orientation_wxyz: np.ndarray


def frames(path: Path) -> Iterator[Frame]:
    """Yield the frames that have both images and depth, one at a time."""
    with open_bag(path) as bag:
        odometry = read_odometry(bag)
        topic_of = {bag.resolve(name): name for name in STEREO}
        for stamp_ns in common_stamps(bag, STEREO):
            found = {topic_of[topic]: picture(bag, message).pixels
                     for topic, _, message in bag.messages(STEREO, stamp_ns, stamp_ns + 1)}
            k = int(np.searchsorted(odometry.stamps_ns, stamp_ns))
            yield Frame(stamp_ns, *(found[name] for name in STEREO), odometry.positions_m[k],
                        odometry.orientations_wxyz[k])


def main(path: Path) -> None:
    """Print a line on each frame."""
    for frame in frames(path):
        near_m = np.nanmin(np.where(frame.depth_m > 0, frame.depth_m, np.nan))
        print(f'{frame.stamp_ns * 1e-9:.3f} s: {frame.left.shape}, mean {frame.left.mean():.1f}, '
              f'nearest {near_m:.2f} m, at {frame.position_m.round(3)}')


if __name__ == '__main__':
    main(Path(sys.argv[1]))
