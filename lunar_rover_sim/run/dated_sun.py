"""The sun of a date: azimuth and elevation where a scenario's ground lies on the Moon."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from lunar_rover_sim.base.errors import brief, ConfigError, WorldError
from lunar_rover_sim.base.files.paths import user_path
from lunar_rover_sim.base.parameters import nest
from lunar_rover_sim.ground.world.config import DEM, WorldConfig
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.moon_place import MoonPlace, reported_site
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.illumination.sun_of_date import check_last_date, given_site, sun_of_date

# Two directions of grid north that differ by less are the same [deg].
_SAME_DEG = 0.01


def sun_of_run(sun: SunConfig, recipe: WorldConfig, duration_s: float,
               changes: Iterable[Mapping[str, Any]], world: str | Path | None) -> SunConfig:
    """Return the sun of a run, with azimuth and elevation of its date, if it names one.

    A file may state both, as a recorded scenario does; the date is what counts.

    Args:
        recipe: Of the scenario's own world.
        changes: What overrides set, as nested sections.
        world: Folder of a world that is used instead of the scenario's own.

    Raises:
        ConfigError: If an override sets what the date decides.
    """
    if not sun.date:
        return sun
    for change in changes:
        values = nest(change.get('render_node', {})).get('sun', {})
        for name in ('azimuth_deg', 'elevation_deg'):
            if name in values:
                raise ConfigError(f'render_node.sun.{name}: {brief(values[name])} is not valid '
                                  f'with render_node.sun.date ({sun.date}), which decides '
                                  "it; set the date to ''")
    dated = dated_sun(sun, recipe, None if world is None else load_world(world, verify=False))
    try:
        check_last_date(dated, duration_s)
    except ConfigError as error:
        raise ConfigError(f'render_node.{error}') from None
    return dated


def dated_sun(sun: SunConfig, world: WorldConfig, used: World | None = None) -> SunConfig:
    """Return the sun with azimuth and elevation of its date; without a date, as it is.

    A given site is held against the used world, or an elevation model, that says where it is.

    Args:
        used: A world that is used instead of the one of the parameters.

    Raises:
        ConfigError: If a parameter is not valid, with its value and what is valid.
        WorldError: If the world cannot be read.
    """
    if not sun.date:
        return sun
    try:
        given = given_site(sun.site)
        if given is not None:
            _check_given(given, world, used)
            return sun_of_date(sun, None)
        if used is not None:
            return sun_of_date(sun, reported_site(used.report))
        return sun_of_date(sun, _dem_site(world) if world.source == DEM else None)
    except ConfigError as error:
        raise ConfigError(f'render_node.{error}') from None


def _check_given(given: MoonPlace, world: WorldConfig, used: World | None) -> None:
    """Raise ConfigError unless the site is in the world and its grid north is right."""
    place = given.lon_deg, given.lat_deg
    try:
        if used is not None:
            # Here, because rasterio takes time to import, and most runs need none of it.
            from lunar_rover_sim.ground.world.map_projection import site_in_world
            there = site_in_world(used, *place)
        # A recorded scenario may be read where its elevation model is not.
        elif world.source == DEM and user_path(world.path, 'path').exists():
            there = _dem_site(world, place)
        else:
            return
    except WorldError as error:
        raise ConfigError(f'sun.site: {error}') from None
    if there is None:
        return
    difference = (given.grid_north_deg - there.grid_north_deg + 180.0) % 360.0 - 180.0
    if abs(difference) > _SAME_DEG:
        raise ConfigError(
            f'sun.site.grid_north_deg: {given.grid_north_deg:g} is not valid; valid is '
            f'{there.grid_north_deg:.4f}, which the projection of '
            f'{world.path if used is None else "the world"} says for longitude '
            f'{given.lon_deg:g}, latitude {given.lat_deg:g}; or set '
            'render_node.sun.site.source=world')


def _dem_site(world: WorldConfig,
              lon_lat_deg: tuple[float, float] | None = None) -> MoonPlace | None:
    # Here, because what reads elevation models takes time to import, and most runs need none.
    from lunar_rover_sim.ground.world.dem import dem_site
    return dem_site(world, lon_lat_deg)
