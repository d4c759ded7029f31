"""The nest of levels: seams, flatness, determinism, and the surface that MuJoCo collides with."""

import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from waiting import LIMIT_S
import worlds

from lunar_rover_sim.ground.world import levels as nest
from lunar_rover_sim.ground.world.build import build_world, drop_m, MOON_RADIUS_M
from lunar_rover_sim.ground.world.config import LEVEL_RATIO, WorldConfig
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.image.illumination.config import ReflectanceConfig, SunConfig
from lunar_rover_sim.image.illumination.sunlight import Sunlight
from lunar_rover_sim.run.scenario import Scenario


def hfield_model(ground: HeightGrid, extra: str = '') -> mujoco.MjModel:
    """Return a model whose height field is the ground, heights normalised to [0, 1]."""
    h = ground.heights_m
    low, span = float(h.min()), float(np.ptp(h)) or 1.0
    e = ground.half_extent_m
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco><option gravity="0 0 0"/>
<asset>
<hfield name="ground" nrow="{ground.n}" ncol="{ground.n}" size="{e} {e} {span!r} 1"/>
</asset>
<worldbody><geom type="hfield" hfield="ground" pos="0 0 {low!r}"/>{extra}</worldbody></mujoco>""")
    model.hfield_data[:] = ((h - low) / span).ravel()
    return model


def test_arrays_of_a_built_world_cannot_be_written():
    """Physics, light and pictures share them."""
    world = build_world(WorldConfig.from_mapping(
        {'size_m': 3.2, 'cell_m': 0.05, 'surroundings': {'samples': 65, 'extent_m': 50.0}}), 1)
    heights = [level.heights_m for level in world.levels]
    for array in (*heights, world.albedo, *vars(world.rocks).values()):
        assert not array.flags.writeable


def test_rays_meet_the_ground_where_the_world_says():
    # Heights are normalised float32: an error of about 1e-7 of the span, far below 1 mm.
    ground = worlds.small().ground
    model = hfield_model(ground)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rng = np.random.default_rng(0)
    edge = ground.half_extent_m - 1e-6
    xy = rng.uniform(-edge, edge, (2000, 2))
    geom = np.array([-1], np.int32)
    down = np.array([0.0, 0.0, -1.0])
    top = float(ground.heights_m.max()) + 1.0
    z = np.array([top - mujoco.mj_ray(model, data, np.array([x, y, top]), down, None, 1, -1, geom,
                                      None) for x, y in xy])
    assert np.abs(z - ground.height_at(xy)).max() < 1e-3


def test_one_position_has_the_height_of_many():
    ground = worlds.small().ground
    edge = ground.half_extent_m
    xy = np.random.default_rng(1).uniform(-1.02 * edge, 1.02 * edge, (2000, 2))
    corners = np.array([[edge, edge], [-edge, -edge], [edge, -edge], [np.nan, 0.0]])
    xy = np.concatenate([xy, corners, 0.025 * np.round(xy[:100] / 0.025)])
    single = [ground.height_at_point(x, y) for x, y in xy.tolist()]
    np.testing.assert_allclose(single, ground.height_at(xy), rtol=0.0, atol=1e-12)
    assert np.isnan(single).any() and np.isfinite(single).sum() > 1900


def test_collisions_use_the_same_triangles():
    # One cell whose diagonals differ: a ball pressed into its middle shows which one is there.
    heights = np.zeros((3, 3), np.float32)
    heights[0, 1] = heights[1, 0] = 0.2  # the corners off the (ix, iy)-(ix+1, iy+1) diagonal
    ground = HeightGrid(heights, 1.0)
    ball = '<body pos="-0.5 -0.5 0.04"><freejoint/><geom type="sphere" size="0.05"/></body>'
    model = hfield_model(ground, ball)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert ground.height_at((-0.5, -0.5)) == 0.0
    # Resting in the fold at height 0 it is 1 cm deep, measured along the fold's steep sides less.
    # On the other diagonal the surface would be at 0.1 and the ball 11 cm deep.
    assert data.ncon > 0
    assert -0.02 < data.contact.dist.min() < 0.0


@pytest.mark.parametrize('make', [worlds.world, worlds.small])
def test_no_cracks_between_levels(make):
    world = make()
    rng = np.random.default_rng(0)
    for inner, outer in zip(world.levels, world.levels[1:]):
        h = inner.half_extent_m
        along = rng.uniform(-h, h, 2000)
        for x, y in ((along, h), (along, -h), (h, along), (-h, along)):
            xy = np.stack(np.broadcast_arrays(x, y), axis=-1)
            gap = inner.height_at(xy) - outer.height_at(xy)
            # Rounding of float32 heights of some metres.
            assert np.abs(gap).max() < 2e-6


def test_levels_cover_a_horizon_and_nest():
    world = worlds.world()
    assert world.ground.n == 2049
    assert world.ground.half_extent_m == pytest.approx(25.6)
    assert world.levels[-1].half_extent_m >= 1000.0
    for inner, outer in zip(world.levels, world.levels[1:]):
        assert outer.cell_m == pytest.approx(8 * inner.cell_m)
        assert outer.half_extent_m >= 2.0 * inner.half_extent_m
        # Coarse levels hold the fine heights within.
        axis = nest.axis_m(outer.n, outer.cell_m)
        inside = np.abs(axis) < inner.half_extent_m - 0.5 * outer.cell_m
        xy = np.stack(np.meshgrid(axis[inside], axis[inside]), axis=-1)
        assert np.allclose(outer.heights_m[np.ix_(inside, inside)], inner.height_at(xy), atol=1e-6)


def test_origin_is_at_height_zero():
    assert abs(worlds.world().height_at((0.0, 0.0))) < 1e-6


def test_start_is_gentle():
    for seed in range(4):
        world = worlds.small(seed)
        angle = np.linspace(0.0, 2.0 * np.pi, 36)
        ring = 0.4 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        # Craters over the origin are limited to 5 degrees; relief adds a few.
        assert np.abs(world.height_at(ring)).max() < 0.4 * np.tan(np.radians(14.0))


def test_flat_is_flat_but_for_the_sphere():
    world = build_world(Scenario.load('flat').world, 3)
    assert not world.ground.heights_m.any()
    # The drop of the sphere at the farthest corners, and nothing else.
    for level in world.levels[1:]:
        deepest = drop_m(2.0 * level.half_extent_m**2, 25.6 * 2.0**0.5)
        assert level.heights_m.max() == 0.0
        assert level.heights_m.min() == pytest.approx(-deepest, abs=1e-5)
    assert len(world.rocks) == 0 and len(world.craters) == 0
    assert np.all(world.albedo == 1.0)
    assert np.all(world.height_at(np.array([[0.3, 20.0], [25.0, -25.5]])) == 0.0)


def test_seed_decides():
    tiny = {'size_m': 6.4, 'surroundings': {'samples': 129}}
    config = WorldConfig.from_mapping(tiny)
    first, again, other = build_world(config, 4), build_world(config, 4), build_world(config, 5)
    assert first.hash == again.hash != other.hash
    for a, b in zip(first.levels, again.levels):
        assert np.array_equal(a.heights_m, b.heights_m)
    assert first.config.seed == 4
    # The recipe's own seed goes before the scenario's.
    own = WorldConfig.from_mapping({**tiny, 'seed': 4})
    assert build_world(own, 99).hash == first.hash


def test_threads_do_not_decide():
    # Sums of linear algebra libraries depend on how many threads share them.
    program = ('from lunar_rover_sim.ground.world.build import build_world\n'
               'from lunar_rover_sim.ground.world.config import WorldConfig\n'
               f'print(build_world(WorldConfig.from_mapping({worlds.SMALL!r}), 3).hash)')
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)}
    environment |= {f'{name}_NUM_THREADS': '3' for name in ('OMP', 'OPENBLAS', 'MKL')}
    done = subprocess.run([sys.executable, '-c', program], env=environment, text=True,
                          stdout=subprocess.PIPE, check=True, timeout=LIMIT_S)
    assert done.stdout.strip() == worlds.small(3).hash      # by one thread, or as many as cores


def test_progress_runs_from_none_to_all():
    seen = []
    build_world(WorldConfig.from_mapping(worlds.SMALL), 1, lambda what, part: seen.append(part))
    assert seen[0] == 0.0 and seen[-1] == 1.0 and seen == sorted(seen)


def test_fade_leaves_no_ring():
    # Roughness of the coarse surface does not change across the border of the ground: means over
    # bands a metre within and without agree.
    world = worlds.world()
    ground, outer = world.levels[0], world.levels[1]
    h = ground.half_extent_m
    along = np.linspace(-h, h, 4001)
    means = []
    for offset in (-1.5, -0.75, 0.0, 0.75, 1.5):
        sides = [np.stack(np.broadcast_arrays(*side), axis=-1)
                 for side in ((along, h + offset), (h + offset, along))]
        means.append(np.mean([world.height_at(side) for side in sides]))
    steps = np.diff(means)
    # Slopes of terrain over 0.75 m, averaged over 100 m of border: centimetres, no step.
    assert np.abs(steps).max() < 0.1
    assert outer.contains((h + 1.5, 0.0))


def test_each_crater_is_drawn_where_it_is_resolved():
    """On its level it spans 8 cells or more, 6 on the ground, and it reaches that level.

    What would be coarser than 24 cells, and lies wholly on the next finer level, is drawn there.
    """
    world = worlds.world()
    craters, levels = world.craters, world.levels
    place = np.abs(craters.position_m).max(axis=1)
    for k, level in enumerate(levels):
        here = craters.level == k
        assert here.sum() > 20
        cells = craters.diameter_m[here] / level.cell_m
        assert cells.min() >= (8.0 if k else 6.0)
        assert cells.min() < (8.2 if k else 6.2)
        # Ejecta of those beyond it reach it.
        assert np.all(place[here] <= level.half_extent_m + 2.0 * craters.diameter_m[here])
        if k:
            finer = levels[k - 1].half_extent_m - 64 * levels[k - 1].cell_m
            inside = place[here] + 1.3 * craters.diameter_m[here] < finer
            assert np.all(cells[inside] >= 24.0)
            # Craters of the levels between came down from the coarser one.
            came = (craters.level == k - 1) & (craters.diameter_m >= 8.0 * level.cell_m)
            assert craters.diameter_m[came].max() < 24.0 * level.cell_m


def test_the_origin_of_a_made_up_world_is_its_height_over_nothing():
    """Level ground has none; else it is the relief at the origin, which was taken off."""
    assert worlds.small(**worlds.BARE).report['origin_height_m'] == 0.0
    assert worlds.small().report['origin_height_m'] != 0.0


WIDE = {'size_m': 12.8, 'surroundings': {'extent_m': 6000.0, 'samples': 513}}
CORNER_M = 6.4 * 2.0**0.5


@pytest.fixture(scope='module')
def plain():
    """Return a bare world without relief, to 6.5 km and more."""
    return build_world(WorldConfig.from_mapping({**worlds.BARE, **WIDE}), 0)


def fallen(level):
    """Return the (n, n) drop of a level by the formula [m]."""
    x = nest.axis_m(level.n, level.cell_m)
    return np.maximum(x**2 + x[:, None]**2 - CORNER_M**2, 0.0) / (2.0 * 1737.4e3)


def test_the_drop_is_that_of_the_sphere(plain):
    assert not plain.ground.heights_m.any()
    for level in plain.levels[1:]:
        # At the border, a chord of the next level's cells: c^2 / 8R.
        chord = (8.0 * level.cell_m)**2 / (8.0 * MOON_RADIUS_M)
        assert np.abs(level.heights_m + fallen(level)).max() < 2e-6 + chord
    far = plain.levels[-1]
    assert far.half_extent_m > 6000.0
    assert far.heights_m[far.n // 2, -1] == pytest.approx(-far.half_extent_m**2 / 3474.8e3,
                                                          abs=1e-4)


def test_the_parabola_is_the_sphere():
    r = np.array([1600.0, 5000.0, 20000.0])
    assert drop_m(r**2, 0.0) == pytest.approx(
        MOON_RADIUS_M - np.sqrt(MOON_RADIUS_M**2 - r**2), abs=0.005)
    assert drop_m(1600.0**2, 0.0) == pytest.approx(0.737, abs=0.001)


def test_measured_terrain_is_bent_too(tmp_path):
    (tmp_path / 'dem.yaml').write_text('size: [300, 300]\npixel_size: [50.0, -50.0]\n')
    np.save(tmp_path / 'dem.npy', np.full((300, 300), 250.0, np.float32))
    config = {**worlds.BARE, **WIDE, 'source': 'dem', 'path': str(tmp_path)}
    world = build_world(WorldConfig.from_mapping(config), 0)
    assert world.report['origin_height_m'] == pytest.approx(250.0, abs=1e-3)
    assert np.abs(world.ground.heights_m).max() < 1e-4
    for level in world.levels[1:]:
        chord = (8.0 * level.cell_m)**2 / (8.0 * MOON_RADIUS_M)
        assert np.abs(level.heights_m + fallen(level)).max() < 1e-4 + chord


@pytest.mark.parametrize('height_m', [0.5, 3.0])
@pytest.mark.parametrize('above_rad', [1e-4, -1e-4])
def test_the_sun_sets_behind_the_horizon_of_the_sphere(plain, height_m, above_rad):
    """The horizon lies sqrt(2 h / R) below the horizontal, 0.8 and 1.9 mrad.

    The last ground of a plane, 6.5 km away, would be 0.1 and 0.5 mrad below it.
    """
    elevation = above_rad - np.sqrt(2.0 * height_m / MOON_RADIUS_M)
    light = Sunlight(plain, SunConfig(azimuth_deg=90.0, elevation_deg=np.degrees(elevation)),
                     ReflectanceConfig(), np.array([0.0, np.cos(elevation), np.sin(elevation)]),
                     indirect=False)
    seen = light.angle_above_horizon(np.array([[0.0, 0.0, height_m]]))
    assert np.sign(seen) == np.sign(above_rad)


@pytest.mark.parametrize('size_m,samples,extent_m', [
    (12.8, 65, 50.0), (51.2, 161, 1000.0), (3.2, 67, 700.0), (6.4, 257, 6.5), (25.6, 65, 20000.0)])
def test_the_plan_is_the_smallest_nest_that_covers_the_surroundings(size_m, samples, extent_m):
    """Each level begins and ends on samples of the next, an even number of its cells apart."""
    config = WorldConfig.from_mapping({'size_m': size_m, 'cell_m': 0.05, 'surroundings': {
        'samples': samples, 'extent_m': extent_m}})
    levels = nest.plan(config)
    assert levels[0] == (config.samples, 0.05)
    half_m = [0.5 * (n - 1) * cell for n, cell in levels]
    assert half_m[-1] >= extent_m and all(half < extent_m for half in half_m[:-1])
    for (n, cell), (wider, coarse) in zip(levels, levels[1:]):
        assert coarse == cell * LEVEL_RATIO
        valid = [m for m in range(1, 4 * (n + samples)) if (m - 1) % (2 * LEVEL_RATIO) == 0
                 and m >= samples and (m - 1) * coarse >= 2.0 * (n - 1) * cell - 1e-9]
        assert wider == valid[0]
