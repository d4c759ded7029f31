"""The rover as a parameter set: dimensions, masses, motors, sensor mounts.

`base_link` is at the chassis centre, x forward, y left, z up. Legs are a list, `legs.each`: all
that has a value per leg has one for each of its entries, in its order. Each leg turns about an
axle parallel to base +y; the joint `<leg>_joint` turns positively about +y, so that a positive
velocity walks forward (the lower spoke tip moves backward).

At joint angle 0 spoke 0 points straight down. Spoke k of n stands at the angle a = q + k 2 pi / n
from straight down, where q is the joint angle, and points along (-sin a, 0, -cos a) in base axes.
So a > 0 is behind the axle, a < 0 is in front of it, and a goes from negative to positive in
stance.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import find_file
from lunar_rover_sim.base.files.yaml_text import read_yaml, yaml_of
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import group, Named, named, param, Parameters

DEFAULT_ROVER = 'quad'
LEFT, RIGHT = 'left', 'right'
LEAST_LEGS, MOST_LEGS = 3, 12   # fewer do not stand; more have no labels in the truth images

# Beyond any rover that has been built; what is larger is a mistake of units.
MAX_MASS_KG, MAX_LENGTH_M = 2000.0, 10.0


@dataclasses.dataclass(frozen=True)
class Chassis(Parameters):
    """The chassis: a solid box."""

    mass_kg: float = param(2.0, 'without legs', unit='kg', low=0.0, open_low=True,
                           high=MAX_MASS_KG)
    length_m: float = param(0.30, 'along x', unit='m', low=0.0, open_low=True, high=MAX_LENGTH_M)
    width_m: float = param(0.16, 'along y', unit='m', low=0.0, open_low=True, high=MAX_LENGTH_M)
    height_m: float = param(0.08, 'along z', unit='m', low=0.0, open_low=True, high=MAX_LENGTH_M)
    com_m: tuple[float, ...] = param((0.0, 0.0, -0.01), 'centre of mass in base_link', unit='m',
                                     length=3)

    def validate(self) -> None:
        """Raise ConfigError if the centre of mass is outside the chassis."""
        half = (0.5 * self.length_m, 0.5 * self.width_m, 0.5 * self.height_m)
        if any(abs(c) > h for c, h in zip(self.com_m, half)):
            raise ConfigError(f'com_m: {list(self.com_m)} is not valid; valid is within the '
                              f'chassis, +-{half[0]:g}, +-{half[1]:g}, +-{half[2]:g} [m]')


@dataclasses.dataclass(frozen=True)
class Leg(Parameters):
    """One leg: where its axle is, and its phase in the rover's own gait."""

    side: str = param(LEFT, 'in a turn the legs of a side step alike', choices=(LEFT, RIGHT))
    position_m: tuple[float, ...] = param((0.115, 0.105, -0.02), 'middle of the leg on its axle, '
                                          'in base_link', unit='m', length=3, low=-MAX_LENGTH_M,
                                          high=MAX_LENGTH_M)
    phase: float = param(0.0, 'in the gait `rover`', unit='cycles', low=0.0,
                         high=1.0, open_high=True)

    def validate(self) -> None:
        """Raise ConfigError unless the axle is on the side that is named."""
        y = self.position_m[1]
        if (y if self.side == LEFT else -y) <= 0.0:
            raise ConfigError(f'side: {self.side!r} is not valid with position_m = '
                              f'{list(self.position_m)}; valid is left with y > 0, right with '
                              'y < 0')


def rectangle(x: float = 0.115, y: float = 0.105, z: float = -0.02) -> Named[Leg]:
    """Return four legs at +-x and +-y, diagonal ones in step; by default those of `quad`."""
    return Named({'front_left': Leg(LEFT, (x, y, z), 0.0),
                  'front_right': Leg(RIGHT, (x, -y, z), 0.5),
                  'rear_left': Leg(LEFT, (-x, y, z), 0.5),
                  'rear_right': Leg(RIGHT, (-x, -y, z), 0.0)})


