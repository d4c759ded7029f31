"""The wheel odometry study: errors against the true pose, and the stated covariance."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import functools

import numpy as np

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import nees_interval
from lunar_rover_sim.judge.studies.study_folder import map_in_processes, Progress, silent
from lunar_rover_sim.judge.studies.walking import STATE_PERIOD_S, Walk, walk
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.gait.controller import GaitController
from lunar_rover_sim.rover.physics.state import TIPPED_DEG
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.sensors.wheel_odometry import Rolling, RollingFeet, WheelOdometry

COMMAND_S = 5.0                           # duration of each random command
LEAST_DRIVES = 3
_FORWARD_MPS, _YAW_RADPS = (-0.1, 0.2), (-0.15, 0.15)


@dataclasses.dataclass(frozen=True)
class OdometryStudy:
    """Errors and consistency of the wheel odometry over several drives.

    Attributes:
        drives: Number of drives.
        rolled_m: Way that their legs rolled, in all.
        tipped_over: Seeds of further drives, in which the rover tipped over: encoders do not see
            that.
        measured: Scales and deviations that fit these drives.
        errors: (n, 3) true pose less that of the odometry at the end of each drive, in the frame
            of its start: x, y [m], yaw [rad].
        consistency: Squared errors at the end over their stated covariance, mean of the drives and
            of the three axes; 1 where the covariance is right, more where it promises too much.
        interval: (2,) where it lies in 95 of 100 studies of as many drives if the covariance is
            right (Bar-Shalom, Li, Kirubarajan, Estimation with applications to tracking and
            navigation, 2001, section 5.4).
    """

    drives: int
    tipped_over: tuple[int, ...]
    rolled_m: float
    measured: Rolling
    errors: Array
    consistency: float
    interval: tuple[float, float]

    @property
    def consistent(self) -> bool:
        """Whether the errors agree with the stated covariance: `consistency` is in `interval`."""
        return self.interval[0] <= self.consistency <= self.interval[1]


def study(scenario: Scenario, seeds: Sequence[int], duration_s: float, workers: int = 1,
          progress: Progress = silent) -> OdometryStudy:
    """Drive with random commands on the scenario's world of each seed; judge the odometry.

    Args:
        seeds: At least `LEAST_DRIVES`.
        duration_s: Of each drive [s], at least one command long.

    Raises:
        StudyError: If the rover tipped over in all but two of them, or stood still.
    """
    walks = map_in_processes(functools.partial(_drive, scenario, duration_s), seeds, workers,
                             progress)
    config = scenario.physics_node
    result = judge(walks, scenario.rover, config.wheel_odometry.counts_per_turn,
                   Rolling.of(config.wheel_odometry, config.ground.name, scenario.rover.name))
    return dataclasses.replace(result, tipped_over=tuple(seeds[k] for k in result.tipped_over))


def _drive(scenario: Scenario, duration_s: float, seed: int) -> Walk:
    scenario = dataclasses.replace(scenario, shared=dataclasses.replace(scenario.shared,
                                                                        seed=seed))
    rng = np.random.default_rng(seed)
    commands = [(rng.uniform(*_FORWARD_MPS), rng.uniform(*_YAW_RADPS))
                for _ in range(int(duration_s / COMMAND_S) + 1)]

    def command(controller: GaitController, stamp_ns: int) -> None:
        controller.set_velocity(*commands[int(stamp_ns * 1e-9 / COMMAND_S)], stamp_ns)

    with scenario.simulation() as simulation:
        return walk(simulation, scenario.gait_controller(), duration_s, command)


def judge(walks: Sequence[Walk], rover: RoverDescription, counts_per_turn: int,
          rolling: Rolling) -> OdometryStudy:
    """Judge wheel odometry on recorded walks.

    Walks in which the rover tips over are left out; `tipped_over` holds their indices.

    Args:
        counts_per_turn: Of the encoders.
        rolling: Scales and deviations that the odometry assumes.

    Raises:
        StudyError: If fewer than three are left, or if the rover stood still.
    """
    tipped_over = tuple(k for k, each in enumerate(walks) if each.tilt_deg().max() > TIPPED_DEG)
    walks = [each for k, each in enumerate(walks) if k not in tipped_over]
    if len(walks) < LEAST_DRIVES:
        raise StudyError(f'{len(walks)} drives in which the rover does not tip over are not valid;'
                         f' valid are at least {LEAST_DRIVES}')
    rolled = [_rolled(each, RollingFeet(rover, counts_per_turn)) for each in walks]
    true = [each.steps() for each in walks]
    period = round(COMMAND_S / STATE_PERIOD_S)
    ways, steps = (np.concatenate([_sums(each, period) for each in kind])
                   for kind in (rolled, true))
    if not ways[:, 2].sum() > 0.0 or not np.all(np.square(ways[:, :2]).sum(axis=0) > 0.0):
        raise StudyError('the legs did not roll')
    scales = [float(ways[:, k] @ steps[:, j] / (ways[:, k] @ ways[:, k]))
              for k, j in ((0, 0), (1, 2))]
    missed = steps - np.column_stack([scales[0] * ways[:, 0], np.zeros(len(ways)),
                                      scales[1] * ways[:, 1]])
    stddev = np.sqrt(np.square(missed).sum(axis=0) / ways[:, 2].sum())
    measured = Rolling(*scales, *(float(value) for value in stddev))
    errors, squares = zip(*(_error(each, WheelOdometry(rover, counts_per_turn, rolling))
                            for each in walks))
    rolled_m = float(sum(each[:, 2].sum() for each in rolled))
    return OdometryStudy(len(walks), tipped_over, rolled_m, measured, np.array(errors),
                         float(sum(squares) / (3 * len(walks))), nees_interval(3, len(walks)))


def _rolled(recorded: Walk, feet: RollingFeet) -> Array:
    """Return (n - 1, 3) forward ways [m], turns [rad] and ways of the legs [m]."""
    return np.array([dataclasses.astuple(feet.add(angles))
                     for angles in recorded.joint_angle_rad][1:])


def _sums(values: Array, length: int) -> Array:
    """Return the sums of each `length` rows; an incomplete rest is left out."""
    whole = len(values) // length * length
    if whole == 0:
        return values.sum(axis=0, keepdims=True)
    return values[:whole].reshape(-1, length, values.shape[1]).sum(axis=1)


def _error(recorded: Walk, odometry: WheelOdometry) -> tuple[Array, float]:
    """Return the (3,) error at the end of a walk, and its square over the covariance."""
    for angles in recorded.joint_angle_rad:
        odometry.add(angles, STATE_PERIOD_S)
    yaw = recorded.rpy_rad[:, 2]
    x, y = recorded.position_m[-1, :2] - recorded.position_m[0, :2]
    c, s = np.cos(yaw[0]), np.sin(yaw[0])
    error = np.array([c * x + s * y, c * y - s * x, yaw[-1] - yaw[0]]) - odometry.pose
    return error, float(error @ np.linalg.solve(odometry.covariance, error))
