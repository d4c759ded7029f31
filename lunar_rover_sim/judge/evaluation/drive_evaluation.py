"""What happened on a recorded drive: its way, incidents, unknown ground and stops."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
import dataclasses
import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.autonomy.navigation.traversability import belly_clearance_m, UNKNOWN
from lunar_rover_sim.bag import series
from lunar_rover_sim.bag.message_validity import grid_problem
from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.results import plain
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, tilt_deg
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.judge.evaluation.map_evaluation import TrueSurface
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.physics.state import TIPPED_DEG
from lunar_rover_sim.run.recorded_run import RecordedRun

TILTED_DEG = 45.0
_LEVEL_DEG = 30.0           # from there on a rover that was tilted may be so again
_TOUCH_M = 0.01             # the body touches what is nearer to its lower side
_CLOSE_S = 0.3              # contacts nearer in time than this are one
_COLUMNS, _ROWS = 7, 4      # points on the lower side of the body, along it and across
_STANDING = ('looking', 'waiting')
_STOPS = ('looking', 'backing off')
TILT, ROLL_OVER, HIGH, BELLY = 'tilt', 'roll-over', 'high contact', 'belly contact'


@dataclasses.dataclass(frozen=True)
class DriveEvaluation:
    """A recorded drive.

    Attributes:
        distance_m: Way of the base, in x and y, from place to place of every 0.1 s.
        duration_s: Simulated time.
        incidents: How often, by kind. Tilt: beyond 45 deg. Roll-over: beyond 70 deg. High contact:
            the lower side of the body meets a rock that rises by more than its clearance. Belly
            contact: it meets other rocks, or the ground. The last two only where the world is
            found.
        seen_m: Way on ground of that world.
        unknown_m: Way over cells that the newest map did not know; NaN without maps.
        stops: How often it stopped, by what it did then.
        standing_s: Time for which it stood and looked, or waited.
        plans: Plans over the map from orbit.
        end: What the navigator said last; '' without one.
    """

    distance_m: float
    duration_s: float
    incidents: Mapping[str, int]
    seen_m: float
    unknown_m: float
    stops: Mapping[str, int]
    standing_s: float
    plans: int
    end: str

    def per_km(self, kind: str) -> float:
        """Return incidents of a kind per kilometre; NaN where nothing was driven."""
        way = self.seen_m if kind in (HIGH, BELLY) else self.distance_m
        return 1e3 * self.incidents[kind] / way if way else math.nan

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values."""
        found: dict[str, Any] = plain(dataclasses.asdict(self))
        return found | {'per_km': {kind: self.per_km(kind) for kind in self.incidents}}


def evaluate_drive(path: Path, world: Path | None = None) -> DriveEvaluation:
    """Judge the drive of a bag.

    Args:
        world: Folder of its world, where that is not found beside the bag or in the cache.

    Raises:
        EvaluationError: If the bag holds no true odometry, or maps that are none.
    """
    with open_bag(path) as bag:
        odometry = series.read_odometry(bag) if bag.has(bag.truth) else None
        if odometry is None or not len(odometry.stamps_ns):
            raise EvaluationError(f'{path}: holds no true odometry; physics_node publishes it')
        run = RecordedRun(bag)
        stamps = odometry.stamps_ns
        tilt = tilt_deg(odometry.orientations_wxyz)
        incidents = {TILT: _risen(tilt, TILTED_DEG, _LEVEL_DEG),
                     ROLL_OVER: _risen(tilt, TIPPED_DEG, TILTED_DEG)}
        kept = odometry.every_step()
        way = kept.positions_m
        steps = np.concatenate([[0.0], np.linalg.norm(np.diff(way[:, :2], axis=0), axis=1)])
        seen_m, found, rover = 0.0, run.world(world), run.rover
        if found is not None and rover is not None:
            met, known = _contacts(found, rover, way, kept.orientations_wxyz)
            seen_m = float(steps[known].sum())
            for kind, is_met in met.items():
                at_s = kept.stamps_ns[is_met] / NS_PER_S
                incidents[kind] = int(len(at_s) > 0) + int((np.diff(at_s) > _CLOSE_S).sum())
        stops, standing_s, end = _stops(bag, int(stamps[-1]))
        plans = bag.count(topics.GLOBAL_PLAN.name)
        return DriveEvaluation(float(steps.sum()), float(stamps[-1] - stamps[0]) / NS_PER_S,
                               incidents, seen_m, _unknown_m(bag, kept.stamps_ns, way, steps),
                               stops, standing_s, plans, end)


