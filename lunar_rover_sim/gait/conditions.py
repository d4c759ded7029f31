"""The conditions of a gait measurement: the rover and the ground on which a table holds."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from lunar_rover_sim.physics.config import PhysicsConfig
from lunar_rover_sim.regolith.config import RIGID
from lunar_rover_sim.rover.description import RoverDescription

Conditions = dict[str, float | str]
_TOLERANCE = 0.01   # relative; speeds are hardly less exact within it


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
