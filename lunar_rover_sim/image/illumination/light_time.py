"""Times when a site is in light: the sky over time before a world's horizon, and its figure."""

from __future__ import annotations

import dataclasses
import pathlib
from typing import Any

from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
import numpy as np

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.files.results import save_figure
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.moon_place import MoonPlace
from lunar_rover_sim.ground.world.shade import horizon_deg
from lunar_rover_sim.image.illumination.sky import Dates, lit_share, Sky, sky

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


def sky_over_time(site: MoonPlace, dates_utc: Dates, world: World | None = None) -> SkyOverTime:
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


def figure(over: SkyOverTime, title: str) -> Any:
    """Return a matplotlib figure: elevation over time above, sun and Earth before the horizon."""
    result = Figure(figsize=(11, 8), constrained_layout=True)
    upper, lower = result.subplots(2, 1)
    result.suptitle(title)
    dates, sun, earth = over.dates_utc, over.sky.sun, over.sky.earth
    upper.plot(dates, sun.elevation_deg, color='tab:orange', label='sun')
    upper.plot(dates, earth.elevation_deg, color='tab:blue', label='Earth')
    upper.plot(dates, over.horizon_deg, color='0.4', linewidth=0.8, label='horizon below the sun')
    low, high = upper.get_ylim()
    upper.fill_between(dates, low, high, where=over.lit > 0.0, color='gold', alpha=0.25,
                       linewidth=0.0, label=f'in light, {100.0 * over.light_share:.1f} % of the '
                       'time')
    upper.set_ylim(low, high)
    upper.set_ylabel('elevation of the centre [deg]')
    upper.set_xlabel('UTC')
    locator = AutoDateLocator()
    upper.xaxis.set_major_locator(locator)
    upper.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    lower.fill_between(over.mask_azimuth_deg, over.mask_deg, min(over.mask_deg.min(), 0.0) - 1.0,
                       color='0.6', label='horizon')
    for body, colour, label in ((sun, 'tab:orange', 'sun'), (earth, 'tab:blue', 'Earth')):
        lower.plot(body.azimuth_deg, body.elevation_deg, '.', markersize=2, color=colour,
                   label=label)
    lower.set_xlim(0.0, 360.0)
    lower.set_xticks(range(0, 361, 45))
    lower.set_xlabel('azimuth from x (grid east) towards y (grid north) [deg]')
    lower.set_ylabel('elevation [deg]')
    for axis in (upper, lower):
        axis.grid(True, alpha=0.2)
        axis.legend(loc='best', fontsize='small')
    return result


def write_figure(over: SkyOverTime, path: str | pathlib.Path, title: str) -> None:
    """Write the figure to a PNG file; raise WorldError if it cannot be written."""
    save_figure(figure(over, title), path, WorldError)
