"""Map projections: a round hill is round and as wide as it is, whatever the file is drawn in.

Places on the sphere are computed here from its geometry and from the formulas of each projection,
not by PROJ.
"""

import math

from ground.world.elevation_models import config, refused
import numpy as np
import pytest
import rasterio
from rasterio.crs import CRS
import worlds

from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.dem import dem_site, open_dem
from lunar_rover_sim.ground.world.map_projection import site_in_world
from lunar_rover_sim.ground.world.moon_place import reported_site

R = 1737400.0
PER_DEG = math.radians(1.0) * R


def longlat(x, y):
    return x, y


def equirectangular(x, y):
    return x / PER_DEG, y / PER_DEG


def mercator(x, y):
    return x / PER_DEG, np.degrees(2.0 * np.arctan(np.exp(y / R)) - 0.5 * np.pi)


def south_polar(x, y):
    """Stereographic, the meridian of 0 upwards."""
    return (np.degrees(np.arctan2(x, y)),
            np.degrees(2.0 * np.arctan(np.hypot(x, y) / (2.0 * R))) - 90.0)


def kilometres(x, y):
    return south_polar(1e3 * x, 1e3 * y)


# CRS, its inverse, and the coordinates of a place by longitude and latitude (in radians).
PROJECTIONS = {
    'longlat': (f'+proj=longlat +R={R}', longlat,
                lambda lon, lat: (math.degrees(lon), math.degrees(lat))),
    'eqc': (f'+proj=eqc +R={R} +units=m', equirectangular, lambda lon, lat: (R * lon, R * lat)),
    'merc': (f'+proj=merc +R={R} +units=m', mercator,
             lambda lon, lat: (R * lon, R * math.log(math.tan(0.25 * math.pi + 0.5 * lat)))),
    'stere': (f'+proj=stere +lat_0=-90 +R={R} +units=m', south_polar,
              lambda lon, lat: (2.0 * R * math.tan(0.25 * math.pi + 0.5 * lat) * math.sin(lon),
                                2.0 * R * math.tan(0.25 * math.pi + 0.5 * lat) * math.cos(lon))),
    'stere_km': (f'+proj=stere +lat_0=-90 +R={R} +units=km', kilometres,
                 lambda lon, lat: tuple(2e-3 * R * math.tan(0.25 * math.pi + 0.5 * lat) * f(lon)
                                        for f in (math.sin, math.cos)))}


def offsets_m(lon_deg, lat_deg, lon0_deg, lat0_deg):
    """Return metres east and north of a place along great circles."""
    lon, lat, lat0 = np.radians(lon_deg - lon0_deg), np.radians(lat_deg), math.radians(lat0_deg)
    east = np.cos(lat) * np.sin(lon)
    north = np.cos(lat0) * np.sin(lat) - np.sin(lat0) * np.cos(lat) * np.cos(lon)
    up = np.sin(lat0) * np.sin(lat) + np.cos(lat0) * np.cos(lat) * np.cos(lon)
    sine = np.maximum(np.hypot(east, north), 1e-300)
    away = R * np.arctan2(sine, up)
    return away * east / sine, away * north / sine


def cap(east, north):
    """Return the heights of a round cap: 12 m high, 60 m in radius."""
    return 12.0 * (1.0 - (east**2 + north**2) / 60.0**2)


