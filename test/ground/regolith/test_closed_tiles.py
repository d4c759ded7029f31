"""Old tiles are closed: less memory, the same bits, wherever they are read, written, gathered."""

import numpy as np
import pytest

from lunar_rover_sim.ground.regolith import overlay as module
from lunar_rover_sim.ground.regolith.overlay import CELL_M, Overlay, TILE, TILE_M
from lunar_rover_sim.ground.regolith.tracks import press
from lunar_rover_sim.ground.world.grid import HeightGrid


@pytest.fixture
def few_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """Close tiles from 30 on."""
    monkeypatch.setattr(module, '_OPEN', 30)


def put(overlay: Overlay, place: tuple[int, int], rng: np.random.Generator) -> None:
    values = rng.normal(0.0, 0.01, (2, 9, 11)) * (rng.random((2, 9, 11)) < 0.3)
    overlay.put(*place, values[0], np.abs(values[1]))


def same(one: Overlay, other: Overlay) -> bool:
    a, b = one.snapshot(), other.snapshot()
    return all(getattr(a, name).tobytes() == getattr(b, name).tobytes()
               for name in ('index', 'height_m', 'compaction_m'))


def drive(monkeypatch: pytest.MonkeyPatch, limit: int) -> list[object]:
    """Return what an overlay tells along a way of 100 m and back."""
    monkeypatch.setattr(module, '_OPEN', limit)
    overlay, rng, told = Overlay(), np.random.default_rng(3), []
    way = [(160 * k, 40 * k) for k in range(120)]
    mirror, seen = Overlay(), 0
    for n, (ix, iy) in enumerate(way + way[::-1][:60]):
        overlay.gather(ix * CELL_M, iy * CELL_M, 0.3, 0.2)
        put(overlay, (ix + int(rng.integers(-5, 5)), iy), rng)
        if n % 3 == 0:
            changes = overlay.take_changes()
            mirror.apply(changes)
            told += [changes.index.tobytes(), changes.height_m.tobytes(),
                     sorted(overlay.tiles_since(seen)), sorted(overlay.tiles_since(seen // 2, 40))]
            seen = overlay.writes
        told.append([values.tobytes() for values in overlay.window(ix - 800, iy - 200, 400, 200)])
        told.append(overlay.at((ix - 157) * CELL_M, (iy - 39) * CELL_M))
    mirror.apply(overlay.take_changes())
    assert same(overlay, mirror) and same(overlay, overlay.copy())
    kept = overlay.copy()
    put(overlay, way[3], rng)
    overlay.restore(kept)
    told += [overlay.snapshot().height_m.tobytes(), overlay.take_changes().index.tobytes(),
             overlay.sums_m(), overlay.residue_m, len(overlay.tiles_since(0))]
    return told


def test_nothing_tells_whether_tiles_are_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reads, changes, tiles since a write, a mirror, a copy, restoring it: bit by bit."""
    assert drive(monkeypatch, 30) == drive(monkeypatch, 10**9)


@pytest.mark.usefixtures('few_open')
def test_memory_of_a_long_way_is_that_of_what_it_changed() -> None:
    """A strip of prints of 1 km: the index is bounded, and most tiles are closed."""
    overlay, rng = Overlay(), np.random.default_rng(1)
    for k in range(2000):
        overlay.gather(0.5 * k, 0.0, 1.0, 1.0)
        put(overlay, (100 * k, -5), rng)
    assert overlay.near.slots.nbytes < 10_000 and len(overlay.near.samples) < 200
    changed = len(overlay.snapshot())
    assert overlay.memory_bytes < 200 * 3600 + 8 * changed + 160 * 2 * 2000
    assert {key for key in overlay.tiles_since(0)} == {
        (x // TILE, y // TILE) for k in range(2000) for x in (100 * k, 100 * k + 10)
        for y in (-5, 3)}


@pytest.mark.usefixtures('few_open')
def test_a_print_on_old_tracks_is_that_on_tracks_that_were_never_closed() -> None:
    """Compiled code finds them where they were gathered; negative zeros keep their sign."""
    ground, prints = HeightGrid(np.zeros((401, 401), np.float32), 0.025), []
    for away in (0, 60):
        overlay, rng = Overlay(), np.random.default_rng(7)
        put(overlay, (-8, -4), rng)
        overlay.put(12, 0, np.full((1, 1), -0.0), np.full((1, 1), 0.001))
        for k in range(away):
            put(overlay, (100 + 30 * k, 300), rng)
        overlay.gather(0.0, 0.0, 0.3, 0.5)
        tile = overlay.near.slots[-overlay.near.origin[1], -overlay.near.origin[0]]
        assert tile >= 0 and overlay.near.centre[2] == 0.5
        overlay.residue_m = 0.0
        press(overlay, ground, (0.0, 0.0, 0.006), (0.01, 0.0, 0.004), 0.008, 0.6)
        prints.append([values.tobytes() for values in overlay.window(-40, -40, 80, 80)])
        size = overlay.near.slots.shape[0] * TILE_M
        assert 1.6 <= size <= 1.9
    assert prints[0] == prints[1]
