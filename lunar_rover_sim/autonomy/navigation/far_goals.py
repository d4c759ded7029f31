"""Goals that are far off: the plan over the map from orbit along which local plans lead."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses

import numpy as np

from lunar_rover_sim.autonomy.navigation.config import GlobalPlanConfig
from lunar_rover_sim.autonomy.navigation.global_plan import GlobalPlan, GroundCosts
from lunar_rover_sim.autonomy.navigation.traversability import LETHAL, Traversability
from lunar_rover_sim.base.frames import Array

CostsAround = Callable[[Sequence[Array]], GroundCosts]
_ONE_PLACE_M = 10.0         # plans that are made anew within this are at one place
_HOLE_M = 3.0               # a hole of the map from orbit this near is told of
_NEWS_M = 1.0               # from place to place of the way on which no way was found


class FarGoals:
    """Knows the plan over the map from orbit, and where it was made anew.

    Attributes:
        plan: None: the way leads straight to the goal.
        is_known: Whether it is known if there is to be such a plan.
    """

    def __init__(self, config: GlobalPlanConfig) -> None:
        self._config = config
        self._holes: list[Array] = []           # of that map, which were told of
        self.drop()

    def drop(self) -> None:
        """Forget the plan."""
        self.plan: GlobalPlan | None = None
        self.is_known = False
        self._news: list[Array] = []            # where it was made anew

    def follow(self, plan: GlobalPlan) -> None:
        """Follow a plan that was made elsewhere."""
        self.plan, self.is_known = plan, True

    def make(self, costs: CostsAround | None, position: Array,
             goals: Sequence[Array]) -> GlobalPlan | None:
        """Plan where a goal is far; return the plan, None where none is.

        Args:
            costs: As of `Navigator`.

        Raises:
            NavigationError: If no way leads to the goals.
        """
        self.is_known = True
        places = [position[:2], *goals]
        if costs is None or all(np.linalg.norm(b - a) <= self._config.from_m
                                for a, b in zip(places, places[1:])):
            return None
        self.plan = GlobalPlan(costs(places), position, goals, self._config)
        return self.plan

    def make_anew(self, position: Array) -> str | None:
        """Plan another way, since none leads along the plan; return why there is none."""
        assert self.plan is not None
        here = [place for place in self._news
                if np.linalg.norm(place - position[:2]) < _ONE_PLACE_M]
        if len(here) >= self._config.plans:
            return f', and made {len(here)} plans within {_ONE_PLACE_M:g} m'
        self._news.append(position[:2].copy())
        ahead = np.arange(0.0, self._config.ahead_m + _NEWS_M, _NEWS_M)
        found = self.plan.report_blocked([self.plan.ahead(position, s) for s in ahead], position)
        return None if found else ''

    def without_holes(self, grid: Traversability,
                      position: Array) -> tuple[Traversability, list[str]]:
        """Return a map in which ground that the map from orbit does not know is not driven.

        With it comes a note on a hole that is near, once.
        """
        if self.plan is None:
            return grid, []
        at = [low + (np.arange(len(grid.cost)) + 0.5) * grid.cell_m for low in grid.origin_m]
        hole = ~self.plan.costs.known_at(*at)
        if not hole.any() or not self.plan.has_ground(*position[:2]):
            return grid, []
        rows, columns = np.nonzero(hole)
        holes = np.stack([at[0][columns], at[1][rows]], axis=-1)
        apart = np.linalg.norm(holes - position[:2], axis=1)
        nearest = holes[int(np.argmin(apart))]
        notes = []
        if apart.min() < _HOLE_M and all(np.linalg.norm(nearest - one) > _ONE_PLACE_M
                                         for one in self._holes):
            self._holes.append(nearest)
            notes.append(f'keeps off x {nearest[0]:.1f} m, y {nearest[1]:.1f} m: the map '
                         'from orbit has no heights there')
        return dataclasses.replace(grid, cost=np.where(hole, np.int8(LETHAL), grid.cost)), notes
