"""The rover as a parameter set: dimensions, masses, motors, sensor mounts.

`base_link` is at the chassis centre, x forward, y left, z up. Legs are named front_left,
front_right, rear_left, rear_right, in this order everywhere. Each turns about an axle parallel
to base +y; the joint `<leg>_joint` turns positively about +y, so that a positive velocity walks
forward (the lower spoke tip moves backward).
"""

from __future__ import annotations

import dataclasses
import math

from lunar_rover_sim.parameters import group, param, Parameters
from lunar_rover_sim.topics import LEGS

LEG_NAMES = LEGS
JOINT_NAMES = tuple(f'{leg}_joint' for leg in LEG_NAMES)


@dataclasses.dataclass(frozen=True)
class Chassis(Parameters):
    """The box that carries everything."""

    mass_kg: float = param(2.0, 'mass without legs', unit='kg', low=0.0, open_low=True)
    length_m: float = param(0.30, 'along x', unit='m', low=0.0, open_low=True)
    width_m: float = param(0.16, 'along y', unit='m', low=0.0, open_low=True)
    height_m: float = param(0.08, 'along z', unit='m', low=0.0, open_low=True)
    com_m: tuple[float, ...] = param((0.0, 0.0, -0.01), 'centre of mass in base_link', unit='m',
                                     length=3)


@dataclasses.dataclass(frozen=True)
class Legs(Parameters):
    """Four equal legs of rigid spokes; positions are those of the axles in base_link."""

    spokes: int = param(3, 'spokes per leg', low=2, high=12)
    spoke_length_m: float = param(0.08, 'axle to the end of the tip', unit='m', low=0.0,
                                  open_low=True)
    spoke_radius_m: float = param(0.005, 'radius of the rod', unit='m', low=0.0, open_low=True)
    tip_radius_m: float = param(0.008, 'radius of the rounded tip', unit='m', low=0.0,
                                open_low=True)
    mass_kg: float = param(0.06, 'mass of one leg', unit='kg', low=0.0, open_low=True)
    axle_x_m: float = param(0.115, 'axles at +x and -x', unit='m', low=0.0, open_low=True)
    axle_y_m: float = param(0.105, 'leg planes at +y and -y', unit='m', low=0.0, open_low=True)
    axle_z_m: float = param(-0.02, 'axle height', unit='m')

    @property
    def spoke_pitch_rad(self) -> float:
        """Angle between neighbouring spokes."""
        return 2.0 * math.pi / self.spokes

    def axle_positions_m(self) -> tuple[tuple[float, float, float], ...]:
        """Return the (4, 3) axle positions in base_link, in the order of LEG_NAMES."""
        x, y, z = self.axle_x_m, self.axle_y_m, self.axle_z_m
        return ((x, y, z), (x, -y, z), (-x, y, z), (-x, -y, z))


@dataclasses.dataclass(frozen=True)
class StereoMount(Parameters):
    """Where the stereo camera sits: the midpoint between both lenses, and where it looks."""

    position_m: tuple[float, ...] = param((0.12, 0.0, 0.18), 'midpoint of the lenses in base_link',
                                          unit='m', length=3)
    pitch_deg: float = param(10.0, 'downward tilt of the optical axes', unit='deg', low=-90.0,
                             high=90.0)
    baseline_m: float = param(0.10, 'distance between the lenses', unit='m', low=0.0,
                              open_low=True)


@dataclasses.dataclass(frozen=True)
class ImuMount(Parameters):
    """Where the IMU sits; its axes are those of base_link turned by rpy."""

    position_m: tuple[float, ...] = param((0.0, 0.0, 0.0), 'origin in base_link', unit='m',
                                          length=3)
    rpy_deg: tuple[float, ...] = param((0.0, 0.0, 0.0), 'fixed-axis roll, pitch, yaw', unit='deg',
                                       length=3)


@dataclasses.dataclass(frozen=True)
class RoverDescription(Parameters):
    """Everything that makes this rover this rover; MJCF and URDF are made from it."""

    chassis: Chassis = group(Chassis)
    legs: Legs = group(Legs)
    stereo: StereoMount = group(StereoMount)
    imu: ImuMount = group(ImuMount)
