"""The traverse study: minutes of waypoints over rough worlds, their cost to the rover, a report.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import dataclasses
import functools
import math
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import uniform_filter1d

from lunar_rover_sim.autonomy.path_following.config import DriveConfig
from lunar_rover_sim.autonomy.path_following.driver import DONE, Driver, Stop
from lunar_rover_sim.base.errors import PhysicsError, StudyError
from lunar_rover_sim.base.files.results import csv_table, markdown_table, save_figure
from lunar_rover_sim.base.frames import Array, distance_along, path_length, tilt_deg
from lunar_rover_sim.ground.world.cache import cached
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.site import OneWindow
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.judge.studies.study_folder import StudyFolder, write_report
from lunar_rover_sim.judge.studies.terramechanics import (compare, comparison_text,
                                                          plot_comparison, Quantity)
from lunar_rover_sim.judge.studies.walking import (by_gait, DUG_IN, on_ground, STATE_PERIOD_S,
                                                   Walker)
from lunar_rover_sim.rover.physics.foot_motion import SlipMeter
from lunar_rover_sim.rover.physics.penetration import TipPenetration
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.rover.physics.state import RoverState
from lunar_rover_sim.run.scenario import Scenario

PATH_PERIOD_S = 0.2                   # of the recorded path
STRANDED_S, STRANDED_M = 60.0, 0.5    # a rover that stays this long this near its end is stranded
DRIVEN, TIPPED_OVER, STRANDED = 'driven', 'tipped over', 'stranded'    # outcomes, with DUG_IN
Case = tuple[str, int]                # ground and seed


@dataclasses.dataclass(frozen=True)
class Traverse:
    """One drive over one world.

    Attributes:
        outcome: 'driven' (all the time), 'tipped over', 'stranded' (all the time, but stuck in one
            place at the end, although it backed up), 'dug in' (stranded, with feet deep in
            regolith), or an error of the simulation.
        driven_s: Simulated time [s].
        distance_m: Length of the horizontal path at 5 Hz [m].
        waypoints, stuck, tilted: Waypoints reached, times stuck, times stopped by tilt and
            recovered.
        slip: Of all feet, as `SlipMeter.total`.
        transport_mechanical, transport_electric: Energy / (mass gravity distance), of the positive
            power at the legs and of that drawn from the supply (nothing is recuperated).
        tilt_mean_deg, tilt_p95_deg, tilt_max_deg: Angle between base z and the vertical [deg].
        pitch_rms_deg: RMS of the pitch about its mean over two seconds: that of the walk [deg].
        penetration_max_m: Greatest penetration of a spoke tip into ground or rock, at 200 Hz [m].
        path_m: (n, 3) positions at 5 Hz, world frame [m].
    """

    seed: int
    outcome: str
    driven_s: float
    distance_m: float
    waypoints: int
    stuck: int
    tilted: int
    slip: float
    transport_mechanical: float
    transport_electric: float
    tilt_mean_deg: float
    tilt_p95_deg: float
    tilt_max_deg: float
    pitch_rms_deg: float
    penetration_max_m: float
    path_m: Array

    @property
    def tipped_over(self) -> bool:
        """Whether it ended on its side or back."""
        return self.outcome == TIPPED_OVER

    @property
    def speed_mps(self) -> float:
        """Mean speed [m/s]."""
        return self.distance_m / self.driven_s if self.driven_s else 0.0


def is_stranded(path_m: Array) -> bool:
    """Return whether an (n, 3) path at 5 Hz [m] has been near its end for long."""
    last = path_m[-round(STRANDED_S / PATH_PERIOD_S):, :2]
    return (len(last) * PATH_PERIOD_S >= STRANDED_S
            and float(np.linalg.norm(last - last[-1], axis=1).max()) < STRANDED_M)


WAYPOINT_STEP_M = (2.0, 7.0)   # least and greatest distance between waypoints
OBSTACLE_M = 0.04              # rocks that rise more than this are driven around
ROCK_HEIGHT = 0.7              # height of a rock over its greatest horizontal diameter, about
CORRIDOR_M = 0.4               # least distance of the way from the middle of such a rock
MAX_TRIALS = 2000              # for the next waypoint, before the search is given up
MARGIN_M = 4.0                 # least distance of waypoints from the edge


def obstacles(world: World) -> Array:
    """Return (n, 2) positions of the rocks that rise higher than the rover can stride over."""
    rocks = world.rocks
    if len(rocks) == 0:
        return np.zeros((0, 2))
    xy = rocks.position_m[:, :2]
    rise = rocks.position_m[:, 2] + 0.5 * ROCK_HEIGHT * rocks.diameter_m - world.height_at(xy)
    return xy[rise > OBSTACLE_M]


def random_waypoints(world: World, length_m: float, rng: np.random.Generator,
                     start_m: ArrayLike = (0.0, 0.0)) -> Array:
    """Return (n, 2) waypoints [m] of a route from a start (2,) on, at least length_m [m] long.

    The straight way from each to the next keeps `CORRIDOR_M` from obstacles, as an operator with a
    map would plan it: the rover avoids nothing by itself. Obstacles that are nearer to the start
    are ignored.

    Raises:
        StudyError: If the world is too small or no route is found.
    """
    limit = world.ground.half_extent_m - MARGIN_M
    if limit < WAYPOINT_STEP_M[1]:
        raise StudyError('the world is too small to traverse:'
                         f' {2 * world.ground.half_extent_m:g} m;'
                         f' valid is >= {2 * (MARGIN_M + WAYPOINT_STEP_M[1]):g} m')
    start, blocked = np.asarray(start_m, dtype=float), obstacles(world)
    blocked = blocked[np.linalg.norm(blocked - start, axis=1) >= CORRIDOR_M]
    points, gone, heading = [start], 0.0, rng.uniform(-math.pi, math.pi)
    trials = 0
    while gone < length_m:
        trials += 1
        if trials > MAX_TRIALS:
            raise StudyError('no way between the rocks of this world; valid is one with fewer'
                             ' of them')
        # Mostly ahead; every third trial goes anywhere.
        turn = heading + rng.normal(0.0, 0.7) if trials % 3 else rng.uniform(-math.pi, math.pi)
        step = rng.uniform(*WAYPOINT_STEP_M)
        point = points[-1] + step * np.array([math.cos(turn), math.sin(turn)])
        if np.max(np.abs(point)) > limit or _distance(points[-1], point, blocked) < CORRIDOR_M:
            continue
        heading, gone, trials = turn, gone + step, 0
        points.append(point)
    return np.array(points[1:])


def _distance(start: Array, end: Array, points: Array) -> float:
    """Return the distance [m] of the nearest of (n, 2) points from a straight way."""
    if len(points) == 0:
        return math.inf
    way = end - start
    along = np.clip((points - start) @ way / (way @ way), 0.0, 1.0)
    return float(np.min(np.linalg.norm(start + along[:, None] * way - points, axis=1)))


REST_S = 5.0                   # a rover that is tilted past the limit has this time to come back
ON_ITS_SIDE_DEG = 70.0         # if it is tilted less than this after REST_S, it backs up once
BACK_UP_S, BACK_UP_MPS = 6.0, -0.08   # a rover that is stuck backs up, and takes another way
PITCH_MEAN_S = 2.0             # window of the moving mean: steps are shorter, slopes longer
DRIVE_PERIODS = 10             # periods of the controller per update of the driver: 20 Hz
PATH_PERIODS = round(PATH_PERIOD_S / STATE_PERIOD_S)


class TraverseDrive:
    """A drive in progress; `run` it once.

    Args:
        scenario: Gait, and how waypoints are followed.
        simulation: The rover on its ground.
        plan: Returns (n, 2) waypoints from a position (2,) on [m], or raises StudyError.
    """

    def __init__(self, scenario: Scenario, simulation: Simulation,
                 plan: Callable[[Array], Array]) -> None:
        self._controller = scenario.gait_controller()
        self._config: DriveConfig = scenario.drive_node
        self._plan = plan
        self._half_extent_m = simulation.world.ground.half_extent_m
        self._walker = Walker(simulation, by_gait(self._controller))
        self._period_s = self._walker.period_s
        self._back_up_periods = round(BACK_UP_S / self._period_s)
        self._next = 0                    # index of the waypoint ahead
        self._reached = self._stuck = self._tilted = 0
        self._measurement = _Measurement(simulation, self._walker)
        self._state = simulation.state
        self._waypoints = plan(self._state.position_m[:2])
        self._driver = self._make_driver()

    def run(self, seed: int, duration_s: float) -> Traverse:
        """Drive until the time [s] is over or the rover has tipped over; return the result."""
        outcome, periods = DRIVEN, round(duration_s / self._period_s)
        velocity, back_up = (0.0, 0.0), 0
        tilted_since: int | None = None
        backed_up = False       # from a lasting tilt; a second one counts as tipped over
        try:
            for k in range(periods):
                if back_up > 0:
                    back_up -= 1
                    if back_up == 0:
                        self._go_elsewhere()
                elif tilted_since is not None:
                    if k - tilted_since >= REST_S / self._period_s:
                        if _tilt_deg(self._state) > self._config.tilt_limit_deg:
                            if backed_up or _tilt_deg(self._state) > ON_ITS_SIDE_DEG:
                                outcome = TIPPED_OVER
                                break
                            backed_up = True
                        tilted_since, self._tilted = None, self._tilted + 1
                        back_up, velocity = self._back_up_periods, (BACK_UP_MPS, 0.0)
                elif k % DRIVE_PERIODS == 0:
                    state = self._state
                    command = self._driver.update(state.stamp_ns, state.position_m,
                                                  state.orientation_wxyz)
                    velocity = (command.forward_mps, command.yaw_rate_radps)
                    if command.status == DONE:
                        self._reached += 1
                        self._go_on()
                    elif command.cause is Stop.TILTED:
                        tilted_since = k
                    elif command.cause is not None:
                        self._stuck += 1
                        back_up, velocity = self._back_up_periods, (BACK_UP_MPS, 0.0)
                    else:
                        backed_up = False
                self._controller.set_velocity(*velocity, self._state.stamp_ns)
                self._state = self._walker.step()
                self._measurement.add()
                if k % PATH_PERIODS == 0:
                    self._measurement.path_m.append(self._state.position_m)
        except PhysicsError as error:
            outcome = str(error)
        return self._measurement.result(
            seed, outcome, self._state.stamp_ns * 1e-9,
            (self._reached, self._stuck, self._tilted))

    def _go_on(self) -> None:
        self._next = min(self._next + 1, len(self._waypoints) - 1)
        self._driver = self._make_driver()

    def _go_elsewhere(self) -> None:
        """Plan a new route from here; go on along the old one if there is none."""
        try:
            self._waypoints = self._plan(self._state.position_m[:2])
        except StudyError:
            self._go_on()
        else:
            self._next = 0
            self._driver = self._make_driver()

    def _make_driver(self) -> Driver:
        x, y = self._waypoints[self._next]
        config = dataclasses.replace(
            self._config, mode='waypoints', shape='none', relative=False, laps=1,
            start_delay_s=0.0, waypoints_x_m=(float(x),), waypoints_y_m=(float(y),))
        return Driver(config, self._half_extent_m)


class _Measurement:
    """What a drive sums up, period by period."""

    def __init__(self, simulation: Simulation, walker: Walker) -> None:
        self._simulation, self._walker = simulation, walker
        self._tips = TipPenetration(simulation)
        self._feet = SlipMeter(len(simulation.rover.legs.each))
        self._mechanical_j = self._electric_j = 0.0
        self._tilts_deg: list[float] = []
        self._pitches_deg: list[float] = []
        self._penetration_m = 0.0
        self.path_m: list[Array] = []

    def add(self) -> None:
        """Take in the state of the simulation after a period."""
        state, dt = self._simulation.state, self._walker.period_s
        self._tilts_deg.append(_tilt_deg(state))
        self._pitches_deg.append(_pitch_deg(state))
        for torque, speed in zip(state.motor_torque_nm.tolist(),
                                 state.joint_velocity_radps.tolist()):
            self._mechanical_j += max(torque * speed, 0.0) * dt
        self._electric_j += self._walker.drawn_j()
        self._penetration_m = max(self._penetration_m, self._tips.deepest_m())
        self._feet.add(self._simulation.foot_motion, dt)

    def result(self, seed: int, outcome: str, driven_s: float,
               counts: tuple[int, int, int]) -> Traverse:
        """Return the result; counts: waypoints reached, times stuck, times tilted."""
        path = np.array(self.path_m).reshape(-1, 3)
        distance = path_length(path[:, :2])
        mass = self._simulation.rover.total_mass_kg
        weight = max(mass * self._simulation.config.gravity_mps2, 1e-9)
        tilts = np.array(self._tilts_deg or [0.0])
        if outcome == DRIVEN and is_stranded(path):
            outcome = DUG_IN if self._walker.has_dug_in() else STRANDED
        return Traverse(
            seed, outcome, driven_s, distance, *counts,
            self._feet.total,
            self._mechanical_j / (weight * distance) if distance else math.nan,
            self._electric_j / (weight * distance) if distance else math.nan,
            float(tilts.mean()), float(np.percentile(tilts, 95.0)), float(tilts.max()),
            self._pitch_rms_deg(), self._penetration_m, path)

    def _pitch_rms_deg(self) -> float:
        """Return the RMS of the pitch about its moving mean [deg]."""
        pitch = np.array(self._pitches_deg or [0.0])
        return float(np.std(pitch - uniform_filter1d(pitch, round(
            PITCH_MEAN_S / self._walker.period_s))))


def _pitch_deg(state: RoverState) -> float:
    """Return the angle by which base x points down [deg]."""
    w, x, y, z = state.orientation_wxyz.tolist()
    return math.degrees(math.asin(max(-1.0, min(1.0, 2.0 * (w * y - x * z)))))


def _tilt_deg(state: RoverState) -> float:
    return float(tilt_deg(state.orientation_wxyz))


class TraverseStore(StudyFolder[Case, Traverse]):
    """The finished drives of a study, by ground and seed."""

    def name(self, case: Case) -> str:
        """Return ground and seed."""
        return '_'.join(map(str, case))

    def drive(self, values: dict[str, Any]) -> Traverse:
        """Return the drive of its values."""
        return Traverse(**{**values, 'path_m': np.array(values['path_m']).reshape(-1, 3)})


def traverse(scenario: Scenario, duration_s: float, world: World, seed: int) -> Traverse:
    """Drive random waypoints over a world for a time [s]; raise StudyError without a route."""
    length_m = 1.5 * scenario.drive_node.speed_mps * duration_s
    plan = functools.partial(random_waypoints, world, length_m, np.random.default_rng(seed))
    with Simulation(world, scenario.rover, scenario.physics_node, OneWindow(world)) as simulation:
        return TraverseDrive(scenario, simulation, plan).run(seed, duration_s)


def traverse_case(scenario: Scenario, duration_s: float, case: Case) -> Traverse:
    """Traverse the world of a seed on a ground."""
    ground, seed = case
    return traverse(on_ground(scenario, ground), duration_s,
                    load_world(cached(scenario.world, seed), verify=False), seed)


ALLOWED_SHARE = 0.05   # of drives that end tipped over or stranded: one in twenty

_FIELDS = ('seed', 'outcome', 'driven_s', 'distance_m', 'speed_mps', 'waypoints', 'stuck',
           'tilted', 'slip', 'transport_mechanical', 'transport_electric', 'tilt_mean_deg',
           'tilt_p95_deg', 'tilt_max_deg', 'pitch_rms_deg', 'penetration_max_m')


def tipped(results: Sequence[Traverse]) -> int:
    """Return how many drives ended tipped over."""
    return sum(result.tipped_over for result in results)


def stranded(results: Sequence[Traverse]) -> int:
    """Return how many drives ended stuck in one place."""
    return sum(result.outcome in (STRANDED, DUG_IN) for result in results)


def acceptable(results: Sequence[Traverse]) -> bool:
    """Return whether all drives could be simulated and at most one in twenty was lost.

    A drive is lost if the rover tipped over or is stranded.
    """
    return (all(result.outcome in (DRIVEN, TIPPED_OVER, STRANDED, DUG_IN) for result in results)
            and tipped(results) + stranded(results)
            <= max(1, round(ALLOWED_SHARE * len(results))))


def report_text(results: Sequence[Traverse], scenario: str) -> str:
    """Return the report as Markdown."""
    driven = sum(result.driven_s for result in results)
    distance = sum(result.distance_m for result in results)
    lines = [f'# Traverse of {scenario}', '',
             f'{len(results)} worlds, {driven / 60.0:.1f} min, {distance:.1f} m:'
             f' {tipped(results)} tipped over, {stranded(results)} stranded,'
             f' {sum(r.stuck for r in results)} times stuck and'
             f' {sum(r.tilted for r in results)} times stopped by tilt, and backed up.', '',
             'Slip: 1 - true distance / commanded distance of the feet in stance.'
             ' Transport: energy / (weight × distance), mechanical at the legs, electric from the'
             ' supply. Penetration: of a spoke tip into ground or rock, at 200 Hz.', '',
             *markdown_table(
                 ('seed', 'outcome', 'time [s]', 'distance [m]', 'speed [m/s]', 'waypoints',
                  'stuck', 'tilted', 'slip', 'transport mech.', 'electric', 'tilt mean [°]',
                  '95 %', 'max', 'pitch RMS [°]', 'penetration max [mm]'),
                 ([str(r.seed), r.outcome, f'{r.driven_s:.0f}', f'{r.distance_m:.2f}',
                   f'{r.speed_mps:.3f}', str(r.waypoints), str(r.stuck), str(r.tilted),
                   f'{r.slip:.3f}', f'{r.transport_mechanical:.2f}',
                   f'{r.transport_electric:.2f}', f'{r.tilt_mean_deg:.1f}',
                   f'{r.tilt_p95_deg:.1f}', f'{r.tilt_max_deg:.1f}',
                   f'{r.pitch_rms_deg:.2f}', f'{1000.0 * r.penetration_max_m:.1f}']
                  for r in results))]
    return '\n'.join(lines) + '\n'


def write_all(results: Sequence[Traverse], scenario: str, folder: Path) -> str:
    """Write traverse.md, traverse.csv and traverse.png; return the text of the first.

    Raises:
        StudyError: If one cannot be written.
    """
    text = write_report(folder, 'traverse', report_text(results, scenario), csv_table(
        _FIELDS, ([getattr(result, name) for name in _FIELDS] for result in results)))
    plot_paths(results, folder / 'traverse.png')
    return text


def plot_paths(results: Sequence[Traverse], path: str | Path) -> None:
    """Write a plot of all paths, and of distance over time.

    Raises:
        StudyError: If the file cannot be written.
    """
    figure = Figure(figsize=(12.0, 5.5), layout='constrained')
    above, along = figure.subplots(1, 2)
    for result in results:
        if len(result.path_m) < 2:
            continue
        x, y = result.path_m[:, 0], result.path_m[:, 1]
        line, = above.plot(x, y, lw=0.8, label=str(result.seed))
        above.plot(x[-1], y[-1], 'x' if result.tipped_over else '.', color=line.get_color())
        gone = distance_along(result.path_m[:, :2])
        along.plot(np.linspace(0.0, result.driven_s, len(gone)), gone, lw=0.8,
                   color=line.get_color())
    above.set(xlabel='x [m]', ylabel='y [m]', title='paths; x: tipped over')
    above.set_aspect('equal')
    along.set(xlabel='time [s]', ylabel='distance [m]')
    for axis in (above, along):
        axis.grid(alpha=0.3)
    above.legend(title='seed', fontsize=7, ncols=2)
    save_figure(figure, path, StudyError)


QUANTITIES = (
    Quantity('speed [m/s]', lambda r: r.speed_mps, 4),
    Quantity('slip [%]', lambda r: 1e2 * r.slip, 1),
    Quantity('electric cost of transport', lambda r: r.transport_electric, 2),
    Quantity('mechanical cost of transport', lambda r: r.transport_mechanical, 2),
    Quantity('pitch RMS [°]', lambda r: r.pitch_rms_deg, 2),
    Quantity('stops per drive', lambda r: float(r.stuck + r.tilted), 2))


def write_grounds(results: Mapping[str, Sequence[Traverse]], scenario: str, folder: Path) -> str:
    """Write grounds.md and grounds.png, and a report of each ground; return the text."""
    grounds = list(results)
    text = (f'# Traverses of {scenario} on {", ".join(grounds)}\n\n'
            + comparison_text(compare(results, QUANTITIES), grounds[0]) + '\n'
            + '\n'.join(f'{name}: {len(each)} drives, {tipped(each)} tipped over,'
                        f' {stranded(each)} stranded.\n'
                        for name, each in results.items()))
    write_report(folder, 'grounds', text)
    plot_comparison(results, QUANTITIES, folder / 'grounds.png')
    for name, each in results.items():
        (folder / name).mkdir(exist_ok=True)
        write_all(each, f'{scenario} on {name}', folder / name)
    return text
