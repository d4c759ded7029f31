"""Craters: the catalogue of those that a world shows."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array


@dataclasses.dataclass(frozen=True)
class Craters:
    """A catalogue of craters: arrays of equal length m, read-only.

    Attributes:
        position_m: (m, 2) centre.
        diameter_m: (m,) from rim to rim when the crater was fresh.
        age: (m,) fraction of the crater's lifetime, 0 = fresh.
        level: (m,) index of the height level on which it is drawn (finer levels show it too).
    """

    position_m: Array
    diameter_m: Array
    age: Array
    level: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.diameter_m)

    @property
    def time(self) -> Array:
        """(m,) time since formation, in lifetimes of a 1 m crater.

        Diffusion erases a crater in a time that grows with its area (Fassett & Thomson 2014).
        """
        return self.age * self.diameter_m ** 2

    def select(self, chosen: NDArray) -> Craters:
        """Return the craters at the chosen indices, or where a mask is true."""
        return Craters(self.position_m[chosen], self.diameter_m[chosen], self.age[chosen],
                       self.level[chosen])

    @staticmethod
    def join(parts: Sequence[Craters]) -> Craters:
        """Return all craters of several catalogues."""
        if not parts:
            return Craters(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0, np.int32))
        return Craters(*(np.concatenate([getattr(part, field.name) for part in parts])
                         for field in dataclasses.fields(Craters)))
