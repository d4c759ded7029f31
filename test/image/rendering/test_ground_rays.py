"""Depth of the ground against heights along each ray, for cameras of all kinds."""

import numpy as np
from numpy.typing import NDArray
import pytest
from scipy.spatial.transform import Rotation
import worlds

from lunar_rover_sim.base.frames import Array, R_BODY_OPTICAL, se3
from lunar_rover_sim.base.workers import Workers
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.rendering.config import DetailConfig
from lunar_rover_sim.image.rendering.ground import Ground, SeenTracks
from lunar_rover_sim.image.rendering.projection import Projection, view_numbers

WIDTH, HEIGHT, FOCAL = 150, 110, 100.0      # two blocks of columns and a part of one
K = np.array([[FOCAL, 0.0, 74.5], [0.0, FOCAL, 54.5], [0.0, 0.0, 1.0]])
PROJECTION = Projection(K, WIDTH, HEIGHT, 0.02, 3000.0)


class NoRelief:
    """In place of a `Surface`: no relief below the grid."""

    class tiles:        # noqa: N801  (an attribute of that name)
        flat = True


@pytest.fixture(scope='module')
def world() -> World:
    return worlds.small()


def heights(world: World, x: Array, y: Array) -> Array:
    """Return the height of the finest grid that holds each place, -inf beyond all of them."""
    result = np.full(np.shape(x), -np.inf)
    for grid in reversed(world.levels):
        own = grid.height_at(np.stack([x, y], axis=-1))
        result = np.where(np.isnan(own), result, own)
    return result


def by_small_steps(world: World, T: Array, pixels: NDArray[np.int64]) -> Array:
    """Return the depth at (n, 2) columns and rows, 0 where a ray meets nothing."""
    rays = np.column_stack([(pixels - K[:2, 2]) / FOCAL, np.ones(len(pixels))]) @ T[:3, :3].T
    t = np.concatenate([np.arange(0.02, 2.0, 0.002), 2.0 * 1.001**np.arange(7200)])
    result = np.zeros(len(pixels))
    for k, ray in enumerate(rays):
        over = T[2, 3] + ray[2] * t - heights(world, T[0, 3] + ray[0] * t, T[1, 3] + ray[1] * t)
        below = np.flatnonzero(over <= 0.0)
        if len(below):
            n = max(int(below[0]), 1)
            share = over[n - 1] / (over[n - 1] - over[n]) if over[n - 1] > 0.0 else 0.0
            result[k] = t[n - 1] + share * (t[n] - t[n - 1])
    return result


def camera(world: World, x: float, y: float, above: float, rpy_deg: tuple[float, ...]) -> Array:
    """Return the pose of a camera over the ground; at no angles it looks ahead."""
    turn = Rotation.from_euler('ZYX', rpy_deg[::-1], degrees=True).as_matrix()
    z = float(heights(world, np.array(x), np.array(y))) + above
    return se3(turn @ R_BODY_OPTICAL, np.array([x, y, z]))


@pytest.mark.parametrize('x,y,above,rpy_deg', [
    (0.3, -0.2, 0.3, (0.0, 10.0, 40.0)),        # as the rover looks
    (-1.0, 0.5, 0.5, (80.0, 0.0, 10.0)),        # lying on its side
    (0.5, 0.5, 1.0, (0.0, 90.0, 20.0)),         # straight down
    (0.5, 0.5, 0.6, (5.0, 60.0, 200.0)),        # with the foot point in the image
    (0.0, 0.0, 0.3, (180.0, 0.0, 0.0)),         # upside down
    (3.1, 3.1, 0.4, (0.0, 8.0, 225.0)),         # from the corner of the finest grid
    (40.0, -30.0, 2.0, (0.0, 5.0, 135.0))])     # from a coarse grid
def test_depth(world: World, x: float, y: float, above: float, rpy_deg: tuple[float, ...]) -> None:
    """Of the pixels less than 2 % are off by 1 %: those beside outlines."""
    T = camera(world, x, y, above, rpy_deg)
    ground = Ground(world, DetailConfig(), NoRelief())     # type: ignore[arg-type]
    depth = ground.depth(view_numbers(T, PROJECTION, T[:2, 3]), PROJECTION, SeenTracks(),
                         Workers(1))
    rng = np.random.default_rng(1)
    pixels = np.column_stack([rng.integers(0, WIDTH, 400), rng.integers(0, HEIGHT, 400)])
    expected, found = by_small_steps(world, T, pixels), depth[pixels[:, 1], pixels[:, 0]]
    assert np.mean((found > 0.0) != (expected > 0.0)) < 0.01
    met = (found > 0.0) & (expected > 0.0)
    if rpy_deg[1] > -50.0:
        assert met.sum() > 30
    off = np.abs(found - expected)
    assert np.sum(met & (off > 0.01 * expected)) < 0.02 * len(pixels)
    assert np.sum(met & (expected < 2.0) & (off > 1e-3)) < 0.02 * len(pixels)


def test_any_number_of_threads(world: World) -> None:
    T = camera(world, 0.3, -0.2, 0.3, (8.0, 10.0, 40.0))
    ground = Ground(world, DetailConfig(), NoRelief())     # type: ignore[arg-type]
    images = [ground.depth(view_numbers(T, PROJECTION, T[:2, 3]), PROJECTION, SeenTracks(),
                           Workers(count)) for count in (1, 3, 8)]
    assert np.array_equal(images[0], images[1]) and np.array_equal(images[0], images[2])


def test_no_holes(world: World) -> None:
    """No pixel of sky inside the ground, wherever the camera stands."""
    ground = Ground(world, DetailConfig(), NoRelief())     # type: ignore[arg-type]
    rng = np.random.default_rng(4)
    for _ in range(30):
        T = camera(world, *rng.uniform(-3.0, 3.0, 2), 0.3,
                   (*rng.uniform(-15.0, 15.0, 2), rng.uniform(0.0, 360.0)))
        shows = ground.depth(view_numbers(T, PROJECTION, T[:2, 3]), PROJECTION, SeenTracks(),
                             Workers(1)) > 0.0
        around = [np.roll(shows, (dv, du), (0, 1))[1:-1, 1:-1]
                  for dv in (-1, 0, 1) for du in (-1, 0, 1) if dv or du]
        assert 0.2 < shows.mean() < 1.0
        assert not np.any(~shows[1:-1, 1:-1] & np.all(around, axis=0))
