"""Ray casting against closed forms and MuJoCo."""

import mujoco
import numpy as np
from physics_scene import make_world, plane_heights
import pytest
import worlds

from lunar_rover_sim.frames import matrix_from_wxyz
from lunar_rover_sim.lidar import ray_march
from lunar_rover_sim.lidar.ray_arrays import HeightPyramid, RockHulls, SoftCells
from lunar_rover_sim.lidar.ray_caster import GROUND, NOTHING, RayCaster
from lunar_rover_sim.physics.config import PhysicsConfig
from lunar_rover_sim.physics.model import build_model
from lunar_rover_sim.regolith.overlay import CELL_M, Overlay, TILE
from lunar_rover_sim.rover.description import RoverDescription


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
    rock = np.int32(world.rocks.diameter_m.argmax())
    centre = world.rocks.position_m[rock]
    shape = world.rock_shapes[world.rocks.shape[rock]]
    R = matrix_from_wxyz(world.rocks.orientation_wxyz[rock])
    corners = (shape.vertices[shape.faces] * world.rocks.diameter_m[rock]) @ R.T + centre
    # Rays to the middle of each triangle, from along its normal.
    middle = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
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
