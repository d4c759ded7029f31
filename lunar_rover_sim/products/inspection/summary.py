"""Summary of a recording: counts, duration, distance, size, hash, and how well it is tracked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
import dataclasses
from pathlib import Path
from typing import Any

from lunar_rover_sim.bag.content_hash import ContentHash
from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.totals import resumed_line, simulated_end_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.products.inspection import tracking
from lunar_rover_sim.products.inspection.tracking import Drive, PredictionMiss


@dataclasses.dataclass(frozen=True)
class Summary:
    """Counts by topic, simulated time [s], path length [m], size [bytes], content hash.

    Attributes:
        tracking: How far constant velocity mispredicts the images, as `tracking.predictions` has
            it.
        slam: How many frames a SLAM program had in each of its states, such as `tracking`.
        goal: What the navigator said last, and when; '' without one.
        notes: What one may not expect, see `notes_on`.
    """

    counts: dict[str, int]
    duration_s: float
    distance_m: float
    size_bytes: int
    hash: str
    tracking: tuple[PredictionMiss, ...]
    slam: Mapping[str, int]
    goal: str = ''
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
            *([_slam_line(self.slam)] if self.slam else []),
            *([f'goal: {self.goal}'] if self.goal else []), *self.notes,
            f'hash {self.hash}'])


def summarise(path: Path) -> Summary:
    """Return the summary of a bag, read once; the distance is that along the true path."""
    with open_bag(path) as bag:
        hashes, drive, slam, goal = ContentHash(bag), Drive(bag), Counter[str](), ''
        of_slam, of_navigator = (bag.resolve(topic.name) if bag.has(topic.name) else ''
                                 for topic in (topics.SLAM_STATUS, topics.NAVIGATOR_STATUS))
        decoded_topics = {*drive.topics, of_slam, of_navigator}
        for message in bag.raw(hashes.topics) if hashes.topics else ():
            if message.topic not in decoded_topics:
                hashes.add(message)
                continue
            decoded = bag.decode(message.data, message.msgtype)
            hashes.add(message, decoded)
            drive.add(message, decoded)
            if message.topic == of_slam and decoded.status:
                slam[decoded.status[0].message] += 1
            elif message.topic == of_navigator and decoded.status:
                goal = _goal_line(decoded)
        return Summary(dict(bag.counts), simulated_end_ns(bag) / NS_PER_S, drive.distance_m(),
                       bag.size_bytes, hashes.of_bag(), tuple(drive.predictions()), slam, goal,
                       notes_on(bag))


def notes_on(bag: Bag) -> tuple[str, ...]:
    """Return lines on what one may not expect: that a recording was resumed, that tf is missing.
    """
    no_tf = not bag.has(topics.TF.name) and bag.has(bag.truth)
    return tuple(filter(None, (
        resumed_line(bag),
        f'no tf: it was not to be recorded; {bag.truth} has the poses' if no_tf else '')))


def _goal_line(array: Any) -> str:
    status = array.status[0]
    reason = next((pair.value for pair in status.values if pair.key == 'reason'), '')
    return ' '.join(filter(None, (status.message, reason,
                                  f'after {header_ns(array) / NS_PER_S:.1f} s')))


def _slam_line(states: Mapping[str, int]) -> str:
    counts = ', '.join(f'{count} {state}' for state, count in sorted(states.items()))
    return f'slam: {sum(states.values())} frames answered: {counts}'
