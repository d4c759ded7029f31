"""Elevation models: windows, units, gaps, sizes, and that refinement keeps what they say."""

import dataclasses
import json
import os
import pathlib
import struct
import tracemalloc

from ground.world.elevation_models import config, hills, MOON, refused, write_tiff
import numpy as np
import pytest
import rasterio
from rasterio.crs import CRS
from rasterio.transform import from_origin
from rasterio.warp import transform
import worlds

from lunar_rover_sim.base.errors import ConfigError, WorldError
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.dem import open_dem
from lunar_rover_sim.ground.world.map_projection import (lon_lat_crs, projected_origin,
                                                         site_in_world)

REAL = pathlib.Path(__file__).resolve().parents[4] / 'shared' / 'data' / 'moon_npole_80m.tif'
needs_real = pytest.mark.skipif(not REAL.is_file(), reason=f'{REAL} is not there')


def box_means(world, k, x, y, pixel):
    """Return the means of a level's heights over square pixels centred on x and y."""
    grid = world.levels[k]
    fine = (np.arange(40) + 0.5) / 40 * pixel - pixel / 2
    xy = np.stack(np.meshgrid((x[:, None] + fine).ravel(), (y[:, None] + fine).ravel()), -1)
    return grid.height_at(xy).reshape(len(y), 40, len(x), 40).mean(axis=(1, 3))


def assert_keeps(world, heights, x, y, pixel, tolerance_m):
    """Check that pixel means of the ground are the heights given (row 0 south)."""
    means = box_means(world, 0, x, y, pixel) + world.report['origin_height_m']
    assert np.abs(means - heights).max() < tolerance_m


def test_what_the_model_says_survives(tmp_path):
    heights = hills()
    path = write_tiff(tmp_path / 'hills.tif', heights)
    # Without the soil at the feet of rocks, of which the model knows nothing.
    world = build_world(config(path, size_m=25.6, rocks={'fillet': 0.0}), 3)
    plain = build_world(config(path, size_m=25.6, **worlds.BARE), 3)
    # Pixels wholly on the ground, but for those in the band where levels meet.
    x = (np.arange(48) - 23.5) * 2.0
    inner = np.abs(x) < 12.8 - 1.0 - 1.5
    assert_keeps(world, heights[::-1][np.ix_(inner, inner)], x[inner], x[inner], 2.0, 0.02)
    # And below that scale there is something: relief and craters, none above a pixel.
    residual = (world.ground.heights_m - plain.ground.heights_m)[100:-100, 100:-100]
    lag = 12
    assert np.std(residual[:, lag:] - residual[:, :-lag]) / 0.3 > np.tan(np.radians(2.0))
    inside = np.abs(world.craters.position_m).max(axis=1) < 40.0
    assert inside.sum() > 100 and world.craters.diameter_m[inside].max() <= 2.0


@needs_real
def test_a_real_model_survives():
    with rasterio.open(REAL) as file:
        heights, pixel = file.read(1)[::-1], file.transform.a
    # Without the soil at the feet of rocks, of which the model knows nothing.
    world = build_world(WorldConfig.from_mapping({'source': 'dem', 'path': str(REAL),
                                                  'rocks': {'fillet': 0.0},
                                                  'surroundings': {'samples': 1025}}), 1)
    x = (np.arange(33) - 16.0) * pixel
    inner = np.abs(x) < 25.6 - 1.5 - 0.5 * pixel
    assert_keeps(world, heights[np.ix_(inner, inner)], x[inner], x[inner], pixel, 0.03)
    # The first coarse level holds the whole file; its outermost pixels are blended.
    core = np.abs(x) < 27.0
    means = box_means(world, 1, x[core], x[core], pixel) + world.report['origin_height_m']
    assert np.abs(means - heights[np.ix_(core, core)]).max() < 0.05
    assert world.report['origin_height_m'] == pytest.approx(heights[16, 16], abs=0.5)


def test_axes_point_where_the_file_says(tmp_path):
    # 10 cm per metre east, 5 cm per metre north.
    axis = (np.arange(40) - 19.5) * 2.0
    heights = (0.1 * axis - 0.05 * axis[:, None]).astype(np.float32)
    path = write_tiff(tmp_path / 'ramp.tif', heights)
    world = build_world(config(path, **worlds.BARE), 0)
    z = world.height_at(np.array([[0.0, 0.0], [5.0, 0.0], [0.0, 5.0], [-5.0, -5.0]]))
    assert np.allclose(z, [0.0, 0.5, 0.25, -0.75], atol=2e-3)


