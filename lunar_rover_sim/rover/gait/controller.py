"""The leg controller: from a commanded velocity and the joint state to joint velocities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.errors import brief, ConfigError, GaitError
from lunar_rover_sim.base.files.state_file import attributes_but, restore_attributes
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.rover.description import Legs
from lunar_rover_sim.rover.gait.calibration import GaitCalibration, STAND, Stride
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.gait.shaping import ShapingFunction

MAX_COMMAND = 10.0      # [m/s] or [rad/s], far beyond any walk: a mistake of units
_MIN_DUTY, _MAX_DUTY = 0.1, 0.9
_MIN_SWEEP = 0.05      # least share of the foot width that a stance sweeps: hardly any motion
_SHAPE_FIELDS = ('duty_factor', 'foot_width_deg', 'stance_smoothing', 'flight_smoothing')


@dataclasses.dataclass(frozen=True)
class LegCommand:
    """The command to the motors, in the order of the rover's legs.

    Attributes:
        velocity_radps: (legs,) velocity command.
        angle_rad: (legs,) reference angle, unwrapped to the present turn of each leg.
        phase: (legs,) phase of each leg [cycles], 0 in the middle of stance.
    """

    velocity_radps: Array
    angle_rad: Array
    phase: Array


def check_velocity(forward_mps: float, yaw_rate_radps: float) -> None:
    """Raise GaitError if a commanded velocity is no number, or beyond any walk."""
    try:
        valid = abs(forward_mps) <= MAX_COMMAND and abs(yaw_rate_radps) <= MAX_COMMAND
    except TypeError:
        valid = False
    if not valid:
        raise GaitError(f'velocity: {forward_mps} m/s and {yaw_rate_radps} rad/s is not valid;'
                        f' valid is -{MAX_COMMAND:g} to {MAX_COMMAND:g}')


class GaitController:
    """Walks by phases: each leg follows its share of one clock through the shaping function.

    The velocity command of a leg has three terms::

        u = p' s(p) + k_p (a(p) - q) + k_v (p' s(p) - q')

    They are feedforward from the slope s of the shaping function at the phase p that advances with
    p', feedback of the angle error against the shaped angle a(p), and feedback of the velocity of
    the motor. A reference that leads its leg by `max_angle_lead_deg` waits for it, so that a
    blocked leg is pushed by a bounded command. Once free, the leg returns to its phase
    (`LegPhases`). In flight u is within `max_flight_lead_radps` of q': the inner legs of a tight
    arc swing fast, and one that strikes a rock would throw the body.

    Without a command, at a command of zero, or when the command is older than `cmd_timeout_s`, the
    rover stands: each leg turns its nearest spoke straight down and holds it.

    The controller reads no clock: the same calls give the same commands.
    """

    def __init__(self, config: GaitConfig | None = None,
                 calibration: GaitCalibration | None = None, legs: Legs = Legs()) -> None:
        """Stand, until the first command.

        Args:
            legs: Those of the rover; by default the four of the packaged one.

        Raises:
            ConfigError: If the phase offsets are not one for each leg.
        """
        self._config = config or GaitConfig()
        self._legs = legs
        self._sides = [0 if left else 1 for left in legs.on_left]
        self._offsets = self._config.offsets(legs)
        self._calibration = calibration or GaitCalibration.default()
        self.reset()

    def __repr__(self) -> str:
        forward_mps, yaw_rate_radps = self._velocity
        return (f'GaitController({self._config.gait}, {len(self._offsets)} legs, at '
                f'{forward_mps:g} m/s and {yaw_rate_radps:g} rad/s)')

    @property
    def config(self) -> GaitConfig:
        """The parameters in force, or blended towards."""
        return self._config

    @property
    def calibration(self) -> GaitCalibration:
        """The map from velocity to stride."""
        return self._calibration

    @property
    def stride(self) -> Stride:
        """The stride in force."""
        return self._stride

    @property
    def saturated(self) -> bool:
        """Whether the latest command was beyond reach and has been scaled down."""
        return self._saturated

    def reset(self) -> None:
        """Forget time, phases and command: the next update starts from the angles it is given."""
        self._last_ns: int | None = None
        self._command_ns: float = -math.inf
        self._velocity = (0.0, 0.0)
        self._stride = self._commanded = STAND
        self._saturated = self._saturation_reported = False
        self._reports: list[str] = []
        self._phases = LegPhases(self._legs.on_left)
        self._sweeps = [1.0, 1.0]         # left, right: share of the foot width
        self._duty_offset = 0.0
        self._shape = {name: getattr(self._config, name) for name in _SHAPE_FIELDS}
        self._shape_from = dict(self._shape)
        self._blend_s = math.inf          # time since the last change of parameters
        self._settings: list[tuple[float, ...]] = []
        self._make_sides()

    def state(self) -> dict[str, Any]:
        """Return all that the gait goes on from."""
        return attributes_but(self, '_config', '_legs', '_sides', '_offsets', '_calibration')

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` has returned, of a controller with the same parameters."""
        restore_attributes(self, state)

    def set_velocity(self, forward_mps: float, yaw_rate_radps: float,
                     stamp_ns: int | None = None) -> None:
        """Command a velocity: forward [m/s] and yaw rate [rad/s, left positive].

        It holds until `cmd_timeout_s` after `stamp_ns`; without a stamp, until the next command. A
        velocity beyond reach is scaled down with its curvature kept, and reported once.

        Raises:
            GaitError: If a value is no number, or beyond any walk; the command in force is kept.
        """
        check_velocity(forward_mps, yaw_rate_radps)
        self._command_ns = math.inf if stamp_ns is None else stamp_ns
        if (forward_mps, yaw_rate_radps) != self._velocity:
            self._velocity = (forward_mps, yaw_rate_radps)
            self._look_up()

    def set_stride(self, stride: Stride, stamp_ns: int | None = None) -> None:
        """Command a stride itself, without the calibration, which is measured in this way.

        `stamp_ns` as in `set_velocity`.
        """
        self._command_ns = math.inf if stamp_ns is None else stamp_ns
        self._velocity = (math.nan, math.nan)
        self._commanded, self._saturated = stride, False

    def take_reports(self) -> list[str]:
        """Return the reports since the last call, one line each."""
        reports, self._reports = self._reports, []
        return reports

    def configure(self, config: GaitConfig) -> None:
        """Change the parameters; the shape is blended within the new `blend_time_s`.

        Raises:
            ConfigError: If the number of spokes, or of phase offsets, is that of another
                rover.
        """
        if config.spokes != self._config.spokes:
            raise ConfigError(f'spokes: {config.spokes} is not valid while running; valid is'
                              f' {self._config.spokes}, or a new start')
        self._offsets = config.offsets(self._legs)
        self._shape_from = dict(self._shape)
        self._blend_s = 0.0
        self._config = config
        if math.isfinite(self._velocity[0]):
            self._look_up()

    def update(self, stamp_ns: int, joint_angle_rad: ArrayLike,
               joint_velocity_radps: ArrayLike) -> LegCommand:
        """Return the command for the joint state at `stamp_ns`.

        If time goes backward, the controller is reset.

        Args:
            joint_angle_rad: (legs,) as measured, unwrapped.
            joint_velocity_radps: (legs,) as measured.

        Raises:
            GaitError: If angles or velocities are not finite numbers, one for each leg.
        """
        angle = self._values('angle', joint_angle_rad)
        velocity = self._values('velocity', joint_velocity_radps)
        if self._last_ns is not None and stamp_ns < self._last_ns:
            self.reset()
        dt = 0.0
        if self._last_ns is None:
            self._phases.start([float(self._shapings[side].phase(q))
                                for side, q in zip(self._sides, angle)])
        else:
            dt = (stamp_ns - self._last_ns) * 1e-9
        self._last_ns = stamp_ns
        is_fresh = stamp_ns - self._command_ns <= self._config.cmd_timeout_s * 1e9
        self._stride = self._commanded if is_fresh else STAND
        self._blend(dt)
        self._follow(dt, angle)
        return self._command(angle, velocity)

    def _look_up(self) -> None:
        """Find the stride of the commanded velocity."""
        self._commanded, scale = self._calibration.stride(*self._velocity, self._config)
        self._saturated = scale < 1.0
        if self._saturated and not self._saturation_reported:
            self._saturation_reported = True
            forward, yaw_rate = self._velocity
            self._reports.append(
                f'velocity command {forward:.3f} m/s, {yaw_rate:.3f} rad/s is beyond reach: scaled'
                f' by {scale:.2f}, curvature kept (reported once)')

    def _blend(self, dt: float) -> None:
        """Move shape, sweeps and duty offset towards the parameters and the stride in force."""
        self._blend_s += dt
        x = min(self._blend_s / self._config.blend_time_s, 1.0)
        x = x * x * (3.0 - 2.0 * x)
        for name in _SHAPE_FIELDS:
            start = self._shape_from[name]
            self._shape[name] = start + x * (getattr(self._config, name) - start)
        if not self._stride.stands:
            step = dt / self._config.blend_time_s
            for side, sweep in enumerate((self._stride.left_sweep, self._stride.right_sweep)):
                self._sweeps[side] += _bounded(abs(sweep) - self._sweeps[side], step)
            self._duty_offset += _bounded(self._stride.duty_offset - self._duty_offset, step)
        self._make_sides()

    def _make_sides(self) -> None:
        """Make the shaping functions of both sides, if anything has changed."""
        duty, width, *smoothing = (self._shape[name] for name in _SHAPE_FIELDS)
        settings = [(min(max(duty + sign * self._duty_offset, _MIN_DUTY), _MAX_DUTY),
                     math.radians(width) * max(sweep, _MIN_SWEEP), *smoothing,
                     self._config.pitch_rad)
                    for sign, sweep in zip((1.0, -1.0), self._sweeps)]
        if settings != self._settings:
            self._settings = settings
            self._shapings = [ShapingFunction(*values) for values in settings]

    def _follow(self, dt: float, angle: list[float]) -> None:
        """Advance the phases as far as the legs can follow."""
        config, phases = self._config, self._phases
        for leg, side in enumerate(self._sides):
            # All spokes are alike: a leg that was turned by hand goes on with its nearest spoke.
            lead = self._shapings[side].angle_at(phases.phase[leg]) - angle[leg]
            phases.phase[leg] -= round(lead / config.pitch_rad)
        held = list(phases.phase)
        phases.advance(dt, config, self._stride, self._offsets)
        limit = math.radians(config.max_angle_lead_deg)
        for leg, side in enumerate(self._sides):
            lead = self._shapings[side].angle_at(phases.phase[leg]) - angle[leg]
            if abs(lead) > limit and lead * phases.rate[leg] > 0.0:
                phases.phase[leg] = held[leg]

    def _command(self, angle: list[float], velocity: list[float]) -> LegCommand:
        config, phases = self._config, self._phases
        limit = config.max_joint_velocity_radps
        commands, references = [], []
        for leg, side in enumerate(self._sides):
            shaping, phase = self._shapings[side], phases.phase[leg]
            reference = shaping.angle_at(phase)
            forward = phases.rate[leg] * shaping.slope_at(phase)
            command = (forward + config.position_gain * (reference - angle[leg])
                       + config.velocity_gain * (forward - velocity[leg]))
            if shaping.is_flight(phase):
                lead = _bounded(command - velocity[leg], config.max_flight_lead_radps)
                command = velocity[leg] + lead
            commands.append(_bounded(command, limit))
            references.append(reference)
        return LegCommand(np.array(commands), np.array(references), np.array(phases.phase))

    def _values(self, name: str, values: ArrayLike) -> list[float]:
        try:
            array = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape != (len(self._sides),) or not np.isfinite(array).all():
            raise GaitError(f'joint {name}: {brief(values)} is not valid; valid are '
                            f'{len(self._sides)} finite numbers')
        return array.tolist()


