"""Elevation models and meshes that are wrong without saying so: units, marks, geotransforms."""

from ground.world.elevation_models import config, hills, MOON, refused, write_tiff
import numpy as np
import pytest
import rasterio
from rasterio.crs import CRS
import trimesh
import worlds

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.parameters import merge
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.dem import open_dem


def bare(path, **parameters):
    """Return the parameters of a small world of the heights alone."""
    return config(path, **worlds.BARE, **parameters)


def edited(path, **changes):
    """Change attributes of a raster, as `gdal_edit.py` does."""
    with rasterio.open(path, 'r+') as file:
        for name, value in changes.items():
            setattr(file, name, value)
    return path


@pytest.mark.parametrize('unit, metres', [
    ('km', 1e3), ('kilometre', 1e3), ('ft', 0.3048), ('US survey foot', 1200 / 3937),
    ('cm', 0.01), ('metre', 1.0), ('M', 1.0)])
def test_heights_in_other_units_are_converted(tmp_path, unit, metres):
    heights = hills()
    path = write_tiff(tmp_path / 'hills.tif', (heights / metres).astype(np.float32))
    tiles = []
    for file in (write_tiff(tmp_path / 'm.tif', heights), edited(path, units=(unit,))):
        raster = open_dem(config(file))
        tiles.append(raster.tile((-20.0, 20.0, -20.0, 20.0), 0.1).heights_m + raster.reference_m)
        raster.close()
    np.testing.assert_allclose(*tiles, atol=1e-3)


def test_a_unit_that_is_none_of_length_is_refused_unless_the_user_says_what_it_is(
        tmp_path, caplog):
    path = edited(write_tiff(tmp_path / 'hills.tif', hills()), units=('degree',))
    refused(path, "the heights of band 1 are in 'degree'; valid are m, km, .*height_scale")
    raster = open_dem(config(path, dem={'height_scale': 0.5}))
    assert raster.reference_m == pytest.approx(-917.0, abs=3.0)
    assert "in place of the unit 'degree' of band 1" in caplog.text
    raster.close()


@pytest.mark.parametrize('scale, offset', [(0.0, 0.0), (np.nan, 0.0), (1.0, np.inf)])
def test_a_scale_without_sense(tmp_path, scale, offset):
    path = edited(write_tiff(tmp_path / 'hills.tif', hills()), scales=(scale,), offsets=(offset,))
    refused(path, 'band 1 has the scale .* valid are numbers, and a scale other than 0')


@pytest.mark.parametrize('folder', [False, True])
@pytest.mark.parametrize('mark, dtype', [
    (-9999.0, 'float32'), (-32768, 'int16'), (65535, 'uint16'), (32767.0, 'float64')])
def test_a_window_wholly_of_a_mark(tmp_path, mark, dtype, folder):
    """Ground begins far beyond the window, or nowhere."""
    heights = np.full((160, 160), mark, dtype)
    if folder:
        (tmp_path / 'dem').mkdir()
        np.save(tmp_path / 'dem' / 'dem.npy', heights)
        (tmp_path / 'dem' / 'dem.yaml').write_text('pixel_size: [1.0, -1.0]')
    path = tmp_path / 'dem' if folder else write_tiff(tmp_path / 'x.tif', heights, pixel=1.0)
    refused(path, f'all pixels in the window are {mark:g}, a mark of missing data; declare it')


def test_level_ground_is_ground(tmp_path):
    for level in (0.0, -3000.0, 12.5):
        open_dem(config(write_tiff(tmp_path / 'level.tif', np.full((60, 60), level, np.float32)))
                 ).close()


@pytest.mark.parametrize('pixel', [0.5, 1.0, 5.0])
@pytest.mark.parametrize('block', [np.s_[:30], np.s_[:, :30], np.s_[2:9, 5:8], np.s_[100, 100]])
def test_zeros_beside_ground_at_20_m_are_no_ground(tmp_path, pixel, block):
    heights = hills(200, pixel) + np.float32(1834.0 + 20.0)
    heights[block] = 0.0
    path = write_tiff(tmp_path / 'edge.tif', heights, pixel=pixel)
    with pytest.raises(WorldError, match=r'x .*, y .* m in .* of the value 0 stands? [12]\d\S* m '
                                         'off the ground beside them: a mark') as error:
        build_world(bare(path), 1)
    assert '\n' not in str(error.value)
    build_world(bare(edited(path, nodata=0.0), dem={'nodata': 'fill'}), 1)


def test_boxes_and_shores_at_0_are_ground(tmp_path):
    """A course of boxes on a plain at 0, and hills that begin there."""
    course = np.zeros((120, 120), np.float32)
    course[50:60, 50:60] = 0.4
    course[20:22, 80:90] = 3.0
    shore = np.maximum(hills(120, 1.0) + 1834.0, 0.0).astype(np.float32)
    whole = np.round(hills(120, 1.0) + 1834.0).astype(np.int16)
    for k, heights in enumerate((course, shore, whole)):
        build_world(bare(write_tiff(tmp_path / f'{k}.tif', heights, pixel=1.0)), 1)


@pytest.mark.parametrize('pixel', [1.0, 20.0])
def test_the_end_of_a_type_of_whole_numbers_is_a_mark_at_any_scale(tmp_path, pixel):
    """-32768 in units of 0.1 mm lies 3.3 m below ground at 0."""
    heights = np.round((hills(60, 1.0) + 1834.0) * 0.2 / 1e-4).astype(np.int16)
    heights[5:9, 5:9] = -32768
    path = edited(write_tiff(tmp_path / 'fine.tif', heights, pixel=pixel), scales=(1e-4,))
    with pytest.raises(WorldError, match='16 pixels of the value -32768 stand 3.* m off'):
        build_world(bare(path), 1)


