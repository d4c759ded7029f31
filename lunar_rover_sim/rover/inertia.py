"""Inertia of chassis and legs, shared by MJCF and URDF."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rover.description import Chassis, Legs


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
