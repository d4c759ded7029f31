"""Directions to sun and Earth at a site and a date, as a rover there sees them."""

from __future__ import annotations

import dataclasses

import numpy as np

from lunar_rover_sim.base.frames import Array, sun_direction
from lunar_rover_sim.ground.world.moon_place import MoonPlace, unit_vector
from lunar_rover_sim.image.illumination.ephemeris import (Dates, EARTH_RADIUS_KM, MOON_RADIUS_KM,
                                                          sun_and_earth, SUN_RADIUS_KM)


@dataclasses.dataclass(frozen=True)
class Body:
    """A body in the sky; each field is (...), as the dates are.

    Attributes:
        azimuth_deg: From x towards y of the world, as `sun.azimuth_deg`, 0 to 360.
        true_azimuth_deg: From true north towards east, 0 to 360.
        elevation_deg: Of the centre above the horizontal of the sphere.
        distance_km: From the site.
        radius_deg: Apparent radius of the disc.
    """

    azimuth_deg: Array
    true_azimuth_deg: Array
    elevation_deg: Array
    distance_km: Array
    radius_deg: Array

    @property
    def direction(self) -> Array:
        """The (3,) unit vector to it, world axes; of one date."""
        return sun_direction(float(self.azimuth_deg), float(self.elevation_deg))


@dataclasses.dataclass(frozen=True)
class Sky:
    """Sun and Earth."""

    sun: Body
    earth: Body


def sky(site: MoonPlace, dates_utc: Dates) -> Sky:
    """Return the sky over a site at (...) dates; raise ConfigError outside 1972 to 2100.

    The site is on the sphere of 1737.4 km. A kilometre above it moves the Earth by 0.0002 deg.
    """
    positions = sun_and_earth(dates_utc)
    return Sky(_seen(site, positions.sun_km, SUN_RADIUS_KM),
               _seen(site, positions.earth_km, EARTH_RADIUS_KM))


def lit_share(sun: Body, horizon_deg: Array | float) -> Array:
    """Return the share of the sun's disc, 0 to 1, above a horizon that is level across it.

    Args:
        horizon_deg: Elevation of the horizon below the sun.
    """
    height = np.clip((sun.elevation_deg - horizon_deg) / sun.radius_deg, -1.0, 1.0)
    return 1.0 - (np.arccos(height) - height * np.sqrt(1.0 - height**2)) / np.pi


def _seen(site: MoonPlace, position_km: Array, radius_km: float) -> Body:
    from_site = position_km - MOON_RADIUS_KM * unit_vector(site.lon_deg, site.lat_deg)
    east, north, up = np.moveaxis(from_site @ site.rotation_enu_moon().T, -1, 0)
    distance = np.linalg.norm(from_site, axis=-1)
    true_azimuth = np.mod(np.degrees(np.arctan2(east, north)), 360.0)
    return Body(site.azimuth_deg(true_azimuth), true_azimuth,
                np.degrees(np.arcsin(up / distance)), distance,
                np.degrees(np.arcsin(radius_km / distance)))
