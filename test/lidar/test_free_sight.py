"""Rays meet nothing where bounds on their slopes say so, and the bounds say so of most of it."""

import numpy as np
from physics_scene import make_world
import pytest
import worlds

from lunar_rover_sim.frames import matrix_from_wxyz, wxyz_from_rpy
from lunar_rover_sim.lidar import ray_march
from lunar_rover_sim.lidar.beam_pattern import beam_pattern
from lunar_rover_sim.lidar.optics import VLP16
from lunar_rover_sim.lidar.ray_arrays import HeightPyramid, RockHulls, SoftCells
from lunar_rover_sim.lidar.ray_caster import box_around, free_distances, NOTHING, RayCaster
from lunar_rover_sim.regolith.overlay import Overlay

RANGE_M = 60.0


def rough(n=201, amplitude=0.01):
    """Return ground whose waves are a tenth as high as long; its cells fill no whole blocks."""
    rng, z = np.random.default_rng(4), np.zeros((n, n))
    for wide in (1, 2, 4, 8, 16, 32):
        lumps = rng.normal(0.0, amplitude * wide, (n // wide + 2, n // wide + 2))
        z += np.kron(lumps, np.ones((wide, wide)))[:n, :n]
    return make_world(z)


class Scene:
    """A world, and rays on it with and without bounds; changed: with prints and rims about it."""

    def __init__(self, world, changed=False):
        self.world, self.half = world, world.ground.half_extent_m
        hulls = RockHulls(world.rocks, world.rock_shapes)
        self.rocks, self.pyramids = hulls.arrays, [HeightPyramid(g, hulls)
                                                   for g in world.levels[:2]]
        self.caster, self.soft = RayCaster(self.pyramids, hulls), None
        if changed:
            overlay, rng = Overlay(), np.random.default_rng(6)
            self.soft = self.caster.soft = SoftCells(self.pyramids[0], overlay)
            for x, y in rng.integers(-500, 440, (40, 2)):
                overlay.put(int(x), int(y), rng.normal(0.0, 0.01, (60, 60)), np.zeros((60, 60)))
            self.soft.update()

    def rays(self, place, up_m, rpy=(0.0, 0.0, 0.0)):
        """Return origins and directions of a VLP-16 that moves by 3 cm in its scan."""
        pattern = beam_pattern(VLP16, 10.0)
        d = pattern.direction[::3] @ matrix_from_wxyz(wxyz_from_rpy(*rpy)).T
        o = np.tile([*place, float(self.world.height_at(place)) + up_m], (len(d), 1))
        o[:, :2] += np.linspace(0.0, 1.0, len(d))[:, None] * [0.02, -0.02]
        o[:, :2] = np.clip(o[:, :2], 1e-9 - self.half, self.half - 1e-9)
        return o, d

    def without_bounds(self, o, d):
        """Return distances, targets and normals of rays that look from their origin on."""
        hits = (np.full(len(d), np.inf), np.full(len(d), NOTHING, np.int32),
                np.zeros((len(d), 3)))
        inner_m, which = 0.0, np.arange(len(d))
        for pyramid in self.pyramids:
            soft = self.soft.arrays if self.soft and not inner_m else SoftCells.nothing()
            ray_march.cast(pyramid.arrays, inner_m, self.rocks, soft, which, np.zeros(len(d)), o,
                           d, RANGE_M, *hits)
            inner_m = pyramid.grid.half_extent_m
        return hits


WORLDS = {'rocks and craters': lambda: Scene(worlds.small(rocks={'abundance': 0.1})),
          'prints': lambda: Scene(worlds.small(rocks={'abundance': 0.1}), changed=True),
          'rough': lambda: Scene(rough()), 'rough prints': lambda: Scene(rough(), changed=True)}


@pytest.mark.parametrize('name', WORLDS)
def test_bounds_change_no_bit(name):
    """Low, tilted, on the lowest and the highest ground, and at the rim of the world."""
    scene = WORLDS[name]()
    heights, half = np.asarray(scene.world.ground.heights_m), scene.half
    low, high = (np.clip(np.array(np.unravel_index(end(heights), heights.shape))[::-1]
                         * scene.world.ground.cell_m - half, 0.05 - half, half - 0.05)
                 for end in (np.argmin, np.argmax))
    met = 0
    for place in ((0.3, -0.7), low, high, (half - 1e-3, 0.4), (0.01 - half, half - 0.02)):
        for up_m, rpy in ((0.02, (0.0, 0.0, 0.0)), (0.34, (0.3, -0.2, 1.0)),
                          (2.0, (1.2, 0.3, 0.0))):
            o, d = scene.rays(place, up_m, rpy)
            found, plain = scene.caster.cast(o, d, RANGE_M), scene.without_bounds(o, d)
            for one, other in zip((found.distance_m, found.target, found.normal), plain):
                assert np.array_equal(one, other)
            met += np.isfinite(found.distance_m).sum()
    assert met > 40_000


def test_free_distances_end_before_what_is_met_and_near_it():
    """On the level that the rover walks on; one that is free of it meets nothing."""
    scene = Scene(worlds.small(rocks={'abundance': 0.1}))
    o, d = scene.rays((1.3, -0.7), 0.34)
    which = np.arange(len(d))
    free = free_distances(scene.pyramids[0].arrays, 0.0, box_around(which, o), which, d, RANGE_M)
    met = scene.without_bounds(o, d)[0]
    met[np.abs((o + met[:, None] * d)[:, :2]).max(axis=1) > scene.half] = np.inf
    assert (free < met).all()
    # Rings grow by 9 % and blocks are a quarter of their distance: they hide no more than half.
    assert np.median((free / met)[np.isfinite(met)]) > 0.75
    assert (free[np.isfinite(met)] > 0.5 * met[np.isfinite(met)]).mean() > 0.9
    rising = d[:, 2] > 0.1
    assert (free[rising] >= RANGE_M).mean() > 0.9


def test_straight_up_and_down():
    world = make_world()
    hulls = RockHulls(world.rocks, world.rock_shapes)
    pyramid = HeightPyramid(world.ground, hulls)
    o, d = np.tile([0.5, 0.5, 1.0], (2, 1)), np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    which = np.arange(2)
    free = free_distances(pyramid.arrays, 0.0, box_around(which, o), which, d, 10.0)
    assert free[0] <= 1.0
    hits = RayCaster([pyramid], hulls).cast(o, d, 10.0)
    assert hits.distance_m[0] == 1.0 and np.isinf(hits.distance_m[1])
