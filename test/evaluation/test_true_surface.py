"""The true surface: the ground where there is no rock, and rocks above it."""

import numpy as np
import worlds

from lunar_rover_sim.evaluation.true_surface import TrueSurface


def test_it_is_the_ground_or_a_rock_above_it():
    world = worlds.small(3)
    surface = TrueSurface(world)
    rng = np.random.default_rng(1)
    xy = rng.uniform(-6.0, 6.0, (2000, 2))
    height, rise = surface.heights(xy)
    ground = world.ground.height_at(xy)
    bare = rise == 0.0
    assert 0.9 < bare.mean() < 1.0
    np.testing.assert_allclose(height[bare], ground[bare], atol=1e-5)
    np.testing.assert_allclose(height, ground + rise, atol=1e-5)
    k = int(np.argmax(world.rocks.diameter_m))
    _, top = surface.heights(world.rocks.position_m[k, :2])
    assert top > 0.1 * world.rocks.diameter_m[k]
    assert np.isnan(surface.heights((100.0, 0.0))[0])


def test_a_map_of_it_has_means_of_its_cells():
    surface = TrueSurface(worlds.small(3))
    found = surface.elevation((1.0, -1.0), 4.0, 0.1)
    assert found.height_m.shape == (40, 40)
    x, y = found.centres_m
    height, rise = surface.heights((x[7], y[30]))
    if rise == 0.0:
        assert abs(found.height_m[30, 7] - height) < 0.02
