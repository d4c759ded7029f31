"""Walks on flat ground: the table from velocity to stride, and how commands are followed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses
import functools
import math

import numpy as np

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.judge.studies.study_folder import map_in_processes, Progress, silent
from lunar_rover_sim.judge.studies.walking import (flat_world, STATE_PERIOD_S, walk, Walk,
                                                   with_physics)
from lunar_rover_sim.rover.gait.calibration import (GaitCalibration, ground_conditions,
                                                    rover_conditions, Stride)
from lunar_rover_sim.rover.gait.controller import GaitController
from lunar_rover_sim.rover.physics.config import StartPose
from lunar_rover_sim.rover.physics.state import TIPPED_DEG
from lunar_rover_sim.run.scenario import Scenario

Grid = tuple[tuple[float, ...], tuple[float, ...]]   # phase rates [Hz], turns
# The sweep of the inner side reverses at 0.7: a turn on either side of it.
FINE: Grid = ((0.2, 0.4, 0.55, 0.75, 1.0, 1.2, 1.5, 1.75, 1.88, 2.0, 2.2),
              (0.0, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.69, 0.71, 0.8, 0.9, 1.0))
COARSE: Grid = ((0.2, 0.5, 0.9, 1.2, 1.5, 2.2), (0.0, 0.1, 0.25, 0.4, 0.55, 0.69, 0.71, 0.85, 1.0))
SKIP_S, SKIP_CYCLES = 5.0, 1.0
MEASURE_S, MEASURE_CYCLES = 20.0, 4.0
MAX_MEASURE_S = 120.0   # a longer walk needs larger ground
FASTEST_MPS = 0.6


def _walked(scenario: Scenario, controller: GaitController, measure_s: float, end_s: float,
            command: Callable[[GaitController, int], object]) -> Walk:
    """Return a walk from the origin of flat ground, on which there is room to walk straight on."""
    world = flat_world(FASTEST_MPS * (SKIP_S + measure_s))
    with with_physics(scenario, start=StartPose()).simulation(world) as simulation:
        return walk(simulation, controller, end_s + STATE_PERIOD_S, command)


def measure_stride(scenario: Scenario, measure_s: float,
                   stride: Stride) -> tuple[float, float] | None:
    """Return the mean velocity [m/s, rad/s] of a stride, over whole cycles after the start.

    It is measured for `measure_s`, and for at least four cycles. None: the rover tips over.
    """
    rate = stride.phase_rate_hz
    skip_s = max(SKIP_S, SKIP_CYCLES / rate)
    cycles = math.ceil(max(MEASURE_CYCLES, measure_s * rate))
    end_s = skip_s + cycles / rate
    gait = scenario.gait_controller_node.for_rover(scenario.rover)
    recorded = _walked(scenario, GaitController(gait, legs=scenario.rover.legs), measure_s, end_s,
                       lambda controller, stamp_ns: controller.set_stride(stride, stamp_ns))
    if recorded.tilt_deg().max() > TIPPED_DEG:
        return None
    return recorded.mean_velocity(skip_s, end_s)


def measure(scenario: Scenario, rates_hz: Sequence[float] = FINE[0],
            turns: Sequence[float] = FINE[1], measure_s: float = MEASURE_S, workers: int = 1,
            progress: Progress = silent) -> GaitCalibration:
    """Walk every stride of a table on flat ground, turning left and right; return the table.

    Left and right are averaged: a trot begins with one diagonal and is not symmetric. The table
    ends below the slowest phase rate at which the rover tips over.

    Args:
        rates_hz, turns: Phase rates [Hz], increasing, and turns of the table.
        measure_s: How long each walk is measured [s].
        workers: Processes that share the walks; their number does not change the result.
        progress: Called after each walk with the number of walks done, and of all.

    Raises:
        PhysicsError: If a walk cannot be simulated.
        StudyError: If the rover tips over at every phase rate.
        ConfigError: If it does not walk forward and turn, or the gait does not fit the rover.
    """
    gait = scenario.gait_controller_node.for_rover(scenario.rover)
    strides = [Stride.turning(rate, sign * turn) for rate in rates_hz for turn in turns
               for sign in ((1.0, -1.0) if turn else (1.0,))]
    results = dict(zip(strides, map_in_processes(
        functools.partial(measure_stride, scenario, measure_s), strides, workers, progress)))
    walked = {stride: velocity for stride, velocity in results.items() if velocity is not None}
    tips = [stride.phase_rate_hz for stride in results if stride not in walked]
    rates_hz = [rate for rate in rates_hz if rate < min(tips, default=math.inf)]
    if not rates_hz:
        raise StudyError(f'the rover tips over at a phase rate of {min(tips):g} Hz, the slowest '
                         'of the table')
    forward = np.zeros((len(rates_hz), len(turns)))
    yaw_rate = np.zeros_like(forward)
    for i, rate in enumerate(rates_hz):
        for k, turn in enumerate(turns):
            left = walked[Stride.turning(rate, turn)]
            right = walked[Stride.turning(rate, -turn)] if turn else (left[0], -left[1])
            forward[i, k] = 0.5 * (left[0] + right[0])
            yaw_rate[i, k] = 0.5 * (left[1] - right[1])
    return GaitCalibration(
        tuple(rates_hz), tuple(turns), tuple(tuple(row) for row in forward.tolist()),
        tuple(tuple(row) for row in yaw_rate.tolist()), gait.duty_factor, gait.foot_width_deg,
        {'gait': gait.gait, 'stance_smoothing': gait.stance_smoothing,
         'flight_smoothing': gait.flight_smoothing, **ground_conditions(scenario.physics_node),
         **rover_conditions(scenario.rover)})


TRACKING_S = 60.0   # a fast walk varies about its mean course
FORWARD_TOLERANCE, YAW_TOLERANCE, SLOWEST_YAW_RADPS = 0.10, 0.15, 0.05
# The velocities (forward [m/s], yaw rate [rad/s]) that must be followed.
COMMANDS = tuple((v, w) for v in (0.03, 0.06, 0.10, 0.15, 0.20, 0.25)
                 for w in (-0.15, -0.10, -0.05, 0.0, 0.05, 0.10, 0.15))


@dataclasses.dataclass(frozen=True)
class CommandTracking:
    """A velocity command and the measured velocity: forward [m/s] and yaw rate [rad/s].

    The command counts as followed within 10 % of the forward speed and 15 % of the yaw rate, the
    latter of at least 0.05 rad/s: for less, the start of the walk alone turns the rover that much.
    """

    commanded: tuple[float, float]
    measured: tuple[float, float]

    @property
    def forward_error(self) -> float:
        """Relative error of the forward speed."""
        return (self.measured[0] - self.commanded[0]) / self.commanded[0]

    @property
    def yaw_error_radps(self) -> float:
        """Error of the yaw rate [rad/s]."""
        return self.measured[1] - self.commanded[1]

    @property
    def followed(self) -> bool:
        """Whether the command was followed."""
        return (abs(self.forward_error) <= FORWARD_TOLERANCE
                and abs(self.yaw_error_radps)
                <= YAW_TOLERANCE * max(abs(self.commanded[1]), SLOWEST_YAW_RADPS))


def measure_commands(scenario: Scenario, commands: Sequence[tuple[float, float]],
                     measure_s: float = TRACKING_S, workers: int = 1,
                     progress: Progress = silent) -> list[CommandTracking]:
    """Command velocities (forward [m/s], yaw rate [rad/s]) and measure what the rover does.

    Means are taken over `measure_s` [s], from 5 s after the start on. `workers` processes share
    the walks.
    """
    return map_in_processes(functools.partial(_follow, scenario, measure_s), commands, workers,
                            progress)


def _follow(scenario: Scenario, measure_s: float,
            command: tuple[float, float]) -> CommandTracking:
    end_s = SKIP_S + measure_s
    recorded = _walked(scenario, scenario.gait_controller(), measure_s, end_s,
                       lambda controller, stamp_ns: controller.set_velocity(*command, stamp_ns))
    return CommandTracking(command, recorded.mean_velocity(SKIP_S, end_s))
