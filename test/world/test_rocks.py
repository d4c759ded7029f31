"""Rocks and albedo read back from built worlds; the library of shapes."""

import dataclasses

import numpy as np
import pytest
import trimesh
import worlds

from lunar_rover_sim.frames import matrix_from_wxyz
from lunar_rover_sim.world import rockfield, shapes
from lunar_rover_sim.world.config import RockConfig
from lunar_rover_sim.world.craters import Craters
from lunar_rover_sim.world.grid import HeightGrid
from lunar_rover_sim.world.shapes import library


def extents(world):
    """Return the lowest and highest point of each rock [m]."""
    rocks = world.rocks
    rotation = matrix_from_wxyz(rocks.orientation_wxyz)
    low, high = np.empty(len(rocks)), np.empty(len(rocks))
    for i in range(len(rocks)):
        z = (world.rock_shapes[rocks.shape[i]].vertices @ rotation[i].T)[:, 2]
        low[i], high[i] = z.min(), z.max()
    d = rocks.diameter_m
    return rocks.position_m[:, 2] + d * low, rocks.position_m[:, 2] + d * high


def test_rock_numbers_read_back():
    world = worlds.world()
    config, area = world.config.rocks, world.config.size_m ** 2
    diameter = world.rocks.diameter_m
    for edge in np.geomspace(0.03, 2.0, config.size_classes + 1)[:-6:3]:
        expected = float(rockfield.number_per_m2(config, edge)) * area
        # Poisson; a few of a crowd find no place.
        assert abs((diameter > edge).sum() - expected) < 4.0 * np.sqrt(expected) + 0.02 * expected
    assert 1500 < len(diameter) < 2500
    assert len(world.rocks.size_classes_m) <= 32


def test_rock_area_is_that_of_the_published_law():
    # F(>D) = k exp(-q D): the area of all rocks above 0.1 m, from the numbers.
    config = RockConfig()
    edge = np.geomspace(0.1, config.max_diameter_m, 4000)
    number = rockfield.number_per_m2(config, edge)
    middle = 0.5 * (edge[1:] + edge[:-1])
    area = np.sum(-np.diff(number) * np.pi / 4.0 * middle ** 2)
    q = rockfield.decay_per_m(config)
    expected = config.abundance * (np.exp(-q * 0.1) - np.exp(-q * config.max_diameter_m))
    assert area == pytest.approx(expected, rel=1e-3)
    assert q == pytest.approx(0.5648 + 0.01258 / 0.0125)


