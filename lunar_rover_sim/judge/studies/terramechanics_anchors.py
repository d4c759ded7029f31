"""Reference values for the soft ground: published ones, closed forms, and scaling laws."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import math

import numpy as np

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.ground.regolith.config import GroundConfig, REGOLITH
from lunar_rover_sim.ground.regolith.law import bearing_n
from lunar_rover_sim.ground.regolith.resistive_force import plate_force_n
from lunar_rover_sim.ground.regolith.soil import PRESETS
from lunar_rover_sim.judge.studies import sandbot
from lunar_rover_sim.judge.studies.terramechanics import (Ground, GroundWalk, holding, measure,
                                                          WalkSettings)
from lunar_rover_sim.judge.studies.walking import sloping_world
from lunar_rover_sim.rover.physics.config import PhysicsConfig, StartPose
from lunar_rover_sim.rover.physics.simulation import Simulation

LUNAR = ('highland_loose', 'highland', 'highland_dense')
DROP_M = 0.002
LOST_SLIP = 0.5


@dataclasses.dataclass(frozen=True)
class Anchor:
    """A number of the model, its bounds, and their source.

    Attributes:
        held: Whether the number must lie between them; if not, they are those of other machines,
            for comparison.
    """

    name: str
    measured: float
    low: float
    high: float
    unit: str
    source: str
    held: bool = True

    @property
    def holds(self) -> bool:
        """Whether the number lies between its bounds."""
        return self.low <= self.measured <= self.high


def plates() -> list[Anchor]:
    """Return plates in poppy seeds, footpads and a penetrometer, from the laws alone."""
    found: list[Anchor] = []
    for name, down, aside in (('poppy_loose', 12.7, 4.15), ('poppy_close', 23.2, 5.35)):
        soil, li = PRESETS[name], 'Li et al. 2013'
        force = plate_force_n(soil.shape, soil.zeta_npm3, 1e-3, 0.05, 0.0, 0.5 * math.pi)[1]
        found.append(_within(f'10 cm² at 5 cm down, {name}', force, down, 0.01, 'N', li))
        force = plate_force_n(soil.shape, soil.zeta_npm3, 1e-3, 0.05, 0.5 * math.pi, 0.0)[0]
        found.append(_within(f'10 cm² at 5 cm aside, {name}', force, aside, 0.01, 'N', li))
    zeta = PRESETS['highland'].zeta_npm3
    for depth in (0.02, 0.05):
        found.append(Anchor(f'footpad at {1e2 * depth:.0f} cm, highland', zeta * depth / 1e3, 20.0,
                            60.0, 'kPa', 'Surveyor 3'))
    found.append(_within('cone at 16 cm, highland_dense',
                         PRESETS['highland_dense'].zeta_npm3 * 0.16 / 1e3, 348.0, 0.02, 'kPa',
                         'Apollo 15'))
    return found


def compared(walks: Sequence[GroundWalk]) -> list[Anchor]:
    """Return what other machines did: SandBot from its own model, slopes and pull from walks."""
    best = float(sandbot.curve_mps('poppy_loose', sandbot.CLegs()).max())
    found = [Anchor('greatest speed of SandBot, loose poppy seeds', best, 0.8 * sandbot.BEST_MPS,
                    1.2 * sandbot.BEST_MPS, 'm/s', 'Li et al. 2009', held=False)]
    for name in dict.fromkeys(walk.ground.name for walk in walks):
        walked = [w for w in walks if w.ground.name == name]
        climbed = [w.ground.slope_deg for w in walked if w.slip < LOST_SLIP and not w.ground.pull]
        pulled = holding([w for w in walked if w.ground.slope_deg == 0.0])
        if climbed:
            found.append(Anchor(f'steepest slope with less than half of slip, {name}',
                                max(climbed), 20.0, 32.0, 'deg', 'Apollo rover to Lunokhod 1',
                                held=False))
        if pulled:
            most = pulled[-1]
            found.append(Anchor(f'slip at the greatest pull ({most.ground.pull:g}), {name}',
                                1e2 * most.slip, 15.0, 25.0, '%', 'wheel of the Apollo rover',
                                held=False))
    return found


def simulated(settings: WalkSettings) -> list[Anchor]:
    """Return the energy of a fall, holding on slopes, gravity scaling and convergence."""
    found: list[Anchor] = []
    for name in LUNAR[1:]:
        expected = _energy_depth_m(settings, name)
        for step_s, tolerance in ((0.001, 0.10), (0.00025, 0.03)):
            found.append(_within(f'fall of 2 mm, {name}, step {1e3 * step_s:g} ms',
                                 1e3 * _drop_m(settings, name, step_s), 1e3 * expected, tolerance,
                                 'mm', 'energy'))
    for name in LUNAR:
        limit = math.degrees(math.atan(PRESETS[name].friction))
        found.append(Anchor(f'creep at {limit - 3.0:.0f}°, {name}',
                            slide_mmps(settings, name, limit - 3.0), 0.0, 0.05, 'mm/s',
                            'Coulomb'))
        found.append(Anchor(f'slide at {limit + 3.0:.0f}°, {name}',
                            slide_mmps(settings, name, limit + 3.0), 20.0, math.inf, 'mm/s',
                            'Coulomb'))
    # Time steps in proportion to the time of a fall, about sqrt(1 / g).
    moon, earth = (_rest_m(settings, 'highland', g, step_s)
                   for g, step_s in ((1.62, 0.0005), (9.81, 0.0002)))
    found.append(_within('sinkage at rest on Earth over that on the Moon', earth / moon, 1.0, 0.02,
                         '', 'scaling'))
    for name in LUNAR:
        walks = [_walk(settings, name, step_s) for step_s in (0.001, 0.00025)]
        found.append(_within(f'distance at 1 ms over that at 0.25 ms, {name}',
                             walks[0].speed_mps / walks[1].speed_mps, 1.0, 0.03, '',
                             'convergence'))
    return found


def _within(name: str, measured: float, expected: float, tolerance: float, unit: str,
            source: str) -> Anchor:
    return Anchor(name, measured, expected * (1.0 - tolerance), expected * (1.0 + tolerance), unit,
                  source)


def _simulation(settings: WalkSettings, physics: PhysicsConfig, name: str,
                slope_deg: float = 0.0) -> Simulation:
    # Slopes test friction alone: if they bore less, the belly would hold the rover, too.
    ground = GroundConfig(model=REGOLITH, preset=name, weak_slopes=False)
    return Simulation(sloping_world(slope_deg), settings.rover,
                      dataclasses.replace(physics, ground=ground))


def _sinkage_m(simulation: Simulation) -> float:
    """Return the mean sinkage of the legs, 0 on rigid ground [m]."""
    contact = simulation.ground_contact
    return float(contact.sinkage_m.mean()) if contact is not None else 0.0


def _drop_m(settings: WalkSettings, name: str, step_s: float) -> float:
    """Return the depth of the prints of a rover that falls by 2 mm [m]."""
    rover = settings.rover
    physics = dataclasses.replace(settings.physics, step_s=step_s, start=StartPose(settle_s=0.0))
    with _simulation(settings, physics, name) as simulation:
        lowest = simulation.state.position_m[2] - rover.standing_height_m
        simulation.data.qpos[2] += DROP_M - lowest
        simulation.data.qvel[:] = 0.0
        simulation.advance(round(0.5 / step_s))
        load = 0.25 * rover.total_mass_kg * settings.physics.gravity_mps2
        # At rest the tips are pressed on by the weight, elastically.
        return _sinkage_m(simulation) - load / PRESETS[name].elastic_npm


def _energy_depth_m(settings: WalkSettings, name: str) -> float:
    """Return the depth at which a fall by 2 mm has done its work [m]."""
    z = np.linspace(0.0, 0.08, 40001)
    radius = settings.rover.legs.tip_radius_m
    force = np.array([bearing_n(v, radius, PRESETS[name].zeta_npm3) for v in z])
    work = np.cumsum(force) * (z[1] - z[0])
    load = 0.25 * settings.rover.total_mass_kg * settings.physics.gravity_mps2
    return float(z[np.argmax(work > load * (z + DROP_M))])


def slide_mmps(settings: WalkSettings, name: str, slope_deg: float) -> float:
    """Return the mean speed in the fourth second of a rover across a slope, legs held.

    It is infinite where the rover tumbles before.
    """
    physics = dataclasses.replace(settings.physics, start=StartPose(yaw_deg=90.0, settle_s=3.0))
    try:
        with _simulation(settings, physics, name, slope_deg) as simulation:
            before = simulation.state.position_m
            after = simulation.advance(round(1.0 / settings.physics.step_s)).position_m
            return 1e3 * float(np.linalg.norm(after - before))
    except ConfigError as error:
        if 'does not stand' not in str(error):
            raise
        return math.inf


def _rest_m(settings: WalkSettings, name: str, gravity_mps2: float, step_s: float) -> float:
    """Return the sinkage at rest [m]."""
    physics = dataclasses.replace(settings.physics, step_s=step_s, start=StartPose(),
                                  gravity_mps2=gravity_mps2)
    with _simulation(settings, physics, name) as simulation:
        return _sinkage_m(simulation)


def _walk(settings: WalkSettings, name: str, step_s: float) -> GroundWalk:
    physics = dataclasses.replace(settings.physics, step_s=step_s)
    return measure(dataclasses.replace(settings, physics=physics), Ground(name))
