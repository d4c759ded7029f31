"""A figure of the sky over a site: elevations over time, and the ways of sun and Earth."""

from __future__ import annotations

import pathlib
from typing import Any

from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from lunar_rover_sim.errors import WorldError
from lunar_rover_sim.files.figures import save_figure
from lunar_rover_sim.illumination.light_time import SkyOverTime


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


def write(over: SkyOverTime, path: str | pathlib.Path, title: str) -> None:
    """Write the figure to a PNG file; raise WorldError if it cannot be written."""
    save_figure(figure(over, title), path, WorldError)
