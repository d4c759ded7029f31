"""Ray casting against closed forms and MuJoCo."""

import dataclasses
from typing import Any

import mujoco
import numpy as np
from physics_scene import make_world, plane_heights, ROVER
import pytest
import worlds

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.frames import matrix_from_wxyz, wxyz_from_rpy
from lunar_rover_sim.ground.regolith.overlay import CELL_M, Overlay, TILE
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.lidar import ray_caster, ray_march, returns
from lunar_rover_sim.image.lidar.beam_pattern import beam_pattern
from lunar_rover_sim.image.lidar.lidar import Lidar
from lunar_rover_sim.image.lidar.optics import LidarConfig, VLP16
from lunar_rover_sim.image.lidar.ray_arrays import HeightPyramid, RockHulls, SoftCells
from lunar_rover_sim.image.lidar.ray_caster import GROUND, NOTHING, RayCaster
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.physics.config import PhysicsConfig
from lunar_rover_sim.rover.physics.model import build_model
from lunar_rover_sim.rover.pose import RoverPose


def caster_of(world, levels=1):
    hulls = RockHulls(world.rocks, world.rock_shapes)
    return RayCaster([HeightPyramid(grid, hulls) for grid in world.levels[:levels]], hulls)


def on_soft_ground(world):
    """Return a ray caster on the finest level, and the overlay whose changes it knows of."""
    hulls, overlay = RockHulls(world.rocks, world.rock_shapes), Overlay()
    pyramid = HeightPyramid(world.ground, hulls)
    caster = RayCaster([pyramid], hulls)
    caster.soft = SoftCells(pyramid, overlay)
    return caster, overlay


def directions(count=500, low=-1.2, high=0.1, seed=2):
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(-np.pi, np.pi, count), rng.uniform(low, high, count)
    return np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
                     np.sin(elevation)], axis=-1)


@pytest.mark.parametrize('slope_deg', [0.0, 12.0])
def test_plane(slope_deg):
    world = make_world(plane_heights(slope_deg))
    d = directions()
    o = np.tile([0.3, -0.2, 0.7], (len(d), 1))
    hits = caster_of(world).cast(o, d, 40.0)
    normal = np.array([-np.sin(np.radians(slope_deg)), 0.0, np.cos(np.radians(slope_deg))])
    with np.errstate(divide='ignore'):
        expected = -(o @ normal) / (d @ normal)
    spot = o + expected[:, None] * d
    on_it = (expected > 0.0) & (np.abs(spot[:, :2]).max(axis=1) < 5.0)
    assert np.array_equal(hits.target == GROUND, on_it) and 300 < on_it.sum() < 500
    # The heights are float32: a rounding of 1e-7 m over the sine of the grazing angle.
    assert np.allclose(hits.distance_m[on_it], expected[on_it], atol=1e-5)
    assert np.allclose(hits.normal[on_it], normal, atol=1e-5)
    assert np.isinf(hits.distance_m[~on_it]).all() and not hits.normal[~on_it].any()


def test_range_and_straight_down():
    world = make_world()
    d = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [1.0, 0.0, 0.0]])
    o = np.tile([0.5, 0.5, 1.0], (4, 1))
    hits = caster_of(world).cast(o, d, 1.2)
    assert np.allclose(hits.distance_m[0], 1.0)
    assert np.isinf(hits.distance_m[1:]).all()      # 1.25 m is beyond 1.2 m
    assert (hits.target[1:] == NOTHING).all()


def test_mujoco_finds_the_same():
    """On a world with rocks and craters, from several places, also grazing."""
    world = worlds.small(rocks={'abundance': 0.1})
    model = build_model(world, RoverDescription(), PhysicsConfig())
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    caster, half = caster_of(world), world.ground.half_extent_m
    groups = np.array([1, 0, 0, 0, 0, 0], np.uint8)     # the rover is in group 1
    geom, rocks = np.zeros(1, np.int32), 0
    for place, seed in (((1.3, -0.7), 1), ((-4.0, 3.0), 2), ((0.0, 0.0), 3)):
        d = directions(250, -0.5, 0.1, seed)
        o = np.tile([*place, float(world.height_at(place)) + 0.3], (len(d), 1))
        hits = caster.cast(o, d, 50.0)
        edge = ((np.copysign(half, d[:, :2]) - o[:, :2]) / d[:, :2]).min(axis=1)
        truth = np.array([mujoco.mj_ray(model, data, o[i], d[i], groups, 1, -1, geom)
                          for i in range(len(d))])
        truth[(truth < 0.0) | (truth > edge)] = np.inf  # MuJoCo's field has sides of its own
        assert np.array_equal(np.isinf(truth), np.isinf(hits.distance_m))
        met = np.isfinite(truth)
        assert np.abs(truth[met] - hits.distance_m[met]).max() < 1e-3
        rocks += (hits.target >= 0).sum()
    assert rocks > 15       # else the test says nothing of rocks


