"""Strides, and the measured, invertible map from a commanded velocity to its stride.

A stride is the settings of the gait. The conditions of a measurement are the rover and the ground
on which a map holds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from lunar_rover_sim.base.errors import brief, ConfigError, GaitError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import find_file, packaged_names
from lunar_rover_sim.base.files.yaml_text import read_yaml, yaml_of
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import nearest
from lunar_rover_sim.ground.regolith.config import RIGID
from lunar_rover_sim.rover.description import DEFAULT_ROVER, RoverDescription
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.physics.config import PhysicsConfig

Conditions = dict[str, float | str]
_TOLERANCE = 0.01   # relative; speeds are hardly less exact within it
MAX_DUTY_OFFSET = 0.2
_OFFSET_ALONE = 0.4   # up to this turn, the duty offset alone turns the rover
_OFFSET_HELD = 0.6    # it is held up to this share of the rest, past the reversal of the sweep
_KIND = 'gait_calibration'
_MOST_BYTES = 1 << 20
DEAD_SPEED_MPS = 2e-4   # a slower command (forward, or at the feet by yaw) means to stand
# Estimates for the default rover (0.3 m x 0.21 m between the feet, 8 cm spokes): advance per
# cycle, and half of the effective track width in a turn, in which the feet slip.
_ADVANCE_M, _HALF_TRACK_M = 0.14, 0.25
# Bounds of a table: beyond any legged robot.
_MAX_PHASE_RATE_HZ, _MAX_SPEED_MPS, _MAX_YAW_RATE_RADPS = 50.0, 10.0, 50.0
# Feet slip, and a rover that hops while it turns on the spot drifts: entries may be negative by
# this share of the largest.
_MAX_BACKWARD = 0.3
_HEADER = """\
# Map from velocity to gait, measured on flat ground: rows are phase rates, columns are turns
# (0 straight on, 1 on the spot). Written by `lunar_rover_sim calibrate gait`.
"""


def rover_conditions(rover: RoverDescription) -> Conditions:
    """Return what a gait table depends on of the rover: mass [kg], spokes, places of axles [m].

    `axle_x_m` and `axle_y_m` are those of the outermost legs.
    """
    legs = rover.legs
    return {'rover_mass_kg': round(rover.total_mass_kg, 6), 'spokes': legs.spokes,
            'spoke_length_m': legs.spoke_length_m, 'legs': len(legs.each),
            'axle_x_m': max(abs(x) for x, _, _ in legs.axle_positions_m()),
            'axle_y_m': max(abs(y) for _, y, _ in legs.axle_positions_m())}


def ground_conditions(physics: PhysicsConfig) -> Conditions:
    """Return what a gait table depends on of the ground: gravity, and its contact or its soil."""
    ground = physics.ground
    gravity: Conditions = {'gravity_mps2': physics.gravity_mps2, 'ground': ground.name}
    if not ground.deforms:
        return {**gravity, 'sliding_friction': physics.contact.sliding_friction,
                'stiffness_npm': physics.contact.stiffness_npm}
    soil = ground.soil(physics.gravity_mps2)
    return {**gravity, 'bearing_mnpm3': round(1e-6 * soil.zeta_npm3, 9),
            'soil_friction': soil.friction}


def differences(measured: Mapping[str, Any], here: Conditions) -> list[str]:
    """Return how the conditions of a measurement differ from the present ones, a line each.

    A line names the quantity with both values. What a table does not name is not compared: an
    analytic table names nothing. A table of before soft ground names gravity and no ground, which
    was rigid.
    """
    if 'gravity_mps2' in measured:
        measured = {'ground': RIGID, **measured}
    result = []
    for name, value in here.items():
        then = measured.get(name)
        if isinstance(value, str):
            if then is not None and then != value:
                result.append(f'{name} {then}, here {value}')
        elif isinstance(then, (int, float)) and not math.isclose(then, value, rel_tol=_TOLERANCE):
            result.append(f'{name} {then:g}, here {value:g}')
    return result


@dataclasses.dataclass(frozen=True)
class Stride:
    """The settings of the gait that make one velocity.

    Attributes:
        phase_rate_hz: Cycles per second of all legs, >= 0.
        duty_offset: Added to the duty factor on the left, taken from it on the right; positive
            turns left, because the left feet then move more slowly and stand longer.
        left_sweep, right_sweep: Factor on the foot width of that side, -1 to 1; the sign is the
            direction in which its legs turn.
    """

    phase_rate_hz: float = 0.0
    duty_offset: float = 0.0
    left_sweep: float = 1.0
    right_sweep: float = 1.0

    @classmethod
    def turning(cls, phase_rate_hz: float, turn: float) -> Stride:
        """Return the forward stride of one turn: 0 straight on, 1 left on the spot, -1 right.

        The duty offset alone, up to `MAX_DUTY_OFFSET`, makes wide curves. In tighter ones the
        inner side shortens its sweep and then reverses it, and at last the offset returns to 0:
        on the spot both sides do the same in opposite directions.
        """
        amount = abs(turn)
        beyond = max(0.0, (amount - _OFFSET_ALONE) / (1.0 - _OFFSET_ALONE))
        offset = MAX_DUTY_OFFSET * min(amount / _OFFSET_ALONE, 1.0,
                                       (1.0 - beyond) / (1.0 - _OFFSET_HELD))
        inner = 1.0 - 2.0 * beyond
        if turn < 0.0:
            return cls(phase_rate_hz, -offset, 1.0, inner)
        return cls(phase_rate_hz, offset, inner, 1.0)

    @property
    def stands(self) -> bool:
        """Whether no leg moves."""
        return self.phase_rate_hz == 0.0

    def reversed(self) -> Stride:
        """Return the same motion backward.

        The speed changes its sign and, since the same side still moves less, so does the yaw rate.
        """
        return dataclasses.replace(self, left_sweep=-self.left_sweep,
                                   right_sweep=-self.right_sweep)


STAND = Stride()


def is_packaged(name: str) -> bool:
    """Return whether a calibration is named that comes with the package; else it is a file."""
    return name in packaged_names(_KIND)


def packaged_calibration(ground: str, rover: str = DEFAULT_ROVER) -> str:
    """Return the name of the packaged calibration of a rover, by its name, on a ground.

    Where there is none for the ground it is that of rigid ground, and where there is none for the
    rover that of the default one, which are named by the ground alone.
    """
    prefix = '' if rover == DEFAULT_ROVER else f'{rover}_'
    return next((name for name in (prefix + ground, prefix + RIGID, ground) if is_packaged(name)),
                RIGID)


@dataclasses.dataclass(frozen=True)
class GaitCalibration:
    """Forward speed and yaw rate over phase rate and turn, and their inverse.

    Right turns mirror left turns, and backward motion mirrors forward motion. Between the rows and
    columns, with r the half track, a velocity (v, w) has the course c = atan2(w r, v) and the
    speed s = hypot(v, w r). Along each row the turn is a monotonic function of the course (the
    measured values are made monotonic, so that a range without effect is skipped), and along each
    course the speed is a monotonic function of the phase rate. Both are inverted by linear
    interpolation.

    Attributes:
        phase_rates_hz: (n,) increasing, > 0.
        turns: (m,) increasing from 0 to 1, see `Stride.turning`.
        forward_mps, yaw_rate_radps: (n, m) measured mean velocities, turning left.
        duty_factor, foot_width_deg: Of the measured gait; another gait is scaled by the ratio of
            its advance per cycle, 2 l sin(width / 2) / duty.
        conditions: The other conditions of the measurement.

    Raises:
        ConfigError: If the table cannot be inverted.
    """

    phase_rates_hz: tuple[float, ...]
    turns: tuple[float, ...]
    forward_mps: tuple[tuple[float, ...], ...]
    yaw_rate_radps: tuple[tuple[float, ...], ...]
    duty_factor: float = 0.6
    foot_width_deg: float = 60.0
    conditions: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    _half_track_m: float = dataclasses.field(init=False, repr=False, compare=False)
    _course: Array = dataclasses.field(init=False, repr=False, compare=False)
    _speed: Array = dataclasses.field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        rates, turns = np.array(self.phase_rates_hz), np.array(self.turns)
        forward = _table('forward_mps', self.forward_mps, (len(rates), len(turns)))
        yaw_rate = _table('yaw_rate_radps', self.yaw_rate_radps, (len(rates), len(turns)))
        if (len(rates) < 1 or not np.all(np.isfinite(rates)) or rates[0] <= 0.0
                or np.any(np.diff(rates) <= 0.0) or rates[-1] > _MAX_PHASE_RATE_HZ):
            raise ConfigError(f'phase_rates_hz: {list(self.phase_rates_hz)} is not valid; valid is'
                              f' one or more, > 0, <= {_MAX_PHASE_RATE_HZ:g} and increasing [Hz]')
        for name, value, high in (('duty_factor', self.duty_factor, 1.0),
                                  ('foot_width_deg', self.foot_width_deg, 180.0)):
            if not isinstance(value, (int, float)) or not 0.0 < value < high:
                raise ConfigError(f'{name}: {brief(value)} is not valid; valid is > 0 and '
                                  f'< {high:g}')
        if not isinstance(self.conditions, Mapping):
            raise ConfigError(f'conditions: {brief(self.conditions)} is not a mapping')
        # NaN is not greater than anything.
        if (len(turns) < 2 or not np.all(np.diff(turns) > 0.0)
                or turns[0] != 0.0 or turns[-1] != 1.0):
            raise ConfigError(f'turns: {list(self.turns)} is not valid; valid is increasing from 0'
                              ' to 1')
        if np.any(forward[:, 0] <= 0.0) or np.any(yaw_rate[:, -1] <= 0.0):
            raise ConfigError('forward_mps, yaw_rate_radps: the first column must walk forward and'
                              ' the last one turn left (> 0)')
        _check_range('forward_mps', forward, _MAX_SPEED_MPS)
        _check_range('yaw_rate_radps', yaw_rate, _MAX_YAW_RATE_RADPS)
        for name, straight in (('forward_mps', forward[:, 0]),
                               ('yaw_rate_radps', yaw_rate[:, -1])):
            if np.any(straight < 0.9 * np.maximum.accumulate(straight)):
                raise ConfigError(f'{name}: {straight.tolist()} is not valid; a faster phase rate '
                                  'must not be slower by more than 10 %: the table cannot be '
                                  'inverted')
        half_track = float(np.median(forward[:, 0] / yaw_rate[:, -1]))
        # Not by NumPy, whose arc tangent rounds otherwise where there is AVX-512.
        course = np.vectorize(math.atan2, otypes=[float])(yaw_rate * half_track, forward)
        # By symmetry the first column goes straight on and the last one turns on the spot.
        course[:, 0], course[:, -1] = 0.0, 0.5 * math.pi
        course = np.clip(_increasing(course), 0.0, 0.5 * math.pi)
        speed = np.hypot(forward, yaw_rate * half_track)
        speed[:, -1] = yaw_rate[:, -1] * half_track
        object.__setattr__(self, '_half_track_m', half_track)
        object.__setattr__(self, '_course', course)
        object.__setattr__(self, '_speed', speed)

    @classmethod
    def default(cls) -> GaitCalibration:
        """Return the analytic map of feet that do not slip, for use before one is measured.

        The speed of a side is advance per cycle times phase rate times its sweep, multiplied by
        the duty factor over that of the side. It rests on one trial: 0.14 m/s at 1 Hz, duty 0.6,
        60 deg.
        """
        rates, turns, duty = (1.0, 2.5), tuple(k / 20.0 for k in range(21)), 0.6
        forward, yaw_rate = [], []
        for rate in rates:
            strides = [Stride.turning(rate, turn) for turn in turns]
            sides = [(rate * _ADVANCE_M * s.left_sweep * duty / (duty + s.duty_offset),
                      rate * _ADVANCE_M * s.right_sweep * duty / (duty - s.duty_offset))
                     for s in strides]
            forward.append(tuple(0.5 * (left + right) for left, right in sides))
            yaw_rate.append(tuple(0.5 * (right - left) / _HALF_TRACK_M for left, right in sides))
        return cls(rates, turns, tuple(forward), tuple(yaw_rate),
                   conditions={'source': 'analytic'})

    @classmethod
    def of(cls, config: GaitConfig, ground: str = RIGID,
           rover: str = DEFAULT_ROVER) -> GaitCalibration:
        """Return the map that a gait names, or else the packaged one of a rover on a ground.

        Args:
            ground: `rigid`, or the name of a soil.
            rover: Its name.

        Raises:
            ConfigError: As `load`.
        """
        name = config.calibration or packaged_calibration(ground, rover)
        return cls.load(find_file(_KIND, name) if is_packaged(name) else name)

    @classmethod
    def load(cls, path: str | Path | None) -> GaitCalibration:
        """Read a table from YAML; None gives the analytic default.

        Raises:
            ConfigError: If it is missing, unreadable or not a table; the error names the file.
        """
        if path is None:
            return cls.default()
        try:
            document = read_yaml(Path(path), _MOST_BYTES)
        except ConfigError as error:
            reason = str(error).removeprefix(f'{path}: ').removeprefix('cannot be read: ')
            raise ConfigError(f'calibration: {path} cannot be read: {reason}; make it with'
                              ' `lunar_rover_sim calibrate gait`, or name a packaged one: '
                              f'{", ".join(packaged_names(_KIND))}') from None
        fields = [f.name for f in dataclasses.fields(cls) if f.init]
        if not isinstance(document, dict):
            raise ConfigError(f'calibration: {path} is not a table of {", ".join(fields)}')
        for name in document:
            if name not in fields:
                raise ConfigError(f'calibration: {path}: {name}: no such entry;'
                                  f' {nearest(str(name), fields)}')
        missing = [name for name in fields[:4] if name not in document]
        if missing:
            raise ConfigError(f'calibration: {path}: {", ".join(missing)} missing')
        try:
            for name in fields[:2]:
                document[name] = tuple(float(x) for x in document[name])
            for name in fields[2:4]:
                document[name] = tuple(tuple(float(x) for x in row) for row in document[name])
            return cls(**document)
        except (TypeError, ValueError, OverflowError) as error:
            raise ConfigError(f'calibration: {path} is not a table of numbers: {error}') from None
        except ConfigError as error:
            raise ConfigError(f'calibration: {path}: {error}') from None

    def save(self, path: str | Path) -> None:
        """Write the table as YAML, whole or not at all; an existing file is replaced.

        Raises:
            GaitError: If it cannot be written.
        """
        document: dict[str, Any] = {
            'conditions': dict(self.conditions), 'duty_factor': self.duty_factor,
            'foot_width_deg': self.foot_width_deg, 'phase_rates_hz': list(self.phase_rates_hz),
            'turns': list(self.turns)}
        for name in ('forward_mps', 'yaw_rate_radps'):
            document[name] = [[round(x, 5) for x in row] for row in getattr(self, name)]
        text = _HEADER + yaml_of(document, width=99, default_flow_style=None)
        atomic_write(path, text, GaitError)

    def stride(self, forward_mps: float, yaw_rate_radps: float,
               config: GaitConfig | None = None) -> tuple[Stride, float]:
        """Return the stride for a velocity, and the factor (<= 1) by which it was scaled.

        Beyond the phase rates of the table, `max_phase_rate_hz` or `max_yaw_rate_radps`, both
        velocities are scaled by one factor, which keeps the curvature.
        """
        config = config or GaitConfig()
        scale = 1.0
        if abs(yaw_rate_radps) > config.max_yaw_rate_radps:
            scale = config.max_yaw_rate_radps / abs(yaw_rate_radps)
        v, w = abs(forward_mps) * scale, yaw_rate_radps * scale
        if forward_mps < 0.0:
            w = -w
        side = abs(w) * self._half_track_m
        speed = math.hypot(v, side) / self._advance_ratio(config)
        if speed < DEAD_SPEED_MPS:
            return STAND, 1.0
        rates, turns, speeds = self._along(math.atan2(side, v))
        top = float(np.interp(config.max_phase_rate_hz, rates, speeds))
        if speed > top:
            scale, speed = scale * top / speed, top
        rate = float(np.interp(speed, speeds, rates))
        turn = math.copysign(float(np.interp(rate, rates, turns)), w)
        stride = Stride.turning(rate, turn)
        return (stride.reversed() if forward_mps < 0.0 else stride), scale

    def velocity(self, phase_rate_hz: float, turn: float,
                 config: GaitConfig | None = None) -> tuple[float, float]:
        """Return the velocity [m/s, rad/s] of `Stride.turning(phase_rate_hz, turn)`.

        It is the inverse of `stride` within the table, for strides that go forward.
        """
        low, high = 0.0, 0.5 * math.pi
        for _ in range(60):
            course = 0.5 * (low + high)
            rates, turns, _speeds = self._along(course)
            if np.interp(phase_rate_hz, rates, turns) < abs(turn):
                low = course
            else:
                high = course
        rates, _turns, speeds = self._along(course)
        speed = float(np.interp(phase_rate_hz, rates, speeds))
        speed *= self._advance_ratio(config or GaitConfig())
        yaw_rate = speed * math.sin(course) / self._half_track_m
        return speed * math.cos(course), math.copysign(yaw_rate, turn)

    def _along(self, course: float) -> tuple[Array, Array, Array]:
        """Return phase rates, turns and speeds along one course, from rest upwards."""
        turns = np.array([np.interp(course, row, self.turns) for row in self._course])
        speeds = np.array([np.interp(turn, self.turns, row)
                           for turn, row in zip(turns, self._speed)])
        # Below the first row the speed is proportional to the rate, at the turn of that row.
        return (np.r_[0.0, self.phase_rates_hz], np.r_[turns[0], turns],
                _increasing(np.r_[0.0, speeds]))

    def _advance_ratio(self, config: GaitConfig) -> float:
        now = math.sin(math.radians(config.foot_width_deg) / 2.0) / config.duty_factor
        return now * self.duty_factor / math.sin(math.radians(self.foot_width_deg) / 2.0)


def _table(name: str, rows: Sequence[Sequence[float]], shape: tuple[int, int]) -> Array:
    try:
        table = np.array(rows, dtype=float)
    except (TypeError, ValueError):
        table = np.empty(0)
    if table.shape != shape or not np.all(np.isfinite(table)):
        raise ConfigError(f'{name}: not a table of {shape[0]} rows (phase rates) of {shape[1]}'
                          ' finite numbers (turns)')
    return table


def _check_range(name: str, table: Array, most: float) -> None:
    largest = min(float(table.max()), most)
    for value in table.ravel().tolist():
        if not -_MAX_BACKWARD * largest <= value <= most:
            raise ConfigError(f'{name}: {value:g} is not valid; valid is >= '
                              f'{-_MAX_BACKWARD * largest:g} and <= {most:g}')


def _increasing(values: Array) -> Array:
    """Return values that increase along the last axis: the mean of the envelopes from both ends.

    Increasing values stay as they are, except for an added slope of 1e-9 per element.
    """
    up = np.maximum.accumulate(values, axis=-1)
    down = np.flip(np.minimum.accumulate(np.flip(values, -1), axis=-1), -1)
    return 0.5 * (up + down) + 1e-9 * np.arange(values.shape[-1])
