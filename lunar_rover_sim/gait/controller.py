"""The leg controller: from a commanded velocity and the joint state to joint velocities."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.gait.calibration import GaitCalibration
from lunar_rover_sim.gait.config import GaitConfig
from lunar_rover_sim.gait.shaping import ShapingFunction
from lunar_rover_sim.gait.stride import STAND, Stride

Array = NDArray[np.float64]

_LEFT = np.array([True, False, True, False])  # of front_left, front_right, rear_left, rear_right
_SETTLE_GAIN = 3.0    # phase rate per phase error when standing [1/s]
_MIN_DUTY, _MAX_DUTY = 0.1, 0.9
_MIN_SWEEP = 0.05     # below this share of the foot width a stance is as good as still
_SHAPE_FIELDS = ('duty_factor', 'foot_width_deg', 'stance_smoothing', 'flight_smoothing')


@dataclasses.dataclass(frozen=True)
class LegCommand:
    """What the four motors are told, in the order of `topics.LEGS`.

    velocity_radps: (4,) velocity command; angle_rad: (4,) reference angle, unwrapped to the
    present turn of each leg; phase: (4,) phase of each leg [cycles], 0 in the middle of stance.
    """

    velocity_radps: Array
    angle_rad: Array
    phase: Array


class GaitController:
    """Walks by phases: each leg follows its share of one clock through the shaping function.

    Each leg i has a phase of its own that is drawn to the clock plus its offset; the drawing is
    bounded, so that from any start angle, after a block or a change of gait the leg slides into
    its place without a jump. The velocity command of a leg has three terms,

        u = r' s(p) + k_p (a(p) - q) + k_v (r' s(p) - q'),

    feedforward from the slope s of the shaping function at the phase p that advances with r',
    feedback of the angle error against the shaped angle a(p), and of the motor's velocity error.
    A reference that leads its leg by `max_angle_lead_deg` waits for it.

    Nothing here reads a clock: the same calls give the same commands.
    """

    def __init__(self, config: GaitConfig | None = None,
                 calibration: GaitCalibration | None = None) -> None:
        self._config = config or GaitConfig()
        self._calibration = calibration or GaitCalibration.default()
        self.refused = 0
        self.reset()

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
        """The stride that the legs are asked for now."""
        return self._stride

    @property
    def saturated(self) -> bool:
        """Whether the newest command was beyond reach and has been scaled down."""
        return self._saturated

    def reset(self) -> None:
        """Forget time, phases and command: the next update starts from the angles it is given."""
        self._last_ns: int | None = None
        self._command_ns: int | None = None
        self._stride = self._commanded = STAND
        self._saturated = self._said_saturated = False
        self._reports: list[str] = []
        self._clock = 0.0                 # [cycles]
        self._clock_rate = 0.0            # [Hz], >= 0
        self._phase = np.zeros(4)
        self._rate = np.zeros(4)          # [Hz]
        self._direction = np.ones(4)
        self._sweep = np.ones(2)          # left, right: share of the foot width
        self._duty_offset = 0.0
        self._walking = False
        self._shape = {name: getattr(self._config, name) for name in _SHAPE_FIELDS}
        self._shape_from = dict(self._shape)
        self._blend_s = math.inf          # time since the parameters changed
        self._sides = self._make_sides()

    def set_velocity(self, forward_mps: float, yaw_rate_radps: float, stamp_ns: int) -> bool:
        """Take a velocity command: forward [m/s] and yaw rate [rad/s, left positive].

        Returns False, and changes nothing but the count `refused`, where a value is not finite.
        What is beyond reach is scaled down with its curvature kept, and reported once.
        """
        if not (math.isfinite(forward_mps) and math.isfinite(yaw_rate_radps)):
            self.refused += 1
            return False
        self._command_ns = stamp_ns
        self._commanded, scale = self._calibration.stride(forward_mps, yaw_rate_radps)
        if self._commanded.phase_rate_hz > self._config.max_phase_rate_hz:
            scale *= self._config.max_phase_rate_hz / self._commanded.phase_rate_hz
            self._commanded = dataclasses.replace(
                self._commanded, phase_rate_hz=self._config.max_phase_rate_hz)
        self._saturated = scale < 1.0
        if self._saturated and not self._said_saturated:
            self._said_saturated = True
            self._reports.append(
                f'velocity command {forward_mps:.3f} m/s, {yaw_rate_radps:.3f} rad/s is beyond'
                f' reach: scaled by {scale:.2f}, curvature kept (said once)')
        return True

    def take_reports(self) -> list[str]:
        """Return what there is to say since the last call, one line each."""
        reports, self._reports = self._reports, []
        return reports

    def configure(self, config: GaitConfig) -> None:
        """Change the parameters; the shape blends over within the new `blend_time_s`.

        Raises ConfigError where the number of spokes differs: that is another rover.
        """
        if config.spokes != self._config.spokes:
            raise ConfigError(f'spokes: {config.spokes} is not valid while running; valid is'
                              f' {self._config.spokes}, or a new start')
        self._shape_from = dict(self._shape)
        self._blend_s = 0.0
        self._config = config

    def update(self, stamp_ns: int, joint_angle_rad: ArrayLike,
               joint_velocity_radps: ArrayLike) -> LegCommand:
        """Return the command that answers the joint state of `stamp_ns`.

        joint_angle_rad, joint_velocity_radps: (4,) as measured, angles unwrapped. Time that goes
        backward starts the controller anew.
        """
        angle = np.asarray(joint_angle_rad, dtype=float)
        velocity = np.asarray(joint_velocity_radps, dtype=float)
        if self._last_ns is not None and stamp_ns < self._last_ns:
            self.reset()
        if self._last_ns is None:
            self._sides = self._make_sides()
            self._phase = self._sides[0].phase(angle)
            dt = 0.0
        else:
            dt = (stamp_ns - self._last_ns) * 1e-9
        self._last_ns = stamp_ns
        self._choose_stride(stamp_ns)
        self._blend(dt)
        self._advance(dt, angle)
        reference = self._by_side('angle', self._phase)
        forward = self._rate * self._by_side('slope', self._phase)
        command = (forward + self._config.position_gain * (reference - angle)
                   + self._config.velocity_gain * (forward - velocity))
        limit = self._config.max_joint_velocity_radps
        return LegCommand(np.clip(command, -limit, limit), reference, self._phase.copy())

    def _choose_stride(self, stamp_ns: int) -> None:
        fresh = (self._command_ns is not None
                 and stamp_ns - self._command_ns <= self._config.cmd_timeout_s * 1e9)
        self._stride = self._commanded if fresh else STAND
        if self._stride.stands:
            self._walking = False
            return
        self._direction = np.where(_LEFT, math.copysign(1.0, self._stride.left_sweep),
                                   math.copysign(1.0, self._stride.right_sweep))
        if not self._walking:
            self._walking = True
            self._clock = self._nearest_clock()

    def _blend(self, dt: float) -> None:
        """Move shape, sweep and duty offset towards what is asked for."""
        self._blend_s += dt
        x = min(self._blend_s / self._config.blend_time_s, 1.0)
        x = x * x * (3.0 - 2.0 * x)
        for name in _SHAPE_FIELDS:
            start = self._shape_from[name]
            self._shape[name] = start + x * (getattr(self._config, name) - start)
        step = dt / self._config.blend_time_s
        if not self._stride.stands:
            sweep = np.abs([self._stride.left_sweep, self._stride.right_sweep])
            self._sweep += np.clip(sweep - self._sweep, -step, step)
            self._duty_offset += float(np.clip(self._stride.duty_offset - self._duty_offset,
                                               -step, step))
        self._sides = self._make_sides()

    def _make_sides(self) -> tuple[ShapingFunction, ShapingFunction]:
        shape = self._shape
        left, right = (
            ShapingFunction(min(max(shape['duty_factor'] + offset, _MIN_DUTY), _MAX_DUTY),
                            math.radians(shape['foot_width_deg']) * max(sweep, _MIN_SWEEP),
                            shape['stance_smoothing'], shape['flight_smoothing'],
                            self._config.pitch_rad)
            for offset, sweep in ((self._duty_offset, float(self._sweep[0])),
                                  (-self._duty_offset, float(self._sweep[1]))))
        return left, right

    def _by_side(self, method: str, phase: Array) -> Array:
        left, right = self._sides
        return np.where(_LEFT, getattr(left, method)(phase), getattr(right, method)(phase))

    def _advance(self, dt: float, angle: Array) -> None:
        """Advance the clock and the phase of each leg."""
        config = self._config
        # A leg that was turned by hand, or a new start: the nearest spoke is as good.
        lead = self._by_side('angle', self._phase) - angle
        self._phase -= np.round(lead / config.pitch_rad)
        step = config.phase_acceleration_hzps * dt
        self._clock_rate += min(max(self._stride.phase_rate_hz - self._clock_rate, -step), step)
        if self._walking:
            self._clock += self._clock_rate * dt
            error = _wrap(self._direction * (self._clock + np.array(config.offsets))
                          - self._phase)
            pull = np.clip(config.phase_gain * error * self._direction,
                           -0.75 * self._clock_rate, 0.5 * self._clock_rate + 0.2)
            target = self._direction * (self._clock_rate + pull)
        else:
            target = np.clip(-_SETTLE_GAIN * _wrap(self._phase), -config.settle_rate_hz,
                             config.settle_rate_hz)
        self._rate += np.clip(target - self._rate, -4.0 * step, 4.0 * step)
        phase = self._phase + self._rate * dt
        # A reference does not run away from a leg that cannot follow.
        lead = self._by_side('angle', phase) - angle
        waits = ((np.abs(lead) > math.radians(config.max_angle_lead_deg))
                 & (lead * self._rate > 0.0))
        self._phase = np.where(waits, self._phase, phase)

    def _nearest_clock(self) -> float:
        """Return the clock [cycles] that asks least of the legs as they stand."""
        clocks = np.arange(64) / 64.0
        target = self._direction * (clocks[:, None] + np.array(self._config.offsets))
        return float(clocks[np.argmin(np.sum(_wrap(target - self._phase) ** 2, axis=1))])


def _wrap(phase: Array) -> Array:
    """Return phases wrapped to [-1/2, 1/2)."""
    return (phase + 0.5) % 1.0 - 0.5
