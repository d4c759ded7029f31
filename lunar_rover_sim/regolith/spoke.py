"""What a soil bears under a spoke: its round tip, and the rod above it once that is in the soil.

`regolith/ball.py` has the formulae of the ball. Deeper than its diameter the rod of radius r,
tilted by t from the normal, adds zeta r tan t (z - 2 R)^2 to what is borne, and pushes the soil
aside with zeta a r (z - 2 R)^2.
"""

from __future__ import annotations

import math

from lunar_rover_sim.regolith.ball import (bearing_n, bearing_slope_npm, contact_area_m2,
                                           silhouette_m3)
from lunar_rover_sim.regolith.soil import Soil

_MOST_STEPS, _EXACT_M = 3, 1e-7   # Newton's steps; tolerance of the depth


class SpokeInSoil:
    """Forces on one spoke; depths of the lowest point of the tip [m]."""

    def __init__(self, soil: Soil, tip_radius_m: float, rod_radius_m: float) -> None:
        self._radius, self._rod = tip_radius_m, rod_radius_m
        self._zeta, self._cohesion = soil.zeta_npm3, soil.cohesion_pa
        self._cohesive = soil.cohesive_bearing_pa
        self._side = soil.zeta_npm3 * soil.shape.side_ratio

    def bears_n(self, depth: float, lean: float) -> float:
        """Return what level soil bears at a plastic depth [N]; lean: tangent of the rod's tilt."""
        bears = bearing_n(depth, self._radius, self._zeta)
        if self._cohesive:
            bears += self._cohesive * contact_area_m2(depth, self._radius)
        below = depth - 2.0 * self._radius
        if below > 0.0:
            bears += self._zeta * self._rod * lean * below * below
        return bears

    def slope_npm(self, depth: float, lean: float) -> float:
        """Return the derivative of what level soil bears [N/m]."""
        slope = bearing_slope_npm(depth, self._radius, self._zeta)
        if self._cohesive:
            slope += self._cohesive * 2.0 * math.pi * max(self._radius - depth, 0.0)
        below = depth - 2.0 * self._radius
        if below > 0.0:
            slope += 2.0 * self._zeta * self._rod * lean * below
        return slope

    def yielded(self, depth: float, plastic: float, elastic_npm: float, part: float,
                lean: float) -> tuple[float, float]:
        """Return the plastic depth [m] to which soil yields, and what it bears there [N].

        There `part` of the bearing of level soil equals the elastic force on a tip at `depth`. The
        depth is found by Newton's method, from a plastic depth that bears less.
        """
        bears = part * self.bears_n(plastic, lean)
        exact = _EXACT_M * elastic_npm
        for _ in range(_MOST_STEPS):
            more = elastic_npm * (depth - plastic) - bears
            if -exact < more < exact:
                break
            plastic += more / (elastic_npm + part * self.slope_npm(plastic, lean))
            if plastic > depth:
                plastic = depth
            bears = part * self.bears_n(plastic, lean)
        return plastic, bears

    def ploughs_n(self, depth: float, reserve: float) -> float:
        """Return the sideways force on tip and rod [N]; reserve: share of it left on a slope."""
        plough = self._side * silhouette_m3(depth, self._radius)
        below = depth - 2.0 * self._radius
        if below > 0.0:
            plough += self._side * self._rod * below * below
        plough *= reserve
        if self._cohesion:
            plough += self._cohesion * contact_area_m2(depth, self._radius)
        return plough
