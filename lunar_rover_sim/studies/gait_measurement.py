"""Measuring what the gait does on flat ground: the table that turns velocities into strides."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import concurrent.futures
from concurrent.futures.process import BrokenProcessPool
import dataclasses
import functools
import math
import multiprocessing
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.errors import EvaluationError
from lunar_rover_sim.frames import rpy_from_wxyz
from lunar_rover_sim.gait.calibration import GaitCalibration
from lunar_rover_sim.gait.config import GaitConfig
from lunar_rover_sim.gait.controller import GaitController
from lunar_rover_sim.gait.stride import Stride
from lunar_rover_sim.physics.config import PhysicsConfig, StartPose
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.world.config import preset
from lunar_rover_sim.world.grid import HeightGrid
from lunar_rover_sim.world.model import World
from lunar_rover_sim.world.rocks import Rocks

Grid = tuple[tuple[float, ...], tuple[float, ...]]   # phase rates [Hz], turns
# The sweep of the inner side reverses at 0.7: a turn on either side of it.
FINE: Grid = ((0.2, 0.4, 0.55, 0.75, 1.0, 1.2, 1.5, 1.75, 1.88, 2.0, 2.2),
              (0.0, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.69, 0.71, 0.8, 0.9, 1.0))
COARSE: Grid = ((0.2, 0.5, 0.9, 1.2, 1.5, 2.2), (0.0, 0.1, 0.25, 0.4, 0.55, 0.69, 0.71, 0.85, 1.0))
STATE_PERIOD_S = 0.005   # how often the gait controller answers
SKIP_S, SKIP_CYCLES = 5.0, 1.0
MEASURE_S, MEASURE_CYCLES = 20.0, 4.0
COMMAND_S = 60.0
FASTEST_MPS = 0.6
FORWARD_TOLERANCE, YAW_TOLERANCE, SLOWEST_YAW_RADPS = 0.10, 0.15, 0.05
# The velocities (forward, yaw rate) that must be followed.
COMMANDS = tuple((v, w) for v in (0.03, 0.06, 0.10, 0.15, 0.20, 0.25)
                 for w in (-0.15, -0.10, -0.05, 0.0, 0.05, 0.10, 0.15))

Progress = Callable[[int, int], None]


@dataclasses.dataclass(frozen=True)
class Walk:
    """A walk as it was recorded, one sample per controller period.

    time_s (n,); position_m (n, 3); rpy_rad (n, 3), yaw unwrapped, positive pitch nose down;
    joint_angle_rad, joint_velocity_radps, motor_torque_nm, reference_rad, phase (n, 4);
    contact_force_n (n, 4, 3) world axes.
    """

    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    rpy_rad: NDArray[np.float64]
    joint_angle_rad: NDArray[np.float64]
    joint_velocity_radps: NDArray[np.float64]
    motor_torque_nm: NDArray[np.float64]
    contact_force_n: NDArray[np.float64]
    reference_rad: NDArray[np.float64]
    phase: NDArray[np.float64]

    def mean_velocity(self, from_s: float, to_s: float) -> tuple[float, float]:
        """Return the mean forward speed [m/s] and yaw rate [rad/s] between two times."""
        chosen = (self.time_s >= from_s - 1e-9) & (self.time_s <= to_s + 1e-9)
        xy, yaw = self.position_m[chosen, :2], self.rpy_rad[chosen, 2]
        duration = np.ptp(self.time_s[chosen])
        step, heading = np.diff(xy, axis=0), 0.5 * (yaw[1:] + yaw[:-1])
        forward = np.sum(step[:, 0] * np.cos(heading) + step[:, 1] * np.sin(heading))
        return float(forward / duration), float((yaw[-1] - yaw[0]) / duration)


def flat_world(half_extent_m: float = 15.0, cell_m: float = 0.025) -> World:
    """Return perfectly flat, empty ground."""
    n = 2 * math.ceil(half_extent_m / cell_m) + 1
    ground = HeightGrid(np.zeros((n, n), np.float32), cell_m)
    rocks = Rocks(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, 3)),
                  np.zeros((0, 4)), np.zeros(0, np.float32), np.array([0.1]))
    return World((ground,), np.ones((n, n), np.float32), rocks, (), preset('flat'), 'flat')


def walk(simulation: Simulation, controller: GaitController, duration_s: float,
         command: Callable[[GaitController, int], object]) -> Walk:
    """Walk from the start for a time; `command(controller, stamp_ns)` is asked before each answer.

    The controller answers every `STATE_PERIOD_S`, and its answer holds until the next.
    """
    steps = max(1, round(STATE_PERIOD_S / simulation.config.step_s))
    state = simulation.reset()
    controller.reset()
    rows: list[tuple] = []
    for _ in range(round(duration_s / (steps * simulation.config.step_s))):
        command(controller, state.stamp_ns)
        legs = controller.update(state.stamp_ns, state.joint_angle_rad, state.joint_velocity_radps)
        simulation.command(legs.velocity_radps)
        state = simulation.advance(steps)
        rows.append((state.stamp_ns * 1e-9, state.position_m,
                     rpy_from_wxyz(state.orientation_wxyz), state.joint_angle_rad,
                     state.joint_velocity_radps, state.motor_torque_nm, state.contact_force_n,
                     legs.angle_rad, legs.phase))
    columns = [np.array(column) for column in zip(*rows)]
    columns[2][:, 2] = np.unwrap(columns[2][:, 2])
    return Walk(*columns)


def measure_stride(simulation: Simulation, gait: GaitConfig, stride: Stride,
                   measure_s: float = MEASURE_S) -> tuple[float, float]:
    """Return the mean velocity [m/s, rad/s] of a stride, over whole cycles after the start.

    It is measured for `measure_s` and four cycles at least.
    """
    rate = stride.phase_rate_hz
    skip_s = max(SKIP_S, SKIP_CYCLES / rate)
    cycles = math.ceil(max(MEASURE_CYCLES, measure_s * rate))
    end_s = skip_s + cycles / rate
    done = walk(simulation, GaitController(gait), end_s + STATE_PERIOD_S,
                lambda controller, stamp_ns: controller.set_stride(stride, stamp_ns))
    return done.mean_velocity(skip_s, end_s)


def measure(rover: RoverDescription | None = None, physics: PhysicsConfig | None = None,
            gait: GaitConfig | None = None, rates_hz: Sequence[float] = FINE[0],
            turns: Sequence[float] = FINE[1], workers: int = 1,
            progress: Progress | None = None, measure_s: float = MEASURE_S) -> GaitCalibration:
    """Walk every stride of a table on flat ground, turning left and right, and return the table.

    Left and right are averaged: a trot begins with one diagonal, and is no mirror image.
    `workers` processes share the walks; their number does not change the result.
    `progress(done, all)` is called after each. Raises PhysicsError where a walk cannot be
    simulated, ConfigError where the rover does not walk forward and turn.
    """
    settings = dataclasses.replace(_settings(rover, physics, gait), measure_s=measure_s)
    strides = [Stride.turning(rate, sign * turn) for rate in rates_hz for turn in turns
               for sign in ((1.0, -1.0) if turn else (1.0,))]
    results = dict(zip(strides, _all(_measure_one, strides, settings, workers, progress)))
    forward = np.zeros((len(rates_hz), len(turns)))
    yaw_rate = np.zeros_like(forward)
    for i, rate in enumerate(rates_hz):
        for k, turn in enumerate(turns):
            left = results[Stride.turning(rate, turn)]
            right = results[Stride.turning(rate, -turn)] if turn else (left[0], -left[1])
            forward[i, k] = 0.5 * (left[0] + right[0])
            yaw_rate[i, k] = 0.5 * (left[1] - right[1])
    described, simulated, walked = settings.rover, settings.physics, settings.gait
    return GaitCalibration(
        tuple(rates_hz), tuple(turns), tuple(tuple(row) for row in forward.tolist()),
        tuple(tuple(row) for row in yaw_rate.tolist()), walked.duty_factor, walked.foot_width_deg,
        {'gait': walked.gait, 'stance_smoothing': walked.stance_smoothing,
         'flight_smoothing': walked.flight_smoothing, 'gravity_mps2': simulated.gravity_mps2,
         'sliding_friction': simulated.contact.sliding_friction,
         'stiffness_npm': simulated.contact.stiffness_npm,
         'rover_mass_kg': round(described.chassis.mass_kg + 4.0 * described.legs.mass_kg, 6),
         'spoke_length_m': described.legs.spoke_length_m})


@dataclasses.dataclass(frozen=True)
class Obedience:
    """What became of a velocity command: asked and measured, forward [m/s] and yaw rate [rad/s].

    It was followed within 10 % of the forward speed and 15 % of the yaw rate, the latter of 0.05
    rad/s at least: below, the start of the walk alone turns the rover that much.
    """

    asked: tuple[float, float]
    measured: tuple[float, float]

    @property
    def forward_error(self) -> float:
        """Relative error of the forward speed."""
        return (self.measured[0] - self.asked[0]) / self.asked[0]

    @property
    def yaw_error_radps(self) -> float:
        """Error of the yaw rate [rad/s]."""
        return self.measured[1] - self.asked[1]

    @property
    def within(self) -> bool:
        """Whether the command was followed."""
        return (abs(self.forward_error) <= FORWARD_TOLERANCE
                and abs(self.yaw_error_radps)
                <= YAW_TOLERANCE * max(abs(self.asked[1]), SLOWEST_YAW_RADPS))


def measure_commands(velocities: Sequence[tuple[float, float]], calibration: GaitCalibration,
                     rover: RoverDescription | None = None, physics: PhysicsConfig | None = None,
                     gait: GaitConfig | None = None, workers: int = 1,
                     progress: Progress | None = None) -> list[Obedience]:
    """Command velocities (forward, yaw rate) on flat ground; measure what the rover does.

    Means run from 5 s after the start for a minute: a fast walk wanders about its mean course.
    """
    settings = dataclasses.replace(_settings(rover, physics, gait), calibration=calibration,
                                   measure_s=COMMAND_S)
    results = _all(_command_one, velocities, settings, workers, progress)
    return [Obedience(asked, result) for asked, result in zip(velocities, results)]


@dataclasses.dataclass(frozen=True)
class _Settings:
    rover: RoverDescription
    physics: PhysicsConfig
    gait: GaitConfig
    calibration: GaitCalibration | None = None
    measure_s: float = MEASURE_S


def _settings(rover: RoverDescription | None, physics: PhysicsConfig | None,
              gait: GaitConfig | None) -> _Settings:
    physics = dataclasses.replace(physics or PhysicsConfig(), start=StartPose())
    rover, gait = rover or RoverDescription(), gait or GaitConfig()
    gait.check_spokes(rover.legs.spokes)
    return _Settings(rover, physics, gait)


def _measure_one(simulation: Simulation, settings: _Settings,
                 stride: Stride) -> tuple[float, float]:
    return measure_stride(simulation, settings.gait, stride, settings.measure_s)


def _command_one(simulation: Simulation, settings: _Settings,
                 velocity: tuple[float, float]) -> tuple[float, float]:
    done = walk(simulation, GaitController(settings.gait, settings.calibration),
                SKIP_S + settings.measure_s + STATE_PERIOD_S,
                lambda controller, stamp_ns: controller.set_velocity(*velocity, stamp_ns))
    return done.mean_velocity(SKIP_S, SKIP_S + settings.measure_s)


_Task = Callable[[Simulation, _Settings, Any], tuple[float, float]]
_shared: tuple[Simulation, _Settings] | None = None  # of one worker process


def _all(task: _Task, items: Sequence[Any], settings: _Settings, workers: int,
         progress: Progress | None) -> list[tuple[float, float]]:
    """Return task(simulation, settings, item) of all items, by this process or by several."""
    results: list[tuple[float, float]] = []

    def collect(stream: Iterable[tuple[float, float]]) -> None:
        for result in stream:
            results.append(result)
            if progress is not None:
                progress(len(results), len(items))

    if workers <= 1:
        with _simulation(settings) as simulation:
            collect(task(simulation, settings, item) for item in items)
        return results
    with concurrent.futures.ProcessPoolExecutor(
            workers, multiprocessing.get_context('spawn'), _start_worker, (settings,)) as pool:
        try:
            collect(pool.map(functools.partial(_shared_task, task), items))
        except BrokenProcessPool as error:
            raise EvaluationError(f'a worker process died: {error}') from None
    return results


def _simulation(settings: _Settings) -> Simulation:
    # Who walks straight on for long needs room for it.
    return Simulation(flat_world(FASTEST_MPS * (SKIP_S + settings.measure_s)), settings.rover,
                      settings.physics)


def _start_worker(settings: _Settings) -> None:
    global _shared
    _shared = (_simulation(settings), settings)


def _shared_task(task: _Task, item: Any) -> tuple[float, float]:
    if _shared is None:
        raise EvaluationError('the worker process has not started')
    return task(*_shared, item)
