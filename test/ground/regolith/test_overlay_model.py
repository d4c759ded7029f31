"""The overlay against a plain dictionary of samples, over any order of writing and reading."""

import numpy as np
import pytest

from lunar_rover_sim.ground.regolith.overlay import CELL_M, GroundChanges, Overlay, TILE

Values = dict[tuple[int, int], tuple[float, float]]


def put(overlay: Overlay, model: Values, rng: np.random.Generator, empty: bool = False) -> None:
    """Write a window somewhere around the corners of tiles, into both."""
    ix, iy = (int(v) for v in rng.integers(-50, 45, 2))
    nx, ny = (int(v) for v in rng.integers(1, 9, 2))
    height = np.zeros((ny, nx)) if empty else rng.normal(size=(ny, nx)).astype(np.float32)
    compaction = np.abs(height) * (rng.random((ny, nx)) < 0.7)
    overlay.put(ix, iy, height.astype(float), compaction.astype(float))
    for j in range(ny):
        for i in range(nx):
            model[ix + i, iy + j] = float(height[j, i]), float(np.float32(compaction[j, i]))


def values(changes: GroundChanges) -> Values:
    """Return what changes say, by sample; no sample occurs twice."""
    found = {(int(x), int(y)): (float(h), float(c)) for (x, y), h, c in zip(
        changes.index, changes.height_m, changes.compaction_m)}
    assert len(found) == len(changes)
    return found


def known(model: Values) -> Values:
    """Return the samples that are not 0."""
    return {at: value for at, value in model.items() if value != (0.0, 0.0)}


@pytest.mark.parametrize('seed', range(4))
def test_it_holds_what_was_written(seed):
    rng, overlay, model = np.random.default_rng(seed), Overlay(), {}
    before: Values = {}
    for turn in range(12):
        put(overlay, model, rng)
        if turn % 3 == 2:
            changes = overlay.take_changes()
            expected = {at: value for at, value in model.items()
                        if value != before.get(at, (0.0, 0.0))}
            assert values(changes) == expected
            assert changes.index.dtype == np.int32 and changes.height_m.dtype == np.float32
            before = dict(model)
            assert len(overlay.take_changes()) == 0
    assert values(overlay.snapshot()) == known(model)
    ix, iy = -55, -52
    height, compaction = overlay.window(ix, iy, 110, 108)
    for j in range(108):
        for i in range(110):
            assert (height[j, i], compaction[j, i]) == model.get((ix + i, iy + j), (0.0, 0.0))
    sums = np.array(list(model.values())).sum(axis=0)
    assert overlay.sums_m() == pytest.approx(tuple(sums), abs=1e-9)


