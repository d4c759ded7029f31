"""Rocks and albedo read back from built worlds; the library of shapes."""

import dataclasses

import numpy as np
import pytest
from scipy import stats
import trimesh
import worlds

from lunar_rover_sim.base.frames import matrix_from_wxyz
from lunar_rover_sim.ground.world import rockfield, shapes
from lunar_rover_sim.ground.world.config import RockConfig
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.shapes import library


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
    rocks = world.rocks
    low, high = spans(rocks, matrix_from_wxyz(rocks.orientation_wxyz))
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


def test_where_there_would_be_too_many_the_smallest_are_left_out():
    world = worlds.small(rocks={'abundance': 0.05, 'max_per_m2': 0.6})
    assert 70 <= len(world.rocks) <= 130
    everything = worlds.small(rocks={'abundance': 0.05})
    assert len(everything.rocks) > 200
    assert world.rocks.diameter_m.min() > everything.rocks.diameter_m.min()


def test_ten_thousand_rocks_find_a_place():
    ground = HeightGrid(np.zeros((513, 513), np.float32), 0.1)
    config = RockConfig(abundance=0.035, min_diameter_m=0.01)
    rocks, _ = rockfield.scatter(config, 1, ground, LIBRARY, Craters.join([]), 1.0)
    assert len(rocks) > 10_000


def test_shapes_are_convex_closed_and_of_unit_size():
    library = shapes.library()
    assert len({shape.name for shape in library}) == len(library)
    kinds = [shape.name.split('_')[0] for shape in library]
    assert min(kinds.count(kind) for kind in ('angular', 'rounded')) >= 8
    for shape in library:
        pieces = shape.convex()
        assert sum(len(piece.faces) for piece in pieces) == len(shape.faces)
        for piece in pieces:
            mesh = trimesh.Trimesh(piece.vertices, piece.faces, process=False)
            assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0
            # No corner lies before a face: exactly convex.
            corners = piece.vertices[piece.faces].astype(float)
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            offset = np.einsum('fi,fi->f', normal, corners[:, 0])
            assert (piece.vertices.astype(float) @ normal.T - offset).max() < 1e-12
        # As many triangles as legs and images have time for.
        assert len(shape.faces) <= 480 and max(len(p.vertices) for p in pieces) <= 128
        hull = trimesh.Trimesh(shape.vertices, process=False).convex_hull
        assert 0.05 < hull.volume < 0.5
        assert np.allclose(hull.center_mass, 0.0, atol=1e-5)
        flat = shape.vertices[:, :2]
        widest = np.linalg.norm(flat[:, None] - flat[None], axis=-1).max()
        assert widest == pytest.approx(1.0, abs=4e-6)
        assert 0.3 < np.ptp(shape.vertices[:, 2]) < 1.1
        assert not shape.vertices.flags.writeable


def test_pieces_are_one_rock_with_ledges():
    """They overlap, none is hidden in another, and the rock has notches that its hull has not."""
    several = [shape for shape in shapes.library() if shape.pieces]
    assert len(several) >= 6
    for shape in several:
        pieces = [trimesh.Trimesh(p.vertices, p.faces) for p in shape.convex()]
        hull = trimesh.Trimesh(shape.vertices).convex_hull
        points = np.random.default_rng(1).uniform(*hull.bounds, (40000, 3))
        points = points[_within(hull, points)]
        inside = np.array([_within(piece, points) for piece in pieces])
        assert inside.any(axis=0).mean() < 0.99
        for k, own in enumerate(inside):
            others = np.delete(inside, k, axis=0).any(axis=0)
            assert (own & others).any() and (own & ~others).any()


def _within(mesh, points):
    """Return which points lie in a convex mesh."""
    distance = np.einsum('fi,fi->f', mesh.face_normals, mesh.triangles[:, 0])
    return (points @ mesh.face_normals.T <= distance).all(axis=1)


def test_fragments_have_the_measured_axes():
    """The longest diameter a, b across it, c across both: 1 : 0.7 : 0.5 (Fujiwara et al. 1978)."""
    def longest(points):
        between = points[:, None] - points
        length = np.linalg.norm(between, axis=-1)
        return length.max(), between[np.unravel_index(length.argmax(), length.shape)]
    ratios = []
    for shape in shapes.library():
        points = shape.vertices.astype(float)
        a, along = longest(points)
        along /= a
        b, across = longest(points - np.outer(points @ along, along))
        ratios.append((b / a, np.ptp(points @ np.cross(along, across / b)) / a))
    assert np.mean(ratios, axis=0) == pytest.approx((0.71, 0.5), abs=0.06)
    assert np.all(np.std(ratios, axis=0) > 0.05)