def test_rays_on_grid_lines():
    """Rays along edges and diagonals of cells, through samples."""
    world = make_world()
    heading = np.radians(np.arange(0.0, 360.0, 45.0))
    d = np.stack([np.cos(heading), np.sin(heading), np.full(8, -0.2)], axis=-1)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    hits = caster_of(world).cast(np.tile([0.5, 0.25, 0.4], (8, 1)), d, 10.0)
    assert np.allclose(hits.distance_m, 0.4 / -d[:, 2], atol=1e-5)


def test_coarser_levels_follow():
    world = worlds.small(**worlds.BARE)
    d = directions(300, -0.06, -0.02)
    z = float(world.height_at((0.0, 0.0))) + 0.5
    o = np.tile([0.013, 0.007, z], (len(d), 1))
    near, far = (caster_of(world, levels).cast(o, d, 60.0) for levels in (1, 2))
    beyond = np.isinf(near.distance_m) & np.isfinite(far.distance_m)
    assert beyond.sum() > 100
    spot = (o + far.distance_m[:, None] * d)[beyond]
    assert np.abs(spot[:, :2]).max(axis=1).min() > world.ground.half_extent_m - 1e-6
    assert np.allclose(spot[:, 2], world.height_at(spot[:, :2]), atol=1e-4)


def test_rock_of_known_planes():
    world = worlds.small(rocks={'abundance': 0.1})
    hulls = RockHulls(world.rocks, world.rock_shapes)
    single = np.array([not shape.pieces for shape in world.rock_shapes])[world.rocks.shape]
    rock = np.int32((single * world.rocks.diameter_m).argmax())
    centre = world.rocks.position_m[rock]
    shape = world.rock_shapes[world.rocks.shape[rock]]
    R = matrix_from_wxyz(world.rocks.orientation_wxyz[rock])
    corners = (shape.vertices[shape.faces] * world.rocks.diameter_m[rock]) @ R.T + centre
    # Rays to the middle of each triangle, from along its normal.
    middle = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= area
    fair = area[:, 0] > 1e-4 * area.sum()       # the normal of a splinter is not told by rays
    middle, normal = middle[fair], normal[fair]
    assert len(middle) > 30
    for start, outward in zip(middle + 2.0 * normal, normal):
        distance, *found = ray_march.meet_rock(hulls.arrays, rock, *start, *-outward)
        assert np.isclose(distance, 2.0, atol=1e-6)
        assert np.allclose(found, outward, atol=1e-3)
        assert ray_march.meet_rock(hulls.arrays, rock, *start, *outward)[0] == np.inf
        # From within.
        assert ray_march.meet_rock(hulls.arrays, rock, *centre, *outward)[0] == np.inf


def test_a_rock_beyond_the_range():
    world = worlds.small(rocks={'abundance': 0.1})
    rock = world.rocks.position_m[int(world.rocks.diameter_m.argmax())]
    d = np.array([[0.0, 0.6, -0.8]])
    hits = caster_of(world).cast(rock - 3.0 * d, d, 10.0)
    assert hits.target[0] >= 0 and hits.distance_m[0] < 3.0
    for beyond, met in ((1e-6, False), (-1e-6, True)):
        again = caster_of(world).cast(rock - 3.0 * d, d, hits.distance_m[0] - beyond)
        assert np.isfinite(again.distance_m[0]) == met and (again.target[0] != NOTHING) == met


def test_prints_and_rims():
    """A print 2 cm deep with a rim of 1 cm: where its heights say, and nowhere else."""
    world = make_world()
    caster, overlay = on_soft_ground(world)
    d = directions(4000, -0.9, -0.15)
    d[:, 0] = np.abs(d[:, 0])
    o = np.tile([-0.6, 0.031, 0.35], (len(d), 1))
    before = caster.cast(o, d, 10.0)
    height = np.full((60, 60), 0.01)
    height[10:50, 10:50] = -0.02
    overlay.put(-30, -30, height, np.zeros((60, 60)))
    caster.soft.update()
    after = caster.cast(o, d, 10.0)
    spot = o + after.distance_m[:, None] * d
    over = np.abs(spot[:, :2]).max(axis=1) < 0.16
    assert over.sum() > 100
    error = spot[:, 2] - overlay.height_change(spot[:, :2])
    assert np.abs(error[over]).max() < 2e-4 and np.median(np.abs(error[over])) < 1e-6
    same = np.abs((o + before.distance_m[:, None] * d)[:, :2]).max(axis=1) > 0.5
    assert np.array_equal(before.distance_m[same & ~over], after.distance_m[same & ~over])
    assert spot[over, 2].min() < -0.019 and spot[over, 2].max() > 0.009


