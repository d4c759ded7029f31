"""The place of a far drive with images on maps from orbit, and what it costs: over a bag.

    lunar_rover_sim run expedition --seed 4 --goal 800,600 -o RUN
    lunar_rover_sim world export RUN/world -o MAPS --orbital --set orbital.extent_m=2000
    python test/benchmarks/bench_far_place.py RUN/bag MAPS --near 12,-16

Where the bag has wheels, those and sun and stars are as recorded. Else they are drawn from the
truth, with the errors of the sensors: those of the wheels as measured on soft ground, the sun
wherever it stands in view, the stars while the rover turns slowly.

Of each 50 m it prints the processor time of the graph alone, a keyframe, and what the process has
in memory: that of Python and its libraries, and of the bag, is there from the first line on.
"""

import argparse
from collections.abc import Iterator
import dataclasses
import math
from pathlib import Path
import time

import numpy as np
import psutil
from scipy.spatial.transform import Rotation

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.series import read_odometry
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import matrix_from_wxyz, sun_direction
from lunar_rover_sim.ground.world.orbital_map import OrbitalMap
from lunar_rover_sim.image.illumination.sun_view import SeenSun
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory, wxyz
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.judge.slam.graph.anchor import Anchor, Doubt
from lunar_rover_sim.judge.slam.graph.from_bag import steps
from lunar_rover_sim.judge.slam.graph.measured import Aids, Stars, Sun, Wheels
from lunar_rover_sim.judge.slam.graph.odometry import GraphOdometry
from lunar_rover_sim.products.sequences.sensors import recorded_sensors
from lunar_rover_sim.sensors.star_tracker import StarCamera, StarTrackerConfig
from lunar_rover_sim.sensors.sun_sensor import SunHeads, SunSensorConfig
from lunar_rover_sim.sensors.wheel_odometry import Rolling, WheelOdometryConfig

EVERY_NS = 500_000_000
SUN_DEG = 60.0, 6.0             # of the scenario `expedition`
STRETCH_M = 50.0
TURNED_M = 0.15                 # a foot rolls so far for each radian that the rover turns


class Drawn:
    """What sun sensor, star tracker and wheels would have measured."""

    def __init__(self, bag, rng: np.random.Generator) -> None:
        odometry = read_odometry(bag)
        regular = np.flatnonzero(np.diff(odometry.stamps_ns // EVERY_NS, prepend=-1))
        self._rows = zip(*(part[regular] for part in odometry))
        self._next = next(self._rows)
        self._sun = SeenSun(sun_direction(*SUN_DEG), 1.0)
        self._heads, self._camera = SunHeads(SunSensorConfig(), rng), StarCamera(
            StarTrackerConfig(), rng)
        rolling = Rolling.of(WheelOdometryConfig(), 'highland')
        self._variance = np.square([rolling.forward_stddev, rolling.lateral_stddev,
                                    rolling.yaw_stddev])
        self._rng, self._before = rng, None
        self._rolled, self._covariance = np.zeros(3), 1e-8 * np.eye(3)

    def until(self, stamp_ns: int, aids: Aids) -> Aids:
        """Return what there is beside a pair of images, with what is drawn."""
        sun = stars = None
        while self._next is not None and self._next[0] <= stamp_ns:
            ns, position, q, twist = self._next
            R = matrix_from_wxyz(q)
            self._roll(np.array([*position[:2], math.atan2(R[1, 0], R[0, 0])]))
            measured = self._camera.measure(R, twist[3:], self._sun, None)
            if measured is not None:
                stars = Stars(int(ns), measured, self._camera.covariance_rad2(R))
            direction = self._heads.measure(self._sun, R)
            if direction is not None:
                sun = Sun(int(ns), direction, self._sun.direction)
            self._next = next(self._rows, None)
        wheels = Wheels(self._rolled.copy(), self._covariance.copy())
        return dataclasses.replace(aids, sun=sun, stars=stars, wheels=wheels)

    def _roll(self, pose: np.ndarray) -> None:
        if self._before is not None:
            moved = pose - self._before
            c, s = math.cos(self._before[2]), math.sin(self._before[2])
            moved[:2] = c * moved[0] + s * moved[1], c * moved[1] - s * moved[0]
            moved[2] = (moved[2] + math.pi) % (2.0 * math.pi) - math.pi
            variance = self._variance * (math.hypot(*moved[:2]) + TURNED_M * abs(moved[2]))
            moved += np.sqrt(variance) * self._rng.standard_normal(3)
            c, s = math.cos(self._rolled[2]), math.sin(self._rolled[2])
            G = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            way = G @ moved
            F = np.eye(3)
            F[:2, 2] = -way[1], way[0]
            self._covariance = F @ self._covariance @ F.T + G @ np.diag(variance) @ G.T
            self._rolled = self._rolled + way
        self._before = pose


def located(bag, anchor: Anchor | None) -> Iterator[tuple]:
    """Yield stamp, pose and covariance of each frame, as told at the time."""
    suite = recorded_sensors(bag, (topics.LEFT_IMAGE.name, topics.RIGHT_IMAGE.name))
    odometry = GraphOdometry.of(suite, True, anchor)
    drawn = None if bag.counts.get(f'/{topics.WHEEL_ODOM.name}') else Drawn(
        bag, np.random.default_rng(7))
    way_m, place, cpu_s, keyframes, told_m = 0.0, None, 0.0, 0, STRETCH_M
    for stamp_ns, left, right, aids in steps(bag, suite):
        aids = aids if drawn is None else drawn.until(stamp_ns, aids)
        start_s = time.process_time()
        found = odometry.add(stamp_ns, left, right, aids)
        cpu_s += time.process_time() - start_s
        if found is None:
            continue
        if found.news:
            print(f'{1e-9 * stamp_ns:.0f} s: {found.news}', flush=True)
            place = None        # a jump is not way
        here = found.T_map_left[:3, 3]
        way_m += 0.0 if place is None else math.dist(place, here)
        place = here
        if way_m >= told_m:
            new = odometry.counts.keyframes - keyframes
            print(f'{told_m:.0f} m: {1e3 * cpu_s / new:.1f} ms a keyframe of {new}, '
                  f'{psutil.Process().memory_info().rss / 1e6:.0f} MB, '
                  f'{odometry.counts.places} places', flush=True)
            cpu_s, keyframes, told_m = 0.0, odometry.counts.keyframes, told_m + STRETCH_M
        yield stamp_ns, found.T_map_left, found.covariance
    print(odometry.words)


def main() -> None:
    """Print what the graph told of its place, and how good it was."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('bag', type=Path)
    parser.add_argument('maps', type=Path, nargs='?', help='without, the graph alone')
    parser.add_argument('--near', default='0,0', help='place that the start is near to, X,Y [m]')
    parser.add_argument('--doubt', type=float, default=50.0)
    given = parser.parse_args()
    x, y = map(float, given.near.split(','))
    anchor = given.maps and Anchor(OrbitalMap.load(given.maps), Doubt((x, y), given.doubt))
    with open_bag(given.bag) as bag:
        stamps, T, P = map(np.array, zip(*located(bag, anchor)))
    told = Trajectory(stamps, T[:, :3, 3], wxyz(Rotation.from_matrix(T[:, :3, :3])), 'told', P)
    result = evaluate(given.bag, told, align='none', estimate_frame='left')
    print(f'{result.length_m:.0f} m; {result.fixes}\n{result.consistency}')


if __name__ == '__main__':
    main()
