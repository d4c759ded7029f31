"""SandBot's speed over leg frequency, by the soil of this package and rotary walking.

SandBot (Li et al., Sensitive dependence of the motion of a legged robot on granular media, PNAS
106, 2009): 2.3 kg, six C-legs, alternating tripods, poppy seeds; at best 0.3 m/s where hard ground
gives 0.6, and next to nothing beyond some leg frequency. Its rotary walking is rebuilt here. A
tripod of legs, half circles of radius R, is pressed in until the soil bears the weight and what it
takes to bring the body to the speed of the legs,

    3 F(z) = m (g + R omega / dt),

with F of resistive force theory over the half circle. Then each leg turns in place about its
centre, and carries its axle, whose height over the belly is h, along a chord: a step of

    s = 2 sqrt(R^2 - (z + h - R)^2),    v = s omega / pi    (two steps a turn).

Where z + h exceeds 2 R the belly no longer leaves the ground: the robot swims.

R and h are from memory of that paper. The width of a leg and the time dt are not known here; the
study gives the curve for a range of both.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.regolith.soil import EARTH, PRESETS, Soil

MASS_KG = 2.3
BEST_MPS = 0.3
FREQUENCIES_RADPS = np.linspace(1.0, 30.0, 59)
_SLICES, _DEPTHS = 200, 100


@dataclasses.dataclass(frozen=True)
class CLegs:
    """Six half circles: radius, height of the axles over the belly, width [m]; dt [s]."""

    radius_m: float = 0.0355
    hip_m: float = 0.025
    width_m: float = 0.02
    start_s: float = 0.2


def lift_n(soil: Soil, legs: CLegs, depth_m: float) -> float:
    """Return what the soil bears under one leg that is pressed straight down to a depth [N]."""
    theta = (np.arange(_SLICES) + 0.5) / _SLICES * 0.5 * math.pi
    below = np.maximum(depth_m - legs.radius_m * (1.0 - np.cos(theta)), 0.0)
    # Both halves of the arc, each facet tilted as the arc is there.
    alpha = 0.5 * (soil.shape.alpha(theta, 0.5 * math.pi)[1]
                   + soil.shape.alpha(-theta, 0.5 * math.pi)[1]) / soil.shape.bearing
    slice_m = legs.radius_m * 0.5 * math.pi / _SLICES
    return float(2.0 * soil.zeta_npm3 * legs.width_m * slice_m * np.sum(alpha * below))


def speeds_mps(soil: Soil, legs: CLegs, omega_radps: Array) -> Array:
    """Return the speeds at leg frequencies [m/s]; 0 where it swims."""
    depths = np.linspace(0.0, 2.0 * legs.radius_m - legs.hip_m, _DEPTHS)
    lifts = [lift_n(soil, legs, float(depth)) for depth in depths]
    wanted = MASS_KG * (EARTH + legs.radius_m * omega_radps / legs.start_s) / 3.0
    lever = np.interp(wanted, lifts, depths) + legs.hip_m - legs.radius_m
    step = 2.0 * np.sqrt(np.maximum(legs.radius_m ** 2 - lever ** 2, 0.0))
    return np.where(wanted <= lifts[-1], step * omega_radps / math.pi, 0.0)


def curve_mps(preset: str, legs: CLegs) -> Array:
    """Return the speeds at `FREQUENCIES_RADPS` in poppy seeds."""
    return speeds_mps(PRESETS[preset].under(EARTH), legs, FREQUENCIES_RADPS)
