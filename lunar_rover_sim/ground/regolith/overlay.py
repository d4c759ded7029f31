"""Changes of the ground by the rover: height and compaction on a sparse fine grid.

The sample (ix, iy) lies at x = 5 mm ix, y = 5 mm iy; whole numbers, 0 at the origin of the world.
Samples exist in tiles of 20 x 20 (10 cm) around what was touched; elsewhere both values are 0.
Larger tiles would hold more of what is not touched: a track is 2 to 4 cm wide.

Height change [m] is added to the height of the untouched world. Compaction [m] is the height that
a column of soil has lost by being pressed together: heights and compaction add up to 0 over the
whole overlay, but for the rounding to float32, which `residue_m` carries on to the next change.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping
import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

CELL_M = 0.005
TILE = 20
TILE_M = TILE * CELL_M
TileKey = tuple[int, int]
_OPEN = 4096        # tiles that are open before old ones are closed: 15 MB
_MARGIN = 32        # tiles around what is reserved that compiled code can reach, too
_NUMBER = 8         # bytes of the number of the last write


class NearTiles(NamedTuple):
    """The tiles around a place, for compiled code.

    Attributes:
        slots: (rows, columns) int32, which tile of `samples` lies where; -1: none.
        origin: (2,) tx and ty of its first one.
        samples: (tiles, 2, TILE, TILE) float32, height change and compaction [m].
        centre: (3,) x and y of the place, and how far from it in x and y a rover may go [m].
    """

    slots: NDArray[np.int32]
    origin: NDArray[np.int64]
    samples: NDArray[np.float32]
    centre: NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class GroundChanges:
    """Values of samples, absolute, so that the newest message on a sample is all that counts.

    Attributes:
        index: (n, 2) int32, ix and iy, sorted.
        height_m: (n,) float32.
        compaction_m: (n,) float32.
    """

    index: NDArray[np.int32]
    height_m: NDArray[np.float32]
    compaction_m: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.index)


@dataclasses.dataclass(frozen=True)
class _Tile:
    """Views of the samples of a tile in the pool, (TILE, TILE) each."""

    height: NDArray[np.float32]
    compaction: NDArray[np.float32]
    changed: NDArray[np.bool_]


class Overlay:
    """The changes of the ground; arrays are indexed [iy, ix] as those of a HeightGrid.

    Tiles that were written long ago are closed: of what they hold only numbers other than 0 are
    kept, bit for bit, which is a fifth of the memory. All methods read and open them as needed.

    Attributes:
        near: For compiled code, which reads and writes these arrays; `gather`, `reserve` and
            writes may replace them.
        changed: (tiles, TILE, TILE) which samples have changed since `take_changes`.
        writes: number of writes.
        residue_m: what rounding to float32 has left of all changes [m].
    """

    def __init__(self) -> None:
        self.near = NearTiles(np.full((1, 1), -1, np.int32), np.zeros(2, np.int64),
                              np.zeros((0, 2, TILE, TILE), np.float32),
                              np.array([0.0, 0.0, math.inf]))
        self.changed = np.zeros((0, TILE, TILE), bool)
        self._open: dict[TileKey, int] = {}         # place in `samples`
        self._free: list[int] = []                  # places that hold no tile
        self._closed: dict[TileKey, bytes] = {}
        self._dirty: set[TileKey] = set()
        # Tile → number of its last write: of open tiles, in the order of these. A tile that was
        # opened again is in `_reopened` until it is written to.
        self._written: dict[TileKey, int] = {}
        self._reopened: dict[TileKey, int] = {}
        self._last_closed = 0       # greatest number of a closed or reopened tile
        self.writes = 0
        self.residue_m = 0.0

    # Reading

    def tiles_since(self, writes: int, side: int = TILE) -> list[TileKey]:
        """Return the tiles written since `self.writes` had a value; 0: all.

        Args:
            writes: that value.
            side: samples of a tile along one side, a multiple of TILE.

        Returns:
            Tiles (tx, ty), each once: the samples from (side tx, side ty) on.
        """
        tiles: dict[TileKey, None] = {}
        for (tx, ty), number in reversed(self._written.items()):
            if number <= writes:
                break
            tiles[tx * TILE // side, ty * TILE // side] = None
        if writes < self._last_closed:
            numbers = {key: _number(data) for key, data in self._closed.items()}
            for (tx, ty), number in {**numbers, **self._reopened}.items():
                if number > writes:
                    tiles[tx * TILE // side, ty * TILE // side] = None
        return list(tiles)

    def height_change(self, xy_m: ArrayLike) -> NDArray[np.float64]:
        """Return the height change [m] at (..., 2) positions [m], bilinear between samples."""
        return self._interpolate(xy_m, 'height')

    def compaction(self, xy_m: ArrayLike) -> NDArray[np.float64]:
        """Return the compaction [m] at (..., 2) positions [m], bilinear between samples."""
        return self._interpolate(xy_m, 'compaction')

    def at(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return height change and compaction [m] at one position, bilinear."""
        xy = (x_m, y_m)
        return float(self.height_change(xy)), float(self.compaction(xy))

    def window(self, ix: int, iy: int, nx: int,
               ny: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return copies of height change and compaction, (ny, nx), from the sample (ix, iy) on."""
        height, compaction = np.zeros((ny, nx)), np.zeros((ny, nx))
        for key, there, here in pieces(ix, iy, nx, ny, self):
            tile = self._read(key)
            height[here] = tile.height[there]
            compaction[here] = tile.compaction[there]
        return height, compaction

    def __contains__(self, key: object) -> bool:
        return key in self._open or key in self._closed

    @property
    def memory_bytes(self) -> int:
        """Memory of the samples."""
        return len(self._open) * TILE * TILE * 9 + sum(map(len, self._closed.values()))

    def sums_m(self) -> tuple[float, float]:
        """Return the sums of height change and of compaction over all samples [m]."""
        # Sums by `fsum` do not depend on the order.
        tiles = [self._read(key) for key in self._keys()]
        return (math.fsum(v for t in tiles for v in t.height[t.height != 0.0].tolist()),
                math.fsum(v for t in tiles for v in t.compaction[t.compaction != 0.0].tolist()))

    # Writing

    def put(self, ix: int, iy: int, height_m: NDArray[np.float64],
            compaction_m: NDArray[np.float64]) -> None:
        """Write a window back, rounded to float32, and take the rounding into the residue."""
        height, compaction = height_m.astype(np.float32), compaction_m.astype(np.float32)
        self.residue_m += float((height_m - height).sum() + (compaction_m - compaction).sum())
        ny, nx = height.shape
        for key, there, here in pieces(ix, iy, nx, ny):
            if key not in self and not (height[here].any() or compaction[here].any()):
                continue
            tile = self._make(key)
            tile.changed[there] |= ((tile.height[there] != height[here])
                                    | (tile.compaction[there] != compaction[here]))
            tile.height[there] = height[here]
            tile.compaction[there] = compaction[here]
            self._note_write(key)

    def gather(self, x_m: float, y_m: float, reach_m: float, way_m: float) -> None:
        """Let compiled code reach all tiles around a rover that goes on from a place.

        Args:
            x_m, y_m: Place of the rover [m].
            reach_m: How far around itself it touches the ground [m].
            way_m: How far from the place it may go in x and y until the next call [m].
        """
        span = reach_m + way_m
        low = [math.floor((v - span) / TILE_M) for v in (x_m, y_m)]
        high = [math.floor((v + span) / TILE_M) + 1 for v in (x_m, y_m)]
        self._look_at(low, high)
        for key in [(tx, ty) for ty in range(low[1], high[1]) for tx in range(low[0], high[0])]:
            if key in self._closed:
                self._make(key)
        self.near = self.near._replace(centre=np.array([x_m, y_m, way_m]))

    def reserve(self, ix: int, iy: int, nx: int, ny: int) -> list[TileKey]:
        """Make all tiles of a window, and return them: for compiled code that writes to them."""
        low = ix // TILE, iy // TILE
        high = (ix + nx - 1) // TILE + 1, (iy + ny - 1) // TILE + 1
        keys = [(tx, ty) for ty in range(low[1], high[1]) for tx in range(low[0], high[0])]
        first, size = self.near.origin, self.near.slots.shape[::-1]
        if np.any(low < first) or np.any(high > first + size):
            self._look_at(np.array(low) - _MARGIN, np.array(high) + _MARGIN)
        for key in keys:
            if key not in self._open:
                self._make(key)
        return keys

    def note_writes(self, keys: Iterable[TileKey]) -> None:
        """Take down that compiled code has written to tiles."""
        for key in keys:
            self._note_write(key)

    def apply(self, changes: GroundChanges) -> None:
        """Take over the values of another overlay."""
        tiles, inside = np.divmod(changes.index, TILE)
        order = np.lexsort((tiles[:, 1], tiles[:, 0]))
        begins = np.flatnonzero(np.any(np.diff(tiles[order], axis=0), axis=1)) + 1
        for chosen in np.split(order, begins):
            if not len(chosen):
                continue
            key = int(tiles[chosen[0], 0]), int(tiles[chosen[0], 1])
            tile = self._make(key)
            there = inside[chosen, 1], inside[chosen, 0]
            tile.height[there] = changes.height_m[chosen]
            tile.compaction[there] = changes.compaction_m[chosen]
            tile.changed[there] = True
            self._note_write(key)

    def _note_write(self, key: TileKey) -> None:
        self._dirty.add(key)
        self.writes += 1
        self._written.pop(key, None)
        self._reopened.pop(key, None)
        self._written[key] = self.writes

    def take_changes(self) -> GroundChanges:
        """Return the samples that have changed since the last call, and forget that they did."""
        changes = self._collect(sorted(self._dirty), only_changed=True)
        for key in self._dirty:
            number = self._open.get(key)
            if number is None:
                data = self._closed[key]
                self._closed[key] = _closed(_number(data), *_opened(data)[:2])
            else:
                self.changed[number] = False
        self._dirty.clear()
        return changes

    def snapshot(self) -> GroundChanges:
        """Return all samples that are not 0."""
        return self._collect(sorted(self._keys()), only_changed=False)

    def copy(self) -> Overlay:
        """Return an independent overlay of the same values, with nothing changed since."""
        other = Overlay()
        other.restore(self)
        other.take_changes()
        return other

    def restore(self, other: Overlay) -> None:
        """Take over all values of another overlay; what differs counts as changed."""
        for key in sorted({*self._keys(), *other._keys()}):
            tile, source = self._make(key), other._read(key)
            height, compaction = source.height, source.compaction
            tile.changed[:] |= (tile.height != height) | (tile.compaction != compaction)
            tile.height[:] = height
            tile.compaction[:] = compaction
            self._note_write(key)
        self.residue_m = other.residue_m

    def state(self) -> dict[str, Any]:
        """Return all values, and which of them have changed since `take_changes`."""
        changed = self._collect(sorted(self._dirty), only_changed=True)
        return {'all': self.snapshot(), 'changed': changed, 'residue_m': self.residue_m}

    def resume(self, state: Mapping[str, Any]) -> None:
        """Take over what `state` has returned, of another overlay too."""
        self.restore(Overlay())
        for changes in (state['all'], state['changed']):
            self.apply(changes)
        self.take_changes()
        self.apply(state['changed'])
        self.residue_m = state['residue_m']

    def _collect(self, keys: list[TileKey], only_changed: bool) -> GroundChanges:
        index, heights, compactions = [], [], []
        for key in keys:
            tile = self._read(key)
            chosen = tile.changed if only_changed else (
                (tile.height != 0.0) | (tile.compaction != 0.0))
            jy, jx = np.nonzero(chosen)
            index.append(np.stack([jx + key[0] * TILE, jy + key[1] * TILE], axis=-1))
            heights.append(tile.height[chosen])
            compactions.append(tile.compaction[chosen])
        if not index:
            return GroundChanges(np.zeros((0, 2), np.int32), np.zeros(0, np.float32),
                                 np.zeros(0, np.float32))
        return GroundChanges(np.concatenate(index).astype(np.int32), np.concatenate(heights),
                             np.concatenate(compactions))

    def _keys(self) -> list[TileKey]:
        return [*self._open, *self._closed]

    def _tile_at(self, number: int) -> _Tile:
        samples = self.near.samples
        return _Tile(samples[number, 0], samples[number, 1], self.changed[number])

    def _read(self, key: TileKey) -> _Tile:
        """Return a tile, to be read; one of zeros if there is none."""
        number = self._open.get(key)
        if number is not None:
            return self._tile_at(number)
        data = self._closed.get(key)
        return _NO_TILE if data is None else _Tile(*_opened(data))

    def _make(self, key: TileKey) -> _Tile:
        """Return an open tile, which is made if there is none."""
        number = self._open.get(key)
        if number is None:
            number = self._open[key] = self._place()
            data = self._closed.pop(key, None)
            tile = self._tile_at(number)
            if data is None:
                tile.height[:], tile.compaction[:], tile.changed[:] = 0.0, 0.0, False
            else:
                tile.height[:], tile.compaction[:], tile.changed[:] = _opened(data)
                if _number(data):
                    self._reopened[key] = _number(data)
            self._enter(key, number)
        return self._tile_at(number)

    def _place(self) -> int:
        """Return a place for a tile."""
        if not self._free:
            if len(self._open) > _OPEN:
                self._close_old()
            count = len(self.near.samples)
            if not self._free:
                more = max(8, count // 4)
                self.near = self.near._replace(samples=np.concatenate(
                    [self.near.samples, np.zeros((more, 2, TILE, TILE), np.float32)]))
                self.changed = np.concatenate([self.changed, np.zeros((more, TILE, TILE), bool)])
                self._free = list(reversed(range(count, count + more)))
        return self._free.pop()

    def _close_old(self) -> None:
        """Close the tiles that were written first, half of those that compiled code leaves."""
        old = [key for key in [*self._reopened, *self._written] if not self._is_near(key)]
        silent = [key for key in self._open if key not in self._written
                  and key not in self._reopened and not self._is_near(key)]
        for key in silent + old[:len(old) // 2]:
            number = self._open.pop(key)
            write = self._written.pop(key, 0) or self._reopened.pop(key, 0)
            self._free.append(number)
            self._last_closed = max(self._last_closed, write)
            tile = self._tile_at(number)
            if write or tile.changed.any():     # others were reserved only
                self._closed[key] = _closed(write, tile.height, tile.compaction, tile.changed)

    def _look_at(self, low: ArrayLike, high: ArrayLike) -> None:
        """Let compiled code see the tiles from `low` to before `high`, (2,) each."""
        low, high = np.array(low), np.array(high)
        slots = np.full((high - low)[::-1], -1, np.int32)
        self.near = self.near._replace(slots=slots, origin=low.astype(np.int64))
        for key, number in self._open.items():
            self._enter(key, number)

    def _is_near(self, key: TileKey) -> bool:
        rows, columns = self.near.slots.shape
        x, y = self.near.origin.tolist()
        return x <= key[0] < x + columns and y <= key[1] < y + rows

    def _enter(self, key: TileKey, number: int) -> None:
        """Let compiled code see an open tile, if it is near."""
        if self._is_near(key):
            x, y = self.near.origin.tolist()
            self.near.slots[key[1] - y, key[0] - x] = number

    def _interpolate(self, xy_m: ArrayLike, name: str) -> NDArray[np.float64]:
        grid = np.asarray(xy_m, dtype=float) / CELL_M
        low = np.floor(grid)
        u, v = np.moveaxis(grid - low, -1, 0)
        ix, iy = np.moveaxis(low.astype(np.int64), -1, 0)
        result = np.zeros(grid.shape[:-1])
        for dx, dy, weight in ((0, 0, (1.0 - u) * (1.0 - v)), (1, 0, u * (1.0 - v)),
                               (0, 1, (1.0 - u) * v), (1, 1, u * v)):
            result += weight * self._samples(ix + dx, iy + dy, name)
        return result

    def _samples(self, ix: NDArray[np.int64], iy: NDArray[np.int64],
                 name: str) -> NDArray[np.float64]:
        values = np.zeros(np.shape(ix))
        tx, ty = ix // TILE, iy // TILE
        for key in sorted(set(zip(np.ravel(tx).tolist(), np.ravel(ty).tolist()))):
            if key in self:
                chosen = (tx == key[0]) & (ty == key[1])
                values[chosen] = getattr(self._read(key), name)[iy[chosen] % TILE,
                                                                ix[chosen] % TILE]
        return values


_SHAPE = (3, TILE, TILE)
_BITS = -(-math.prod(_SHAPE) // 8)
_NO_TILE = _Tile(np.zeros(_SHAPE[1:], np.float32), np.zeros(_SHAPE[1:], np.float32),
                 np.zeros(_SHAPE[1:], bool))


def _closed(write: int, height: NDArray[np.float32], compaction: NDArray[np.float32],
            changed: NDArray[np.bool_] = _NO_TILE.changed) -> bytes:
    """Return a tile as bytes: number of its last write, what is not 0, and the values there."""
    values = np.stack([height, compaction])
    held = values.view(np.uint32) != 0
    bits = np.packbits(np.concatenate([held, changed[None]]))
    return write.to_bytes(_NUMBER, 'little') + bits.tobytes() + values[held].tobytes()


def _opened(data: bytes) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Return height, compaction and what has changed of a tile, (TILE, TILE) each."""
    bits = np.frombuffer(data, np.uint8, _BITS, _NUMBER)
    held = np.unpackbits(bits, count=math.prod(_SHAPE)).reshape(_SHAPE).astype(bool)
    values = np.zeros((2, TILE, TILE), np.float32)
    values[held[:2]] = np.frombuffer(data, np.float32, offset=_NUMBER + _BITS)
    return values[0], values[1], held[2]


def _number(data: bytes) -> int:
    """Return the number of the last write of a closed tile; 0: none."""
    return int.from_bytes(data[:_NUMBER], 'little')


_Piece = tuple[TileKey, tuple[slice, slice], tuple[slice, slice]]


def pieces(ix: int, iy: int, nx: int, ny: int,
           tiles: Container[TileKey] | None = None) -> Iterator[_Piece]:
    """Yield (tile, its slices, slices of the window) of a window that begins at (ix, iy).

    Args:
        ix, iy, nx, ny: First sample of the window, and its size.
        tiles: Those to yield; None: all.
    """
    for ty in range(iy // TILE, (iy + ny - 1) // TILE + 1):
        y0, y1 = max(iy, ty * TILE), min(iy + ny, (ty + 1) * TILE)
        for tx in range(ix // TILE, (ix + nx - 1) // TILE + 1):
            if tiles is not None and (tx, ty) not in tiles:
                continue
            x0, x1 = max(ix, tx * TILE), min(ix + nx, (tx + 1) * TILE)
            yield ((tx, ty),
                   (slice(y0 - ty * TILE, y1 - ty * TILE), slice(x0 - tx * TILE, x1 - tx * TILE)),
                   (slice(y0 - iy, y1 - iy), slice(x0 - ix, x1 - ix)))