@pytest.mark.parametrize('seed', range(3))
def test_positions_are_bilinear_between_samples(seed):
    """Also across the borders of tiles, and on samples themselves."""
    rng, overlay, model = np.random.default_rng(seed), Overlay(), {}
    for _ in range(60):
        put(overlay, model, rng)
    places = np.concatenate([rng.uniform(-50.0, 50.0, (200, 2)),
                             rng.integers(-50, 50, (60, 2)).astype(float),
                             [[-0.5, 3.25], [39.5, -0.75], [-40.25, 39.75], [39.25, 39.5],
                              [-1.0, 39.0], [-40.0, -1.0]]])
    for x, y in places:
        ix, iy = int(np.floor(x)), int(np.floor(y))
        u, v = x - ix, y - iy
        corners = [model.get((ix + i, iy + j), (0.0, 0.0)) for j in (0, 1) for i in (0, 1)]
        weights = [(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v]
        expected = tuple(np.dot(weights, corners))
        xy = (x * CELL_M, y * CELL_M)
        # A position on a sample may fall to either side of it by rounding.
        assert overlay.at(*xy) == pytest.approx(expected, abs=1e-9)
        assert overlay.height_change(xy) == pytest.approx(expected[0], abs=1e-9)
        assert overlay.compaction(xy) == pytest.approx(expected[1], abs=1e-9)
    many = overlay.height_change(places.reshape(2, -1, 2) * CELL_M)
    assert many.shape == (2, len(places) // 2)
    np.testing.assert_allclose(many.ravel(), overlay.height_change(places * CELL_M))


def test_tiles_are_told_since_any_write():
    overlay, order = Overlay(), []
    for k, (tx, ty) in enumerate([(0, 0), (1, 0), (-2, 3), (0, 0), (1, -1)]):
        overlay.put(tx * TILE + 2, ty * TILE + 3, np.full((1, 1), k + 1.0), np.zeros((1, 1)))
        order.append((tx, ty))
        assert overlay.writes == k + 1
    for since in range(6):
        assert set(overlay.tiles_since(since)) == set(order[since:])
        assert len(overlay.tiles_since(since)) == len(set(order[since:]))
    assert overlay.memory_bytes == 4 * TILE * TILE * (4 + 4 + 1)


def test_nothing_written_where_nothing_is_makes_no_tile():
    overlay, model = Overlay(), {}
    put(overlay, model, np.random.default_rng(1), empty=True)
    assert overlay.writes == 0 and overlay.memory_bytes == 0 and len(overlay.snapshot()) == 0
    # Where a tile is, zeros are values.
    overlay.put(1, 1, np.ones((1, 1)), np.zeros((1, 1)))
    overlay.take_changes()
    overlay.put(1, 1, np.zeros((1, 1)), np.zeros((1, 1)))
    assert values(overlay.take_changes()) == {(1, 1): (0.0, 0.0)}
    # Compaction alone makes a tile too.
    overlay.put(-90, 7, np.zeros((1, 1)), np.full((1, 1), 0.25))
    assert values(overlay.snapshot()) == {(-90, 7): (0.0, 0.25)}


def test_a_copy_is_independent_and_restoring_it_tells_what_differs():
    rng, overlay, model = np.random.default_rng(5), Overlay(), {}
    for _ in range(6):
        put(overlay, model, rng)
    overlay.residue_m = 0.125
    other, kept = overlay.copy(), dict(model)
    assert other.residue_m == 0.125 and len(other.take_changes()) == 0
    overlay.take_changes()
    for _ in range(3):
        put(overlay, model, rng)
    overlay.put(200, -200, np.ones((1, 1)), np.ones((1, 1)))
    overlay.residue_m = 0.5
    model[200, -200] = 1.0, 1.0
    overlay.take_changes()
    writes = overlay.writes
    overlay.restore(other)
    differ = {at: kept.get(at, (0.0, 0.0)) for at, value in model.items()
              if value != kept.get(at, (0.0, 0.0))}
    assert values(overlay.take_changes()) == differ
    assert values(overlay.snapshot()) == values(other.snapshot()) == known(kept)
    assert overlay.residue_m == 0.125 and overlay.writes > writes
    assert (200 // TILE, -200 // TILE) in overlay.tiles_since(writes)


def test_rounding_goes_to_the_residue():
    overlay = Overlay()
    third, fifth = np.full((2, 3), 1.0 / 3.0), np.full((2, 3), 0.2)
    overlay.put(0, 0, third, fifth)
    height, compaction = overlay.sums_m()
    assert height + compaction + overlay.residue_m == pytest.approx(6.0 / 3.0 + 1.2, abs=1e-15)
    assert overlay.residue_m == pytest.approx(
        6.0 * (1.0 / 3.0 - float(np.float32(1.0 / 3.0)) + 0.2 - float(np.float32(0.2))), rel=1e-9)


def test_changes_are_taken_over_whatever_their_order():
    rng, overlay, model = np.random.default_rng(8), Overlay(), {}
    for _ in range(9):
        put(overlay, model, rng)
    changes = overlay.snapshot()
    order = rng.permutation(len(changes))
    other = Overlay()
    other.apply(GroundChanges(changes.index[order], changes.height_m[order],
                              changes.compaction_m[order]))
    assert values(other.snapshot()) == known(model) == values(other.take_changes())
    assert set(other.tiles_since(0)) == {(x // TILE, y // TILE) for x, y in known(model)}
    other.apply(GroundChanges(np.zeros((0, 2), np.int32), np.zeros(0, np.float32),
                              np.zeros(0, np.float32)))
    assert values(other.snapshot()) == known(model) and len(other.take_changes()) == 0