@dataclasses.dataclass(frozen=True)
class Legs(Parameters):
    """Equal legs of rigid spokes, `each` with its place."""

    spokes: int = param(3, 'per leg', low=2, high=12)
    spoke_length_m: float = param(0.08, 'from the axle to the end of the tip', unit='m',
                                  low=0.0, open_low=True, high=MAX_LENGTH_M)
    spoke_radius_m: float = param(0.005, 'of the rod', unit='m', low=0.0, open_low=True,
                                  high=MAX_LENGTH_M)
    tip_radius_m: float = param(0.008, 'of the rounded tip', unit='m', low=0.0,
                                open_low=True, high=MAX_LENGTH_M)
    mass_kg: float = param(0.06, 'of one leg', unit='kg', low=0.0, open_low=True, high=MAX_MASS_KG)
    each: Named[Leg] = named(Leg, rectangle)

    def validate(self) -> None:
        """Raise ConfigError if the tip is larger than the spoke is long, or legs are missing."""
        if self.tip_radius_m >= self.spoke_length_m:
            raise ConfigError(f'tip_radius_m: {self.tip_radius_m} is not valid; valid is less than'
                              f' spoke_length_m = {self.spoke_length_m} [m]')
        if not LEAST_LEGS <= len(self.each) <= MOST_LEGS:
            raise ConfigError(f'each: {len(self.each)} legs given; valid are {LEAST_LEGS} to '
                              f'{MOST_LEGS}')

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the legs."""
        return tuple(self.each)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints of the legs."""
        return tuple(f'{leg}_joint' for leg in self.each)

    @property
    def on_left(self) -> tuple[bool, ...]:
        """Whether each leg is on the left."""
        return tuple(leg.side == LEFT for leg in self.each.values())

    def rows(self) -> tuple[int, ...]:
        """Return the number of each leg on its side, from 0 at the front."""
        return tuple(sum(other.side == leg.side and other.position_m[0] > leg.position_m[0]
                         for other in self.each.values()) for leg in self.each.values())

    def spoke_directions(self) -> tuple[tuple[float, float, float], ...]:
        """Return the unit vectors from axle to tip at joint angle 0, in base axes."""
        angles = [k * self.spoke_pitch_rad for k in range(self.spokes)]
        return tuple((-math.sin(a), 0.0, -math.cos(a)) for a in angles)

    @property
    def spoke_pitch_rad(self) -> float:
        """Angle between neighbouring spokes."""
        return 2.0 * math.pi / self.spokes

    def axle_positions_m(self) -> tuple[tuple[float, ...], ...]:
        """Return the (legs, 3) axle positions in base_link."""
        return tuple(leg.position_m for leg in self.each.values())

    @property
    def lowest_axle_m(self) -> float:
        """Height of the lowest axle in base_link [m]."""
        return min(leg.position_m[2] for leg in self.each.values())


@dataclasses.dataclass(frozen=True)
class Motor(Parameters):
    """One brushed DC gear motor per leg with a velocity loop (current-controlled driver).

    Stall torque and no-load speed are those of the bare motor at the supply voltage, as a data
    sheet gives them. The defaults are those of a 16 mm motor with precious-metal brushes and an
    84:1 planetary gear: 13.1 rad/s and at most 1.3 N m at the leg.
    """

    supply_voltage_v: float = param(12.0, 'voltage of the supply', unit='V', low=0.1, high=1000.0)
    stall_torque_nm: float = param(0.042, 'of the bare motor at the supply voltage',
                                   unit='N m', low=1e-6, high=1000.0)
    no_load_speed_radps: float = param(1100.0, 'of the bare motor at the supply voltage',
                                       unit='rad/s', low=0.1, high=1e5)
    gear_ratio: float = param(84.0, 'turns of the motor per turn of the leg', low=0.01, high=1e5)
    rotor_inertia_kgm2: float = param(1.2e-7, 'of rotor and first gear stage',
                                      unit='kg m^2', low=1e-12, high=1.0)
    current_limit_a: float = param(1.4, 'of the driver', unit='A', low=1e-3, high=1e4)
    coulomb_friction_nm: float = param(0.03, 'of the gear, at the leg', unit='N m',
                                       low=0.0, high=1e4)
    viscous_friction_nms: float = param(0.002, 'of the gear, at the leg',
                                        unit='N m s/rad', low=0.0, high=1e4)
    velocity_gain_nms: float = param(1.0, 'of the velocity loop, at the leg',
                                     unit='N m s/rad', low=1e-4, high=1e6)

    @property
    def motor_constant(self) -> float:
        """Torque constant = back-EMF constant of the bare motor [N m/A = V s/rad]."""
        return self.supply_voltage_v / self.no_load_speed_radps

    @property
    def resistance_ohm(self) -> float:
        """Terminal resistance [ohm]."""
        return self.motor_constant * self.supply_voltage_v / self.stall_torque_nm

    @property
    def leg_stall_torque_nm(self) -> float:
        """Greatest torque at the leg, set by the current limit or the winding [N m]."""
        return self.gear_ratio * min(self.stall_torque_nm,
                                     self.motor_constant * self.current_limit_a)

    @property
    def leg_no_load_speed_radps(self) -> float:
        """Speed of the leg without load [rad/s]."""
        return self.no_load_speed_radps / self.gear_ratio

    def current_a(self, leg_torque_nm: Any) -> Any:
        """Return the winding current [A] for an electromagnetic torque at the leg [N m]."""
        return leg_torque_nm / (self.gear_ratio * self.motor_constant)

    def electric_power_w(self, leg_torque_nm: Any, leg_speed_radps: Any) -> Any:
        """Return the power drawn from the supply [W]: i^2 R + torque times speed."""
        current = self.current_a(leg_torque_nm)
        return current ** 2 * self.resistance_ohm + leg_torque_nm * leg_speed_radps

    def drawn_w(self, leg_torques_nm: Array, leg_speeds_radps: Array) -> float:
        """Return the power that all legs draw [W]; none feeds back. (legs,) each."""
        # Plain floats: on four numbers they take a third of the time of arrays.
        return sum(max(self.electric_power_w(torque, speed), 0.0) for torque, speed
                   in zip(leg_torques_nm.tolist(), leg_speeds_radps.tolist()))