def write(path, name, lon_deg, lat_deg, surface, pixel_m=2.0, turned_deg=0.0, flip=False,
          half_m=90.0, full_turn=0.0):
    """Write a surface of metres east and north of a place, as a file of pixels of about a size."""
    crs, inverse, forward = PROJECTIONS[name]
    x0, y0 = forward(math.radians(lon_deg), math.radians(lat_deg))
    # Units of coordinates per metre, from the inverse.
    unit = {'longlat': 1.0 / PER_DEG, 'stere_km': 1e-3}.get(name, 1.0)
    e, n = offsets_m(*inverse(np.array([x0 + unit, x0]), np.array([y0, y0 + unit])), lon_deg,
                     lat_deg)
    size = pixel_m * unit / np.hypot(e, n)
    count = int(2 * half_m / pixel_m)
    c, s = math.cos(math.radians(turned_deg)), math.sin(math.radians(turned_deg))
    sense = -1.0 if flip else 1.0
    grid = np.array([[sense * size[0] * c, size[0] * s], [sense * size[1] * s, -size[1] * c]])
    corner = np.array([x0, y0]) - grid @ [count / 2, count / 2]
    column, row = np.meshgrid(np.arange(count) + 0.5, np.arange(count) + 0.5)
    x, y = (grid @ np.stack([column.ravel(), row.ravel()]) + corner[:, None]).reshape(2, count, -1)
    heights = surface(*offsets_m(*inverse(x, y), lon_deg, lat_deg)).astype(np.float32)
    with rasterio.open(path, 'w', driver='GTiff', width=count, height=count, count=1,
                       dtype='float32', crs=CRS.from_user_input(crs), transform=rasterio.Affine(
                           *grid[0], corner[0] + full_turn, *grid[1], corner[1])) as file:
        file.write(heights, 1)
    return path


def ring(world, radius_m=10.0, number=24):
    """Return the bearings from true north [rad] of places around the origin, and their heights."""
    site = reported_site(world.report)
    bearing = np.arange(number) * 2.0 * np.pi / number
    azimuth = np.radians(site.azimuth_deg(np.degrees(bearing)))
    xy = radius_m * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    return bearing, world.height_at(xy)


@pytest.mark.parametrize('name, lon, lat, more', [
    ('eqc', 20.0, 85.0, {}), ('eqc', -140.0, -85.0, {}), ('eqc', 0.0, 0.0, {}),
    ('merc', 20.0, 85.0, {}), ('merc', 179.99999, -60.0, {}),
    ('eqc', -30.0, 50.0, {'full_turn': 360.0 * PER_DEG}),
    ('stere', 33.0, -60.0, {}), ('stere', 33.0, -89.0, {}), ('stere_km', -120.0, -70.0, {}),
    ('longlat', 10.0, 80.0, {}), ('longlat', -20.0, -45.0, {'full_turn': 360.0}),
    ('longlat', 180.0, 5.0, {}), ('stere', 33.0, -89.0, {'turned_deg': 30.0}),
    ('eqc', 20.0, 85.0, {'turned_deg': -70.0}), ('stere', 33.0, -80.0, {'flip': True})])
def test_a_round_cap_is_round_and_as_wide_as_it_is(tmp_path, name, lon, lat, more):
    """To 5 cm of 1.3 m; a dent to the true north-east lies where the sun of a date would."""
    def surface(east, north):
        return cap(east, north) - np.exp(-((east - 7.0)**2 + (north - 7.0)**2) / 18.0)
    path = write(tmp_path / 'cap.tif', name, lon, lat, surface, **more)
    world = build_world(config(path, size_m=25.6, **worlds.BARE), 0)
    site = reported_site(world.report)
    assert (site.lon_deg - lon + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-6)
    assert site.lat_deg == pytest.approx(lat, abs=1e-6)
    bearing, heights = ring(world)
    expected = surface(10.0 * np.sin(bearing), 10.0 * np.cos(bearing)) - surface(0.0, 0.0)
    np.testing.assert_allclose(heights, expected, atol=0.05)


def test_a_true_projection_is_taken_pixel_by_pixel(tmp_path):
    """Beyond 0.5 % it is resampled: stereographic from 81.9 deg to the equator."""
    for lat, same in ((-82.5, True), (-81.0, False)):
        path = write(tmp_path / 'cap.tif', 'stere', 33.0, lat, cap)
        raster = open_dem(config(path))
        assert ('azimuthal_equidistant' in raster.report['crs'].lower()) is not same
        assert raster.report['grid_north_deg'] == pytest.approx(-33.0 if same else 0.0, abs=1e-3)
        raster.close()


