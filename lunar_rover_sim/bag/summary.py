"""What a recording came to, in a few lines."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from lunar_rover_sim import topics
from lunar_rover_sim.bag.digest import bag_hash
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.series import read_odometry


@dataclasses.dataclass(frozen=True)
class Summary:
    """Counts by topic, simulated time [s], path length [m], size [bytes], content hash."""

    counts: dict[str, int]
    duration_s: float
    distance_m: float
    size_bytes: int
    hash: str

    def lines(self, wall_s: float | None = None) -> str:
        """Return a readable text; `wall_s` is the wall time that the run took."""
        width = max(map(len, self.counts), default=0)
        table = [f'  {topic:{width}}  {count:7d}' for topic, count in sorted(self.counts.items())]
        pace = f', RTF {self.duration_s / wall_s:.2f} with start and stop' if wall_s else ''
        return '\n'.join([
            *table,
            f'{sum(self.counts.values())} messages, {self.duration_s:.2f} s{pace}, '
            f'{self.distance_m:.2f} m, {self.size_bytes / 1e6:.0f} MB',
            f'hash {self.hash}'])


def summarise(path: Path) -> Summary:
    """Return the summary of a bag; the distance is that along the true path."""
    with open_bag(path) as bag:
        distance_m = 0.0
        if bag.has(topics.ODOM.name):
            positions = read_odometry(bag).positions_m
            # Steps of 0.1 s or so: the bounce of the gait is no distance travelled.
            coarse = positions[::20, :2]
            distance_m = float(np.linalg.norm(np.diff(coarse, axis=0), axis=1).sum())
        return Summary(dict(bag.counts), bag.end_ns / 1e9, distance_m, bag.size_bytes,
                       bag_hash(path))
