"""The traverse study: minutes of waypoints over rough worlds, and what they cost the rover."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import concurrent.futures
from concurrent.futures.process import BrokenProcessPool
import dataclasses
import functools
import math
import multiprocessing

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.errors import EvaluationError, PhysicsError
from lunar_rover_sim.frames import path_length
from lunar_rover_sim.gait.calibration import GaitCalibration
from lunar_rover_sim.gait.config import GaitConfig
from lunar_rover_sim.gait.controller import GaitController, LegCommand
from lunar_rover_sim.path_following.config import DriveConfig
from lunar_rover_sim.path_following.driver import DONE, Driver, STOPPED
from lunar_rover_sim.physics.config import PhysicsConfig
from lunar_rover_sim.physics.penetration import TipPenetration
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.studies.gait_measurement import STATE_PERIOD_S
from lunar_rover_sim.world.cache import cached
from lunar_rover_sim.world.config import WorldConfig
from lunar_rover_sim.world.grid import HeightGrid
from lunar_rover_sim.world.model import World
from lunar_rover_sim.world.world_folder import load_world

Array = NDArray[np.float64]

WAYPOINT_STEP_M = (2.0, 7.0)   # least and greatest distance between waypoints
OBSTACLE_M = 0.04              # rocks that rise more than this are driven around
ROCK_HEIGHT = 0.7              # height of a rock over its greatest horizontal diameter, about
CORRIDOR_M = 0.4               # from the way to the middle of such a rock, at least
MOST_TRIALS = 2000             # for the next waypoint, before there is no way
MARGIN_M = 4.0                 # waypoints keep this distance from the edge
REST_S = 5.0                   # what is tilted past the limit has this long to come back, ...
ON_ITS_SIDE_DEG = 70.0         # ... and if it leans no more than this, one trial to back up
BACK_UP_S, BACK_UP_MPS = 6.0, -0.08   # what is stuck goes back a little, and another way
STRANDED_S, STRANDED_M = 60.0, 0.5    # who is no farther from the end for so long is stranded
DRIVE_PERIOD = 10              # gait periods per answer of the driver: 20 Hz
RECORD_PERIOD = 40             # gait periods per recorded point: 5 Hz
DRIVEN, TIPPED_OVER, STRANDED = 'driven', 'tipped over', 'stranded'   # outcomes


@dataclasses.dataclass(frozen=True)
class Traverse:
    """One drive over one world.

    outcome: 'driven' (all the time), 'tipped over', 'stranded' (all the time, but at its end stuck
        in one place in spite of backing up), or an error of the simulation
    driven_s: simulated time; distance_m: length of the path at 5 Hz, horizontal
    waypoints, stuck, tilted: waypoints reached, times stuck, times stopped by tilt and recovered
    slip: 1 - true forward distance / distance that the feet in stance were asked to go
    transport_mechanical, transport_electric: energy / (mass gravity distance), of the positive
        power at the legs and of that drawn from the supply (nothing is recuperated)
    tilt_mean_deg, tilt_p95_deg, tilt_max_deg: angle between base z and the vertical
    sinkage_max_m: how deep a spoke tip was in the ground or in a rock at most, at 200 Hz
    path_m: (n, 3) positions at 5 Hz
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
    sinkage_max_m: float
    path_m: Array

    @property
    def tipped_over(self) -> bool:
        """Whether it ended on its side or back."""
        return self.outcome == TIPPED_OVER

    @property
    def speed_mps(self) -> float:
        """Mean speed [m/s]."""
        return self.distance_m / self.driven_s if self.driven_s else 0.0


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
    """Return (n, 2) waypoints from a start (2,) on, at least length_m of way, inside the world.

    The straight way from each to the next keeps `CORRIDOR_M` from obstacles, as an operator with
    a map would plan it: the rover avoids nothing by itself. What is nearer to the start than that
    is left behind, not avoided. Raises EvaluationError where there is no such way.
    """
    limit = world.ground.half_extent_m - MARGIN_M
    if limit < WAYPOINT_STEP_M[1]:
        raise EvaluationError('the world is too small to traverse:'
                              f' {2 * world.ground.half_extent_m:g} m;'
                              f' valid is >= {2 * (MARGIN_M + WAYPOINT_STEP_M[1]):g} m')
    start, blocked = np.asarray(start_m, dtype=float), obstacles(world)
    blocked = blocked[np.linalg.norm(blocked - start, axis=1) >= CORRIDOR_M]
    points, gone, heading = [start], 0.0, rng.uniform(-math.pi, math.pi)
    trials = 0
    while gone < length_m:
        trials += 1
        if trials > MOST_TRIALS:
            raise EvaluationError('no way between the rocks of this world; valid is one with fewer'
                                  ' of them')
        # Ahead where that is possible, anywhere where it is not.
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