def test_angular_shapes_have_sharp_edges():
    """Share of the surface in faces of more than 3 %: half of angular ones, little of others."""
    def flat(shape):
        mesh = trimesh.Trimesh(shape.convex()[0].vertices, shape.convex()[0].faces)
        normal = np.round(mesh.face_normals * 30.0)     # faces within two degrees are one
        _, which = np.unique(normal, axis=0, return_inverse=True)
        area = np.bincount(which.ravel(), mesh.area_faces) / mesh.area
        return area[area > 0.03].sum()
    for shape in shapes.library():
        share = flat(shape)
        assert share > 0.5 if shape.name.startswith('angular') else share < 0.35


@pytest.mark.parametrize('config,share', [({'angular': 0.2}, 0.2), ({'angular': 1.0}, 1.0),
                                          ({'site': 'surveyor_7', 'angular': 0.1}, 0.85)])
def test_a_share_of_rocks_is_angular(config, share):
    """Stones below 12 cm are of one piece; larger ones have all shapes of their kind."""
    rocks, _ = scatter(**config)
    names = np.array([LIBRARY[k].name for k in rocks.shape])
    found = np.mean([name.startswith('angular') for name in names])
    assert found == pytest.approx(share, abs=4.0 * np.sqrt(0.25 / len(rocks)))
    several = np.array([len(LIBRARY[k].pieces) > 1 for k in rocks.shape])
    assert not several[rocks.diameter_m < shapes.LEDGES_M].any()
    assert 0.15 < several[rocks.diameter_m >= shapes.LEDGES_M].mean() < 0.7


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
    ground = HeightGrid(np.zeros((801, 801), np.float32), 0.025)
    config = RockConfig(fillet=0.06, min_diameter_m=0.4, max_diameter_m=1.0, abundance=0.05)
    rocks, all_of_them = rockfield.scatter(config, 1, ground, library(), Craters.join([]), 0.0)
    raised = rockfield.fillets(config, ground, all_of_them)
    at_rocks = raised.height_at(rocks.position_m[:, :2]) / rocks.diameter_m
    assert len(rocks) > 5 and at_rocks.min() >= 0.0 and at_rocks.max() <= 0.121
    assert at_rocks.mean() == pytest.approx(0.06, abs=0.03)
    y, x = np.mgrid[-10:10:801j, -10:10:801j]
    away = np.min([np.hypot(x - px, y - py) / d for (px, py), d in zip(
        all_of_them.xy_m, rocks.size_classes_m[all_of_them.size])], axis=0)
    assert not raised.heights_m[away > 0.78].any()
    none = dataclasses.replace(config, fillet=0.0)
    assert rockfield.fillets(none, ground, all_of_them) is ground


LIBRARY = shapes.library()
N, CELL = 257, 0.1     # 25.6 m
MANY = {'max_height': 2.0, 'abundance': 0.06, 'min_diameter_m': 0.04, 'max_diameter_m': 1.0}


def scatter(east=0.0, north=0.0, craters=None, seed=0, clear_radius_m=0.0, **values):
    """Return rocks on a plane that rises by these slopes, and their rotation matrices."""
    axis = (np.arange(N) - (N - 1) / 2) * CELL
    heights = (east * axis + north * axis[:, None]).astype(np.float32)
    rocks, _ = rockfield.scatter(RockConfig(**{**MANY, **values}), seed,
                                 HeightGrid(heights, CELL), LIBRARY, craters or Craters.join([]),
                                 clear_radius_m)
    return rocks, matrix_from_wxyz(rocks.orientation_wxyz)


def spans(rocks, rotation):
    """Return the lowest and the highest point of each rock [m]."""
    low, high = np.empty(len(rocks)), np.empty(len(rocks))
    for i in range(len(rocks)):
        z = rocks.diameter_m[i] * (LIBRARY[rocks.shape[i]].vertices @ rotation[i].T)[:, 2]
        low[i], high[i] = rocks.position_m[i, 2] + z.min(), rocks.position_m[i, 2] + z.max()
    return low, high


