"""Sinkage and slip of each leg, from state to state."""

from __future__ import annotations

from collections.abc import Iterable
import dataclasses
import logging

import numpy as np

from lunar_rover_sim.frames import Array
from lunar_rover_sim.physics.soft_tip import SoftTip

logger = logging.getLogger(__name__)

# Part of a spoke below ground from which on a leg is dug in. The belly of the default rover lies
# on flat ground at 0.72 to 0.76.
DUG_IN_SPOKES = 0.7


@dataclasses.dataclass(frozen=True)
class GroundContact:
    """What the ground does at each leg, in the order of LEG_NAMES.

    sinkage_m: (4,) depth of the deepest tip below the surface that it met, 0 in the air
    slip_mps: (4,) mean speed at which loaded tips slid, since the previous state
    dug_in: whether at least two legs are in the ground by seven tenths of a spoke
    """

    sinkage_m: Array
    slip_mps: Array
    dug_in: bool


class ContactObserver:
    """Adds up the way that tips slip, and sees when the rover digs itself in."""

    def __init__(self, spoke_m: float, step_s: float) -> None:
        self._deep_m, self._step_s = DUG_IN_SPOKES * spoke_m, step_s
        self._was_dug_in = False
        self.restart()

    def restart(self) -> None:
        """Begin to count at step 0."""
        self._slid = [0.0] * 4
        self._observed = 0

    def surface_again(self) -> None:
        """Count the rover as not dug in, so that the next time is told."""
        self._was_dug_in = False

    def add_slip(self, leg: int, way_m: float) -> None:
        """Add a way that a loaded tip of a leg has slipped [m]."""
        self._slid[leg] += way_m

    def observe(self, tips: Iterable[SoftTip], step: int) -> GroundContact:
        """Return sinkage and slip per leg at a step; slip since the last call."""
        sinkage = [0.0] * 4
        for tip in tips:
            if tip.in_ground and tip.sinkage > sinkage[tip.leg]:
                sinkage[tip.leg] = tip.sinkage
        interval_s = max(1, step - self._observed) * self._step_s
        slip = [way / interval_s for way in self._slid]
        self._slid, self._observed = [0.0] * 4, step
        deep = sum(s >= self._deep_m for s in sinkage) >= 2
        if deep and not self._was_dug_in:
            logger.warning('the rover has dug itself in: tips are %s mm deep',
                           ', '.join(f'{1e3 * s:.0f}' for s in sinkage))
        self._was_dug_in = deep
        return GroundContact(np.array(sinkage), np.array(slip), deep)