def test_one_sample_where_four_tiles_meet():
    """Its pyramid of 1 cm reaches one sample to all sides, into tiles that hold nothing else."""
    world = make_world()
    caster, overlay = on_soft_ground(world)
    overlay.put(2 * TILE, -TILE, np.full((1, 1), 0.01), np.zeros((1, 1)))
    caster.soft.update()
    rng = np.random.default_rng(8)
    o = np.column_stack([rng.uniform(-1.0, 1.0, (200, 2)) * CELL_M, np.full(200, 0.3)])
    o[:, :2] += np.array([2 * TILE, -TILE]) * CELL_M
    hits = caster.cast(o, np.tile([0.0, 0.0, -1.0], (200, 1)), 1.0)
    u, v = np.abs(o[:, :2] / CELL_M - [2 * TILE, -TILE]).T
    assert np.allclose(0.3 - hits.distance_m, 0.01 * (1.0 - u) * (1.0 - v), atol=1e-6)


def test_changed_ground_is_met_where_it_is():
    """Waves of 1 cm over 26 tiles: a march in steps of 0.1 mm meets the same places."""
    world = worlds.small(**worlds.BARE)
    caster, overlay = on_soft_ground(world)
    along, across = np.meshgrid(np.linspace(0.0, 1.0, 481), np.linspace(0.0, 1.0, 41))
    height = 0.01 * np.sin(16.0 * np.pi * along) * np.sin(2.0 * np.pi * across)
    overlay.put(-240, -20, height, np.zeros_like(height))
    caster.soft.update()
    rng = np.random.default_rng(3)
    o = np.column_stack([rng.uniform(-1.0, 1.0, 150), rng.uniform(-0.1, 0.1, 150), np.zeros(150)])
    o[:, 2] = world.height_at(o[:, :2]) + rng.uniform(0.05, 0.3, 150)
    d = directions(150, -0.9, -0.05, 4)
    hits = caster.cast(o, d, 3.0)
    t = np.arange(0.0, 3.0, 1e-4)
    changed = 0
    for i in range(150):
        place = o[i, :2] + t[:, None] * d[i, :2]
        change = overlay.height_change(place)
        below = o[i, 2] + t * d[i, 2] <= world.height_at(place) + change
        if not below.any():
            assert np.isinf(hits.distance_m[i])
            continue
        # 1e-4 m is one step of this march; at 3 deg a ray is 4e-4 m longer for 2e-5 m of height.
        assert abs(hits.distance_m[i] - t[below.argmax()]) < 6e-4
        changed += change[below.argmax()] != 0.0
    assert changed > 22


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


STATE = RoverPose(np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0],
                            [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]]))


def versions() -> int:
    """Return for how many types of arguments functions are compiled."""
    return sum(len(getattr(function, 'signatures', ()))
               for module in (ray_caster, ray_march, returns)
               for function in vars(module).values())


def in_memory(world: World) -> World:
    """Return a world with arrays of its own, which may be written to."""
    rocks = {field.name: np.array(getattr(world.rocks, field.name))
             for field in dataclasses.fields(world.rocks)}
    levels = tuple(dataclasses.replace(grid, heights_m=np.array(grid.heights_m))
                   for grid in world.levels)
    return dataclasses.replace(world, levels=levels, albedo=np.array(world.albedo),
                               rocks=dataclasses.replace(world.rocks, **rocks))


def test_scans_compile_nothing() -> None:
    """What is compiled is there before the first scan, also for changed ground."""
    lidar, overlay = Lidar(worlds.small(), ROVER, LidarConfig()), Overlay()
    known = versions()
    assert known > 0
    lidar.scan(STATE)
    overlay.put(0, 0, np.full((9, 9), 0.01), np.zeros((9, 9)))
    lidar.follow(overlay)
    lidar.scan(STATE)
    assert versions() == known


def test_worlds_in_memory_and_from_folders_share_what_is_compiled() -> None:
    """Also with and without noise."""
    loaded = worlds.small(rocks={'abundance': 0.1})
    assert not loaded.rocks.position_m.flags.writeable and not loaded.albedo.flags.writeable
    found = [Lidar(loaded, ROVER, LidarConfig()).scan(STATE).returns.range_m]
    known = versions()
    copied = in_memory(loaded)
    assert copied.rocks.position_m.flags.writeable and copied.albedo.flags.writeable
    found.append(Lidar(copied, ROVER, LidarConfig()).scan(STATE).returns.range_m)
    Lidar(copied, ROVER, LidarConfig(noise=False)).scan(STATE)
    np.testing.assert_array_equal(*found)
    assert versions() == known


def test_nowhere_to_keep_what_is_compiled() -> None:
    """Numba finds no folder for a function without a file: it is compiled all the same."""
    names: dict[str, Any] = {}
    exec('def twice(x): return 2 * x', names)
    assert compiled(names['twice'])(4) == 8