@pytest.mark.parametrize('name', ['eqc', 'longlat'])
def test_every_way_of_naming_the_window_of_a_resampled_file_is_the_same_place(tmp_path, name):
    """6 m east and 4 m north of the middle, at 60 deg."""
    path = write(tmp_path / 'cap.tif', name, 10.0, 60.0, cap)
    d_lon, d_lat = 6.0 / PER_DEG / math.cos(math.radians(60.0)), 4.0 / PER_DEG
    unit = PER_DEG if name == 'eqc' else 1.0
    for mode, center in (('offset', (6.0, 4.0)), ('pixel', (48.0, 43.0)),
                         ('lonlat', (10.0 + d_lon, 60.0 + d_lat)),
                         ('lonlat', (-350.0 + d_lon, 60.0 + d_lat)),
                         ('crs', (unit * (10.0 + d_lon), unit * (60.0 + d_lat)))):
        site = dem_site(config(path, dem={'center_mode': mode, 'center': list(center)}))
        assert site.lon_deg % 360.0 == pytest.approx(10.0 + d_lon, abs=1e-6)
        assert site.lat_deg == pytest.approx(60.0 + d_lat, abs=1e-6)


def test_a_place_in_a_world_of_a_resampled_file(tmp_path):
    path = write(tmp_path / 'cap.tif', 'eqc', 20.0, 85.0, cap)
    parameters = config(path, size_m=25.6, **worlds.BARE)
    world = build_world(parameters, 0)
    there = 20.0 + 8.0 / PER_DEG / math.cos(math.radians(85.0)), 85.0 + 3.0 / PER_DEG
    for site in (site_in_world(world, *there), dem_site(parameters, there)):
        assert (site.lon_deg, site.lat_deg) == pytest.approx(there, abs=1e-9)
        # Metres of the map turn against true north by the sine of latitude over longitude.
        assert abs(site.grid_north_deg) == pytest.approx(there[0] - 20.0, abs=1e-4)


@pytest.mark.parametrize('crs, body', [
    ('EPSG:32633', '6378.14 km'), ('EPSG:4326', '6378.14 km'), ('EPSG:3857', '6378.14 km'),
    ('+proj=eqc +R=3396190 +units=m', '3396.19 km'), ('+proj=longlat +R=2439400', '2439.4 km')])
def test_another_body_is_refused(tmp_path, crs, body):
    path = write(tmp_path / 'cap.tif', 'stere', 33.0, -89.0, cap)
    with rasterio.open(path, 'r+') as file:
        file.crs = CRS.from_user_input(crs)
    refused(path, f'its CRS is of a body of {body}; valid is the Moon, .* remove the CRS')


def test_a_plane_of_feet(tmp_path):
    """A CRS of a building site is on no body; its unit counts."""
    path = write(tmp_path / 'cap.tif', 'stere', 33.0, -89.0, cap)
    with rasterio.open(path, 'r+') as file:
        file.crs = CRS.from_wkt('LOCAL_CS["site",UNIT["foot",0.3048]]')
    raster = open_dem(config(path, size_m=6.4))
    assert raster.pixel_m == pytest.approx(2.0 * 0.3048, rel=1e-3)
    assert 'lon_deg' not in raster.report
    raster.close()
    refused(path, 'has no CRS: use offset or pixel', dem={'center_mode': 'lonlat'})


def test_gaps_of_a_resampled_file_are_gaps(tmp_path):
    def surface(east, north):
        return np.where(np.hypot(east - 4.0, north) < 2.5, -9999.0, cap(east, north))
    path = write(tmp_path / 'cap.tif', 'eqc', 20.0, 85.0, surface, pixel_m=1.0)
    refused(path, 'x .*, y .* m in the window: -9999 m beside .* declare it')
    with rasterio.open(path, 'r+') as file:
        file.nodata = -9999.0
    refused(path, 'pixels in the window have no data; .* set world.dem.nodata to fill')
    world = build_world(config(path, dem={'nodata': 'fill'}, **worlds.BARE), 0)
    assert world.height_at(np.array([4.0, 0.0])) == pytest.approx(0.0, abs=0.2)


def test_a_window_beyond_a_resampled_file(tmp_path):
    path = write(tmp_path / 'cap.tif', 'eqc', 20.0, 85.0, cap)
    refused(path, r'beyond the east edge of the file', dem={'center': [88.0, 0.0]})
    refused(path, r'beyond the north edge of the file', dem={'center': [0.0, 5000.0]})
    refused(path, 'cannot be projected', dem={'center_mode': 'lonlat', 'center': [20.0, 95.0]})