@pytest.mark.parametrize('tilt_deg', [6.0, 15.0])
def test_on_level_ground_the_tilt_has_its_rms_in_every_direction(tilt_deg):
    """Two independent normal angles of tilt / sqrt(2): their length is Rayleigh distributed."""
    _, rotation = scatter(tilt_deg=tilt_deg)
    up = rotation[:, :, 2]
    angle = np.arccos(np.clip(up[:, 2], -1.0, 1.0))
    count = len(angle)
    assert count > 700
    # The mean square of a Rayleigh variable has a deviation of itself over sqrt(count).
    mean_square = np.mean(angle**2) / np.radians(tilt_deg)**2
    assert mean_square == pytest.approx(1.0, abs=4.0 / np.sqrt(count))
    expected = stats.rayleigh(scale=np.radians(tilt_deg) / np.sqrt(2.0))
    assert stats.kstest(angle, expected.cdf).statistic < 2.0 / np.sqrt(count)
    ahead = rotation[:, :, 0]
    for phase in (np.arctan2(up[:, 1], up[:, 0]), np.arctan2(ahead[:, 1], ahead[:, 0])):
        uniform = stats.uniform(-np.pi, 2.0 * np.pi)
        assert stats.kstest(phase, uniform.cdf).statistic < 2.0 / np.sqrt(count)


def test_tilt_and_turn_are_independent():
    _, rotation = scatter(tilt_deg=15.0)
    lean = np.arctan2(rotation[:, 1, 2], rotation[:, 0, 2])
    turn = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    between = np.mean(np.exp(1j * (lean - turn)))
    assert abs(between) < 4.0 / np.sqrt(len(lean))


@pytest.mark.parametrize('east,north', [(0.15, 0.0), (0.0, -0.15), (-0.1, 0.12)])
def test_without_chance_a_rock_stands_square_to_the_slope(east, north):
    _, rotation = scatter(east, north, tilt_deg=0.0)
    normal = np.array([-east, -north, 1.0]) / np.sqrt(1.0 + east**2 + north**2)
    # The slope is taken as the angle: off by its cube over 3.
    slope = np.hypot(east, north)
    angle = np.arccos(np.clip(rotation[:, :, 2] @ normal, -1.0, 1.0))
    assert angle.max() < slope**3 / 3.0 + 1e-3


@pytest.mark.parametrize('burial', [0.2, 0.35, 0.6])
def test_on_level_ground_the_buried_share_has_its_mean(burial):
    """None hovers, and none is gone: at least a little of every rock lies in the ground."""
    rocks, rotation = scatter(burial=burial, tilt_deg=5.0)
    low, high = spans(rocks, rotation)
    share = -low / (high - low)
    assert share.mean() == pytest.approx(burial, abs=0.02)
    assert share.max() < 1.0
    assert (-low / rocks.diameter_m).min() > 0.029
    # Shallow ones are many, deep ones few: a wide distribution.
    assert 0.1 < share.std() < 0.3


def test_rocks_stand_in_a_slope_as_on_level_ground():
    """The foot of a rock, 0.3 of its diameter down the slope, is not in the air."""
    rocks, rotation = scatter(0.2, 0.0, tilt_deg=0.0)
    low, high = spans(rocks, rotation)
    ground = 0.2 * rocks.position_m[:, 0]
    downhill = ground - 0.2 * 0.65 * 0.45 * rocks.diameter_m
    assert np.mean(low < downhill) > 0.99
    assert np.all(high > ground - 1e-6)


def test_places_are_spread_evenly_up_to_the_border():
    rocks, _ = scatter(max_diameter_m=0.2)
    half = 0.5 * (N - 1) * CELL
    for axis in (0, 1):
        # Rocks keep their diameter from the border: 0.2 m of 12.8 m at most.
        uniform = stats.uniform(-half, 2.0 * half)
        statistic = stats.kstest(rocks.position_m[:, axis], uniform.cdf).statistic
        assert statistic < 1.7 / np.sqrt(len(rocks)) + 0.02
    assert np.all(np.abs(rocks.position_m[:, :2]).max(axis=1) <= half - rocks.diameter_m)


def test_shapes_are_taken_at_random_and_albedos_vary_as_told():
    rocks, _ = scatter(albedo_variation=0.08)
    small = rocks.diameter_m < shapes.LEDGES_M
    for kind in ('angular', 'rounded'):
        for chosen in (small, ~small):
            counts = np.bincount(rocks.shape[chosen], minlength=len(LIBRARY))
            counts = [count for count, shape in zip(counts, LIBRARY) if shape.name.startswith(kind)
                      and not (shape.pieces and chosen is small)]
            assert stats.chisquare(counts).pvalue > 1e-4
    assert rocks.albedo.mean() == pytest.approx(1.0, abs=0.01)
    assert rocks.albedo.std() == pytest.approx(0.08, rel=0.08)
    assert np.ptp(scatter(albedo_variation=0.0)[0].albedo) == 0.0


