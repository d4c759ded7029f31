"""How well velocity commands are followed on flat ground."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses
import functools

from lunar_rover_sim.gait.calibration import GaitCalibration
from lunar_rover_sim.gait.controller import GaitController
from lunar_rover_sim.studies.gait_measurement import MeasurementSettings, SKIP_S
from lunar_rover_sim.studies.parallel import map_in_processes
from lunar_rover_sim.studies.walking import STATE_PERIOD_S, walk

MEASURE_S = 60.0   # a fast walk varies about its mean course
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


def measure_commands(commands: Sequence[tuple[float, float]], calibration: GaitCalibration,
                     settings: MeasurementSettings = MeasurementSettings(), workers: int = 1,
                     progress: Callable[[int, int], object] = lambda done, total: None
                     ) -> list[CommandTracking]:
    """Command velocities (forward [m/s], yaw rate [rad/s]) and measure what the rover does.

    Means are taken over a minute, from 5 s after the start on. `workers` processes share the
    walks; `progress` is called with the number of walks done, and of all.
    """
    settings = dataclasses.replace(settings, measure_s=MEASURE_S)
    measured = map_in_processes(functools.partial(_follow, settings, calibration), commands,
                                workers, lambda _, done, total: progress(done, total))
    return [CommandTracking(*pair) for pair in zip(commands, measured)]


def _follow(settings: MeasurementSettings, calibration: GaitCalibration,
            command: tuple[float, float]) -> tuple[float, float]:
    end_s = SKIP_S + settings.measure_s
    with settings.simulation() as simulation:
        recorded = walk(simulation, GaitController(settings.gait, calibration),
                        end_s + STATE_PERIOD_S,
                        lambda controller, stamp_ns: controller.set_velocity(*command, stamp_ns))
    return recorded.mean_velocity(SKIP_S, end_s)