def _bounded(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


SETTLE_GAIN = 3.0   # phase rate per phase error when standing [1/s]
_AGILITY = 4.0      # factor by which legs may change their rate faster than the clock
# Bounds on the rate that corrects the phase of a leg: back and ahead, as shares of the clock's
# rate, and ahead in Hz. A leg that is early slows down but never turns back.
_BACK, _AHEAD, _AHEAD_HZ = 0.75, 0.5, 0.2


class LegPhases:
    """One phase per leg [cycles, unwrapped], each with a rate of its own.

    While walking, leg i converges to the nearest phase equal to direction * (clock + offset i)
    modulo 1, at a bounded rate, from any start, after a block and after a change of gait. While
    standing, it converges to the nearest whole phase, where a spoke points straight down. Phases
    never jump, and rates change with bounded acceleration.
    """

    def __init__(self, on_left: Sequence[bool]) -> None:
        """Start at rest; on_left: which legs are on the left."""
        self._on_left = tuple(on_left)
        self.phase = [0.0] * len(on_left)   # [cycles]
        self.rate = [0.0] * len(on_left)    # [Hz]
        self._clock = 0.0        # [cycles]
        self._clock_rate = 0.0   # [Hz], >= 0
        self._walking = False

    def start(self, phase: Sequence[float]) -> None:
        """Start at rest from the phases of the legs."""
        self.phase = list(phase)

    def advance(self, dt: float, config: GaitConfig, stride: Stride,
                offsets: Sequence[float]) -> None:
        """Advance by dt [s] with the rate and the directions of a stride, at phase offsets."""
        step = config.phase_acceleration_hzps * dt
        self._clock_rate += _clip(stride.phase_rate_hz - self._clock_rate, -step, step)
        direction = [math.copysign(1.0, stride.left_sweep if left else stride.right_sweep)
                     for left in self._on_left]
        if stride.stands:
            target = [_clip(-SETTLE_GAIN * _wrap(phase), -config.settle_rate_hz,
                            config.settle_rate_hz) for phase in self.phase]
        else:
            if not self._walking:
                self._clock = self._nearest_clock(direction, offsets)
            self._clock += self._clock_rate * dt
            target = []
            for sign, offset, phase in zip(direction, offsets, self.phase):
                error = sign * _wrap(sign * (self._clock + offset) - phase)
                pull = _clip(config.phase_gain * error, -_BACK * self._clock_rate,
                             _AHEAD * self._clock_rate + _AHEAD_HZ)
                target.append(sign * (self._clock_rate + pull))
        self._walking = not stride.stands
        for leg in range(len(target)):
            self.rate[leg] += _clip(target[leg] - self.rate[leg], -_AGILITY * step,
                                    _AGILITY * step)
            self.phase[leg] += self.rate[leg] * dt

    def _nearest_clock(self, direction: Sequence[float], offsets: Sequence[float]) -> float:
        """Return the clock [cycles] with the least sum of squared phase errors of the legs."""
        def error(clock: float) -> float:
            return sum(_wrap(sign * (clock + offset) - phase) ** 2
                       for sign, offset, phase in zip(direction, offsets, self.phase))

        return min((k / 64.0 for k in range(64)), key=error)


def _wrap(phase: float) -> float:
    """Return a phase wrapped to [-1/2, 1/2)."""
    return (phase + 0.5) % 1.0 - 0.5


def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
