"""Differences between episodes: one dataclass of ranges, one draw of them, and their ground."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import functools
import math
from typing import Any

import numpy as np

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import param, Parameters
from lunar_rover_sim.ground.regolith.config import GroundConfig, REGOLITH, RIGID
from lunar_rover_sim.ground.regolith.soil import PRESETS
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import (CraterConfig, RockConfig, SurroundingsConfig,
                                                 WorldConfig)
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.physics.config import PhysicsConfig, StartPose

GROUNDS = (RIGID, *PRESETS)
SETTLE_S = 0.5
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


def even(rng: np.random.Generator, between: Sequence[float]) -> float:
    """Return a number drawn evenly from a range, least and greatest."""
    low, high = between
    return float(rng.uniform(low, high))


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
        def drawn(name: str) -> float:
            return even(rng, getattr(self, name))

        def factor(name: str) -> float:
            low, high = getattr(self, name)
            return float(np.exp(rng.uniform(np.log(low), np.log(high))))

        return Conditions(
            int(rng.integers(self.terrain_seed[0], self.terrain_seed[1] + 1)), drawn('slope_deg'),
            drawn('slope_azimuth_deg'), factor('friction_factor'), factor('bearing_factor'),
            factor('mass_factor'), (drawn('com_m'), drawn('com_m')), factor('torque_factor'),
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


def physics_of(ground: str, conditions: Conditions | None = None) -> PhysicsConfig:
    """Return the physics on a ground by its name, rigid or a soil, under conditions."""
    physics = PhysicsConfig(start=StartPose(settle_s=SETTLE_S))
    friction, bearing = (1.0, 1.0) if conditions is None else (conditions.friction_factor,
                                                               conditions.bearing_factor)
    if ground == RIGID:
        contact = physics.contact
        return dataclasses.replace(physics, contact=dataclasses.replace(
            contact, sliding_friction=contact.sliding_friction * friction))
    soil = GroundConfig(model=REGOLITH, preset=ground)
    if friction != 1.0 or bearing != 1.0:
        preset = PRESETS[ground]
        soil = dataclasses.replace(soil, friction=preset.friction * friction,
                                   bearing_mnpm3=1e-6 * preset.zeta_npm3 * bearing)
    return dataclasses.replace(physics, ground=soil)


def terrain(seed: int, size_m: float, obstacles: bool, slope_deg: float = 0.0,
            azimuth_deg: float = 0.0) -> World:
    """Return the ground of an episode: the relief of regolith on a slope, with its own rocks.

    Args:
        seed: Of the relief.
        size_m: Side length.
        obstacles: Whether there are craters and rocks.
        slope_deg: Of the plane that is added.
        azimuth_deg: Direction upwards, from x towards y.
    """
    world = _relief(seed, size_m, obstacles)
    if slope_deg == 0.0:
        return world
    ground = world.ground
    axis = (np.arange(ground.n) - 0.5 * (ground.n - 1)) * ground.cell_m
    rise, angle = math.tan(math.radians(slope_deg)), math.radians(azimuth_deg)

    def raised(x: Any, y: Any) -> Any:
        return rise * (math.cos(angle) * x + math.sin(angle) * y)

    heights = (ground.heights_m + raised(axis, axis[:, None])).astype(np.float32)
    rocks = world.rocks
    position = rocks.position_m.copy()
    position[:, 2] += raised(position[:, 0], position[:, 1])
    return dataclasses.replace(world, levels=(HeightGrid(heights, ground.cell_m),),
                               rocks=dataclasses.replace(rocks, position_m=position))


@functools.lru_cache(maxsize=48)
def _relief(seed: int, size_m: float, obstacles: bool) -> World:
    config = WorldConfig(size_m=size_m,
                         surroundings=SurroundingsConfig(extent_m=2.0 * size_m, samples=65))
    if not obstacles:
        config = dataclasses.replace(config, craters=CraterConfig(density=0.0),
                                     rocks=RockConfig(abundance=0.0))
    return build_world(config, seed)