def test_around_a_fresh_crater_rocks_gather_at_its_rim():
    """Density 1 + a exp(-((rho - 1.15) / 0.4)^2 / 2) about a new crater, rho in its radii.

    An old one (a quarter of its lifetime) gathers none.
    """
    def crater(age):
        return Craters(np.array([[3.0, -2.0]]), np.array([6.0]), np.array([age]),
                       np.zeros(1, np.int32))

    edges = np.array([0.0, 0.55, 1.0, 1.3, 1.75, 2.2, 3.2])

    def densities(age):
        count = np.zeros(len(edges) - 1)
        for seed in range(6):
            rocks, _ = scatter(craters=crater(age), near_craters=6.0, max_diameter_m=0.1,
                               abundance=0.012, min_diameter_m=0.01, seed=seed)
            rho = np.linalg.norm(rocks.position_m[:, :2] - [3.0, -2.0], axis=1) / 3.0
            count += np.histogram(rho, edges)[0]
        assert count.min() > 100
        return count / np.diff(edges**2)

    def expected(amplitude):
        rho = np.linspace(0.0, 3.2, 3201)
        law = 1.0 + amplitude * np.exp(-0.5 * ((rho - 1.15) / 0.4)**2)
        rings = np.histogram(rho, edges, weights=law * rho)[0]
        return rings / np.histogram(rho, edges, weights=rho)[0]

    for age, amplitude in ((0.0, 6.0), (0.125, 3.0), (0.25, 0.0), (0.8, 0.0)):
        found, law = densities(age), expected(amplitude)
        np.testing.assert_allclose(found / found[-1], law / law[-1], rtol=0.25)


def test_every_class_of_sizes_has_its_number():
    """Classes split the logarithm of the diameter evenly; each is as frequent as the law says."""
    config = RockConfig(abundance=0.01, min_diameter_m=0.03, max_diameter_m=0.12, size_classes=4)
    counts = np.zeros(4)
    seeds = 8
    for seed in range(seeds):
        rocks, _ = scatter(seed=seed, abundance=0.01, min_diameter_m=0.03, max_diameter_m=0.12,
                           size_classes=4)
        counts += np.bincount(rocks.size, minlength=4)
    edges = 0.03 * 4.0**(np.arange(5) / 4.0)
    np.testing.assert_allclose(rocks.size_classes_m, np.sqrt(edges[1:] * edges[:-1]), rtol=1e-7)
    above = rockfield.number_per_m2(config, edges) * ((N - 1) * CELL)**2 * seeds
    expected = above[:-1] - above[1:]
    # Poisson; a few of a crowd find no place.
    assert np.all(np.abs(counts - expected) < 4.0 * np.sqrt(expected) + 0.02 * expected)
    assert counts[-1] > 20


def test_over_a_pit_a_rock_sinks_until_only_its_crown_is_left():
    """Holes of one sample, 3 m deep: the foot cannot reach the floor, and the rock stays in sight.

    At least 15 % of its height stand out over the lower of the ground at its middle and the mean
    of the ground around it.
    """
    rng = np.random.default_rng(0)
    heights = np.where(rng.random((N, N)) < 0.1, -3.0, 0.0).astype(np.float32)
    ground = HeightGrid(heights, CELL)
    config = RockConfig(**{**MANY, 'burial': 0.15, 'tilt_deg': 0.0, 'min_diameter_m': 0.3})
    rocks, _ = rockfield.scatter(config, 0, ground, LIBRARY, Craters.join([]), 0.0)
    low, high = spans(rocks, matrix_from_wxyz(rocks.orientation_wxyz))
    ring = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    around = 0.45 * rocks.diameter_m[:, None, None] * np.stack([np.cos(ring), np.sin(ring)], -1)
    xy = rocks.position_m[:, :2]
    level = np.minimum(ground.height_at(xy), ground.height_at(xy[:, None] + around).mean(axis=1))
    standing = (high - level) / (high - low)
    assert len(rocks) > 20
    assert np.mean(standing > 0.149) > 0.97
    # Many are sunk as far as that goes.
    assert np.mean(np.abs(standing - 0.15) < 0.002) > 0.3