def _risen(values: Array, high: float, low: float) -> int:
    """Return how often values rise above a bound, having been below the low one before."""
    count, was_low = 0, True
    for value in values[(values > high) | (values < low)]:
        if value > high and was_low:
            count += 1
        was_low = bool(value < low)
    return count


def _contacts(world: World, rover: RoverDescription, way: Array, turns_wxyz: Array
              ) -> tuple[dict[str, NDArray[np.bool_]], NDArray[np.bool_]]:
    """Return at which poses (n, 3), (n, 4) the body touches what, and where ground is known."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, _COLUMNS) * rover.chassis.length_m,
                       np.linspace(-0.5, 0.5, _ROWS) * rover.chassis.width_m)
    side = np.stack([x.ravel(), y.ravel(), np.full(x.size, -0.5 * rover.chassis.height_m)], -1)
    rotations = np.array([matrix_from_wxyz(turn) for turn in turns_wxyz])
    points = way[:, None] + side @ np.swapaxes(rotations, 1, 2)
    surface, rise = np.full(points.shape[:2], np.nan), np.zeros(points.shape[:2])
    for window, some in _windows(world, way):
        surface[some], rise[some] = TrueSurface(window).heights(points[some, :, :2])
    touches = points[..., 2] < surface + _TOUCH_M
    high = (touches & (rise > belly_clearance_m(rover))).any(axis=1)
    return ({HIGH: high, BELLY: touches.any(axis=1) & ~high},
            np.asarray(np.isfinite(surface).all(axis=1)))


def _windows(world: World, way: Array) -> Iterator[tuple[World, NDArray[np.int64]]]:
    """Yield the windows of a site along a way, each with the places that it is entered for."""
    site, now, middles = Site.of(world), world.ground.middle_m, []
    for place in way:
        now = site.middle((float(place[0]), float(place[1])), now)
        middles.append(now)
    try:
        for middle in dict.fromkeys(middles):
            window = world if middle == world.ground.middle_m else site.window(middle)
            yield window, np.flatnonzero([one == middle for one in middles])
    finally:
        site.close()


def _unknown_m(bag: Bag, stamps: NDArray[np.int64], way: Array, steps: Array) -> float:
    """Return the way over cells that the newest map before did not know [m]."""
    if not bag.has(topics.TRAVERSABILITY.name):
        return math.nan
    total, grid, first = 0.0, None, 0
    maps = (message for _, _, message in bag.messages([bag.resolve(topics.TRAVERSABILITY.name)]))
    for message in itertools.chain(maps, (None,)):
        if message is not None and (problem := grid_problem(message)) is not None:
            raise EvaluationError(f'{bag.path}: {topics.TRAVERSABILITY.name}: {problem}')
        last = (len(stamps) if message is None
                else int(np.searchsorted(stamps, header_ns(message))))
        if grid is not None and last > first:
            origin, cell = grid.info.origin.position, grid.info.resolution
            cost = np.asarray(grid.data, np.int8).reshape(grid.info.height, grid.info.width)
            column, row = np.floor((way[first:last, :2] - (origin.x, origin.y)) / cell
                                   ).astype(int).T
            inside = (column >= 0) & (row >= 0) & (column < cost.shape[1]) & (row < cost.shape[0])
            unknown = ~inside
            unknown[inside] = cost[row[inside], column[inside]] == UNKNOWN
            total += float(steps[first:last][unknown].sum())
        grid, first = message, max(first, last)
    return total


def _stops(bag: Bag, end_ns: int) -> tuple[dict[str, int], float, str]:
    """Return how often the navigator stopped, by what it did; how long it stood; the end."""
    if not bag.has(topics.NAVIGATOR_STATUS.name):
        return {}, 0.0, ''
    told = []
    for _, _, message in bag.messages([bag.resolve(topics.NAVIGATOR_STATUS.name)]):
        if not len(message.status):
            raise EvaluationError(f'{bag.path}: {topics.NAVIGATOR_STATUS.name}: it has no status')
        status = message.status[0]
        reason = next((pair.value for pair in status.values if pair.key == 'reason'), '')
        told.append((header_ns(message), status.message, reason))
    counts = Counter(state for _, state, _ in told)
    until = [stamp for stamp, _, _ in told[1:]] + [end_ns]
    standing = sum(end - begin for (begin, state, _), end in zip(told, until)
                   if state in _STANDING) / NS_PER_S
    return ({state: counts[state] for state in _STOPS}, standing,
            ' '.join(filter(None, told[-1][1:])) if told else '')
