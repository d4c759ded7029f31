"""Place of a world on the Moon, and the angle of its grid to true north."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import math
from typing import Any

import numpy as np

from lunar_rover_sim.base.errors import brief, WorldError
from lunar_rover_sim.base.frames import Array

_REPORTED = ('lon_deg', 'lat_deg', 'grid_north_deg')


@dataclasses.dataclass(frozen=True)
class MoonPlace:
    """A place on the Moon.

    Attributes:
        lon_deg: East longitude, in the mean Earth/polar axis system of maps.
        lat_deg: Latitude in the same system.
        grid_north_deg: Direction of the world's y axis, from true north towards east. In the polar
            stereographic projection of a whole pole it is up to 180; at a pole itself true north
            is that of `lon_deg`.
    """

    lon_deg: float
    lat_deg: float
    grid_north_deg: float = 0.0

    def rotation_enu_moon(self) -> Array:
        """Return the (3, 3) rotation from axes fixed to the Moon to east, true north, up."""
        lon, lat = math.radians(self.lon_deg), math.radians(self.lat_deg)
        east = (-math.sin(lon), math.cos(lon), 0.0)
        north = (-math.sin(lat) * math.cos(lon), -math.sin(lat) * math.sin(lon), math.cos(lat))
        return np.array([east, north, unit_vector(self.lon_deg, self.lat_deg)])

    def azimuth_deg(self, true_azimuth_deg: Array) -> Array:
        """Return directions from x towards y, as scenarios count them.

        Args:
            true_azimuth_deg: (...) from true north towards east.
        """
        return np.mod(90.0 + self.grid_north_deg - true_azimuth_deg, 360.0)

    def to_report(self) -> dict[str, float]:
        """Return the values as the report of a world holds them."""
        return {name: getattr(self, name) for name in _REPORTED}


def unit_vector(lon_deg: float, lat_deg: float) -> Array:
    """Return the (3,) direction of a place from the centre of the Moon."""
    lon, lat = math.radians(lon_deg), math.radians(lat_deg)
    return np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])


def site_towards(lon_deg: float, lat_deg: float, south: Array, north: Array) -> MoonPlace:
    """Return the site whose y axis runs from `south` to `north`, (3,) directions of places.

    Nothing here fails at a pole, where meridians meet.
    """
    site = MoonPlace(lon_deg, lat_deg)
    east, true_north, _ = site.rotation_enu_moon() @ (north - south)
    return dataclasses.replace(site, grid_north_deg=math.degrees(math.atan2(east, true_north)))


def reported_site(report: Mapping[str, Any]) -> MoonPlace | None:
    """Return where the report of a world says that it lies; None if it does not say.

    Raises:
        WorldError: If what it says is no place.
    """
    values = [report.get(name) for name in _REPORTED]
    if any(value is None for value in values):
        return None
    for name, value in zip(_REPORTED, values):
        most = 90.0 if name == 'lat_deg' else 360.0
        if not isinstance(value, (int, float)) or not abs(value) <= most:
            raise WorldError(f'report.{name}: {brief(value)} is not valid; valid is {-most:g} to '
                             f'{most:g} [deg]')
    return MoonPlace(*map(float, values))    # type: ignore[arg-type]