def traverse(world: World, seed: int, calibration: GaitCalibration, rover: RoverDescription,
             physics: PhysicsConfig, gait: GaitConfig, drive: DriveConfig,
             duration_s: float) -> Traverse:
    """Drive random waypoints over a world for a time and return what became of it."""
    plan = functools.partial(random_waypoints, world, 1.5 * drive.speed_mps * duration_s,
                             np.random.default_rng(seed))
    with Simulation(world, rover, physics) as simulation:
        return _Run(simulation, GaitController(gait, calibration), drive, plan, seed,
                    world.ground).drive(duration_s)


def study(worlds: WorldConfig, seeds: Sequence[int], calibration: GaitCalibration,
          rover: RoverDescription, physics: PhysicsConfig, gait: GaitConfig, drive: DriveConfig,
          duration_s: float = 600.0, workers: int = 1,
          progress: Callable[[Traverse, int, int], None] | None = None) -> list[Traverse]:
    """Traverse one world per seed; `progress(result, done, all)` is called after each."""
    gait.check_spokes(rover.legs.spokes)
    one = functools.partial(_traverse_seed, worlds, calibration, rover, physics, gait, drive,
                            duration_s)
    results: list[Traverse] = []

    def collect(result: Traverse) -> None:
        results.append(result)
        if progress is not None:
            progress(result, len(results), len(seeds))

    if workers <= 1:
        for seed in seeds:
            collect(one(seed))
        return results
    with concurrent.futures.ProcessPoolExecutor(
            workers, multiprocessing.get_context('spawn')) as pool:
        try:
            for result in pool.map(one, seeds):
                collect(result)
        except BrokenProcessPool as error:
            raise EvaluationError(f'a worker process died: {error}') from None
    return results


def _traverse_seed(worlds: WorldConfig, calibration: GaitCalibration, rover: RoverDescription,
                   physics: PhysicsConfig, gait: GaitConfig, drive: DriveConfig,
                   duration_s: float, seed: int) -> Traverse:
    world = load_world(cached(worlds, seed), verify=False)
    return traverse(world, seed, calibration, rover, physics, gait, drive, duration_s)


def is_stranded(path_m: Array) -> bool:
    """Return whether an (n, 3) path at 5 Hz has been in the place of its end for long."""
    last = path_m[-round(STRANDED_S / (RECORD_PERIOD * STATE_PERIOD_S)):, :2]
    return (len(last) * RECORD_PERIOD * STATE_PERIOD_S >= STRANDED_S
            and float(np.linalg.norm(last - last[-1], axis=1).max()) < STRANDED_M)