@dataclasses.dataclass(frozen=True)
class StereoMount(Parameters):
    """The mount of the stereo camera: the midpoint between the lenses and the line of sight."""

    position_m: tuple[float, ...] = param((0.12, 0.0, 0.18), 'midpoint of the lenses in base_link',
                                          unit='m', length=3, low=-10.0, high=10.0)
    pitch_deg: float = param(10.0, 'of the optical axes, downward', unit='deg', low=-90.0,
                             high=90.0)
    baseline_m: float = param(0.10, 'between the lenses', unit='m', low=0.0,
                              open_low=True, high=MAX_LENGTH_M)


@dataclasses.dataclass(frozen=True)
class ImuMount(Parameters):
    """The mount of the IMU; its axes are those of base_link, turned by rpy."""

    position_m: tuple[float, ...] = param((0.0, 0.0, 0.0), 'in base_link', unit='m',
                                          length=3, low=-10.0, high=10.0)
    rpy_deg: tuple[float, ...] = param((0.0, 0.0, 0.0), 'fixed-axis roll, pitch, yaw', unit='deg',
                                       length=3, low=-360.0, high=360.0)


@dataclasses.dataclass(frozen=True)
class LidarMount(Parameters):
    """The mount of the LiDAR or time-of-flight camera: x ahead, z up, turned by rpy."""

    position_m: tuple[float, ...] = param((0.12, 0.0, 0.24), 'optical centre in base_link',
                                          unit='m', length=3, low=-10.0, high=10.0)
    rpy_deg: tuple[float, ...] = param((0.0, 0.0, 0.0), 'fixed-axis roll, pitch, yaw; pitch > 0 '
                                       'looks down', unit='deg', length=3, low=-360.0, high=360.0)


@dataclasses.dataclass(frozen=True)
class RoverDescription(Parameters):
    """The complete rover; MJCF and URDF are made from it."""

    name: str = param(DEFAULT_ROVER, 'by which its packaged gait calibrations are found')
    chassis: Chassis = group(Chassis)
    legs: Legs = group(Legs)
    motor: Motor = group(Motor)
    stereo: StereoMount = group(StereoMount)
    imu: ImuMount = group(ImuMount)
    lidar: LidarMount = group(LidarMount)

    def validate(self) -> None:
        """Raise ConfigError if the centre of mass is not above the area between the legs."""
        x, y, _ = self.chassis.com_m
        around = sorted(math.atan2(axle_y - y, axle_x - x)
                        for axle_x, axle_y, _ in self.legs.axle_positions_m())
        gaps = [b - a for a, b in zip(around, (*around[1:], around[0] + 2.0 * math.pi))]
        if max(gaps) >= math.pi:
            raise ConfigError(
                f'chassis.com_m: {list(self.chassis.com_m)} is not valid; valid is between the '
                'axles of legs.each: the rover could not stand')

    @property
    def standing_height_m(self) -> float:
        """Height of base_link over level ground while a spoke of every leg points down [m]."""
        return self.legs.spoke_length_m - self.legs.lowest_axle_m

    @property
    def total_mass_kg(self) -> float:
        """Mass of chassis and legs [kg]."""
        return self.chassis.mass_kg + len(self.legs.each) * self.legs.mass_kg


def chassis_inertia(chassis: Chassis) -> Array:
    """Return the (3, 3) inertia [kg m^2] about the centre of mass, base axes: a solid box."""
    x, y, z = chassis.length_m ** 2, chassis.width_m ** 2, chassis.height_m ** 2
    return chassis.mass_kg / 12.0 * np.diag([y + z, x + z, x + y])


def leg_inertia(legs: Legs) -> Array:
    """Return the (3, 3) inertia [kg m^2] about the axle at joint angle 0, base axes.

    Each spoke is a thin uniform rod from the axle, of length spoke_length_m.
    """
    rod = legs.mass_kg / legs.spokes * legs.spoke_length_m ** 2 / 3.0
    inertia = np.zeros((3, 3))
    for direction in np.array(legs.spoke_directions()):
        inertia += rod * (np.eye(3) - np.outer(direction, direction))
    # The inertia of a rod about its own axis keeps the matrix positive definite.
    own = 0.5 * legs.mass_kg / legs.spokes * legs.spoke_radius_m ** 2
    return inertia + own * np.eye(3)


_MOST_BYTES = 1 << 18


def load_rover(path: str | Path | None = None) -> RoverDescription:
    """Return a rover by its YAML file, or by the name of a packaged one; by default `quad`.

    Raises:
        ConfigError: If there is none, or if it cannot be read or is not valid.
    """
    path = find_file('rover', str(path or DEFAULT_ROVER))
    content = read_yaml(path, _MOST_BYTES)
    try:
        return RoverDescription.from_mapping({} if content is None else content)
    except ConfigError as error:
        raise ConfigError(f'{path}: {error}') from None


def save_rover(rover: RoverDescription, path: str | Path) -> None:
    """Write the rover to a YAML file for `load_rover`; raise ConfigError if that fails."""
    atomic_write(path, yaml_of(rover.to_mapping()), ConfigError)
