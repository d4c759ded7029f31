"""Summary of a recording: counts, duration, distance, size, hash, and how well it is tracked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
import dataclasses
from pathlib import Path

from lunar_rover_sim import topics
from lunar_rover_sim.bag.content_hash import bag_hash
from lunar_rover_sim.bag.messages import xyz
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.totals import driven_distance_m, every_step, simulated_end_ns
from lunar_rover_sim.inspection import tracking
from lunar_rover_sim.inspection.tracking import PredictionMiss
from lunar_rover_sim.seconds import NS_PER_S


@dataclasses.dataclass(frozen=True)
class Summary:
    """Counts by topic, simulated time [s], path length [m], size [bytes], content hash.

    Attributes:
        tracking: How far constant velocity mispredicts the images, as `tracking.predictions` has
            it.
        slam: How many frames a SLAM program had in each of its states, such as `tracking`.
        notes: What is missing that one may expect.
    """

    counts: dict[str, int]
    duration_s: float
    distance_m: float
    size_bytes: int
    hash: str
    tracking: tuple[PredictionMiss, ...]
    slam: Mapping[str, int]
    notes: tuple[str, ...] = ()

    def lines(self, wall_s: float | None = None) -> str:
        """Return a readable text; `wall_s` is the wall time that the run took."""
        width = max(map(len, self.counts), default=0)
        table = [f'  {topic:{width}}  {count:7d}' for topic, count in sorted(self.counts.items())]
        pace = f', RTF {self.duration_s / wall_s:.2f} with start and stop' if wall_s else ''
        return '\n'.join([
            *table,
            f'{sum(self.counts.values())} messages, {self.duration_s:.2f} s{pace}, '
            f'{self.distance_m:.2f} m, {self.size_bytes / 1e6:.0f} MB',
            *([f'tracking: {tracking.sentence(self.tracking)}'] if self.tracking else []),
            *([_slam_line(self.slam)] if self.slam else []), *self.notes,
            f'hash {self.hash}'])


def summarise(path: Path) -> Summary:
    """Return the summary of a bag; the distance is that along the true path."""
    with open_bag(path) as bag:
        return Summary(dict(bag.counts), simulated_end_ns(bag) / NS_PER_S, _distance_m(bag),
                       bag.size_bytes, bag_hash(path), tuple(tracking.of_bag(bag)),
                       _slam_states(bag), missing_tf(bag))


def missing_tf(bag: Bag) -> tuple[str, ...]:
    """Return a line where poses, but no tf, are recorded; else nothing."""
    if bag.has(topics.TF.name) or not bag.has(bag.truth):
        return ()
    return (f'no tf: it was not to be recorded, or there was no tf2_msgs and no run; {bag.truth} '
            'has the poses',)


def _slam_states(bag: Bag) -> Counter[str]:
    """Return the number of frames by what slam_node said of each; empty without one."""
    if not bag.has(topics.SLAM_STATUS.name):
        return Counter()
    return Counter(message.status[0].message
                   for _, _, message in bag.messages([topics.SLAM_STATUS.name]) if message.status)


def _slam_line(states: Mapping[str, int]) -> str:
    counts = ', '.join(f'{count} {state}' for state, count in sorted(states.items()))
    return f'slam: {sum(states.values())} frames answered: {counts}'


def _distance_m(bag: Bag) -> float:
    """Return the distance driven; of the odometry only what it needs is held in memory."""
    if not bag.has(bag.truth):
        return 0.0
    stamped = ((message.time_ns, message) for message in bag.raw([bag.truth]))
    decoded = ((stamp_ns, bag.decode(message.data, message.msgtype))
               for stamp_ns, message in every_step(stamped))
    return driven_distance_m((stamp_ns, xyz(odometry.pose.pose.position))
                             for stamp_ns, odometry in decoded)
