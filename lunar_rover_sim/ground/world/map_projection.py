"""Places on the Moon in the map projection of an elevation model, and in a world made of it."""

from __future__ import annotations

import logging
import re

import numpy as np
import rasterio
from rasterio.crs import CRS
from rasterio.warp import transform

from lunar_rover_sim.base.errors import brief, WorldError
from lunar_rover_sim.base.files.library_output import stderr_to_log
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.moon_place import (MoonPlace, reported_site, site_towards,
                                                     unit_vector)

logger = logging.getLogger(__name__)

# Bodies of this radius are the Moon. Directions and lengths are taken over twice this step.
MOON_M = (1.73e6, 1.745e6)
_STEP_M = 50.0
_AUTHORITY = re.compile(r'(\w+):(\w+)')
_ELLIPSOID = re.compile(r'(?:SPHEROID|ELLIPSOID)\["[^"]*",\s*([0-9.eE+-]+)')


def body_radius_m(crs: CRS) -> float | None:
    """Return the equatorial radius of the body of a CRS; None for a CRS on no body."""
    found = _ELLIPSOID.search(crs.to_wkt())
    return float(found.group(1)) if found else None


def lon_lat_crs(crs: CRS) -> CRS:
    """Return longitude and latitude on the body of a CRS."""
    body = crs.to_dict()
    keys = {k: body[k] for k in ('R', 'a', 'b', 'rf', 'ellps', 'datum') if k in body}
    return CRS.from_dict(proj='longlat', no_defs=True, **(keys or {'R': 1737400.0}))


def local_crs(crs: CRS, lon_deg: float, lat_deg: float) -> CRS:
    """Return metres east and north of a place: azimuthal equidistant, on the body of a CRS."""
    return CRS.from_dict(proj='aeqd', lon_0=lon_deg, lat_0=lat_deg, R=body_radius_m(crs),
                         units='m', no_defs=True)


def transformed(source: CRS, target: CRS, x: float, y: float) -> tuple[float, float] | None:
    """Return coordinates in another CRS, None where there are none."""
    try:
        xs, ys = transform(source, target, [x], [y])
    except Exception:  # rasterio has no public class for the errors of PROJ
        return None
    return (float(xs[0]), float(ys[0])) if np.all(np.isfinite([*xs, *ys])) else None


def metres_per_unit(crs: CRS) -> float:
    """Return the length of a unit of coordinates; of an angle, along the equator."""
    if crs.is_geographic:
        return (body_radius_m(crs) or 0.0) * float(crs.units_factor[1])
    return float(crs.linear_units_factor[1])


def local_scale(crs: CRS, x: float, y: float) -> Array | None:
    """Return metres east and north per unit of x and of y at a place; None where there are none.

    The first column of the (2, 2) matrix is what a unit of x is on the ground, the second what a
    unit of y is. In a projection without distortion it is a rotation times the length of the unit.
    """
    sphere, radius = lon_lat_crs(crs), body_radius_m(crs)
    here = transformed(crs, sphere, x, y)
    if here is None or radius is None or abs(here[1]) > 90.0:
        return None
    step = _STEP_M / metres_per_unit(crs)
    axes = MoonPlace(*here).rotation_enu_moon()[:2] * radius
    columns = []
    for dx, dy in ((step, 0.0), (0.0, step)):
        # At the edge of a projection, as at a pole in longitude and latitude, only one side is.
        ends = [(sign, transformed(crs, sphere, x + sign * dx, y + sign * dy))
                for sign in (1.0, 0.0, -1.0)]
        (high, there), *_, (low, back) = [(sign, end) for sign, end in ends if end is not None]
        if high == low:
            return None
        columns.append(axes @ (unit_vector(*there) - unit_vector(*back)) / ((high - low) * step))
    return np.stack(columns, axis=1)


def site_of(crs: CRS, x: float, y: float) -> MoonPlace | None:
    """Return the place of projected coordinates; None if the CRS is of another body."""
    sphere = lon_lat_crs(crs)
    if not MOON_M[0] <= (body_radius_m(crs) or 0.0) <= MOON_M[1]:
        return None
    step = _STEP_M / metres_per_unit(crs)
    here, south, north = (transformed(crs, sphere, x, y + dy) for dy in (0.0, -step, step))
    if here is None or south is None or north is None:
        return None
    return site_towards(*here, unit_vector(*south), unit_vector(*north))


def site_in_world(world: World, lon_deg: float, lat_deg: float) -> MoonPlace | None:
    """Return a place with the direction of the world's grid there.

    None if the report does not say where the world is, as that of a generated one.

    Raises:
        WorldError: If the place is outside the world, or if the report holds no projection.
    """
    origin = reported_site(world.report)
    if origin is None:
        return None
    with rasterio.Env(), stderr_to_log(logger):
        crs = _reported_crs(world)
        sphere = lon_lat_crs(crs)
        there = transformed(sphere, crs, lon_deg, lat_deg)
        middle = transformed(sphere, crs, origin.lon_deg, origin.lat_deg)
        valid = f'valid is x and y within {world.levels[-1].half_extent_m:g} m'
        if there is None or middle is None:
            raise WorldError(f'longitude {lon_deg:g}, latitude {lat_deg:g} is not on the map of '
                             f'the world; {valid}')
        xy_m = (np.array(there) - middle) * float(crs.linear_units_factor[1])
        if not np.isfinite(world.height_at(xy_m)):
            raise WorldError(f'longitude {lon_deg:g}, latitude {lat_deg:g} (x {xy_m[0]:.6g}, '
                             f'y {xy_m[1]:.6g} m) is outside the world; {valid}')
        return site_of(crs, *there)


def projected_origin(world: World) -> tuple[CRS | None, tuple[float, float]]:
    """Return the CRS of the elevation model of a world, and the place of its (0, 0) in it [m].

    None and the place in the site for a world whose report names none, as a generated one.

    Raises:
        WorldError: If the report names a CRS that is none.
    """
    origin = reported_site(world.report)
    if origin is None or not world.report.get('crs'):
        return None, world.origin_m
    with rasterio.Env(), stderr_to_log(logger):
        crs = _reported_crs(world)
        middle = transformed(lon_lat_crs(crs), crs, origin.lon_deg, origin.lat_deg)
        if middle is None:
            raise WorldError(f'report: longitude {origin.lon_deg:g}, latitude {origin.lat_deg:g} '
                             'is not in its CRS')
        return crs, (middle[0] + world.origin_m[0], middle[1] + world.origin_m[1])


def _reported_crs(world: World) -> CRS:
    """Return the CRS that the report names, as a code of an authority or as WKT."""
    text = world.report.get('crs')
    code = _AUTHORITY.fullmatch(str(text))
    try:
        # Not from any text: GDAL would read files and addresses that it names.
        crs = CRS.from_authority(*code.groups()) if code else CRS.from_wkt(text)
        if not crs.is_projected:
            raise ValueError('not projected')
    except ValueError:      # CRSError too
        raise WorldError(f'report.crs: {brief(text)} is not valid; valid is a projected CRS, as '
                         'WKT or AUTHORITY:CODE') from None
    return crs
