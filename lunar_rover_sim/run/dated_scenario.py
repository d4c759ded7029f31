"""The sun of a scenario that names a date."""

from __future__ import annotations

from lunar_rover_sim.errors import ConfigError, WorldError
from lunar_rover_sim.files.paths import user_path
from lunar_rover_sim.illumination.config import SunConfig
from lunar_rover_sim.illumination.sun_of_date import given_site, sun_of_date
from lunar_rover_sim.world.config import DEM, WorldConfig
from lunar_rover_sim.world.model import World
from lunar_rover_sim.world.site import reported_site, Site

# Two directions of grid north that differ by less are the same [deg].
_SAME_DEG = 0.01


def dated_sun(sun: SunConfig, world: WorldConfig, used: World | None = None) -> SunConfig:
    """Return the sun with azimuth and elevation of its date; without a date, as it is.

    used: a world that is used instead of the one of the parameters
    A given site is held against the used world, or an elevation model, that says where it is.
    Raises ConfigError or WorldError that names the parameter, its value and what is valid.
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


def _check_given(given: Site, world: WorldConfig, used: World | None) -> None:
    """Raise ConfigError unless the site is in the world and its grid north is right."""
    place = given.lon_deg, given.lat_deg
    try:
        if used is not None:
            there = _site_in_world(used, place)
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


def _site_in_world(world: World, lon_lat_deg: tuple[float, float]) -> Site | None:
    # Here, because rasterio takes time to import, and most runs need none of it.
    from lunar_rover_sim.world.map_projection import site_in_world
    return site_in_world(world, *lon_lat_deg)


def _dem_site(world: WorldConfig, lon_lat_deg: tuple[float, float] | None = None) -> Site | None:
    # Here, because what reads elevation models takes time to import, and most runs need none.
    from lunar_rover_sim.world.dem import dem_site
    return dem_site(world, lon_lat_deg)