class _Run:
    """A drive in progress: the loop, and the sums it keeps."""

    def __init__(self, simulation: Simulation, controller: GaitController, drive: DriveConfig,
                 plan: Callable[[Array], Array], seed: int, ground: HeightGrid) -> None:
        self._simulation = simulation
        self._controller = controller
        self._drive_config = drive
        self._plan = plan                 # waypoints from a position on
        self._half_extent_m = ground.half_extent_m
        self._seed = seed
        self._steps = max(1, round(STATE_PERIOD_S / simulation.config.step_s))
        self._period_s = self._steps * simulation.config.step_s
        self._back_up_periods = round(BACK_UP_S / self._period_s)
        self._next = 0                    # waypoint that is driven to
        self._reached = self._stuck = self._tilted = 0
        self._true_m = self._asked_m = 0.0
        self._mechanical_j = self._electric_j = 0.0
        self._tilts: list[float] = []
        self._path: list[Array] = []
        self._reference: list[float] | None = None
        self._tips = TipPenetration(simulation, ground)
        self._sinkage_m = 0.0
        self._state = simulation.state
        self._waypoints = plan(self._state.position_m[:2])
        self._driver = self._make_driver()

    def drive(self, duration_s: float) -> Traverse:
        """Drive until the time is over or the rover has tipped over."""
        outcome, periods = DRIVEN, round(duration_s / self._period_s)
        velocity, back_up = (0.0, 0.0), 0
        tilted_since: int | None = None
        backed_up = False       # from a tilt that stayed; the next time it is over
        try:
            for k in range(periods):
                if back_up > 0:
                    back_up -= 1
                    if back_up == 0:
                        self._go_elsewhere()
                elif tilted_since is not None:
                    if k - tilted_since >= REST_S / self._period_s:
                        if self._tilt_deg() > self._drive_config.tilt_limit_deg:
                            if backed_up or self._tilt_deg() > ON_ITS_SIDE_DEG:
                                outcome = TIPPED_OVER
                                break
                            backed_up = True
                        tilted_since, self._tilted = None, self._tilted + 1
                        back_up, velocity = self._back_up_periods, (BACK_UP_MPS, 0.0)
                elif k % DRIVE_PERIOD == 0:
                    state = self._state
                    command = self._driver.update(state.stamp_ns, state.position_m,
                                                  state.orientation_wxyz)
                    velocity = (command.forward_mps, command.yaw_rate_radps)
                    if command.status == DONE:
                        self._reached += 1
                        self._go_on()
                    elif command.status == STOPPED and command.reason.startswith('tilted'):
                        tilted_since = k
                    elif command.status == STOPPED:
                        self._stuck += 1
                        back_up, velocity = self._back_up_periods, (BACK_UP_MPS, 0.0)
                    else:
                        backed_up = False
                self._step(velocity)
                if k % RECORD_PERIOD == 0:
                    self._path.append(self._state.position_m)
        except PhysicsError as error:
            outcome = str(error)
        return self._result(outcome)

    def _go_on(self) -> None:
        self._next = min(self._next + 1, len(self._waypoints) - 1)
        self._driver = self._make_driver()

    def _go_elsewhere(self) -> None:
        """Plan anew from here; where there is no way, go on as planned."""
        try:
            self._waypoints = self._plan(self._state.position_m[:2])
        except EvaluationError:
            self._go_on()
        else:
            self._next = 0
            self._driver = self._make_driver()

    def _make_driver(self) -> Driver:
        x, y = self._waypoints[self._next]
        config = dataclasses.replace(
            self._drive_config, mode='waypoints', shape='none', relative=False, laps=1,
            start_delay_s=0.0, waypoints_x_m=(float(x),), waypoints_y_m=(float(y),))
        return Driver(config, self._half_extent_m)

    def _step(self, velocity: tuple[float, float]) -> None:
        state = self._state
        self._controller.set_velocity(*velocity, state.stamp_ns)
        legs = self._controller.update(state.stamp_ns, state.joint_angle_rad,
                                       state.joint_velocity_radps)
        self._simulation.command(legs.velocity_radps)
        self._state = self._simulation.advance(self._steps)
        self._note(legs)

    def _note(self, legs: LegCommand) -> None:
        # Plain floats: on four numbers they take a third of the time of arrays.
        state, dt = self._state, self._period_s
        motor = self._simulation.rover.motor
        self._tilts.append(self._tilt_deg())
        for torque, speed in zip(state.motor_torque_nm.tolist(),
                                 state.joint_velocity_radps.tolist()):
            self._mechanical_j += max(torque * speed, 0.0) * dt
            self._electric_j += max(motor.electric_power_w(torque, speed), 0.0) * dt
        self._sinkage_m = max(self._sinkage_m, self._tips.deepest_m())
        reference = legs.angle_rad.tolist()
        if self._reference is not None:
            asked = self._stance_m(reference, self._reference)
            self._asked_m += abs(asked)
            self._true_m += math.copysign(1.0, asked) * float(state.linear_velocity_mps[0]) * dt
        self._reference = reference

    def _stance_m(self, reference: list[float], before: list[float]) -> float:
        """Return how far the feet in stance were asked to push the rover in this period [m]."""
        config, rover = self._controller.config, self._simulation.rover
        pitch, half = config.pitch_rad, math.radians(0.5 * config.foot_width_deg)
        swept = []
        for now, last in zip(reference, before):
            local = (now + 0.5 * pitch) % pitch - 0.5 * pitch
            if abs(local) <= half:
                swept.append((now - last) * math.cos(local))
        return rover.legs.spoke_length_m * sum(swept) / len(swept) if swept else 0.0

    def _tilt_deg(self) -> float:
        _, x, y, _ = self._state.orientation_wxyz.tolist()
        return math.degrees(math.acos(max(-1.0, 1.0 - 2.0 * (x * x + y * y))))

    def _result(self, outcome: str) -> Traverse:
        path = np.array(self._path).reshape(-1, 3)
        distance = path_length(path[:, :2])
        mass = self._simulation.rover.total_mass_kg
        weight = max(mass * self._simulation.config.gravity_mps2, 1e-9)
        tilts = np.array(self._tilts or [0.0])
        if outcome == DRIVEN and is_stranded(path):
            outcome = STRANDED
        return Traverse(
            self._seed, outcome, self._state.stamp_ns * 1e-9, distance, self._reached,
            self._stuck, self._tilted,
            1.0 - self._true_m / self._asked_m if self._asked_m else math.nan,
            self._mechanical_j / (weight * distance) if distance else math.nan,
            self._electric_j / (weight * distance) if distance else math.nan,
            float(tilts.mean()), float(np.percentile(tilts, 95.0)), float(tilts.max()),
            self._sinkage_m, path)