def test_no_step_where_the_file_ends(tmp_path):
    path = write_tiff(tmp_path / 'hills.tif', hills())
    world = build_world(config(path, craters={'density': 0.0}), 3)
    # Lines across the file's edge at +-48 m, on the level that shows it.
    level = next(g for g in world.levels if g.half_extent_m > 60.0)
    s = np.arange(40.0, 56.0, level.cell_m)
    steps = []
    for t in np.linspace(-40.0, 40.0, 41):
        for xy in (np.stack([s, np.full_like(s, t)], -1), np.stack([np.full_like(s, t), -s], -1)):
            steps.append(np.abs(np.diff(level.height_at(xy))).max() / level.cell_m)
    # No slope beyond those of the terrain itself: hills of up to 20 degrees.
    assert np.max(steps) < np.tan(np.radians(25.0))


def test_a_large_model_serves_the_surroundings_too(tmp_path):
    heights = hills(400, pixel=5.0)
    path = write_tiff(tmp_path / 'wide.tif', heights, pixel=5.0)
    world = build_world(config(path, craters={'density': 0.0}), 3)
    x = (np.arange(400) - 199.5) * 5.0
    some = np.arange(60, 340, 37)
    for k in (2, 3):  # 1.6 m and 12.8 m cells: finer and coarser than the file
        grid = world.levels[k]
        use = some[np.abs(x[some]) < grid.half_extent_m - 60.0]
        xy = np.stack(np.meshgrid(x[use], x[use]), axis=-1)
        z = grid.height_at(xy) + world.report['origin_height_m']
        off = z - heights[::-1][np.ix_(use, use)]
        assert np.std(off) < (0.15 if k == 2 else 0.5)
        assert np.std(heights) > 1.5


@pytest.mark.parametrize('mode, center', [
    ('offset', (10.0, -6.0)), ('pixel', (29.0, 27.0)), ('crs', (1058.0, -3054.0))])
def test_windows(tmp_path, mode, center):
    # 48 pixels of 2 m from x = 1000, y = -3000: the same place in three ways.
    path = write_tiff(tmp_path / 'hills.tif', hills())
    here = open_dem(config(path, dem={'center_mode': mode, 'center': list(center)}))
    assert (here.column0, here.row0) == pytest.approx((29.0, 27.0))
    here.close()


def test_window_by_longitude_and_latitude(tmp_path):
    from rasterio.warp import transform
    path = write_tiff(tmp_path / 'hills.tif', hills())
    moon = CRS.from_user_input('+proj=longlat +R=1737400 +no_defs')
    lon, lat = transform(CRS.from_user_input(MOON), moon, [1058.0], [-3054.0])
    assert lat[0] < -89.8
    here = open_dem(config(path, dem={'center_mode': 'lonlat', 'center': [lon[0], lat[0]]}))
    assert (here.column0, here.row0) == pytest.approx((29.0, 27.0), abs=1e-3)
    here.close()


def test_other_units_of_length(tmp_path):
    feet = MOON.replace('+units=m', '+units=us-ft')
    path = write_tiff(tmp_path / 'feet.tif', hills(), pixel=10.0, crs=feet)
    here = open_dem(config(path, dem={'height_scale': 1200 / 3937}))
    assert here.pixel_m == pytest.approx(10.0 * 1200 / 3937)
    assert here.reference_m == pytest.approx(-1834.0 * 1200 / 3937, abs=2.0)
    here.close()


def test_a_unit_given_by_its_number_is_found_without_a_word(tmp_path, capfd):
    path = write_tiff(tmp_path / 'feet.tif', hills(), pixel=10.0)
    key, metre, clarkes_foot = 3076, 9001, 9005     # of GeoTIFF and EPSG
    entry = struct.pack('<4H', key, 0, 1, metre)
    content = path.read_bytes()
    assert content.count(entry) == 1
    path.write_bytes(content.replace(entry, struct.pack('<4H', key, 0, 1, clarkes_foot)))
    here = open_dem(config(path))
    assert here.pixel_m == pytest.approx(3.047972654)
    here.close()
    # PROJ, which libgeotiff asks, prints past GDAL and rasterio.
    assert capfd.readouterr() == ('', '')