def test_a_full_range_of_whole_numbers_is_ground(tmp_path):
    """The lowest and the highest pixel of a model that was stretched over its type."""
    heights = hills(60, 1.0).astype(float)
    span = heights.max() - heights.min()
    raw = np.round((heights - heights.min()) / span * 65535.0).astype(np.uint16)
    path = edited(write_tiff(tmp_path / 'full.tif', raw, pixel=1.0), scales=(span / 65535.0,))
    build_world(bare(path), 1)


def turned(path, transform, crs=MOON):
    with rasterio.open(path, 'w', driver='GTiff', width=60, height=60, count=1, dtype='float32',
                       crs=CRS.from_user_input(crs) if crs else None,
                       transform=rasterio.Affine(*transform)) as file:
        file.write(hills(60), 1)
    return path


@pytest.mark.parametrize('crs', [None, MOON])
@pytest.mark.parametrize('transform', [
    (0.0, 0.0, 5.0, 0.0, 0.0, 5.0), (2.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (np.nan, 0.0, 0.0, 0.0, -2.0, 0.0), (2.0, 0.0, np.inf, 0.0, -2.0, 0.0),
    (1.0, 1.0, 0.0, 1.0, 1.0, 0.0)])
def test_a_geotransform_without_area_is_refused(tmp_path, transform, crs):
    refused(turned(tmp_path / 'x.tif', transform, crs),
            'its geotransform is .* pixels have no area; mend it with `gdal_edit.py -tr`')


def test_pixels_of_another_order_than_the_window(tmp_path):
    """A tenth of a millimetre over 30 m, in a file that holds no more than its header."""
    path = tmp_path / 'fine.tif'
    with rasterio.open(path, 'w', driver='GTiff', width=300_000, height=300_000, count=1,
                       dtype='float32', crs=CRS.from_user_input(MOON), tiled=True,
                       transform=rasterio.transform.from_origin(0, 0, 1e-4, 1e-4),
                       sparse_ok=True, BIGTIFF='YES'):
        pass
    refused(path, '129500 x 129500 pixels of 0.0001 x 0.0001 m; valid are at most .* resample it')
    refused(turned(tmp_path / 'far.tif', (1e300, 0.0, 0.0, 0.0, -1e300, 0.0)), 'its pixels are')
    refused(turned(tmp_path / 'wide.tif', (1e7, 0.0, 0.0, 0.0, -1e7, 0.0), None),
            'its pixels are 1e.07 x 1e.07 m; valid is up to 1e.06 m')


def sheet(spike=None, at=(0, 0), n=41, size_m=40.0):
    """Return a mesh of gentle ground with one vertex moved."""
    axis = np.linspace(-size_m / 2, size_m / 2, n)
    x, y = np.meshgrid(axis, axis)
    vertices = np.stack([x, y, 0.3 * np.sin(x / 4.0) * np.cos(y / 5.0)], axis=-1)
    if spike is not None:
        vertices[at[1] + n // 2, at[0] + n // 2, 2] = spike
    corner = np.arange(n - 1)[:, None] * n + np.arange(n - 1)
    faces = np.concatenate([np.stack([corner, corner + 1, corner + n + 1], -1).reshape(-1, 3),
                            np.stack([corner, corner + n + 1, corner + n], -1).reshape(-1, 3)])
    return vertices.reshape(-1, 3), faces


def of_mesh(path, **parameters):
    return WorldConfig.from_mapping(
        merge({**worlds.SMALL, **worlds.BARE, 'source': 'mesh', 'path': str(path)}, parameters))


@pytest.mark.parametrize('suffix', ['.ply', '.stl', '.glb'])
@pytest.mark.parametrize('spike', [5000.0, -5000.0])
@pytest.mark.parametrize('at', [(3, -2), (-15, 15)])
def test_one_vertex_far_off_is_refused(tmp_path, suffix, spike, at):
    """In the window and in the surroundings."""
    path = tmp_path / f'spike{suffix}'
    trimesh.Trimesh(*sheet(spike, at), process=False).export(path)
    with pytest.raises(WorldError, match=rf'vertex at x {at[0]}, y {at[1]}, z {spike:g} m .*mend'
                       ) as error:
        build_world(of_mesh(path, mesh={'up_axis': 'z'}), 1)
    assert '\n' not in str(error.value)


def test_the_walls_of_a_solid_mesh_are_no_spikes(tmp_path):
    """A block of ground on a base 80 m below, as a printer needs it."""
    vertices, faces = sheet()
    base = vertices * [1.0, 1.0, 0.0] - [0.0, 0.0, 80.0]
    rim = [k for edge in (range(0, 40), range(40, 1680, 41), range(1680, 1640, -1),
                          range(1640, 0, -41)) for k in edge]
    walls = [(a, b, c) for k, m in zip(rim, rim[1:] + rim[:1])
             for a, b, c in ((k, k + 1681, m), (m, k + 1681, m + 1681))]
    path = tmp_path / 'block.ply'
    trimesh.Trimesh(np.concatenate([vertices, base]),
                    np.concatenate([faces, faces[:, ::-1] + 1681, walls]), process=False
                    ).export(path)
    world = build_world(of_mesh(path), 1)
    assert np.abs(world.ground.heights_m).max() < 1.0
