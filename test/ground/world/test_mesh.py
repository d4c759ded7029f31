"""Meshes: exact vertical rays, axes, holes, overhangs, and what is not a surface."""

import os
import warnings

from ground.world.elevation_models import bumps
import numpy as np
import pytest
import trimesh
import worlds

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.parameters import merge
from lunar_rover_sim.ground.world import export
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.mesh import cast, MeshSource


def config(path, **parameters):
    """Return the parameters of a small bare world from a mesh."""
    base = merge(merge(worlds.SMALL, worlds.BARE), {'source': 'mesh', 'path': str(path)})
    return WorldConfig.from_mapping(merge(base, parameters))


@pytest.mark.parametrize('suffix', ['obj', 'stl', 'ply', 'glb'])
def test_the_ground_is_the_mesh(tmp_path, suffix):
    mesh, grid = bumps()
    path = tmp_path / f'bumps.{suffix}'
    if suffix == 'glb':  # y up by convention
        mesh.apply_transform([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    mesh.export(path)
    world = build_world(config(path), 0)
    ground = world.ground
    axis = np.arange(-225, 226) * ground.cell_m  # within the band where levels meet
    xy = np.stack(np.meshgrid(axis, axis), axis=-1)[::5, ::5]
    expected = grid.height_at(xy) - grid.height_at((0.0, 0.0))
    inner = np.abs(xy).max(axis=-1) < 6.4 - 1.5
    assert np.abs(world.height_at(xy) - expected)[inner].max() < 1e-4
    assert world.report['holes'] == 0 and world.report['overhangs'] == 0


def test_rays_against_a_reference():
    # Random soup of triangles: every ray against every triangle, one by one.
    rng = np.random.default_rng(0)
    triangles = rng.uniform(-1.0, 1.0, (200, 3, 3))
    x, y = np.linspace(-1.0, 1.0, 33), np.linspace(-0.9, 0.8, 27)
    top = cast(triangles, x, y).top_m
    expected = np.full((27, 33), -np.inf)
    rays = np.stack(np.meshgrid(x, y), axis=-1)
    for a, b, c in triangles:
        inverse = np.linalg.inv(np.column_stack([b - a, c - a])[:2])
        u, v = np.moveaxis((rays - a[:2]) @ inverse.T, -1, 0)
        met = (u >= 0) & (v >= 0) & (u + v <= 1)
        height = a[2] + u * (b - a)[2] + v * (c - a)[2]
        expected[met] = np.maximum(expected, height)[met]
    expected[np.isneginf(expected)] = np.nan
    assert np.allclose(top, expected, equal_nan=True, atol=1e-9)


def test_many_triangles():
    n = 317  # 200,000 triangles on 513 x 513 rays
    axis = np.linspace(-10.0, 10.0, n)
    grid = HeightGrid(np.sin(axis + axis[:, None]).astype(np.float32), axis[1] - axis[0])
    vertices, faces = export.surface(grid)
    rays = np.linspace(-9.99, 9.99, 513)
    hits = cast(vertices[faces], rays, rays)
    xy = np.stack(np.meshgrid(rays, rays), axis=-1)
    assert np.abs(hits.top_m - grid.height_at(xy)).max() < 1e-6
    assert np.all(hits.layers == 1)


def test_scale_centre_and_resolution(tmp_path):
    mesh, grid = bumps()
    mesh.apply_scale(100.0)  # centimetres
    mesh.export(tmp_path / 'cm.stl')
    mapping = {'scale': 0.01, 'center': [2.0, -1.0]}
    world = build_world(config(tmp_path / 'cm.stl', mesh=mapping), 0)
    xy = np.array([[1.0, 1.0], [-2.0, 0.5]])
    expected = grid.height_at(xy + [2.0, -1.0]) - grid.height_at((2.0, -1.0))
    assert np.allclose(world.height_at(xy), expected, atol=1e-3)
    # Sampled at 0.5 m, with relief below.
    rough = build_world(config(tmp_path / 'cm.stl', mesh={'scale': 0.01, 'resolution_m': 0.5},
                               relief={'rms_slope_deg': 3.0}), 0)
    smooth = build_world(config(tmp_path / 'cm.stl', mesh={'scale': 0.01, 'resolution_m': 0.5}), 0)
    off = (rough.ground.heights_m - smooth.ground.heights_m)[100:-100, 100:-100]
    assert 0.002 < np.std(off) < 0.05


def test_the_middle_of_a_file_that_lies_elsewhere_is_the_origin(tmp_path):
    """Its coordinates may be those of a map; `center` counts from its middle."""
    mesh, grid = bumps()
    mesh.apply_translation([120.0, -45.0, 800.0])
    mesh.export(tmp_path / 'map.ply')
    for center in ([0.0, 0.0], [2.0, -1.0]):
        source = MeshSource(config(tmp_path / 'map.ply', mesh={'center': center}))
        tile = source.tile((-4.0, 4.0, -4.0, 4.0), 0.5)
        xy = np.stack(np.meshgrid(tile.x_m, tile.y_m), axis=-1)
        np.testing.assert_allclose(tile.heights_m + source.reference_m - 800.0,
                                   grid.height_at(xy + center), atol=1e-3)
        assert source.area_m == pytest.approx((-10.0 - center[0], 10.0 - center[0],
                                               -10.0 - center[1], 10.0 - center[1]), abs=1e-4)


def holed(tmp_path):
    mesh, _ = bumps()
    centres = mesh.triangles_center
    mesh.update_faces(np.linalg.norm(centres[:, :2] - [3.0, 0.0], axis=1) > 0.8)
    mesh.export(tmp_path / 'holed.ply')
    return tmp_path / 'holed.ply'


def test_holes(tmp_path):
    path = holed(tmp_path)
    with pytest.raises(WorldError, match=r'\d+ of 263169 vertical rays in the window meet no face;'
                                         r' mend the mesh or set world.mesh.holes to fill'):
        MeshSource(config(path))
    world = build_world(config(path, mesh={'holes': 'fill'}), 0)
    # A hole of about 2 m2 is 3,200 rays of 6.25 cm2.
    assert 2000 < world.report['holes'] < 4500
    assert np.all(np.isfinite(world.ground.heights_m))
    assert np.abs(world.ground.heights_m).max() < 1.5


def test_overhangs(tmp_path, caplog):
    mesh, _ = bumps()
    shelf = trimesh.creation.box((2.0, 2.0, 0.1))
    shelf.apply_translation([-2.0, 1.0, 2.0])
    trimesh.util.concatenate([mesh, shelf]).export(tmp_path / 'shelf.ply')
    world = build_world(config(tmp_path / 'shelf.ply'), 0)
    # The shelf covers 4 m2: 81 x 81 rays. The highest surface is taken, and it is said.
    assert world.report['overhangs'] == pytest.approx(81 * 81, abs=2 * 81)
    assert 'several surfaces' in caplog.text
    level = world.height_at(np.array([-2.0, 1.0])) - world.height_at(np.array([-2.0, 3.0]))
    assert level > 1.0


def test_the_window_may_touch_the_edge_of_the_mesh(tmp_path):
    mesh, _ = bumps()
    mesh.export(tmp_path / 'bumps.stl')
    MeshSource(config(tmp_path / 'bumps.stl', mesh={'center': [-3.6, 3.6]})).close()
    for center in ([3.7, 0.0], [-3.7, 0.0], [0.0, 3.7], [0.0, -3.7]):
        refused(tmp_path / 'bumps.stl', r'reaches 0\.1 m beyond the mesh', mesh={'center': center})


def test_faces_turned_down(tmp_path):
    mesh, grid = bumps()
    mesh.invert()
    mesh.export(tmp_path / 'down.ply')
    source = MeshSource(config(tmp_path / 'down.ply'))
    assert source.report['overhangs'] == 0 and source.report['holes'] == 0


def refused(path, message, **parameters):
    with pytest.raises(WorldError, match=message) as error:
        MeshSource(config(path, **parameters))
    assert '\n' not in str(error.value)


def test_what_is_not_a_surface(tmp_path):
    trimesh.PointCloud(np.random.default_rng(0).random((100, 3))).export(tmp_path / 'points.ply')
    refused(tmp_path / 'points.ply', 'has no faces; a height field needs a surface')
    wall = trimesh.Trimesh([[-20, 0, 0], [20, 0, 0], [20, 0, 9], [-20, 0, 9]],
                           [[0, 1, 2], [0, 2, 3]])
    wall.export(tmp_path / 'wall.stl')
    refused(tmp_path / 'wall.stl', 'seen from above it has no area')
    (tmp_path / 'text.obj').write_text('nothing here\n')
    refused(tmp_path / 'text.obj', 'no faces|cannot be read')
    (tmp_path / 'one.obj').write_text('v 0\nv 1\nv 2\nf 1 2 3\n')
    refused(tmp_path / 'one.obj', 'its vertices have 1 coordinates, not 3|cannot be read')
    (tmp_path / 'cut.glb').write_bytes(b'glTF\x02\x00')
    refused(tmp_path / 'cut.glb', 'cannot be read as a mesh')
    refused(tmp_path / 'absent.obj', 'no such file')
    (tmp_path / 'mesh.xyz').write_text('')
    refused(tmp_path / 'mesh.xyz', 'not a mesh format that is read; valid are .obj, .stl')
    (tmp_path / 'index.ply').write_text(
        'ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n'
        'property float z\nelement face 1\nproperty list uchar int vertex_indices\n'
        'end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n')
    refused(tmp_path / 'index.ply',
            'a face names vertex 7, .* 3 vertices|cannot be read as a mesh')
    os.mkfifo(tmp_path / 'pipe.obj')
    refused(tmp_path / 'pipe.obj', 'not a regular file')
    for far in ('1e300', '-1e300', 'nan', '3e8'):
        (tmp_path / 'far.obj').write_text(f'v 0 0 0\nv {far} 0 0\nv 0 9 1\nf 1 2 3\n')
        with warnings.catch_warnings():
            warnings.simplefilter('error')     # of NumPy, about its overflow
            refused(tmp_path / 'far.obj', 'not finite numbers up to 1e[+]08 m|cannot be read')
    (tmp_path / 'high.obj').write_text('v 0 0 0\nv 9 0 0\nv 0 9 3e5\nf 1 2 3\n')
    refused(tmp_path / 'high.obj', 'heights differ by 300000 m, .* valid is up to 200000 m')
    mesh, _ = bumps()
    mesh.export(tmp_path / 'bumps.stl')
    refused(tmp_path / 'bumps.stl', r'reaches 1.4 m beyond the mesh \(20 x 20 m\); move '
            'world.mesh.center, set world.mesh.scale', mesh={'center': [5.0, 0.0]})


def axis(n, step=0.1, start=-1.0):
    return start + step * np.arange(n)


def plane_of(corners_xy, a=0.3, b=-0.2, c=1.0):
    """Return corners lifted onto z = a x + b y + c."""
    xy = np.asarray(corners_xy, float)
    return np.column_stack([xy, a * xy[:, 0] + b * xy[:, 1] + c])


@pytest.mark.parametrize('step_m', [0.05, 0.5, 4.0])
def test_rays_are_found_at_any_spacing(step_m):
    """A square of 8 x 8 spacings in the middle of 20 x 20."""
    x = y = axis(21, step_m, -10.0 * step_m)
    hits = cast(square(1.0, 4.2 * step_m), x, y)
    covered = np.abs(x) < 4.2 * step_m
    np.testing.assert_array_equal(np.isfinite(hits.top_m), covered & covered[:, None])


@pytest.mark.parametrize('order', [(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1)])
def test_rays_within_a_triangle_meet_its_plane(order):
    corners = plane_of([(-0.83, -0.77), (0.71, -0.31), (-0.12, 0.93)])[list(order)]
    x, y = axis(21), axis(25, 0.08)
    hits = cast(corners[None], x, y)
    gx, gy = np.meshgrid(x, y)
    # Barycentric by areas: inside where all three have one sign.
    side = []
    for i in range(3):
        p, q = corners[i, :2], corners[(i + 1) % 3, :2]
        side.append((q[0] - p[0]) * (gy - p[1]) - (q[1] - p[1]) * (gx - p[0]))
    inside = np.all(np.array(side) > 0, axis=0) | np.all(np.array(side) < 0, axis=0)
    assert 50 < inside.sum() < 400
    np.testing.assert_array_equal(np.isfinite(hits.top_m), inside)
    np.testing.assert_allclose(hits.top_m[inside], (0.3 * gx - 0.2 * gy + 1.0)[inside])
    # Only faces that look up count as ground.
    expected = inside if order != (0, 2, 1) else np.zeros_like(inside)
    np.testing.assert_array_equal(hits.layers, expected)


def square(z, half=1.0, down=False):
    """Return two triangles at a height, looking up, or down."""
    a, b, c, d = [(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)]
    triangles = np.array([[a, b, c], [a, c, d]], float)
    return triangles[:, ::-1] if down else triangles


def test_the_highest_face_counts_and_layers_are_counted():
    """A roof over a floor: two layers; its underside does not count; edges count once."""
    mesh = np.concatenate([square(0.0), square(0.7, 0.55, down=True), square(0.8, 0.55)])
    x = y = axis(21)
    hits = cast(mesh, x, y)
    roof = (np.abs(x) < 0.55) & (np.abs(y) < 0.55)[:, None]
    np.testing.assert_allclose(hits.top_m, np.where(roof, 0.8, 0.0))
    np.testing.assert_array_equal(hits.layers, np.where(roof, 2, 1))
    assert not cast(mesh, x, y, count_layers=False).layers.any()


def test_what_nothing_covers_is_unknown():
    hits = cast(square(2.0, 0.35), axis(21), axis(21))
    covered = np.abs(axis(21)) < 0.35
    np.testing.assert_array_equal(np.isfinite(hits.top_m), covered & covered[:, None])
    upright = np.array([[[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 1.0]]])
    assert np.isnan(cast(upright, axis(21), axis(21)).top_m).all()
    assert np.isnan(cast(square(0.0) + [50.0, 0.0, 0.0], axis(21), axis(21)).top_m).all()


def test_millions_of_rays_are_met_in_several_batches():
    """Six strips over 1500 x 800 rays, more than are tried at once; heights by strip."""
    x, y = axis(1500, 0.002), axis(800, 0.001)
    edges = np.linspace(-1.2, 2.2, 7)
    strips = []
    for k, (low, high) in enumerate(zip(edges, edges[1:])):
        a, b, c, d = [(low, -2.0, k), (high, -2.0, k), (high, 2.0, k), (low, 2.0, k)]
        strips += [[a, b, c], [a, c, d]]
    hits = cast(np.array(strips, float), x, y)
    expected = np.searchsorted(edges, x, side='right') - 1.0
    clear = np.abs(x[:, None] - edges).min(axis=1) > 1e-6
    np.testing.assert_array_equal(hits.top_m[:, clear], np.tile(expected[clear], (800, 1)))
    assert np.all(hits.layers[:, clear] == 1)


@pytest.mark.parametrize('up_axis,columns', [('x', (2, 0, 1)), ('y', (0, 2, 1)), ('z', (0, 1, 2))])
def test_a_mesh_may_be_long_and_have_any_axis_up(tmp_path, up_axis, columns):
    """What is east, north and up, in the order of the file; y up looks south."""
    x, y = np.meshgrid(np.arange(-10.0, 11.0), np.arange(-4.0, 11.0))
    height = 0.05 * x - 0.08 * y + 0.02 * x * y
    places = np.stack([x, y, height], axis=-1).reshape(-1, 3)
    k = (np.arange(14)[:, None] * 21 + np.arange(20)).ravel()
    faces = np.concatenate([np.stack(corners, axis=-1) for corners in (
        (k, k + 1, k + 22), (k, k + 22, k + 21))])
    vertices = places[:, columns]
    if up_axis == 'y':
        vertices[:, 2] *= -1.0
    path = tmp_path / 'long.ply'
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    source = MeshSource(config(path, mesh={'up_axis': up_axis, 'resolution_m': 1.0}))
    tile = source.tile((-20.0, 20.0, -20.0, 20.0), 0.5)
    np.testing.assert_allclose(tile.x_m, np.arange(-10.0, 11.0), atol=1e-6)
    np.testing.assert_allclose(tile.y_m, np.arange(-7.0, 8.0), atol=1e-6)
    shift = np.median(tile.heights_m - height)
    np.testing.assert_allclose(tile.heights_m, height + shift, atol=1e-5)