def test_integer_heights_with_scale_and_offset(tmp_path):
    path = write_tiff(tmp_path / 'int.tif', np.full((30, 30), 200, np.int16))
    with rasterio.open(path, 'r+') as file:
        file.scales, file.offsets = (0.5,), (1000.0,)
    here = open_dem(config(path))
    assert here.reference_m == pytest.approx(1100.0)
    here.close()


@pytest.mark.parametrize('marker', [-9999.0, np.nan, -3.4028227e38])
def test_gaps(tmp_path, marker):
    heights = hills()
    heights[22:25, 23:25] = marker
    path = write_tiff(tmp_path / 'gap.tif', heights, nodata=-9999.0 if marker == -9999.0 else None)
    with pytest.raises(WorldError, match=r'6 of \d+ pixels in the window have no data; move '
                                         r'world.dem.center or set world.dem.nodata to fill'):
        open_dem(config(path))
    world = build_world(config(path, dem={'nodata': 'fill'}, **worlds.BARE), 1)
    assert world.report['filled_pixels'] == 6
    assert np.abs(world.ground.heights_m).max() < 5.0


def test_gaps_in_the_surroundings_are_filled(tmp_path):
    heights = hills()
    heights[:5, :] = -9999.0
    path = write_tiff(tmp_path / 'gap.tif', heights, nodata=-9999.0)
    world = build_world(config(path, **worlds.BARE), 1)
    assert all(np.abs(level.heights_m).max() < 200.0 for level in world.levels)


@pytest.mark.parametrize('marker', [-9999.0, -32768.0, 65535.0, 9e4])
@pytest.mark.parametrize('block', [(5, 12, 5, 12), (0, 200, 0, 30), (150, 151, 40, 41)])
def test_undeclared_gaps_in_the_surroundings_are_refused(tmp_path, marker, block):
    """A block, a border and a single pixel outside the window, which feed coarser levels only."""
    heights = hills(200, pixel=1.0)
    heights[block[0]:block[1], block[2]:block[3]] = marker
    path = write_tiff(tmp_path / 'marked.tif', heights, pixel=1.0)
    with pytest.raises(WorldError, match=rf'x .*, y .* m around the origin: {marker:g} m '
                                         'beside .* if one of them marks missing data, declare it'
                       ) as error:
        build_world(config(path, **worlds.BARE), 1)
    assert '\n' not in str(error.value)


@pytest.mark.parametrize('marker', [-3.4028227e38, 1e32, np.nan])
def test_what_cannot_be_a_height_is_filled_in_the_surroundings_with_a_message(
        tmp_path, caplog, marker):
    heights = hills(200, pixel=1.0)
    heights[5:30, 5:30] = marker
    path = write_tiff(tmp_path / 'gap.tif', heights, pixel=1.0)
    world = build_world(config(path, **worlds.BARE), 1)
    told = [r.message for r in caplog.records if 'around the window have no data' in r.message]
    assert len(told) == 1 and told[0].endswith('are filled')
    assert all(np.abs(level.heights_m).max() < 200.0 for level in world.levels)


def test_steep_ground_far_away_is_ground(tmp_path):
    """Slopes of 60 degrees between pixels of 5 m."""
    heights = hills(200, pixel=5.0)
    heights[:40] += np.float32(5.0 * np.tan(np.radians(60.0))) * np.arange(40, 0, -1)[:, None]
    path = write_tiff(tmp_path / 'steep.tif', heights, pixel=5.0)
    build_world(config(path, **worlds.BARE), 1)


