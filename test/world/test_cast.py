"""Vertical rays against triangles: planes, overhangs, edges, holes and many at once."""

import numpy as np
import pytest

from lunar_rover_sim.world.mesh import cast


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
