"""Differences between episodes: one dataclass of ranges, and one draw of them."""

from __future__ import annotations

import dataclasses

import numpy as np

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import param, Parameters
from lunar_rover_sim.rover.description import RoverDescription

MOST_DELAY = 3


def _range(low: float, high: float, doc: str, unit: str = '', least: float = 0.0,
           most: float = 1e6) -> tuple[float, ...]:
    return param((low, high), f'{doc}, least and greatest', unit=unit, length=2, low=least,
                 high=most)


def check_ranges(parameters: Parameters, *names: str) -> None:
    """Raise ConfigError for a range whose least value is above its greatest."""
    for name in names:
        low, high = getattr(parameters, name)
        if low > high:
            raise ConfigError(f'{name}: [{low:g}, {high:g}] is not valid; valid is the least value'
                              ' first')


@dataclasses.dataclass(frozen=True)
class Randomisation(Parameters):
    """Ranges from which each episode draws, evenly; factors evenly in their logarithm.

    The default ranges of friction, mass and delay are those usual for walking robots.
    """

    terrain_seed: tuple[int, ...] = param((0, 9999), 'seed of the relief, least and greatest',
                                          length=2, low=0, high=2**31 - 1)
    slope_deg: tuple[float, ...] = _range(0.0, 8.0, 'slope of the ground, in any direction', 'deg',
                                          most=30.0)
    slope_azimuth_deg: tuple[float, ...] = _range(
        0.0, 360.0, 'direction upwards, counted from the first heading', 'deg', least=-360.0,
        most=360.0)
    friction_factor: tuple[float, ...] = _range(0.8, 1.2, 'factor on the friction of the ground',
                                                least=0.2, most=3.0)
    bearing_factor: tuple[float, ...] = _range(
        0.5, 2.0, 'factor on the pressure that soil bears per depth', least=0.05, most=20.0)
    mass_factor: tuple[float, ...] = _range(0.9, 1.1, 'factor on the mass of the chassis',
                                            least=0.3, most=3.0)
    com_m: tuple[float, ...] = _range(-0.02, 0.02, 'shift of the centre of mass, along x and y',
                                      'm', least=-0.05, most=0.05)
    torque_factor: tuple[float, ...] = _range(
        0.85, 1.1, 'factor on stall torque and current limit of the motors', least=0.1, most=3.0)
    gear_friction_factor: tuple[float, ...] = _range(
        0.7, 1.5, 'factor on the dry friction of the gears', least=0.1, most=5.0)
    delay: tuple[int, ...] = param((0, MOST_DELAY), 'decisions by which an action comes late,'
                                   ' least and greatest', length=2, low=0, high=MOST_DELAY)
    push_n: tuple[float, ...] = _range(0.0, 1.0, 'horizontal force of a push', 'N', most=1e3)
    push_every_s: tuple[float, ...] = _range(3.0, 8.0, 'time between pushes', 's', least=0.1)

    def validate(self) -> None:
        """Raise ConfigError for a range that is upside down."""
        check_ranges(self, *(field.name for field in dataclasses.fields(self)))

    @classmethod
    def none(cls) -> Randomisation:
        """Return ranges without width: the rover and the soil as they are, level, undisturbed.

        Only the relief differs.
        """
        one, zero = (1.0, 1.0), (0.0, 0.0)
        return cls(slope_deg=zero, slope_azimuth_deg=zero, friction_factor=one,
                   bearing_factor=one, mass_factor=one, com_m=zero, torque_factor=one,
                   gear_friction_factor=one, delay=(0, 0), push_n=zero)

    def draw(self, rng: np.random.Generator) -> Conditions:
        """Return the conditions of one episode."""
        def even(name: str) -> float:
            low, high = getattr(self, name)
            return float(rng.uniform(low, high))

        def factor(name: str) -> float:
            low, high = getattr(self, name)
            return float(np.exp(rng.uniform(np.log(low), np.log(high))))

        return Conditions(
            int(rng.integers(self.terrain_seed[0], self.terrain_seed[1] + 1)), even('slope_deg'),
            even('slope_azimuth_deg'), factor('friction_factor'), factor('bearing_factor'),
            factor('mass_factor'), (even('com_m'), even('com_m')), factor('torque_factor'),
            factor('gear_friction_factor'),
            int(rng.integers(self.delay[0], self.delay[1] + 1)))


@dataclasses.dataclass(frozen=True)
class Conditions:
    """One draw; see `Randomisation` for meanings and units. com_m is (x, y)."""

    terrain_seed: int
    slope_deg: float
    slope_azimuth_deg: float
    friction_factor: float
    bearing_factor: float
    mass_factor: float
    com_m: tuple[float, float]
    torque_factor: float
    gear_friction_factor: float
    delay: int

    def rover(self, rover: RoverDescription) -> RoverDescription:
        """Return the rover as it is in this episode."""
        chassis, motor = rover.chassis, rover.motor
        half = 0.5 * chassis.length_m, 0.5 * chassis.width_m
        com = [min(max(c + shift, -h), h) for c, shift, h in zip(chassis.com_m, self.com_m, half)]
        return dataclasses.replace(
            rover,
            chassis=dataclasses.replace(chassis, mass_kg=chassis.mass_kg * self.mass_factor,
                                        com_m=(*com, chassis.com_m[2])),
            motor=dataclasses.replace(
                motor, stall_torque_nm=motor.stall_torque_nm * self.torque_factor,
                current_limit_a=motor.current_limit_a * self.torque_factor,
                coulomb_friction_nm=motor.coulomb_friction_nm * self.gear_friction_factor))