def test_refusals(tmp_path):
    heights = hills()
    path = write_tiff(tmp_path / 'hills.tif', heights)
    refused(path, r'reaches 8.4 m beyond the east edge of the file \(96 x 96 m\); move '
            'world.dem.center', dem={'center': [50.0, 0.0]})
    refused(path, 'beyond the south edge', dem={'center': [0.0, -45.0]})
    refused(path, '^world.dem.band: 2;', dem={'band': 2})
    refused(write_tiff(tmp_path / 'bare.tif', heights, pixel=0.0, crs=None),
            'does not say how large its pixels are; set world.dem.pixel_m')
    refused(write_tiff(tmp_path / 'none.tif', np.full((30, 30), np.nan, np.float32)),
            'pixels in the window have no data; move world.dem.center$', dem={'nodata': 'fill'})
    turned = tmp_path / 'turned.tif'
    for along, across in ((1.0, 0.5), (-1.0, 0.0)):
        with rasterio.open(turned, 'w', driver='GTiff', width=30, height=30, count=1,
                           dtype='float32',
                           transform=rasterio.Affine(along, across, 0.0, across, -1.0, 0.0),
                           ) as file:
            file.write(heights[:30, :30], 1)
        refused(turned, 'rows do not run west to east')
    (tmp_path / 'text.tif').write_text('not a raster')
    refused(tmp_path / 'text.tif', 'not a raster that can be read')
    refused(tmp_path / 'absent.tif', 'no such file')
    os.mkfifo(tmp_path / 'pipe.tif')
    refused(tmp_path / 'pipe.tif', 'neither a regular file nor a folder')
    refused(tmp_path, 'dem.npy is missing')
    marked = heights.copy()
    marked[20:22, 20] = -9999.0
    refused(write_tiff(tmp_path / 'marked.tif', marked),
            '-9999 m beside .* if one of them marks missing')
    # The two that differ most are told, along either axis; the window begins at pixel 8.
    ramp = np.add.outer(np.arange(30.0), 100.0 + 3.0 * np.arange(30.0)).astype(np.float32)
    for name, part, other in (('row', np.s_[:16], 140.0), ('column', np.s_[:, 16:], 153.0)):
        marked = ramp.copy()
        marked[part] = 7000.0
        refused(write_tiff(tmp_path / f'{name}.tif', marked), f': 7000 m beside {other:g} m; ')
    colour = tmp_path / 'colour.tif'
    with rasterio.open(colour, 'w', driver='GTiff', width=30, height=30, count=3, dtype='uint16',
                       photometric='RGB', crs=CRS.from_user_input(MOON),
                       transform=rasterio.Affine(2.0, 0.0, 0.0, 0.0, -2.0, 0.0)) as file:
        file.write(np.zeros((3, 30, 30), np.uint16))
    refused(colour, r'band 1 \(uint16, red\) is a picture, not heights')
    grey = write_tiff(tmp_path / 'grey.tif', np.zeros((30, 30), np.uint8))
    refused(grey, r'band 1 \(uint8, gray\) is a picture, .* set world.dem.height_scale')
    open_dem(config(grey, dem={'height_scale': 0.5})).close()
    with pytest.raises(ConfigError, match='height_scale: 0.0 is not valid'):
        config(path, dem={'height_scale': 0.0})
    refused(path, 'cannot be projected', dem={'center_mode': 'lonlat', 'center': [0.0, 400.0]})


def test_pixels_without_a_size_are_told_theirs(tmp_path):
    path = write_tiff(tmp_path / 'bare.tif', hills(), pixel=0.0, crs=None)
    here = open_dem(config(path, dem={'pixel_m': 2.0}))
    assert here.area_m == pytest.approx((-48.0, 48.0, -48.0, 48.0))
    here.close()