def test_rocks_sit_in_the_ground():
    world = worlds.world()
    low, high = extents(world)
    rocks = world.rocks
    ground = world.height_at(rocks.position_m[:, :2])
    assert np.all(low < ground)
    # A few small ones lie below the soil that has gathered around a large one.
    assert np.mean(high > ground - 0.02 * rocks.diameter_m) > 0.98
    standing = (high - ground) / rocks.diameter_m
    # Demidov & Basilevsky (2014): they stand out by about 0.6 of the diameter, or less.
    assert 0.3 < standing.mean() < 0.6
    # The ground below the middle of a rock is not quite the mean around it.
    assert np.mean(standing > world.config.rocks.max_height + 0.03) < 0.02
    buried = (ground - low) / (high - low)
    assert buried.mean() == pytest.approx(world.config.rocks.burial, abs=0.15)
    assert np.allclose(np.linalg.norm(rocks.orientation_wxyz, axis=1), 1.0)
    # None hovers: the rim of the foot is below ground too, for nearly all.
    angle = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    around = 0.3 * rocks.diameter_m[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    lowest = world.height_at(rocks.position_m[:, None, :2] + around).min(axis=1)
    assert np.mean(low < lowest) > 0.995


def test_rocks_do_not_overlap_or_block_the_start():
    world = worlds.world()
    xy, diameter = world.rocks.position_m[:, :2], world.rocks.diameter_m
    assert np.all(np.linalg.norm(xy, axis=1) >= world.config.clear_radius_m + 3.0 * diameter)
    gap = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
    np.fill_diagonal(gap, np.inf)
    assert np.all(gap >= 0.45 * (diameter[:, None] + diameter[None]) - 1e-9)
    assert np.all(np.abs(xy).max(axis=1) <= world.ground.half_extent_m)


def test_rocks_gather_around_fresh_craters():
    world = worlds.small(craters={'density': 0.2, 'age_exponent': 0.1, 'min_diameter_m': 2.0,
                                  'max_diameter_m': 3.0},
                         rocks={'abundance': 0.02, 'near_craters': 30.0})
    xy = world.rocks.position_m[:, :2]
    fresh = world.craters.select((world.craters.age < 0.1)
                                 & (np.abs(world.craters.position_m).max(axis=1) < 6.0))
    assert len(fresh)
    nearest = np.min(np.linalg.norm(xy[:, None] - fresh.position_m, axis=-1)
                     / (0.5 * fresh.diameter_m), axis=1)
    rng = np.random.default_rng(0)
    uniform = rng.uniform(-6.4, 6.4, (20000, 2))
    chance = np.min(np.linalg.norm(uniform[:, None] - fresh.position_m, axis=-1)
                    / (0.5 * fresh.diameter_m), axis=1)
    assert np.mean(nearest < 1.6) > 1.5 * np.mean(chance < 1.6)


def test_most_rocks_leaves_out_the_smallest(caplog):
    world = worlds.small(rocks={'abundance': 0.05, 'max_number': 100})
    assert 90 <= len(world.rocks) <= 100
    assert 'rocks.max_number' in caplog.text
    everything = worlds.small(rocks={'abundance': 0.05})
    assert len(everything.rocks) > 200
    assert world.rocks.diameter_m.min() > everything.rocks.diameter_m.min()


def test_no_rocks():
    assert len(worlds.small(rocks={'abundance': 0.0}).rocks) == 0


def test_ten_thousand_rocks():
    world = worlds.world(rocks={'abundance': 0.035, 'min_diameter_m': 0.01},
                         surroundings={'extent_m': 60.0, 'samples': 513})
    assert len(world.rocks) > 10_000


def test_shapes_are_convex_closed_and_of_unit_size():
    library = shapes.library()
    assert len(library) >= 12
    assert len({shape.name for shape in library}) == len(library)
    kinds = {shape.name.split('_')[0] for shape in library}
    assert kinds == {'faceted', 'rounded'}
    for shape in library:
        mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.is_convex
        assert 0.1 < mesh.volume < 0.6  # positive: faces look outward
        assert np.allclose(mesh.center_mass, 0.0, atol=1e-6)
        flat = shape.vertices[:, :2]
        widest = np.linalg.norm(flat[:, None] - flat[None], axis=-1).max()
        assert widest == pytest.approx(1.0, abs=1e-6)
        height = np.ptp(shape.vertices[:, 2])
        assert 0.4 < height < 1.0
        assert len(shape.vertices) <= 128
        assert not shape.vertices.flags.writeable

    # Faceted and rounded differ: the largest face takes a larger part of the surface.
    def largest(shape):
        mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
        facets = mesh.facets_area
        return max([*facets, mesh.area_faces.max()]) / mesh.area
    faceted = np.mean([largest(s) for s in library if s.name.startswith('faceted')])
    rounded = np.mean([largest(s) for s in library if s.name.startswith('rounded')])
    assert faceted > 2.0 * rounded


def test_albedo_varies_about_one():
    world = worlds.world()
    assert world.albedo.dtype == np.float32
    assert world.albedo.shape == world.ground.heights_m.shape
    assert world.albedo.mean() == pytest.approx(1.0, abs=0.003)
    assert 0.02 < world.albedo.std() < 0.1
    border = np.concatenate([world.albedo[0], world.albedo[-1], world.albedo[:, 0],
                             world.albedo[:, -1]])
    assert np.all(border == 1.0)


@pytest.mark.parametrize('site,counts', [
    ('surveyor_1', (382, 130, 30, 3.0)), ('surveyor_7', (1619, 639, 181, 25))])
def test_sites_have_the_stones_that_surveyor_counted(site, counts):
    """More than 3, 5, 10 and 30 cm per 100 m2 (NASA SP-184)."""
    config = RockConfig(site=site, max_diameter_m=20.0)
    found = 100.0 * rockfield.number_per_m2(config, np.array([0.03, 0.05, 0.1, 0.3]))
    np.testing.assert_allclose(found, counts, rtol=0.03)


def test_soil_gathers_around_rocks():
    """Highest at the rock, of 0 to two times the mean height; none beyond 0.77 diameters."""
    ground = HeightGrid(np.zeros((401, 401), np.float32), 0.025)
    config = RockConfig(fillet=0.06, min_diameter_m=0.4, max_diameter_m=1.0, abundance=0.05)
    rocks = rockfield.scatter(config, ground, library(), Craters.join([]), 0.0,
                              np.random.default_rng(1))
    raised = rockfield.fillets(config, ground, rocks, np.random.default_rng(2))
    at_rocks = raised.height_at(rocks.position_m[:, :2]) / rocks.diameter_m
    assert len(rocks) > 5 and at_rocks.min() >= 0.0 and at_rocks.max() <= 0.121
    assert at_rocks.mean() == pytest.approx(0.06, abs=0.03)
    y, x = np.mgrid[-5:5:401j, -5:5:401j]
    away = np.min([np.hypot(x - px, y - py) / d for (px, py, _), d in zip(
        rocks.position_m, rocks.diameter_m)], axis=0)
    assert not raised.heights_m[away > 0.78].any()
    none = dataclasses.replace(config, fillet=0.0)
    assert rockfield.fillets(none, ground, rocks, np.random.default_rng(2)) is ground
