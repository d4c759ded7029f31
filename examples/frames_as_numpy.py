"""Go through the stereo frames of a bag as NumPy arrays: images, depth, and the true pose."""

from pathlib import Path
import sys

import numpy as np

from lunar_rover_sim import open_bag


def main(path: Path) -> int:
    """Print a line on each frame; return how many there are."""
    count = 0
    with open_bag(path) as bag:
        for frame in bag.frames():      # one at a time, however long the bag is
            count += 1
            said = f'{frame.stamp_ns * 1e-9:.3f} s: {frame.left.shape} of {frame.left.dtype}'
            if frame.depth_m is not None:
                seen = frame.depth_m[np.isfinite(frame.depth_m) & (frame.depth_m > 0)]
                said += f', nearest {seen.min():.2f} m'
            if frame.pose is not None:  # T_world_base (4, 4)
                said += f', at {frame.pose[:3, 3].round(3)} m'
            print(said)
    return count


if __name__ == '__main__':
    if len(sys.argv) != 2:
        sys.exit('usage: python examples/frames_as_numpy.py BAG')
    main(Path(sys.argv[1]))