def test_only_the_window_is_read(tmp_path):
    # 40 GB if it were read: a sparse file of 100,000 x 100,000 pixels with one tile written.
    path = tmp_path / 'huge.tif'
    n = 100_000
    with rasterio.open(path, 'w', driver='GTiff', width=n, height=n, count=1, dtype='float32',
                       crs=CRS.from_user_input(MOON), transform=from_origin(0, 0, 5.0, 5.0),
                       tiled=True, blockxsize=256, blockysize=256, sparse_ok=True, nodata=0.0,
                       BIGTIFF='YES') as file:
        window = rasterio.windows.Window(51_200 - 512, 51_200 - 512, 1024, 1024)
        file.write(np.tile(hills(64, 5.0), (16, 16)), 1, window=window)
    assert path.stat().st_size < 50e6
    parameters = config(path, dem={'center_mode': 'pixel', 'center': [51_200.0, 51_200.0]},
                        **worlds.BARE)
    tracemalloc.start()
    world = build_world(parameters, 1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 400e6
    assert world.report['origin_height_m'] == pytest.approx(-1834.0, abs=10.0)


def write_folder(folder, heights, pixel=(5.0, -5.0), **more):
    """Write dem.npy and dem.yaml."""
    folder.mkdir()
    np.save(folder / 'dem.npy', heights)
    document = {'size': list(heights.shape[::-1]), 'pixel_size': list(pixel),
                'center_coordinates': [12.3, -89.5], **more}
    (folder / 'dem.yaml').write_text(json.dumps(document))  # JSON is YAML
    return folder


def test_folder_of_an_array_equals_the_raster(tmp_path):
    heights = hills(60, 5.0)
    folder = write_folder(tmp_path / 'site', heights)
    tiff = write_tiff(tmp_path / 'site.tif', heights, pixel=5.0)
    a, b = open_dem(config(folder)), open_dem(config(tiff))
    assert a.reference_m == pytest.approx(b.reference_m)
    for half, cell in ((6.4, 0.025), (200.0, 1.6), (1600.0, 12.8)):
        one, other = (
            source.tile((-half, half, -half, half), cell) for source in (a, b))
        assert np.allclose(one.heights_m, other.heights_m, atol=1e-3)
        assert np.allclose(one.x_m, other.x_m) and np.allclose(one.y_m, other.y_m)
    assert a.report['center_lon_lat_deg'] == [12.3, -89.5]
    a.close(), b.close()
    for pixel in ((5.0, -4.0), (4.0, -5.0)):
        oblong = open_dem(config(write_folder(tmp_path / str(pixel), heights, pixel)))
        assert oblong.tile((-30.0, 30.0, -30.0, 30.0), 0.2).pixel_m == oblong.pixel_m == 5.0


def test_rows_from_the_south(tmp_path):
    heights = hills(60, 5.0)
    north = open_dem(config(write_folder(tmp_path / 'a', heights)))
    south = open_dem(config(write_folder(tmp_path / 'b', heights[::-1], (5.0, 5.0))))
    a, b = (source.tile((-30.0, 30.0, -30.0, 30.0), 0.2) for source in (north, south))
    assert np.allclose(a.heights_m, b.heights_m) and np.allclose(a.y_m, b.y_m)


def test_folder_refusals(tmp_path):
    heights = hills(60, 5.0)
    refused(write_folder(tmp_path / 'size', heights, size=[10, 10]), r'dem.yaml: size: \[10, 10\]')
    refused(write_folder(tmp_path / 'pixel', heights, pixel_size=[0, 'x']), 'pixel_size')
    (tmp_path / 'pixel' / 'dem.yaml').write_text('size: [60, 60]')
    refused(tmp_path / 'pixel', 'dem.yaml: pixel_size is missing')
    refused(tmp_path / 'pixel' / 'dem.npy', 'array without a scale; valid is a folder')
    refused(write_folder(tmp_path / 'number', heights, size=5), 'dem.yaml: size: 5; dem.npy is')
    refused(write_folder(tmp_path / 'huge', heights, pixel_size=[10**400, 1]), 'pixel_size')
    refused(write_folder(tmp_path / 'lonlat', heights), 'has no CRS: use offset or pixel',
            dem={'center_mode': 'lonlat'})
    refused(write_folder(tmp_path / 'cube', heights[None]), 'not a two-dimensional array')
    (tmp_path / 'pickle').mkdir()
    np.save(tmp_path / 'pickle' / 'dem.npy', np.array([{}], object), allow_pickle=True)
    (tmp_path / 'pickle' / 'dem.yaml').write_text('{}')
    refused(tmp_path / 'pickle', 'Python objects')


def test_relief_below_a_model_reaches_down_to_the_cells_with_and_without_surroundings(tmp_path):
    """Curvature over one cell is to that over four as it is where coarser levels exist."""
    path = write_tiff(tmp_path / 'hills.tif', hills())
    shares = []
    for surroundings in ({'extent_m': 0.0}, {'samples': 129}):
        world = build_world(config(path, size_m=6.4, craters={'density': 0.0},
                                   rocks={'abundance': 0.0}, surroundings=surroundings), 3)
        short, long = (np.std(np.diff(world.ground.heights_m[::k], 2, axis=0)) for k in (1, 4))
        shares.append(short / long)
    assert len(world.levels) > 1
    assert shares[0] == pytest.approx(shares[1], rel=0.15)


def test_relief_below_a_model_is_handed_on_from_level_to_level(tmp_path):
    """Pixels of 20 m, cells of 1.6 m around ones of 0.2 m: both have relief of 8 m, as strong."""
    path = write_tiff(tmp_path / 'flat.tif', np.full((32, 32), 5.0, np.float32), pixel=20.0)
    rms = []
    for seed in (1, 2):
        world = build_world(config(path, craters={'density': 0.0}, rocks={'abundance': 0.0}), seed)
        for inner, grid in enumerate(world.levels[1:3]):
            lag, heights = round(8.0 / grid.cell_m), grid.heights_m.astype(float)
            bends = heights[:, 2 * lag:] - 2.0 * heights[:, lag:-lag] + heights[:, :-2 * lag]
            axis = (np.arange(grid.n) - 0.5 * (grid.n - 1)) * grid.cell_m
            away = np.maximum(np.abs(axis)[:, None], np.abs(axis[lag:-lag]))
            beyond = world.levels[1].half_extent_m + 10.0 if inner else -1.0
            rms.append(np.sqrt(np.mean(bends[away > beyond]**2)))
    # Finer cells have more of it: 1.4 and 1.6 times; 0.6 and 0.9 without that of the level around.
    assert 1.1 < np.mean([rms[0] / rms[1], rms[2] / rms[3]]) < 2.0


def placed(x_km, y_km, **changes):
    """Return a small world whose middle is there on a map of the south pole in kilometres."""
    crs = CRS.from_string(MOON.replace('units=m', 'units=km'))
    lon, lat = transform(crs, lon_lat_crs(crs), [x_km], [y_km])
    report = {'crs': crs.to_wkt(), 'lon_deg': lon[0], 'lat_deg': lat[0], 'grid_north_deg': 0.0}
    return crs, dataclasses.replace(worlds.small(1, **worlds.BARE), report={**report, **changes})


@pytest.mark.parametrize('east,north', [(3.0, 2.0), (-2.0, 4.0)])
def test_a_place_on_the_map_has_the_direction_of_the_grid_there(east, north):
    """About the south pole, with the meridian of 0 upwards, grid north is as far to the west of
    true north as the place is to the east."""
    crs, world = placed(30.0, -50.0)
    assert projected_origin(world)[1] == pytest.approx((30.0, -50.0))
    lon, lat = transform(crs, lon_lat_crs(crs), [30.0 + east / 1e3], [-50.0 + north / 1e3])
    found = site_in_world(world, lon[0], lat[0])
    assert (found.lon_deg, found.lat_deg) == pytest.approx((lon[0], lat[0]), abs=1e-9)
    assert found.grid_north_deg == pytest.approx(-lon[0], abs=1e-4)


@pytest.mark.parametrize('x_m,y_m', [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
def test_places_beyond_the_world_or_the_map_are_refused(x_m, y_m):
    crs, world = placed(30.0, -50.0)
    half = world.levels[-1].half_extent_m
    for share, inside in ((0.99, True), (1.01, False)):
        lon, lat = transform(crs, lon_lat_crs(crs), [30.0 + share * half * x_m / 1e3],
                             [-50.0 + share * half * y_m / 1e3])
        if inside:
            assert site_in_world(world, lon[0], lat[0]) is not None
            continue
        with pytest.raises(WorldError, match='outside the world; valid is x and y within '
                                             f'{half:g} m'):
            site_in_world(world, lon[0], lat[0])
    with pytest.raises(WorldError, match='is not on the map'):
        site_in_world(world, 0.0, 90.0)


def test_where_a_world_is_comes_from_its_report():
    _, world = placed(30.0, -50.0)
    nowhere = dataclasses.replace(world, report={})
    assert site_in_world(nowhere, 0.0, -89.0) is None
    assert projected_origin(nowhere) == projected_origin(placed(1.0, 1.0, crs='')[1]) \
        == (None, (0.0, 0.0))
    coded = placed(30.0, -50.0, crs='EPSG:32633', lon_deg=15.0, lat_deg=45.0)[1]
    assert projected_origin(coded)[0] == CRS.from_epsg(32633)
    assert site_in_world(coded, 15.0, 45.0) is None       # on the Earth
    for text in ('EPSG:4326', 'nothing', None):
        with pytest.raises(WorldError, match='report.crs: .* is not valid'):
            site_in_world(placed(30.0, -50.0, crs=text)[1], 0.0, -89.0)
