"""Times when a site is in light: the sky over time before the horizon of a world."""

from __future__ import annotations

import dataclasses

import numpy as np

from lunar_rover_sim.frames import Array
from lunar_rover_sim.illumination.ephemeris import Dates
from lunar_rover_sim.illumination.sky import lit_share, Sky, sky
from lunar_rover_sim.world.model import World
from lunar_rover_sim.world.shade import horizon_deg
from lunar_rover_sim.world.site import Site

_MASK_STEP_DEG = 0.5


@dataclasses.dataclass(frozen=True)
class SkyOverTime:
    """Sun, Earth and light at equal steps of time.

    Attributes:
        dates_utc: (n,).
        sky: Fields of (n,).
        mask_azimuth_deg: (m,) directions all around, from x towards y.
        mask_deg: (m,) elevation of the horizon there.
        horizon_deg: (n,) its elevation below the sun.
        lit: (n,) share of the sun's disc above it.
    """

    dates_utc: Dates
    sky: Sky
    mask_azimuth_deg: Array
    mask_deg: Array
    horizon_deg: Array
    lit: Array

    @property
    def light_share(self) -> float:
        """The share of the time in light; a disc that is cut counts by what is seen of it."""
        return float(np.mean(self.lit))

    @property
    def longest_night_h(self) -> float:
        """The longest time without any of the disc [h], to a step of the dates."""
        dark = np.concatenate([[False], self.lit <= 0.0, [False]])
        starts, ends = np.flatnonzero(np.diff(dark)).reshape(-1, 2).T
        step_h = (self.dates_utc[1] - self.dates_utc[0]) / np.timedelta64(1, 'h')
        return float(np.max(ends - starts, initial=0) * step_h)


def sky_over_time(site: Site, dates_utc: Dates, world: World | None = None) -> SkyOverTime:
    """Return the sky over a site at (n,) dates, n > 1, in equal steps.

    Args:
        world: Its horizon hides the sun, seen from 0.3 m above the origin, as far as its levels
            reach; without one the horizon is level.
    """
    seen = sky(site, dates_utc)
    azimuth = np.arange(0.0, 360.0 + _MASK_STEP_DEG, _MASK_STEP_DEG)
    mask = np.zeros(len(azimuth)) if world is None else horizon_deg(world, azimuth)
    below_sun = np.interp(seen.sun.azimuth_deg, azimuth, mask)
    return SkyOverTime(dates_utc, seen, azimuth, mask, below_sun, lit_share(seen.sun, below_sun))
